"""Flights that do not show enough are refused, each for its own reason and with what would help."""

from __future__ import annotations

import pytest
from flights import flight_data

from groundstation.errors import NotIdentifiable
from groundstation.identification.pipeline import identify
from groundstation.paths import find_config
from groundstation.trajectory import Coefficients, Plan, load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from sim.scenario import load_scenario


def channels(**scale: float) -> Plan:
    """Table 2's plan at twice the pace for 15 s, each channel scaled and without yaw offset; channels not named stand still."""
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


def refused(plan: Plan) -> NotIdentifiable:
    """The refusal of a flight of this plan in the laboratory."""
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    flight = flight_data(simulate(vehicle, plan, load_scenario(find_config("scenarios", "lab")), 1))
    with pytest.raises(NotIdentifiable) as refusal:
        identify([flight])
    assert refusal.value.exit_status == 3
    assert "excitation" in refusal.value.remedy
    return refusal.value


def test_a_hover_is_refused() -> None:
    refusal = refused(channels())
    assert "hover" in refusal.reason
    assert {"ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2"} <= set(refusal.not_identifiable)
    assert "mass_kg" not in refusal.not_identifiable


def test_a_flight_that_only_yaws_is_refused_for_its_one_axis() -> None:
    refusal = refused(channels(yaw=1.0))
    assert "one axis only (yaw)" in refusal.reason
    assert {"ixx_kg_m2", "iyy_kg_m2"} <= set(refusal.not_identifiable)
    assert "izz_kg_m2" not in refusal.not_identifiable


def test_a_straight_line_is_refused_for_its_one_axis() -> None:
    refusal = refused(channels(x=0.3))
    assert "one axis only (pitch)" in refusal.reason
    assert {"ixx_kg_m2", "izz_kg_m2"} <= set(refusal.not_identifiable)
    assert "iyy_kg_m2" not in refusal.not_identifiable
