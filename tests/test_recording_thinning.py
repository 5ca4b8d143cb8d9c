"""Long logs: the stretch that tells most is used and told, all of it on demand; whoever waits is told so."""

from __future__ import annotations

import itertools
import threading

import numpy as np
import pytest

from groundstation.commands.common import ProgressLine
from groundstation.flightdata import IMU_COLUMNS, Stream, motor_columns
from groundstation.recording import load_flight, write_bundle
from groundstation.recording.thinning import KEPT_S, LONG_S, informative_stretch
from tests.recording_flight import flight


def long_streams(busy_from, seconds=900.0, rate=20.0):
    """Hovering, but for three minutes of motion; carried about before the motors turn, and a hard landing."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    rng = np.random.default_rng(3)
    values = rng.normal(size=(len(t), 6)) * 0.01
    values[:, 5] += 9.8
    busy = (t >= busy_from) & (t < busy_from + 180.0)
    values[busy, :3] += np.sin(t[busy, None] * [2.0, 3.0, 1.0])
    values[t < 60.0] += 20.0 * np.sin(t[t < 60.0, None] * [2.0, 3.0, 1.0, 2.0, 3.0, 1.0])
    values[-20:, 3:] += 80.0 * np.sin(np.arange(20.0))[:, None]
    motors = np.full((len(t), 4), 500.0)
    motors[t < 60.0] = 0.0
    return Stream(t, values, IMU_COLUMNS), Stream(t, motors, motor_columns("rotor_speed", 4))


@pytest.mark.parametrize("busy_from", [100.0, 333.0, 700.0])
def test_the_stretch_in_which_the_vehicle_moves_is_found(busy_from):
    start, end = informative_stretch(*long_streams(busy_from))
    assert end - start == KEPT_S
    assert start == pytest.approx(busy_from, abs=2.0)


def test_a_flight_of_ten_minutes_is_used_whole():
    imu, motors = long_streams(100.0, LONG_S)
    assert informative_stretch(imu, motors) is None
    assert informative_stretch(None, long_streams(100.0)[1]) is None


def test_a_long_flight_is_cut_and_told_and_used_whole_on_demand(tmp_path):
    imu, motors = long_streams(333.0)
    made = flight(2.0)
    whole = type(made)(name="long", vehicle=made.vehicle, motors=motors, imu=imu)
    write_bundle(whole, tmp_path / "b")
    cut = load_flight(tmp_path / "b")
    assert cut.motors.t_s[-1] - cut.motors.t_s[0] == pytest.approx(KEPT_S, abs=0.1)
    assert any("of 900 s those from 333" in note and "--all" in note for note in cut.notes)
    assert len(load_flight(tmp_path / "b", everything=True).motors) == len(motors)
    assert load_flight(tmp_path / "b", start_s=70.0, end_s=800.0).motors.t_s[-1] > 799.0


def test_nobody_waits_two_seconds_without_a_word(capsys):
    clock = [0.0]
    line = ProgressLine(clock=lambda: clock[0])
    spoken = []
    for k in range(100):
        clock[0] = 0.1 * k
        if k == 40:
            line.fraction(0.5, "fitting")
        line.quiet("reading big.ulg", 0.0)
        if said := capsys.readouterr().err.strip():
            spoken.append((clock[0], said))
    assert spoken[0] == (1.5, "reading big.ulg: 2 s")
    assert max(b[0] - a[0] for a, b in itertools.pairwise([(0.0, ""), *spoken, (9.9, "")])) < 2.0
    assert spoken[-1][1].startswith("fitting: ")


def test_the_line_is_kept_alive_by_itself():
    line = ProgressLine()
    with line.ticking("reading"):
        assert "progress" in [thread.name for thread in threading.enumerate()]
    assert "progress" not in [thread.name for thread in threading.enumerate()]
