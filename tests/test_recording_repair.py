"""Blemishes of real logs, planted one by one: each is found, counted and repaired, and past half refused by name."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.errors import BadInput
from groundstation.flightdata import Stream
from groundstation.frames import quat_from_euler, quat_multiply
from groundstation.recording import blemishes
from groundstation.recording.repair import repair
from tests.recording_flight import flight


@pytest.fixture(scope="module")
def made():
    return flight()


def planted(made, name, change, *, t_s=None):
    """The flight with one stream's values (and stamps) changed in place by ``change``."""
    stream = getattr(made, name)
    values, times = stream.values.copy(), stream.t_s.copy()
    change(values, times)
    return replace(made, **{name: replace(stream, values=values, t_s=times)})


def said(flown, name):
    return [note for note in flown.notes if note.startswith(f"{name}:")]


def counted(flown, name, cause):
    match = re.search(rf"(\d+) {cause}", " ".join(said(flown, name)))
    return int(match[1]) if match else 0


def test_a_sound_flight_has_nothing_to_repair(made):
    assert repair(made).notes == ()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["imu", "motors", "mocap", "state", "battery", "setpoint"])
def test_single_values_that_are_no_numbers(made, name, bad):
    def change(values, times):
        values[[20, 35], 0] = bad

    flown = repair(planted(made, name, change))
    assert counted(flown, name, "not numbers") == 2
    stream = getattr(flown, name)
    assert np.isfinite(stream.values).all()
    if name in ("imu", "motors"):  # bridged: the neighbours' mean at the middle between them
        assert len(stream) == len(getattr(made, name))
        truth = getattr(made, name).values
        assert stream.values[20, 0] == pytest.approx(0.5 * (truth[19, 0] + truth[21, 0]), abs=1e-9)
    else:
        assert len(stream) == len(getattr(made, name)) - 2


def test_a_long_run_of_missing_values_becomes_a_gap_not_an_invention(made):
    def change(values, times):
        values[400:500] = math.nan

    flown = repair(planted(made, "imu", change))
    assert len(flown.imu) == len(made.imu) - 100
    assert any("1 gap" in note and "0.40 s" in note for note in said(flown, "imu"))


@pytest.mark.parametrize(("column", "size"), [(0, 30.0), (2, -8.0), (5, 200.0), (3, -60.0)])
def test_spikes_of_the_imu(made, column, size):
    at = np.array([100, 333, 334, 900])

    def change(values, times):
        values[at, column] += size

    flown = repair(planted(made, "imu", change))
    assert counted(flown, "imu", "spikes") == 4
    assert np.allclose(flown.imu.values[at], made.imu.values[at], atol=0.6)


def test_vibration_is_no_spike(made):
    """A strong vibration fills the stream with large samples: none of them stands out of its neighbourhood."""
    rng = np.random.default_rng(3)

    def change(values, times):
        values[500:1200, 3:] += rng.normal(size=(700, 3)) * 25.0
        values[500:1200, :3] += rng.normal(size=(700, 3)) * 3.0

    assert said(repair(planted(made, "imu", change)), "imu") == []


def test_a_step_of_the_motion_is_no_spike(made):
    def change(values, times):
        values[700:, 0] += 4.0

    assert said(repair(planted(made, "imu", change)), "imu") == []


@pytest.mark.parametrize("name", ["imu", "motors", "mocap"])
def test_repeated_and_backward_stamps(made, name):
    def change(values, times):
        times[50] = times[49]
        times[80] = times[70]

    flown = repair(planted(made, name, change))
    assert len(getattr(flown, name)) == len(getattr(made, name)) - 2
    assert np.all(np.diff(getattr(flown, name).t_s) > 0.0)
    assert "2 of" in said(flown, name)[0]


@pytest.mark.parametrize("at", [0, 300, -1])
def test_a_single_stamp_that_leaps_ahead_costs_one_sample(made, at):
    def change(values, times):
        times[at] = 1e6 if at else -1e6

    flown = repair(planted(made, "mocap", change))
    assert len(flown.mocap) == len(made.mocap) - 1


def test_a_device_that_restarts_keeps_its_longer_life(made):
    def change(values, times):
        times[900:] -= 3.5

    flown = repair(planted(made, "imu", change))
    assert np.all(np.diff(flown.imu.t_s) > 0.0)
    assert len(flown.imu) >= 900


def test_poses_frozen_in_flight(made):
    """Five stretches of 40 of the 600 poses: a third of the stream."""

    def change(values, times):
        for start in range(50, 550, 100):
            values[start : start + 40] = values[start]

    flown = repair(planted(made, "mocap", change))
    assert counted(flown, "mocap", "frozen poses") == 5 * 39
    assert len(flown.mocap) == len(made.mocap) - 5 * 39
    kept = np.isin(made.mocap.t_s, flown.mocap.t_s)
    assert np.allclose(flown.mocap.values, made.mocap.values[kept], atol=1e-9)


def alone(flown, name):
    """The flight with no motion but one stream's: what it cannot do without."""
    others = {other: None for other in ("imu", "mocap", "state") if other != name and name in ("imu", "mocap", "state")}
    return replace(flown, **others)


def test_39_percent_frozen_poses_pass_and_60_percent_are_refused(made):
    def every(share):
        rng = np.random.default_rng(4)
        hold = rng.uniform(size=len(made.mocap)) < share

        def change(values, times):
            for k in np.flatnonzero(hold):
                if k:
                    values[k] = values[k - 1]

        return change

    assert counted(repair(planted(made, "mocap", every(0.39))), "mocap", "frozen poses") > 200
    with pytest.raises(BadInput, match=r"mocap: .*frozen.*refused"):
        repair(alone(planted(made, "mocap", every(0.6)), "mocap"))


def test_a_noise_free_vehicle_at_rest_is_not_frozen(made):
    """Ideal poses repeat while the vehicle stands and creep away as it starts: most of the stream, and all of it
    sound.
    """
    stream = made.mocap
    t = stream.t_s - stream.t_s[0]
    height = np.where(t > 4.0, 0.5 * 0.3 * (t - 4.0) ** 2, 0.0)
    values = np.zeros_like(stream.values)
    values[:, 2], values[:, 3] = height, 1.0
    flown = repair(replace(made, mocap=replace(stream, values=values), imu=None))
    assert said(flown, "mocap") == []
    assert len(flown.mocap) == len(stream)


def test_pose_spikes(made):
    at = np.array([60, 200, 201, 420])

    def change(values, times):
        values[at, :3] += [0.4, -0.3, 0.2]
        values[333, 3:] = quat_multiply(quat_from_euler(0.0, 1.2, 0.0), values[333, 3:])

    flown = repair(planted(made, "mocap", change))
    assert counted(flown, "mocap", "spikes") == 5
    kept = np.isin(made.mocap.t_s, flown.mocap.t_s)
    assert kept.sum() == len(flown.mocap) == len(made.mocap) - 5
    assert not kept[at].any()


def test_a_jump_and_back_costs_the_stretch_between(made):
    def change(values, times):
        values[200:260, 0] += 0.8

    flown = repair(planted(made, "mocap", change))
    assert counted(flown, "mocap", "poses beyond a jump") == 60
    kept = np.isin(made.mocap.t_s, flown.mocap.t_s)
    assert not kept[200:260].any()


def test_a_jump_for_good_costs_the_shorter_side(made):
    def change(values, times):
        values[:180, 3:] = quat_multiply(quat_from_euler(0.0, 0.0, 2.0), values[:180, 3:])

    flown = repair(planted(made, "mocap", change))
    assert counted(flown, "mocap", "poses beyond a jump") == 180
    assert flown.mocap.t_s[0] == made.mocap.t_s[180]


def test_a_gap_is_reported_and_motion_across_it_is_no_jump(made):
    stream = made.mocap
    mask = np.ones(len(stream), bool)
    mask[100:180] = False
    flown = repair(replace(made, mocap=stream.select(mask)))
    assert len(flown.mocap) == mask.sum()
    assert any("1 gap" in note and "0.81 s" in note for note in said(flown, "mocap"))


@pytest.mark.parametrize("name", ["imu", "mocap"])
def test_a_stream_that_is_mostly_gaps_is_refused(made, name):
    stream = getattr(made, name)
    t = stream.t_s - stream.t_s[0]
    broken = replace(made, **{name: stream.select((t < 1.0) | (t > 5.0))})
    with pytest.raises(BadInput, match=rf"{name}: .*gaps.*refused"):
        repair(alone(broken, name))
    flown = repair(broken)
    assert getattr(flown, name) is None
    assert "left out" in said(flown, name)[0]


def test_impossible_rotor_speeds(made):
    """6 000 000 rpm, as ESC telemetry has been seen to report, negative values, and drop-outs to zero."""
    at = np.array([40, 300, 301, 800])

    def change(values, times):
        values[at, 1] = 6e6 * 2.0 * np.pi / 60.0
        values[1000, 2] = -400.0
        values[1200, 3] = 0.0

    flown = repair(planted(made, "motors", change))
    assert counted(flown, "motors", "impossible values") == 5
    assert counted(flown, "motors", "spikes") == 1
    assert np.abs(flown.motors.values - made.motors.values).max() < 15.0


def test_rotor_speeds_far_too_low_in_flight_are_counted_and_bridged_and_a_landing_is_not(made):
    def change(values, times):
        for first in range(100, 1100, 40):
            values[first : first + 4, 1] *= 0.1
        values[-300:] *= 0.05  # the last 1.2 s stand on the ground

    flown = repair(planted(made, "motors", change))
    assert counted(flown, "motors", "far too low in flight") == 100
    assert np.abs(flown.motors.values[:-320] - made.motors.values[: len(flown.motors) - 320]).max() < 30.0
    assert np.max(flown.motors.values[-200:]) < 60.0


def test_half_of_every_rotors_values_far_too_low_are_told_and_refused(made):
    def change(values, times):
        values[np.random.default_rng(7).random(values.shape) < 0.5] *= 0.2

    with pytest.raises(BadInput, match=r"motors: .*refused"):
        repair(planted(made, "motors", change))


def test_moments_of_low_speed_along_a_rotors_lag_are_flown(made):
    def change(values, times):
        values[200:300, 2] *= 1.0 - 0.8 * np.sin(np.linspace(0.0, np.pi, 100))

    flown = repair(planted(made, "motors", change))
    assert counted(flown, "motors", "far too low") == 0


def test_one_rotor_that_reports_nothing_is_refused_by_its_column(made):
    def change(values, times):
        values[::2, 2] = math.nan
        values[1::4, 2] = 1e7

    with pytest.raises(BadInput, match="m3_rad_s"):
        repair(planted(made, "motors", change))


def test_a_command_holds_its_last_value_where_it_is_missing(made):
    vehicle = made.vehicle.model_copy(
        update={"rotors": made.vehicle.rotors.model_copy(update={"input": "command", "speed_max_rad_s": 900.0})}
    )
    command = made.motors.values / 900.0
    command[50] = math.nan
    stream = replace(made.motors, values=command, columns=tuple(f"m{i}_command" for i in range(1, 5)))
    flown = repair(replace(made, vehicle=vehicle, motors=stream))
    assert np.array_equal(flown.motors.values[50], command[49])


def test_rotor_speeds_signed_by_the_turning_direction_are_taken_by_their_size(made):
    def change(values, times):
        values[:, :2] *= -1.0

    flown = repair(planted(made, "motors", change))
    assert np.array_equal(flown.motors.values, made.motors.values)
    assert "negative" in said(flown, "motors")[0]


def test_battery_drop_outs(made):
    def change(values, times):
        values[7, 0] = 0.0
        values[20, 0] = 4.0
        values[:, 1] = math.nan  # a current that nobody measures

    flown = repair(planted(made, "battery", change))
    assert counted(flown, "battery", "impossible values") == 1
    assert counted(flown, "battery", "spikes") == 1
    assert len(flown.battery) == len(made.battery) - 2


@pytest.mark.parametrize("name", ["imu", "motors", "mocap", "battery", "setpoint", "state"])
def test_past_half_a_stream_is_refused_by_name_and_just_below_it_is_not(made, name):
    def spoil(share):
        def change(values, times):
            order = np.random.default_rng(5).permutation(len(values))
            values[order[: int(share * len(values))], 0] = math.nan

        return change

    broken = planted(made, name, spoil(0.55))
    if name in ("battery", "setpoint"):
        assert "left out" in said(repair(broken), name)[0]
        assert getattr(repair(broken), name) is None
    else:
        with pytest.raises(BadInput, match=rf"^{name}: .*refused"):
            repair(alone(broken, name))
    assert said(repair(planted(made, name, spoil(0.45))), name)


def test_all_stamps_alike_are_refused_by_name(made):
    def change(values, times):
        times[:] = 1.0

    with pytest.raises(BadInput, match=r"imu: .*stamps"):
        repair(alone(planted(made, "imu", change), "imu"))


@given(st.lists(st.floats(-10, 10), min_size=1, max_size=60))
def test_kept_stamps_increase_and_no_longer_selection_does(values):
    t_s = np.array(values)
    keep = blemishes._longest_increasing(values)
    assert np.all(np.diff(t_s[keep]) > 0.0)
    best = [1] * len(values)  # the textbook quadratic recursion
    for i in range(len(values)):
        best[i] = 1 + max((best[j] for j in range(i) if values[j] < values[i]), default=0)
    assert len(keep) == max(best)


@given(st.integers(0, 10), st.integers(0, 10), st.floats(10.0, 1e6))
def test_up_to_a_hundredth_of_strays_at_either_end_is_left_out(first, last, far):
    body = np.arange(1000.0 - first - last)
    before, after = -far * 1000.0 + np.arange(first), far**2 * 1e5 + np.arange(last)
    kept = blemishes._without_strays(np.concatenate([before, body, after]), np.ones(1000, dtype=bool))
    assert kept[first : 1000 - last].all() and not kept[1000 - last :].any()
    assert not kept[:first].any() or last > 0  # strays at the other end make the rest look long


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), speed=st.floats(0.3, 2.0))
def test_no_motion_within_the_vehicles_means_is_taken_for_a_blemish(seed, speed):
    assert repair(flight(seed=seed, duration_s=3.0, scale=speed)).notes == ()


def test_repair_leaves_its_input_as_it_was(made):
    def change(values, times):
        values[40:42] = math.nan

    flown = planted(made, "imu", change)
    before = flown.imu.values.copy()
    repair(flown)
    assert np.array_equal(flown.imu.values, before, equal_nan=True)


def test_extras_and_metadata_pass_through(made):
    extra = Stream(np.arange(3.0), np.full((3, 1), math.nan), ("x",))
    flown = repair(replace(made, extras={"imu": extra}))
    assert flown.extras["imu"] is extra
    assert flown.metadata == made.metadata


def test_tracking_that_is_lost_for_good_in_the_air_is_frozen_and_a_landed_vehicle_is_not(made):
    stream = made.mocap

    def lost(values, times):
        values[420:] = values[420]

    assert counted(repair(planted(made, "mocap", lost)), "mocap", "frozen poses") == len(stream) - 421

    t = stream.t_s - stream.t_s[0]
    values = np.zeros_like(stream.values)
    values[:, 2], values[:, 3] = np.maximum(1.0 - 0.4 * t, 0.0), 1.0  # comes down at 0.4 m/s and stands
    flown = repair(replace(made, mocap=replace(stream, values=values), imu=None))
    assert said(flown, "mocap") == []


def test_coarse_poses_of_a_vehicle_that_mostly_stands_are_no_reason_to_refuse(made):
    """Rounded to 0.1 mm and 1 mrad, a vehicle at rest for 80 % of the time repeats its pose most of the time."""
    stream = made.mocap
    values = stream.values.copy()
    values[: int(0.8 * len(values))] = values[0]
    rng = np.random.default_rng(6)
    values[:, :3] = np.round(values[:, :3] + rng.normal(size=(len(values), 3)) * 1e-5, 4)
    values[:, 3:] = np.round(values[:, 3:], 3)
    flown = repair(replace(made, mocap=replace(stream, values=values), imu=None))
    assert len(flown.mocap) > 0.2 * len(stream)
