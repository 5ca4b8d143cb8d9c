"""What no force model tells, planted in whole flights: clocks, frames, lag, dead time and scales, found within their
intervals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from flights import laboratory

from groundstation.diagnosis import diagnose, kinematic
from groundstation.diagnosis.kinematic import kinematic_findings
from groundstation.diagnosis.results import Finding
from groundstation.flightdata import FlightData
from groundstation.frames import quat_exp, quat_multiply, quat_rotate
from groundstation.identification.preparation import prepare
from groundstation.identification.results import Estimate
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import Vehicle, load_vehicle, vehicle_from_dict, vehicle_to_dict
from sim.flight import simulate
from sim.scenario import RotorLag
from studies.effect_sizes import TRUE
from studies.flown import flight_data

SEED = 7
ONCE_IN_A_THOUSAND = 3.3
"""Standard deviations that an estimate leaves its truth by once in a thousand times."""


def _flown(vehicle: Vehicle, *, truth: dict[str, Any] | None = None, **effects: dict[str, Any]) -> FlightData:
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": 4.0})
    scenario = laboratory(**effects)
    scenario = scenario.model_copy(update={"truth": scenario.truth.model_copy(update=truth or {})})
    return flight_data(simulate(vehicle, plan, scenario, SEED))


def _qball(**changed: Any) -> Vehicle:
    """As declared, with these keys of its [rotors] and [identification]."""
    document = vehicle_to_dict(load_vehicle(find_config("vehicles", "qball2")))
    for section, values in changed.items():
        document[section] = {**document.get(section, {}), **values}
    return vehicle_from_dict(document)


def _assert_within(estimate: Estimate, truth: float) -> None:
    assert abs(estimate.value - truth) < ONCE_IN_A_THOUSAND * estimate.std, (estimate, truth)


def _turned_imu(flight: FlightData, *rotation_rad: float) -> FlightData:
    """v_body = exp(rotation) v_imu."""
    assert flight.imu is not None
    back, values = quat_exp(-np.array(rotation_rad)), flight.imu.values.copy()
    values[:, :3], values[:, 3:6] = (quat_rotate(back, values[:, i : i + 3]) for i in (0, 3))
    return replace(flight, imu=replace(flight.imu, values=values))


def _poses(flight: FlightData, position: np.ndarray, quaternion: np.ndarray) -> FlightData:
    assert flight.mocap is not None
    values = np.concatenate([position, quaternion, flight.mocap.values[:, 7:]], axis=1)
    return replace(flight, mocap=replace(flight.mocap, values=values))


def _turned_markers(flight: FlightData, *rotation_rad: float) -> FlightData:
    assert flight.mocap is not None
    p, q = flight.mocap.values[:, :3], flight.mocap.values[:, 3:7]
    return _poses(flight, p, quat_multiply(q, quat_exp(np.array(rotation_rad))))


def _shifted_markers(flight: FlightData, *offset_m: float) -> FlightData:
    assert flight.mocap is not None
    p, q = flight.mocap.values[:, :3], flight.mocap.values[:, 3:7]
    return _poses(flight, p + quat_rotate(q, np.array(offset_m)), q)


def _tilted_room(flight: FlightData, *tilt_rad: float) -> FlightData:
    """Poses as given in a world that is itself turned about x and y."""
    assert flight.mocap is not None
    p, q = flight.mocap.values[:, :3], flight.mocap.values[:, 3:7]
    seen = quat_exp(-np.array([*tilt_rad, 0.0]))
    return _poses(flight, quat_rotate(seen, p), quat_multiply(seen, q))


def _late_stamps(flight: FlightData, offset_s: float, drift: float = 0.0) -> FlightData:
    assert flight.mocap is not None
    t = flight.mocap.t_s
    return replace(flight, mocap=replace(flight.mocap, t_s=t + offset_s + drift * (t - t.mean())))


@cache
def _agreeing() -> FlightData:
    """A flight on which clocks and frames are as declared."""
    return _flown(_qball())


def _told_by_the_sensors(spoil: Callable[..., FlightData], *planted: float) -> list[Finding]:
    return kinematic_findings(prepare(spoil(_agreeing(), *planted)))


SENSORS = {
    "clock_offset": (_late_stamps, {"mocap_minus_imu_s": 0.02, "clock_drift": 2e-4}),
    "imu_misalignment": (_turned_imu, {"rotation_x_rad": 0.01, "rotation_y_rad": -0.015, "rotation_z_rad": 0.02}),
    "mocap_misalignment": (_turned_markers, {"rotation_x_rad": 0.01, "rotation_y_rad": 0.02, "rotation_z_rad": -0.01}),
    "mocap_misalignment, shifted": (_shifted_markers, {"offset_x_m": 0.01, "offset_y_m": 0.0, "offset_z_m": 0.02}),
    "mocap_tilt": (_tilted_room, {"tilt_x_rad": 0.01, "tilt_y_rad": -0.008}),
}


@pytest.mark.parametrize("name", SENSORS)
def test_a_clock_or_a_frame_that_is_off_is_the_one_finding_and_its_size_is_within_the_interval(name):
    spoil, planted = SENSORS[name]
    (finding,) = _told_by_the_sensors(spoil, *planted.values())
    assert (finding.effect, finding.alternatives) == (name.partition(",")[0], ())
    assert set(finding.parameters) == set(planted)
    for parameter, truth in planted.items():
        _assert_within(finding.parameters[parameter], truth)
        assert finding.parameters[parameter].std < 0.1 * max(map(abs, planted.values())), (
            "an interval that says something"
        )


def test_a_gyro_that_sees_noise_alone_turns_no_marker_body():
    """Its noise passes for its scale, far past what is linear in small errors."""
    print("seed", 28)
    flight = _agreeing()
    assert flight.imu is not None
    noise = np.random.default_rng(28).normal(0.0, 1.0, flight.imu.values.shape) * [1, 1, 1, 8, 8, 8]
    rattling = replace(flight, imu=replace(flight.imu, values=flight.imu.values + noise))
    assert kinematic_findings(prepare(rattling)) == []


def test_sensors_that_agree_say_nothing():
    assert kinematic_findings(prepare(_agreeing())) == []


@pytest.mark.parametrize(
    ("spoil", "least"),
    [
        (_late_stamps, 2e-3),
        (_turned_imu, np.deg2rad(0.3)),
        (_turned_markers, np.deg2rad(0.3)),
        (_shifted_markers, 5e-3),
        (_tilted_room, np.deg2rad(0.3)),
    ],
)
def test_what_is_a_third_below_the_least_size_is_no_finding_and_what_is_a_third_above_is_one(spoil, least):
    rest = () if spoil is _late_stamps else (0.0,) if spoil is _tilted_room else (0.0, 0.0)
    assert _told_by_the_sensors(spoil, least * 2.0 / 3.0, *rest) == []
    assert len(_told_by_the_sensors(spoil, least * 4.0 / 3.0, *rest)) == 1


def test_all_four_at_once_are_four_findings():
    spoilt = _late_stamps(
        _turned_imu(_shifted_markers(_tilted_room(_agreeing(), 0.0, 0.01), 0.03, 0.0, 0.0), 0.02, 0.01, 0.0), 0.01
    )
    found = {f.effect: f.parameters for f in kinematic_findings(prepare(spoilt))}
    assert set(found) == {"clock_offset", "imu_misalignment", "mocap_misalignment", "mocap_tilt"}
    _assert_within(found["clock_offset"]["mocap_minus_imu_s"], 0.01)
    _assert_within(found["imu_misalignment"]["rotation_x_rad"], 0.02)
    _assert_within(found["mocap_misalignment"]["offset_x_m"], 0.03)
    _assert_within(found["mocap_tilt"]["tilt_y_rad"], 0.01)


@pytest.mark.parametrize(
    ("name", "table"),
    [
        ("mocap_tilt", {"tilt_rad": [0.02, -0.015]}),
        ("imu_misalignment", {"rotation_rad": [0.02, -0.015, 0.01]}),
        ("mocap_misalignment", {"rotation_rad": [0.02, 0.01, -0.015], "offset_m": [0.0, 0.0, 0.0]}),
    ],
)
def test_a_frame_that_is_off_in_the_simulator_is_found_with_its_sign(name, table):
    """A model that goes back into the simulator as a scenario would else fly with twice the error."""
    (finding,) = kinematic_findings(prepare(_flown(_qball(), **{name: table})))
    assert finding.effect == name
    for parameter, truth in TRUE[name].items():
        _assert_within(finding.parameters[parameter], truth(table, _qball()))


IMU, MARKERS = (-0.016, 0.007, -0.004), (0.002, -0.009, -0.031)


def test_imu_and_markers_that_are_both_turned_are_told_apart_by_the_way_the_rotors_turn_the_vehicle():
    """One rotation was taken for the IMU's alone, and a steady wrench and gyroscopic rotors were named beside it."""
    tables = {"imu_misalignment": IMU, "mocap_misalignment": MARKERS}
    diagnosis = diagnose([_flown(_qball(), **{name: {"rotation_rad": turn} for name, turn in tables.items()})])
    found = {f.effect: f for f in diagnosis.findings}
    assert set(found) == set(tables) and all(f.alternatives == () for f in found.values())
    for name, turn in tables.items():
        for axis, truth in zip("xyz", turn, strict=True):
            _assert_within(found[name].parameters[f"rotation_{axis}_rad"], truth)


@pytest.mark.parametrize("turn", [(0.02, -0.015, 0.01), (0.012, 0.008, 0.029)])
@pytest.mark.parametrize("name", ["imu_misalignment", "mocap_misalignment"])
def test_where_one_of_the_two_is_turned_it_alone_is_named_and_sharply(name, turn):
    """The thrust's direction tells the second turn apart by less than three standard deviations; the way the rotors
    turn the vehicle does.
    """
    (finding,) = diagnose([_flown(_qball(), **{name: {"rotation_rad": turn}})]).findings
    assert finding.effect == name and finding.alternatives == ()
    assert finding.parameters["rotation_x_rad"].std < 1e-3


def test_markers_that_are_shifted_are_told_beside_an_imu_that_is_turned():
    shift = (0.015, 0.0, 0.01)
    markers = {"rotation_rad": (0.0, 0.0, 0.0), "offset_m": shift}
    flight = _flown(_qball(), imu_misalignment={"rotation_rad": (0.012, 0.008, 0.029)}, mocap_misalignment=markers)
    found = {f.effect: f for f in diagnose([flight]).findings}
    assert set(found) == {"imu_misalignment", "mocap_misalignment"}
    assert found["imu_misalignment"].alternatives == ()
    for axis, truth in zip("xyz", shift, strict=True):
        _assert_within(found["mocap_misalignment"].parameters[f"offset_{axis}_m"], truth)


def test_a_body_that_was_taken_for_the_turned_one_is_put_right_where_the_rotors_say_it_is_the_other(monkeypatch):
    """As where the thrust's direction, which alone was asked at first, says the wrong one."""
    monkeypatch.setattr(kinematic, "_lead_of_imu", lambda prepared, found: 1.0)
    turn = (0.012, 0.008, 0.029)
    (finding,) = diagnose([_flown(_qball(), mocap_misalignment={"rotation_rad": turn})]).findings
    assert finding.effect == "mocap_misalignment" and finding.alternatives == ()
    for axis, truth in zip("xyz", turn, strict=True):
        _assert_within(finding.parameters[f"rotation_{axis}_rad"], truth)


TIMING = {
    "lag": ({"lag": RotorLag(up_s=0.04, down_s=0.06)}, {}),
    "dead time": ({}, {"input_delay": {"delay_s": 0.03}}),
    "both": ({"lag": RotorLag(up_s=0.04, down_s=0.06)}, {"input_delay": {"delay_s": 0.025}}),
}


@pytest.mark.parametrize("hidden", TIMING)
def test_lag_and_dead_time_are_told_apart_and_lie_within_their_intervals(hidden):
    truth, effects = TIMING[hidden]
    vehicle = _qball(rotors={"speed_source": "command", "lag": {"up_s": 0.0, "down_s": 0.0}})
    found = {f.effect: f for f in diagnose([_flown(vehicle, truth=truth, **effects)]).findings}
    assert set(found) == {*(["motor_lag"] if truth else []), *effects}
    assert all(f.alternatives == () for f in found.values())
    if truth:
        _assert_within(found["motor_lag"].parameters["rotor_lag_up_s"], 0.04)
        _assert_within(found["motor_lag"].parameters["rotor_lag_down_s"], 0.06)
    if effects:
        _assert_within(found["input_delay"].parameters["input_delay_s"], effects["input_delay"]["delay_s"])


def test_a_lag_of_less_than_5_ms_beside_a_dead_time_is_counted_with_it():
    """Noise in what is recorded of the commands is smoothed by a small lag: docs/diagnosis.md takes less than 5 ms for
    no finding.
    """
    vehicle = _qball(rotors={"speed_source": "command"})
    small = {"lag": RotorLag(up_s=0.003, down_s=0.003)}
    (finding,) = diagnose([_flown(vehicle, truth=small, input_delay={"delay_s": 0.025})]).findings
    assert finding.effect == "input_delay"
    assert finding.parameters["input_delay_s"].value == pytest.approx(0.028, abs=0.001)


@cache
def _thin_air() -> FlightData:
    """Rotors give 0.95 of their declared thrust; the vehicle is as heavy as declared."""
    return _flown(_qball(), truth={"mass_factor": 1.0}, thrust_scale={"density_ratio": 0.95})


def test_a_thrust_scale_is_told_by_a_weighed_mass():
    weighed = _qball(identification={"anchor": "mass"})
    found = diagnose([replace(_thin_air(), vehicle=weighed)]).findings
    assert [f.effect for f in found] == ["thrust_scale"]
    _assert_within(found[0].parameters["thrust_scale"], 0.95)


def test_without_one_thrust_and_torque_scale_pass_for_mass_and_yaw_inertia():
    """No motion shows either: the flight is clean, and what is estimated is scaled by as much."""
    vehicle = _qball()
    thin = diagnose([_thin_air()])
    true_izz = vehicle.inertia_tensor()[2, 2] * laboratory().truth.inertia_factor[2]
    assert thin.findings == ()
    assert thin.parameters_after["mass_kg"].value == pytest.approx(vehicle.mass_kg / 0.95, rel=0.005)
    dragging = diagnose([_flown(vehicle, torque_scale={"ratio": 1.1})])
    assert dragging.findings == ()
    assert dragging.parameters_after["izz_kg_m2"].value == pytest.approx(true_izz / 1.1, rel=0.02)
