"""Rotor speeds that a simulator multiplied out of the commands are told from measured ones, and the commands taken."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.samples import Motors
from groundstation.flight.core.live import LiveEstimate
from groundstation.flight.sequence import Phase
from groundstation.flightdata import Stream, motor_columns
from groundstation.recording import read_recording, write_mcap
from groundstation.recording.computed_speeds import COMMANDS, commands_behind, computed_gain
from groundstation.recording.recorder import McapRecorder
from tests.recording_flight import flight
from tests.test_recording_autopilots import quad

RPM = 2.0 * np.pi / 60.0


def commands(rate_hz: float = 250.0, digits: int = 3) -> Stream:
    t_s = np.arange(0.0, 8.0, 1.0 / rate_hz)
    wave = np.sin(2.0 * np.pi * t_s[:, None] * [0.7, 0.9, 1.1, 1.3])
    return Stream(t_s, np.round(0.75 + 0.08 * wave, digits), motor_columns("command", 4))


def speeds(t_s, values) -> Stream:
    return Stream(t_s, np.round(values / RPM) * RPM, motor_columns("rotor_speed", 4))


@pytest.mark.parametrize("gain_rpm", [6000.0, 9549.3])
def test_a_fixed_multiple_of_the_command_is_no_measurement(gain_rpm):
    u = commands()
    gain = computed_gain(speeds(u.t_s, gain_rpm * RPM * u.values), u)
    assert gain is not None and gain / RPM == pytest.approx(gain_rpm, rel=1e-4)


@pytest.mark.parametrize("late", [0.1, 0.3, 0.4])
@pytest.mark.parametrize("lost", [0.0, 0.2])
def test_a_late_and_lossy_line_hides_no_computed_speed(late, lost):
    """A share of the speeds is that of the command before or after, as on a busy machine; some messages never come."""
    seed = 12
    print("seed", seed)
    rng = np.random.default_rng(seed)
    u = commands(digits=6)
    at = np.arange(len(u)) + np.where(rng.random(len(u)) < late, rng.choice([-3, -2, -1, 1, 2], len(u)), 0)
    w = speeds(u.t_s + rng.normal(0.0, 2e-4, len(u)), 628.3185 * u.values[np.clip(at, 0, len(u) - 1)])
    came = rng.random(len(u)) >= lost
    w = Stream(w.t_s[came], w.values[came], w.columns)
    came = rng.random(len(u)) >= lost
    gain = computed_gain(w, Stream(u.t_s[came], u.values[came], u.columns))
    assert gain == pytest.approx(628.3185, rel=1e-4)


def test_speeds_that_are_told_as_zero_in_flight_are_no_measurement():
    """ArduPilot's simulator tells 0 rpm of its own frames; one ESC without a sensor does the same."""
    u = commands()
    for still in ([0, 1, 2, 3], [2]):
        told = 600.0 * u.values
        told[:, still] = 0.0
        found = commands_behind(speeds(u.t_s[::4], told[::4]), u)
        assert found is not None and found[0] is u
        assert f"no speed of rotor {', '.join(str(i + 1) for i in still)} while it is driven" in found[1]
    on_the_ground = Stream(u.t_s, 0.0 * u.values, u.columns)
    assert commands_behind(speeds(u.t_s, 0.0 * u.values), on_the_ground) is None


@pytest.mark.parametrize("lag_s", [0.005, 0.0125, 0.07])
def test_a_rotor_that_lags_is_measured(lag_s):
    u = commands()
    follow = 1.0 - np.exp(-0.004 / lag_s)
    lagged = np.empty_like(u.values)
    lagged[0] = u.values[0]
    for k in range(1, len(lagged)):
        lagged[k] = lagged[k - 1] + follow * (u.values[k] - lagged[k - 1])
    assert computed_gain(speeds(u.t_s, 1000.0 * lagged), u) is None


def test_speeds_that_sag_with_the_battery_are_measured():
    u = commands()
    sag = np.linspace(1.0, 0.95, len(u))[:, None]
    assert computed_gain(speeds(u.t_s, 1000.0 * sag * u.values), u) is None


def test_speeds_at_other_instants_or_hardly_varying_ones_tell_nothing():
    u = commands()
    assert computed_gain(speeds(u.t_s + 0.0019, 628.0 * u.values), u) is None
    still = replace(u, values=np.full_like(u.values, 0.75))
    assert computed_gain(speeds(u.t_s, 628.0 * still.values), still) is None
    assert computed_gain(speeds(u.t_s[:50], 628.0 * u.values[:50]), u) is None


def test_commands_logged_ten_times_a_second_come_back_at_the_rate_of_the_speeds():
    whole = commands()
    thin = Stream(whole.t_s[::25], whole.values[::25], whole.columns)
    fine = commands(digits=6)
    found = commands_behind(speeds(fine.t_s, 6000.0 * RPM * fine.values), replace(thin, values=fine.values[::25]))
    assert found is None  # 80 of them are too few to tell
    longer = np.tile(fine.values, (2, 1))
    t_s = np.arange(len(longer)) / 250.0
    found = commands_behind(
        speeds(t_s, 6000.0 * RPM * longer), Stream(t_s[::25], longer[::25], motor_columns("command", 4))
    )
    assert found is not None
    assert len(found[0]) == len(longer) and np.allclose(found[0].values, longer, atol=2e-4)
    assert "6000 rpm" in found[1] and "nobody measured" in found[1]


def test_a_recording_with_both_is_read_as_one_of_commands(tmp_path):
    made = flight(2.0)
    u = commands()
    motors = speeds(u.t_s, 6000.0 * RPM * u.values)
    path = tmp_path / "flight.mcap"
    write_mcap(replace(made, motors=motors), tmp_path / "alone.mcap")
    alone = read_recording(tmp_path / "alone.mcap")
    assert alone.streams["motors"].columns == motors.columns
    with McapRecorder(path, {}, dict(alone.files)) as recorder:
        for k, t_s in enumerate(u.t_s):
            recorder.add(Motors(t_s, tuple(motors.values[k]), "rotor_speed"), t_s)
            recorder.add(Motors(t_s, tuple(u.values[k]), "command"), t_s, f"/{COMMANDS}")
    read = read_recording(path)
    assert read.streams["motors"].columns == u.columns
    assert np.array_equal(read.streams["motors"].values, u.values)
    assert COMMANDS not in read.extras
    assert sum("nobody measured" in note for note in read.notes) == 1


@pytest.mark.parametrize("computed", [True, False])
def test_the_live_estimate_goes_by_no_computed_speeds_and_says_so(computed):
    live = LiveEstimate(quad().model_copy(update={"rotors": quad().rotors.model_copy(update={"input": "rotor_speed"})}))
    u = commands()
    late = u.values if computed else np.roll(u.values, 5, axis=0)
    w = speeds(u.t_s, 6000.0 * RPM * late)
    for k in range(0, 1000, 20):
        told = [Motors(u.t_s[i], tuple(w.values[i]), "rotor_speed") for i in range(k, k + 20)]
        live.take([*told, *(Motors(u.t_s[i], tuple(u.values[i]), "command") for i in range(k, k + 20))], Phase.EXCITING)
    assert ("nobody measured" in live.trouble) is computed
    assert computed or live.trouble == ""
