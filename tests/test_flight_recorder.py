"""The recorder's thread: order, counts, gaps and a disk that fails."""

from __future__ import annotations

import json
import threading

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.samples import Batch, Event, Imu, Motors
from groundstation.flight.core.ground_check import check_ground
from groundstation.flight.core.meters import StreamMeter
from groundstation.flight.core.recorder import Recorder
from groundstation.flight.messages import StreamStatus
from groundstation.paths import find_config
from groundstation.vehicle import load_vehicle


class Memory:
    """A sink that keeps what it gets, and fails when told to."""

    def __init__(self, fail_after: int | None = None):
        self.samples, self.topics, self.metadata, self.statuses = [], [], {}, []
        self.failure, self.closed, self._left = None, False, fail_after
        self.gate = threading.Event()
        self.gate.set()

    def add(self, sample, host_s, topic=None):
        self.gate.wait()
        if self._left is not None and len(self.samples) >= self._left:
            self.failure = "no space left on device"
            return
        self.samples.append((sample, host_s))
        self.topics.append(topic)

    def add_status(self, device_s, host_s, phase, armed, text=""):
        self.statuses.append((phase, text))

    def set_metadata(self, values):
        self.metadata |= values

    def close(self):
        self.closed = True


def batch(sequence: int, *times: float) -> Batch:
    return Batch(sequence, times, tuple(Imu(t, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8)) for t in times))


def recorder(sink: Memory):
    digested, failures = [], []
    return Recorder(sink, digested.append, failures.append), digested, failures


@given(st.lists(st.integers(0, 4), max_size=20), st.sets(st.integers(0, 19), max_size=6))
@settings(max_examples=30, deadline=None)
def test_everything_that_arrives_is_written_in_order_and_what_does_not_is_counted(sizes, dropped):
    sink = Memory()
    made, digested, failures = recorder(sink)
    arrived = [index for index in range(len(sizes)) if index not in dropped]
    for index in arrived:
        made.put(batch(index, *(index + 0.1 * k for k in range(sizes[index]))))
    made.close()
    expected = [index + 0.1 * k for index in arrived for k in range(sizes[index])]
    assert [host_s for _, host_s in sink.samples] == expected
    assert made.recorded == len(expected) and sink.closed and not failures
    between = arrived[-1] - arrived[0] + 1 if arrived else 0
    assert made.lost_batches == between - len(arrived)
    assert digested == sorted(digested)


def test_a_slow_disk_delays_nobody_and_loses_nothing():
    sink = Memory()
    sink.gate.clear()
    made, digested, _ = recorder(sink)
    for index in range(100):
        made.put(batch(index, float(index)))  # returns although nothing can be written
    assert not digested
    sink.gate.set()
    made.close()
    assert made.recorded == 100 and digested[-1] == 99.0


def test_a_full_disk_is_told_once():
    sink = Memory(fail_after=3)
    made, _, failures = recorder(sink)
    for index in range(10):
        made.put(batch(index, float(index)))
    made.close()
    assert len(failures) == 1 and "no space left" in failures[0]


def test_notes_status_and_metadata_keep_their_place_among_the_samples():
    sink = Memory()
    made, _, _ = recorder(sink)
    made.put(batch(0, 1.0))
    made.note(1.5, "phase", "airborne")
    made.put(batch(1, 2.0))
    made.metadata({"window_start_s": "1.0"})
    made.close()
    assert [type(sample).__name__ for sample, _ in sink.samples] == ["Imu", "Event", "Imu"]
    assert sink.samples[1] == (Event(1.5, "phase", "airborne"), 1.5)
    assert sink.metadata["window_start_s"] == "1.0"
    assert set(made.streams(2.0)) == {"imu"}, "an event is no stream"


def test_rates_come_from_device_stamps_not_from_batches():
    meter = StreamMeter()
    for index in range(500):
        meter.add(0.002 * index, host_s=0.05 * (index // 25))  # 25 samples arrive at once
    status = meter.status(host_s=1.5)
    assert status.rate_hz == pytest.approx(500.0)
    assert status.count == 500 and status.age_s == pytest.approx(1.5 - 0.95)
    meter.add(0.002 * 499 + 0.3, 1.6)
    assert meter.status(1.6).longest_gap_s == pytest.approx(0.3)


def test_each_gap_duplicate_reordering_and_clock_jump_is_counted_and_a_stalled_host_is_none():
    meter, host_s, ahead_s = StreamMeter(), 100.0, 0.0
    planted = {"gaps": 3, "duplicates": 4, "reordered": 5, "clock_jumps": 2}
    at = {100: "gaps", 150: "gaps", 900: "gaps", 200: "clock_jumps", 260: "clock_jumps", 300: "stall"}
    at |= {400 + 20 * k: "duplicates" for k in range(4)} | {600 + 20 * k: "reordered" for k in range(5)}
    held, index = None, 0
    for step in range(1000):
        what = at.get(step, "")
        index += 2 if what == "gaps" else 1  # one sample never comes
        if what == "clock_jumps":
            ahead_s = 3600.0 if not ahead_s else 0.0  # forward, then back
        host_s = max(host_s, 100.0 + 0.004 * index) if what != "stall" else 100.0 + 0.004 * index + 2.0
        stamp = 0.004 * index + ahead_s
        if what == "reordered":
            held = stamp
            continue
        meter.add(stamp, host_s)
        if what == "duplicates":
            meter.add(stamp, host_s)
        if held is not None:
            meter.add(held, host_s)
            held = None
    found = meter.counts.document()
    assert {name: found[name] for name in planted} == planted
    assert found["samples"] == 1004 and found["longest_gap_s"] == pytest.approx(0.008)


def test_a_clock_that_was_set_back_leaves_no_window_that_grows():
    meter = StreamMeter()
    for index in range(5000):
        meter.add(3600.0 * (index < 1000) + 0.001 * index, 0.001 * index)
    assert meter.counts.clock_jumps == 1
    assert len(meter._stamps) <= 1002
    assert meter.status(5.0).rate_hz == pytest.approx(1000.0)


def test_what_was_counted_is_in_the_record():
    sink = Memory()
    made, _, _ = recorder(sink)
    made.put(batch(0, *(0.01 * k for k in range(50)), 0.49))
    made.close()
    counted = json.loads(sink.metadata["streams"])["imu"]
    assert counted["samples"] == 51 and counted["duplicates"] == 1 and counted["gaps"] == 0


def test_the_ground_check_waits_then_says_yes_or_why_not():
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    both = {"imu": StreamStatus(), "motors": StreamStatus(), "pose": StreamStatus()}
    assert check_ground(both, 12.0, vehicle, 0.5) is None
    assert check_ground(both, 12.0, vehicle, 1.5).ok
    assert check_ground(both, 0.0, vehicle, 1.5).ok, "an unknown voltage is not an empty battery"
    low = check_ground(both, 10.0, vehicle, 1.5)
    assert not low.ok and "10.00 V" in low.reason and "charge" in low.reason
    assert check_ground({"imu": StreamStatus()}, 12.0, vehicle, 2.0) is None
    missing = check_ground({"imu": StreamStatus()}, 12.0, vehicle, 6.0)
    assert not missing.ok and "motors" in missing.reason


def test_commands_are_kept_beside_measured_speeds_and_count_as_no_stream_of_their_own():
    sink = Memory()
    writer, *_ = recorder(sink)
    pair = (Motors(1.0, (500.0,) * 4, "rotor_speed"), Motors(1.0, (0.5,) * 4, "command"))
    writer.put(Batch(0, (1.0, 1.0), pair))
    writer.close()
    assert sink.topics == [None, "/motor_commands"]
    assert writer.streams(1.0)["motors"].count == 1


def test_commands_alone_are_the_motors_stream():
    sink = Memory()
    writer = Recorder(sink, lambda host_s: None, lambda reason: None, "command")
    writer.put(Batch(0, (1.0,), (Motors(1.0, (0.5,) * 4, "command"),)))
    writer.close()
    assert sink.topics == [None] and writer.streams(1.0)["motors"].count == 1
