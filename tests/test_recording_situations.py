"""Logs of unusual flights: replayed, clocks that were set, several flights in one, begun or ended in the air."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest

from groundstation.errors import BadInput
from groundstation.flightdata import STATE_COLUMNS, Stream
from groundstation.frames import quat_from_euler
from groundstation.identification.motion import motion_of
from groundstation.recording import bagclock, load_flight, read_recording, write_bundle
from groundstation.recording.one_clock import pieces_of
from groundstation.recording.thinning import CHANGED_S
from tests.recording_flight import flight
from tests.test_recording_settings import QUAD, STEP
from tests.written_logs import ArduLog, Px4Log, truth


@pytest.fixture(scope="module")
def made():
    """Nine seconds that nobody planned, every stream on one clock, as a log has it."""
    whole = flight(9.0)
    alone = dict.fromkeys(("plan", "window_s", "truth", "state", "setpoint"))
    poses = replace(whole.mocap, t_s=whole.mocap.t_s + 4.75)
    streams = {name: replace(s, received_s=None) for name, s in (whole.streams() | {"mocap": poses}).items()}
    return replace(whole, **(streams | alone))


def clocked(made, change):
    """The flight with other stamps: what ``change`` makes of each stream's own."""
    streams = {name: replace(stream, t_s=change(stream.t_s)) for name, stream in made.streams().items()}
    return replace(made, **streams)


def offsets(read, made):
    """Of each stream's samples by what they hold: their stamps less those they were made with."""
    for name, stream in read.streams().items():
        before = made.streams()[name]
        at = {tuple(row): t for row, t in zip(before.values.round(9).tolist(), before.t_s, strict=True)}
        # Repairs touch some samples; most are as they were.
        shifts = [
            t - at[tuple(row)]
            for row, t in zip(stream.values.round(9).tolist(), stream.t_s, strict=True)
            if tuple(row) in at
        ]
        assert len(shifts) > 0.9 * len(stream), name
        yield name, np.array(shifts)


@pytest.mark.parametrize("by_s", [-2.0, -0.5, 3600.0, 1.7e9, -1.7e9])
def test_a_clock_that_was_set_leaves_the_longest_part_on_one_clock(tmp_path, made, by_s):
    """Set by GPS or NTP after three of nine seconds: samples that belong together stay together, and it is told."""
    write_bundle(clocked(made, lambda t: np.where(t >= 6.25, t + by_s, t)), tmp_path / "log")
    read = load_flight(tmp_path / "log")
    for name, shifts in offsets(read, made):
        assert np.allclose(shifts, by_s, atol=1e-6), name
    assert read.motors.t_s[-1] - read.motors.t_s[0] == pytest.approx(6.0, abs=0.05)
    (note,) = [note for note in read.notes if "the clock steps by" in note]
    assert "imu" in note
    assert "set by GPS or NTP" in note


@pytest.mark.parametrize("name", ["imu", "mocap", "battery"])
@pytest.mark.parametrize("by_s", [-2.0, 1.7e9])
def test_a_stream_whose_own_clock_was_set_is_used_where_it_agrees_with_the_motors(tmp_path, made, name, by_s):
    stream = made.streams()[name]
    stepped = replace(stream, t_s=np.where(stream.t_s >= 9.25, stream.t_s + by_s, stream.t_s))
    write_bundle(replace(made, **{name: stepped}), tmp_path / "log")
    read = load_flight(tmp_path / "log")
    for _, shifts in offsets(read, made):
        assert np.allclose(shifts, 0.0, atol=1e-6)
    assert len(read.motors) == len(made.motors)
    assert any(note.startswith(f"{name}: the clock steps by") for note in read.notes)


def test_a_clock_set_ahead_by_seconds_is_a_gap_that_no_fit_goes_across(tmp_path, made):
    write_bundle(clocked(made, lambda t: np.where(t >= 6.25, t + 3.0, t)), tmp_path / "log")
    read = load_flight(tmp_path / "log")
    assert len(read.motors) == len(made.motors)
    assert any(note.startswith("motors: 1 gap in the stream, 3.0") for note in read.notes)


def test_a_stamp_that_strays_or_comes_late_is_no_step():
    t = np.arange(0.0, 4.0, 0.01)
    t[200] = 1e9
    t[[300, 301]] = t[[301, 300]]
    t[350] = np.nan
    assert pieces_of(t) == [(0, 400)]
    assert pieces_of(t[::-1]) == [(0, 400)]  # a stream that runs backwards is refused as such
    t[320:] -= 1.0
    assert pieces_of(t) == [(0, 320), (320, 400)]


@pytest.mark.parametrize("store", ["MCAP", "SQLITE3"])
def test_a_bag_whose_clock_was_set_back_is_refused(tmp_path, store):
    """Its messages are read in the order of their stamps: those of two times would come out as one."""
    rosbag = pytest.importorskip("tests.test_recording_rosbag")

    def speeds(store, time):
        return store.types["actuator_msgs/msg/Actuators"](
            rosbag.header(store, time), rosbag.NONE, np.full(4, 500.0), rosbag.NONE
        )

    stamps = np.concatenate([np.arange(100.0, 104.0, 0.02), np.arange(102.0, 106.0, 0.02)])
    topics = {"/motors": ("actuator_msgs/msg/Actuators", [(t, speeds) for t in stamps.tolist()])}
    folder = rosbag.bag(tmp_path / "bag", rosbag.StoragePlugin[store], topics)
    with pytest.raises(BadInput, match=r"was set back by 1\.98 s, 3\.98 s into"):
        read_recording(folder, rosbag.QUAD)
    steady = {"/motors": ("actuator_msgs/msg/Actuators", [(t, speeds) for t in np.unique(stamps).tolist()])}
    assert (
        "motors"
        in read_recording(rosbag.bag(tmp_path / "other", rosbag.StoragePlugin[store], steady), rosbag.QUAD).streams
    )


@pytest.mark.parametrize("together", [1, 7, 10, 64])
@pytest.mark.parametrize("step_at", [5, 9, 64, 195])
def test_a_clock_set_back_is_found_wherever_its_stamps_are_divided(monkeypatch, together, step_at):
    monkeypatch.setattr(bagclock, "_AT_ONCE", together)
    stamps = np.arange(200) * 20_000_000 + 10**18
    clock = bagclock._Clock(10**18)
    for first in range(0, 200, 3):
        clock.add(stamps[first : first + 3])
    assert clock.back() == []
    stamps[step_at:] -= 2_000_000_000
    clock = bagclock._Clock(10**18)
    for first in range(0, 200, 3):
        clock.add(stamps[first : first + 3])
    before = 0.02 * (step_at - 1)
    assert clock.back() == [pytest.approx((before, before + 0.02 - 2.0))]


def twice(made, rest_s):
    """Two flights in one log: the vehicle stands between them, its motors off; in the second it moves more."""
    away = made.motors.t_s[-1] - made.motors.t_s[0] + rest_s

    def joined(stream, between, more):
        t_rest = np.arange(stream.t_s[-1] + 0.01, stream.t_s[0] + away - 0.01, 0.01)
        rest = np.tile(between, (len(t_rest), 1))
        values = np.vstack([stream.values, rest, more(stream.values)])
        return Stream(np.concatenate([stream.t_s, t_rest, stream.t_s + away]), values, stream.columns)

    middle = np.median(made.imu.values, axis=0)
    imu = joined(made.imu, [0.0, 0.0, 0.0, 0.0, 0.0, 9.81], lambda v: middle + 2.0 * (v - middle))
    motors = joined(made.motors, np.zeros(4), lambda v: v)
    return replace(made, imu=imu, motors=motors, mocap=None, battery=None), made.motors.t_s[0] + away


def test_of_two_flights_one_is_used_and_told_and_the_other_can_be_chosen(tmp_path, made):
    both, second_s = twice(made, CHANGED_S + 20.0)
    write_bundle(both, tmp_path / "log")
    read = load_flight(tmp_path / "log")
    assert read.motors.t_s[0] == pytest.approx(second_s - 2.0, abs=0.02)
    (note,) = [note for note in read.notes if "holds 2 flights" in note]
    assert "Number 2 is used" in note
    assert "--from and --to" in note
    first = load_flight(tmp_path / "log", start_s=0.0, end_s=13.0)
    assert first.motors.t_s[-1] < 13.0
    assert not any("2 flights" in note for note in first.notes)
    assert len(load_flight(tmp_path / "log", everything=True).motors) == len(both.motors)


def test_hops_with_short_rests_and_a_pause_of_the_logger_are_one_flight(tmp_path, made):
    both, _ = twice(made, 0.5 * CHANGED_S)
    write_bundle(both, tmp_path / "log")
    assert len(load_flight(tmp_path / "log").motors) == len(both.motors)
    both, _ = twice(made, 40.0)
    flying = both.motors.values.mean(axis=1) > 0.0
    write_bundle(replace(both, motors=both.motors.select(flying)), tmp_path / "paused")
    assert len(load_flight(tmp_path / "paused").motors) == np.count_nonzero(flying)


@pytest.mark.parametrize("name", ["a.ulg", "a.bin"])
@pytest.mark.parametrize("part", [slice(60, None), slice(None, 340), slice(60, 340)], ids=["begun", "ended", "both"])
def test_a_log_begun_or_ended_in_flight_gives_the_same_commands(tmp_path, name, part):
    """Of a flight with rest at both ends, what a logger keeps that began after take-off, or stopped before landing."""
    t, u = truth()
    log = (
        Px4Log(limits=dict.fromkeys((1, 2, 3, 4), (1075.0, 1950.0)))
        if name == "a.ulg"
        else ArduLog(limits=(1100.0, 1900.0))
    )
    (tmp_path / name).write_bytes(log.write(t[part], u[part]))
    read = read_recording(tmp_path / name, QUAD)
    assert np.abs(read.streams["motors"].values - u[part]).max() < STEP
    assert np.allclose(read.streams["motors"].t_s, t[part], atol=1e-6)


def ulog_messages(data):
    at = 16
    while at + 3 <= len(data):
        end = at + 3 + int.from_bytes(data[at : at + 2], "little")
        yield data[at + 2 : at + 3], data[at:end]
        at = end


def dataflash_records(data):
    sizes, at = {128: 89}, 0
    while at + 3 <= len(data):
        kind = data[at + 2]
        if kind == 128:
            sizes[data[at + 3]] = data[at + 4]
        yield kind, data[at : at + sizes[kind]]
        at += sizes[kind]


def test_parameters_that_a_log_tells_only_at_its_end_hold_for_all_of_it_and_that_is_told(tmp_path):
    t, u = truth()
    px4 = Px4Log(channels=(4, 2, 1, 3), limits=dict.fromkeys((1, 2, 3, 4), (1075.0, 1950.0))).write(t, u)
    parts = list(ulog_messages(px4))
    late = [m for kind, m in parts if kind != b"P"] + [m for kind, m in parts if kind == b"P"]
    (tmp_path / "a.ulg").write_bytes(px4[:16] + b"".join(late))
    ardu = ArduLog(channels=(4, 2, 1, 3), limits=(1100.0, 1900.0)).write(t, u)
    at_end = struct.pack("<Q", round(1e6 * t[-1]))
    moved = [r if kind != 32 else r[:3] + at_end + r[11:] for kind, r in dataflash_records(ardu)]
    (tmp_path / "a.bin").write_bytes(b"".join(sorted(moved, key=lambda r: r[2] == 32)))
    for name in ("a.ulg", "a.bin"):
        read = read_recording(tmp_path / name, QUAD)
        assert np.abs(read.streams["motors"].values - u).max() < STEP, name
        assert any("told only after the motors ran" in note for note in read.notes), name


def test_a_replay_of_another_log_is_refused(tmp_path):
    """PX4 writes the name of the log that it replayed into the new one's information."""
    t, u = truth()
    data = Px4Log(limits=dict.fromkeys((1, 2, 3, 4), (1000.0, 2000.0))).write(t, u)
    key, value = b"char[9] replay", b"log_1.ulg"
    told = bytes([len(key)]) + key + value
    (tmp_path / "a.ulg").write_bytes(data + struct.pack("<HB", len(told), ord("I")) + told)
    with pytest.raises(BadInput, match=r"is a replay of log_1\.ulg.*Give the log that was replayed"):
        read_recording(tmp_path / "a.ulg", QUAD)


def test_a_log_without_motion_capture_is_not_told_of_its_clock(made):
    """Where the vehicle's own attitude is of another motion than its gyro, that is what is named."""
    t_s = np.arange(3.25, 12.0, 0.01)
    turned = quat_from_euler(*(0.4 * np.sin(np.outer([5.1, 6.3, 4.2], t_s) ** 1.3)))
    values = np.hstack([np.zeros((len(t_s), 6)), turned, np.zeros((len(t_s), 3))])
    other = replace(made, mocap=None, state=Stream(t_s, values, STATE_COLUMNS))
    notes = motion_of(other).notes
    assert any("the clocks of the vehicle's own attitude and IMU cannot be aligned" in note for note in notes)
    assert not any("clocks of motion capture" in note for note in notes)
