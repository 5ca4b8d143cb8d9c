"""Flights that do not show enough are refused, each for its own reason and with what would help."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation.errors import NotIdentifiable
from groundstation.flightdata import FlightData
from groundstation.identification.identifiability import never_moved, revealed
from groundstation.identification.pipeline import identify
from groundstation.identification.preparation import prepare
from groundstation.identification.record_model import RecordModel
from groundstation.identification.results import MASS_AND_TENSOR, Estimate, Identification
from groundstation.model.parameters import FitOptions
from groundstation.paths import find_config
from groundstation.trajectory import Coefficients, Plan, load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from sim.scenario import load_scenario
from studies.flown import flight_data


def channels(**scale: float) -> Plan:
    """Table 2's plan at twice the pace for 15 s, each channel scaled and without yaw offset; channels not named stand
    still.
    """
    plan = load_plan(find_config("plans", "paper_table2"))
    kept = {}
    for name in ("x", "y", "z", "yaw"):
        channel, factor = getattr(plan.coefficients, name), scale.get(name, 0.0)
        kept[name] = channel.model_copy(
            update={
                "a": [factor * v for v in channel.a],
                "b": [factor * v for v in channel.b],
                "c": 0.0 if name == "yaw" else channel.c,
            }
        )
    w = 2.0 * plan.base_frequency_rad_s
    return plan.model_copy(update={"coefficients": Coefficients(**kept), "base_frequency_rad_s": w, "periods": 3.0})


def flown(plan: Plan) -> FlightData:
    """A flight of this plan in the laboratory, seed 1."""
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    return flight_data(simulate(vehicle, plan, load_scenario(find_config("scenarios", "lab")), 1))


def refused(plan: Plan) -> NotIdentifiable:
    """The refusal of a flight of this plan in the laboratory."""
    with pytest.raises(NotIdentifiable) as refusal:
        identify([flown(plan)])
    assert refusal.value.exit_status == 3
    assert "excitation" in refusal.value.remedy
    return refusal.value


def test_a_hover_is_refused() -> None:
    refusal = refused(channels())
    assert "hover" in refusal.reason
    assert {"ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2"} <= set(refusal.not_identifiable)
    assert "mass_kg" not in refusal.not_identifiable


def answered(plan: Plan, *shown: str) -> Identification:
    """What a flight of this plan gives, the parameters ``shown`` within their intervals and half of them again."""
    flight = flown(plan)
    assert flight.truth is not None
    found = identify([flight])
    parameters, truth = found.methods[found.best].parameters, flight.truth.parameters()
    for name in shown:
        estimate = parameters[name]
        assert abs(estimate.value - truth[name]) < 3.0 * estimate.std + 0.01 * truth[name], name
    assert not set(found.not_identifiable) & set(parameters)
    return found


def test_a_flight_that_only_yaws_gives_mass_and_yaw_inertia_and_says_why_no_more() -> None:
    found = answered(channels(yaw=1.0), "mass_kg", "izz_kg_m2")
    assert "one axis only (yaw)" in found.warnings[0]
    assert {"ixx_kg_m2", "iyy_kg_m2"} <= set(found.not_identifiable)


def test_a_straight_line_gives_mass_and_its_one_moment() -> None:
    found = answered(channels(x=0.3), "mass_kg")
    assert "one axis only (pitch)" in found.warnings[0]
    assert {"ixx_kg_m2", "izz_kg_m2"} <= set(found.not_identifiable)
    assert "iyy_kg_m2" in found.methods[found.best].parameters


def test_a_line_aslant_to_the_body_shows_no_product_and_no_yaw_inertia() -> None:
    plan = channels(x=0.3)
    x = plan.coefficients.x
    y = x.model_copy(update={"a": [0.7 * v for v in x.a], "b": [0.7 * v for v in x.b]})
    yaw = plan.coefficients.yaw.model_copy(update={"c": -0.3})
    aslant = plan.model_copy(update={"coefficients": plan.coefficients.model_copy(update={"y": y, "yaw": yaw})})
    found = answered(aslant, "mass_kg")
    assert found.warnings
    assert {"ixy_kg_m2", "izz_kg_m2"} <= set(found.not_identifiable)


def test_a_gentle_flight_about_all_axes_gives_its_mass_and_what_turned_enough() -> None:
    found = answered(channels(x=0.12, y=0.12, z=0.5, yaw=1.0), "mass_kg", "izz_kg_m2")
    assert not any("one axis only" in text and "izz" in text for text in found.warnings)


def test_a_plan_that_drowns_in_the_disturbance_still_gives_the_mass() -> None:
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    lab = load_scenario(find_config("scenarios", "lab"))
    rough = lab.model_copy(update={"disturbance": lab.disturbance.model_copy(update={"torque_share": 0.05})})
    flight = flight_data(simulate(vehicle, channels(x=0.1, y=0.1, z=0.1, yaw=0.1), rough, 1))
    found = identify([flight])
    parameters = found.methods[found.best].parameters
    assert flight.truth is not None
    assert parameters["mass_kg"].value == pytest.approx(flight.truth.mass_kg, rel=0.01)
    assert {"ixx_kg_m2", "iyy_kg_m2"} <= set(found.not_identifiable)
    assert not set(found.not_identifiable) & set(parameters)


def motion_of(plan: Plan) -> RecordModel:
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    flight = flight_data(simulate(vehicle, plan, load_scenario(find_config("scenarios", "clean")), 1))
    return RecordModel(prepare(flight).record)


def test_singular_values_say_what_a_motion_acts_on_before_any_fit() -> None:
    """Yaw alone makes torque through Izz (and mass through the height it holds); what all of Izz makes is what the
    rotors made.
    """
    model = motion_of(channels(yaw=1.0))
    vehicle = model.record.vehicle
    found = revealed([model], vehicle, FitOptions(lag=False))
    assert [each.share for each in found] == sorted((each.share for each in found), reverse=True)
    weights = np.array([list(each.combination.values()) for each in found])
    np.testing.assert_allclose(weights @ weights.T, np.eye(len(MASS_AND_TENSOR)), atol=1e-9)
    yaw = max(found, key=lambda each: abs(each.combination["izz_kg_m2"]))
    roll = max(found, key=lambda each: abs(each.combination["ixx_kg_m2"]))
    assert yaw.share > 20.0 * roll.share


def test_what_a_motion_never_moves_is_told_with_what_would() -> None:
    """The same record with level, unturning rotors and gyro: the tensor acts on nothing, the mass still does."""
    model = motion_of(channels(z=1.0))
    record = model.record
    even = replace(record.motors, value=np.repeat(record.motors.value.mean(axis=1, keepdims=True), 4, axis=1))
    still = RecordModel(replace(record, rate_rad_s=np.zeros_like(record.rate_rad_s), motors=even))
    hidden = never_moved(revealed([still], record.vehicle, FitOptions(lag=False)))
    assert set(hidden) == set(MASS_AND_TENSOR) - {"mass_kg"}
    assert "roll" in hidden["ixx_kg_m2"]


def test_a_lag_carries_what_the_interval_of_the_commands_leaves_open():
    told = Estimate.time(0.03, 0.001, 0.01)
    assert told.std == pytest.approx(np.hypot(0.001, 0.01 / np.sqrt(12.0)))
    assert told.ci95 == pytest.approx((0.03 - 1.96 * told.std, 0.03 + 1.96 * told.std))
    assert Estimate.time(-0.001, 0.001).value == 0.0 and Estimate.time(-0.001, 0.001).ci95[0] == 0.0
