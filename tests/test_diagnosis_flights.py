"""Whole flights with something hidden in them: what is named first, how big, and when the answer is another one."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from flights import laboratory

from groundstation.diagnosis import diagnose
from groundstation.diagnosis.results import Diagnosis
from groundstation.flightdata import FlightData
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import RotorLag, load_vehicle
from sim.flight import simulate
from sim.scenario import load_scenario
from studies.flown import flight_data

PERIODS = 4.0
SEED = 7


def _flight(**effects: dict[str, Any]) -> FlightData:
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": PERIODS})
    return flight_data(simulate(vehicle, plan, laboratory(**effects), SEED))


@cache
def _diagnosis_of(name: str) -> Diagnosis:
    planted: dict[str, dict[str, dict[str, Any]]] = {
        "nothing": {},
        "weak_rotor": {"weak_rotor": {"rotor": 3, "loss": 0.05}},
        "rotor_drag": {"rotor_drag": {"drag_kg_s": (0.25, 0.25)}},
        "payload_change": {"payload_change": {"mass_kg": 0.1, "time_s": 15.0}},
        "com_offset": {"com_offset": {"offset_m": (0.006, -0.004, 0.0)}},
        "attracting_wall": {"attracting_wall": {"strength_n_m3": 3.0}},
    }
    return diagnose([_flight(**planted[name])])


def _assert_near(diagnosis: Diagnosis, name: str, truth: float) -> None:
    estimate = diagnosis.findings[0].parameters[name]
    assert abs(estimate.value - truth) < max(4.0 * estimate.std, 0.2 * abs(truth)), (name, estimate, truth)


def test_a_flight_with_nothing_hidden_is_clean():
    diagnosis = _diagnosis_of("nothing")
    assert diagnosis.verdict == "clean", diagnosis.findings
    assert diagnosis.findings == () and diagnosis.unexplained == ()


def test_a_weak_rotor_is_named_first_with_its_number_and_loss():
    diagnosis = _diagnosis_of("weak_rotor")
    assert (diagnosis.findings[0].effect, diagnosis.findings[0].rotor) == ("weak_rotor", 3)
    _assert_near(diagnosis, "loss", 0.05)


def test_rotor_drag_is_named_first_with_its_size_on_both_axes():
    diagnosis = _diagnosis_of("rotor_drag")
    assert diagnosis.findings[0].effect == "rotor_drag"
    _assert_near(diagnosis, "d_x_kg_s", 0.25)
    _assert_near(diagnosis, "d_y_kg_s", 0.25)


def test_drag_put_in_makes_the_sideways_error_smaller_on_blocks_no_fit_has_seen():
    error = _diagnosis_of("rotor_drag").error["held_out"]
    for channel in ("force_x_n", "force_y_n"):
        assert error["after"][channel] < error["before"][channel], channel
    assert error["after"]["force_z_n"] < 1.1 * error["before"]["force_z_n"]


def test_a_lost_load_is_named_first_with_its_mass():
    diagnosis = _diagnosis_of("payload_change")
    assert diagnosis.findings[0].effect == "payload_change"
    _assert_near(diagnosis, "mass_change_kg", -0.1)


def test_the_mass_beside_a_lost_load_is_the_vehicles_own_without_it():
    truth = _flight(payload_change={"mass_kg": 0.1, "time_s": 15.0}).truth
    assert truth is not None
    assert abs(_diagnosis_of("payload_change").parameters_after["mass_kg"].value / truth.mass_kg - 1.0) < 0.005


def test_a_motor_and_its_propeller_are_a_lag_and_nothing_else_and_bend_neither_mass_nor_moments():
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    vehicle = vehicle.model_copy(update={"rotors": vehicle.rotors.model_copy(update={"speed_source": "command"})})
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": PERIODS})
    simulated = simulate(vehicle, plan, laboratory(motor_lag={"hover_s": 0.05, "propeller_share": 0.4}), SEED)
    diagnosis = diagnose([flight_data(simulated)])
    assert [f.effect for f in diagnosis.findings] == ["motor_lag"], diagnosis.findings
    found, truth = diagnosis.findings[0].parameters, simulated.truth
    assert 0.2 < found["rotor_lag_slope"].value < 0.7
    assert 0.045 < found["rotor_lag_up_s"].value < 0.06
    assert abs(diagnosis.parameters_after["mass_kg"].value / truth.mass_kg - 1.0) < 0.01
    for axis in ("xx", "yy", "zz"):
        own = getattr(truth.inertia_kg_m2, axis)
        assert abs(diagnosis.parameters_after[f"i{axis}_kg_m2"].value / own - 1.0) < 0.02, axis


def test_a_centre_of_mass_beside_the_origin_is_named_first_with_its_place():
    diagnosis = _diagnosis_of("com_offset")
    assert diagnosis.findings[0].effect == "com_offset"
    _assert_near(diagnosis, "com_offset_x_m", 0.006)
    _assert_near(diagnosis, "com_offset_y_m", -0.004)


def test_rotors_that_bend_the_yaw_inertia_are_named_and_the_inertia_comes_back():
    """Rotors that follow their commands with a lag, as all do; their measured speeds are noisy, and the torque is their
    derivative.
    """
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": PERIODS})
    scenario = laboratory(rotor_gyroscopic={"inertia_kg_m2": 4e-5})
    truth = scenario.truth.model_copy(update={"lag": RotorLag(up_s=0.03, down_s=0.04)})
    flight = flight_data(simulate(vehicle, plan, scenario.model_copy(update={"truth": truth}), SEED))
    assert flight.truth is not None
    diagnosis = diagnose([flight])
    assert diagnosis.findings[0].effect == "rotor_gyroscopic"
    _assert_near(diagnosis, "rotor_inertia_kg_m2", 4e-5)
    own = flight.truth.inertia_kg_m2.zz
    before, after = diagnosis.parameters_before["izz_kg_m2"], diagnosis.parameters_after["izz_kg_m2"]
    assert abs(before.value / own - 1.0) > 0.5
    assert abs(after.value - own) < max(0.02 * own, 3.0 * after.std)


def test_a_battery_that_sags_is_named_and_the_mass_comes_back():
    """Its voltage is sampled at 10 Hz with noise, and drops under load: neither may pass for the course of the
    thrust.
    """
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    vehicle = vehicle.model_copy(update={"rotors": vehicle.rotors.model_copy(update={"speed_source": "command"})})
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": PERIODS})
    flight = flight_data(simulate(vehicle, plan, laboratory(battery_sag={"strength": 0.9}), SEED))
    assert flight.truth is not None
    diagnosis = diagnose([flight])
    assert [finding.effect for finding in diagnosis.findings] == ["battery_sag"]
    _assert_near(diagnosis, "exponent", 0.9)
    before, after = diagnosis.parameters_before["mass_kg"], diagnosis.parameters_after["mass_kg"]
    assert before.value > 1.05 * flight.truth.mass_kg
    assert abs(after.value / flight.truth.mass_kg - 1.0) < 0.01


def test_a_wall_that_attracts_which_no_file_models_does_not_pass_for_clean():
    diagnosis = _diagnosis_of("attracting_wall")

    assert diagnosis.verdict != "clean"  # it is told from a tether only by what a gentle flight does not show


def test_a_flight_of_a_second_is_refused_and_says_what_would_help():
    flight = _flight()
    assert flight.window_s is not None
    begin = flight.window_s[0]
    short = replace(flight, window_s=(begin, begin + 0.5))
    diagnosis = diagnose([short])
    assert diagnosis.verdict == "refused"
    assert diagnosis.reason and not diagnosis.findings
    assert diagnosis.to_dict()["verdict"] == "refused"


@pytest.mark.slow
def test_flights_whose_accelerometers_have_other_biases_are_clean_together():
    """Every power-on has its own bias: 0.05 m/s^2 more on the second flight is none of the vehicle's, and varies with
    nothing.
    """
    vehicle, plan = load_vehicle(find_config("vehicles", "qball2")), load_plan(find_config("plans", "qball2"))
    scenario = load_scenario(find_config("scenarios", "clean"))
    first, second = (
        flight_data(simulate(vehicle, plan.model_copy(update={"periods": 3.0}), scenario, seed)) for seed in (1, 2)
    )
    assert second.imu is not None
    moved = second.imu.values + np.array([0.0, 0.0, 0.0, 0.05, -0.03, 0.0])
    found = diagnose([first, replace(second, imu=replace(second.imu, values=moved))])
    assert (found.verdict, found.findings) == ("clean", ())
    assert len(found.by_flight) == 2
    assert found.by_flight[1]["mass_kg"].value == pytest.approx(found.by_flight[0]["mass_kg"].value, rel=1e-3)
