"""Time between streams: shifted where the data demand it, left alone where they do not, told with an error bar."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.flightdata import FlightData, resampled
from groundstation.identification.preparation import prepare
from groundstation.paths import find_config
from groundstation.recording import load_flight
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from studies.flown import flight_data
from tests.flights import laboratory, rest_to_rest_plan

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="module")
def flown() -> FlightData:
    """A laboratory flight, seed 2, whose clocks agree."""
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    return flight_data(simulate(vehicle, rest_to_rest_plan(seed=2), laboratory(), 2))


def shifted(flight: FlightData, offset_s: float) -> FlightData:
    """The same with the motors' clock ahead, and no arrival times to tell it by."""
    assert flight.window_s is not None
    motors = replace(flight.motors, t_s=flight.motors.t_s + offset_s, received_s=None)
    return replace(flight, motors=motors, window_s=(flight.window_s[0] + offset_s, flight.window_s[1] + offset_s))


def said(notes: tuple[str, ...], about: str) -> tuple[float, float] | None:
    """Milliseconds and their error bar of a note."""
    for note in notes:
        if note.startswith(about) and (match := re.search(r"([+-]\d+) \+- (\d+) ms", note)):
            return float(match[1]), float(match[2])
    return None


@pytest.mark.parametrize("offset_s", [-8.3, -0.3, 2.5])
def test_motors_whose_clock_is_off_are_shifted_with_an_error_bar(flown: FlightData, offset_s: float) -> None:
    found = said(prepare(shifted(flown, offset_s)).notes, "The motors' stamps")
    assert found is not None
    assert found[0] == pytest.approx(1e3 * offset_s, abs=60.0)  # rotors and sensors have delays of their own
    assert 0.0 < found[1] < 30.0


@pytest.mark.parametrize("noise_share", [0.0, 0.05])
def test_right_stamps_are_left_alone(flown: FlightData, noise_share: float) -> None:
    noise = 1.0 + noise_share * np.random.default_rng(3).standard_normal(flown.motors.values.shape)
    free = replace(flown, plan=None, setpoint=None, window_s=None)
    spoilt = replace(free, motors=replace(free.motors, values=free.motors.values * noise, received_s=None))
    assert said(prepare(spoilt).notes, "The motors' stamps") is None


def test_a_log_of_one_device_is_never_shifted(flown: FlightData) -> None:
    log = replace(shifted(flown, 2.5), metadata={"format": "PX4 ULog"})
    assert said(prepare(log).notes, "The motors' stamps") is None


@pytest.mark.parametrize("late_s", [0.0, 0.08, 0.12])
def test_late_positions_are_found_beside_attitudes_in_time(flown: FlightData, late_s: float) -> None:
    mocap = flown.mocap
    assert mocap is not None
    values = mocap.values.copy()
    values[:, :3] = resampled(mocap.t_s - late_s, mocap.t_s, mocap.values[:, :3])
    prepared = prepare(replace(flown, mocap=replace(mocap, values=values)))
    found = said(prepared.notes, "Positions are")
    if late_s == 0.0:
        assert found is None
        return
    assert found is not None
    assert found[0] == pytest.approx(1e3 * late_s, abs=3.0 * found[1])
    assert prepared.clock is not None
    assert abs(prepared.clock.mocap_minus_imu_s) < 0.01


@pytest.mark.parametrize("name", ["multisine_20251017_run1", "random2_20251017_run4", "square_20251017_run3"])
def test_measured_flights_stamped_by_one_clock_are_left_alone(name: str) -> None:
    folder = DATA / "nanodrone" / name
    if not folder.exists():
        pytest.skip(f"the measured flights are not there: {folder}")
    notes = prepare(load_flight(folder)).notes
    assert said(notes, "The motors' stamps") is None


def test_a_healthy_crazypad_flight_is_not_shifted_by_eight_seconds() -> None:
    log = DATA / "fails" / "crazypad-normal-E8-log01"
    if not log.exists():
        pytest.skip(f"the log is not there: {log}")
    prepared = prepare(load_flight(log, vehicle=load_vehicle(find_config("vehicles", "crazyflie21"))))
    assert said(prepared.notes, "The motors' stamps") is None
    assert sum(end - start for start, end in prepared.stretches) > 14.0


def test_an_accelerometer_is_not_off_by_a_quarter_of_gravity():
    """Between its two flights this vehicle lay on the ground and was carried, out of sight at times: by the poses its
    accelerometer was off by 2.4 m/s^2, and its thrust came out a quarter too small.
    """
    folder = DATA / "nanodrone" / "square_20251017_run1"
    if not folder.exists():
        pytest.skip(f"the measured flights are not there: {folder}")
    prepared = prepare(load_flight(folder))
    keep = prepared.record.keep
    thrust = float(prepared.signals(0.0, 0.0, 0.0).thrust_n[keep].sum(axis=1).mean())
    assert thrust / float(prepared.record.force_m_s2[keep, 2].mean()) == pytest.approx(0.045, rel=0.03)
    assert np.all(prepared.record.force_bias_std == 0.1)
    assert any(note.startswith("By the poses the accelerometer would be off") for note in prepared.notes)
    assert prepared.compatibility is not None
    assert not any(name.startswith("accel_bias") for name in prepared.compatibility.revealed)
