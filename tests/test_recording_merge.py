"""A vehicle's log beside the recording of its flight: joined on one clock, or left out with the reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation.flightdata import Stream, motor_columns
from groundstation.recording import load_flight, write_mcap
from groundstation.recording.merge import clock_offset
from tests.recording_flight import flight
from tests.test_recording_autopilots import MOTOR_OF_ROTOR, motor_commands, quad, write_dataflash, write_ulog


def over_a_slow_link(made):
    """What telemetry brings of a flight: every tenth sample, stamps to the millisecond, no state."""

    def thin(stream, values=None, columns=None):
        values = stream.values if values is None else values
        received = None if stream.received_s is None else stream.received_s[::10]
        return Stream(np.round(stream.t_s[::10], 3), values[::10], columns or stream.columns, received)

    commands = motor_commands(made)[:, MOTOR_OF_ROTOR]
    return replace(
        made,
        vehicle=quad(),
        imu=thin(made.imu),
        motors=thin(made.motors, commands, motor_columns("command", 4)),
        state=None,
        truth=None,
    )


@pytest.fixture(scope="module")
def made():
    return flight(6.0)


@pytest.mark.parametrize("late_s", [0.0, 731.25, -40.0])
def test_the_vehicles_log_takes_the_place_of_slow_telemetry_on_its_clock(tmp_path, made, late_s):
    link = over_a_slow_link(made)
    write_mcap(link, tmp_path / "flight.mcap")
    shifted = replace(
        made,
        imu=replace(made.imu, t_s=made.imu.t_s + late_s + 50.0),
        motors=replace(made.motors, t_s=made.motors.t_s + late_s + 50.0),
        mocap=replace(made.mocap, t_s=made.mocap.t_s + 50.0),
    )
    write_ulog(tmp_path / "onboard.ulg", shifted)
    joined = load_flight(tmp_path / "flight.mcap")
    assert len(joined.imu) == len(made.imu)
    assert len(joined.motors) == len(made.motors)
    assert np.allclose(joined.imu.values, made.imu.values, atol=1e-5)
    assert np.allclose(joined.imu.t_s, made.imu.t_s, atol=0.03)  # to the grid on which motions are compared
    assert np.array_equal(joined.mocap.t_s, load_flight_alone(tmp_path, link).mocap.t_s)
    offset = np.median(joined.imu.received_s - joined.imu.t_s) - np.median(made.imu.received_s - made.imu.t_s)
    assert abs(offset) < 0.005  # so that motion capture can be found on the vehicle's clock as before
    assert any("imu at 250 Hz for 25" in note and "motors" in note for note in joined.notes)


def load_flight_alone(tmp_path, link):
    return load_flight(write_mcap(link, tmp_path / "alone" / "flight.mcap"))


def test_stamps_of_one_clock_are_left_exactly_as_they_are(tmp_path, made):
    write_mcap(over_a_slow_link(made), tmp_path / "flight.mcap")
    write_ulog(tmp_path / "onboard.ulg", made)
    joined = load_flight(tmp_path / "flight.mcap")
    assert np.allclose(joined.imu.t_s, made.imu.t_s, atol=2e-6)
    assert any("agree within" in note for note in joined.notes)


def test_a_log_of_another_flight_is_left_out(tmp_path, made):
    link = over_a_slow_link(made)
    write_mcap(link, tmp_path / "flight.mcap")
    rng = np.random.default_rng(8)
    other = replace(made.imu, t_s=made.imu.t_s + 900.0, values=rng.normal(size=made.imu.values.shape))
    strange = replace(made, imu=other, motors=replace(made.motors, t_s=made.motors.t_s + 900.0))
    write_ulog(tmp_path / "onboard.ulg", strange)
    joined = load_flight(tmp_path / "flight.mcap")
    assert len(joined.imu) == len(link.imu)
    assert any("another flight" in note for note in joined.notes)


def test_a_damaged_log_does_not_stop_the_flight_from_being_read(tmp_path, made):
    link = over_a_slow_link(made)
    write_mcap(link, tmp_path / "flight.mcap")
    (tmp_path / "onboard.ulg").write_bytes(b"ULog\x01\x12\x35" + bytes(5))
    joined = load_flight(tmp_path / "flight.mcap")
    assert len(joined.imu) == len(link.imu)
    assert any("goes by what came over the link" in note for note in joined.notes)


def test_motors_of_ardupilots_log_at_10_hz_do_not_replace_faster_ones(tmp_path, made):
    link = over_a_slow_link(made)
    link = replace(link, motors=replace(link.motors, t_s=link.motors.t_s))
    write_mcap(link, tmp_path / "flight.mcap")
    write_dataflash(tmp_path / "onboard.bin", made)
    joined = load_flight(tmp_path / "flight.mcap")
    assert len(joined.motors) == len(link.motors)
    assert len(joined.imu) == len(made.imu)


def test_a_still_vehicle_has_no_motion_to_compare_and_keeps_its_clock(made):
    def still(t_s):
        return {"imu": Stream(t_s, np.tile([0.0] * 5 + [9.81], (len(t_s), 1)), made.imu.columns)}

    offset, told = clock_offset(still(np.arange(500) / 50.0), still(np.arange(2500) / 250.0))
    assert offset == 0.0
    assert "taken for" in told
