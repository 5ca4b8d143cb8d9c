"""Recordings: an independent reader sees every sample, a file cut anywhere opens, a full disk is reported."""

from __future__ import annotations

import errno
import math
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from drivers.samples import Battery, Event, Imu, Motors, Pose, Raw, Setpoint, State
from groundstation.errors import BadInput
from groundstation.recording import McapRecorder, load_flight, read_recording
from groundstation.recording.container import ContainerWriter, Contents, read_container
from groundstation.recording.recorded import vehicle_file
from tests.recording_flight import flight, qball

SAMPLES = [
    Imu(1.25, (0.1, -0.2, 0.3), (0.01, 0.02, 9.81)),
    Pose(2.000000001, (1.0, -2.0, 0.5), (0.8, 0.0, 0.6, 0.0)),
    Motors(1.2500001, (500.0, 501.0, 502.0, 503.0)),
    Battery(7.0, 12.345678901234567, 3.2),
    Setpoint(1.5, (0.1, 0.2, 0.3), -0.4),
    State(1.75, (1.0, 2.0, 3.0), (0.1, 0.2, 0.3), (0.8, 0.0, 0.6, 0.0), (0.5, 0.6, 0.7)),
    Event(3.0, "guard", "tilt 41° over 35°"),
    Raw(4.0, "out", bytes(range(7))),
]


def record(path: Path, samples=SAMPLES) -> Path:
    with McapRecorder(path, {"scenario": "none"}, {"vehicle.toml": vehicle_file(qball())}) as recorder:
        for index, sample in enumerate(samples):
            recorder.add(sample, 100.0 + index / 1000.0)
        recorder.add_status(5.0, 101.0, "airborne", armed=True, text="12 s left")
        assert recorder.failure is None
        assert recorder.written == len(samples) + 1
    return path


def test_an_independent_ros2_reader_decodes_every_topic(tmp_path):
    path = record(tmp_path / "a.mcap")
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        decoded = {channel.topic: (message, ros) for _, channel, message, ros in reader.iter_decoded_messages()}
        attachments = {attachment.name for attachment in reader.iter_attachments()}
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        assert (
            reader.get_summary().statistics.message_count == len(SAMPLES) + 2
        )  # and the status, and what the battery had to round
    assert attachments == {"vehicle.toml"}
    assert metadata["groundstation"]["scenario"] == "none"
    imu = decoded["/imu"][1]
    assert (imu.angular_velocity.y, imu.linear_acceleration.z) == (-0.2, 9.81)
    assert imu.orientation_covariance[0] == -1.0
    message, pose = decoded["/mocap"]
    assert (pose.pose.orientation.w, pose.pose.orientation.y, pose.pose.position.y) == (0.8, 0.6, -2.0)
    assert (pose.header.stamp.sec, pose.header.stamp.nanosec, pose.header.frame_id) == (2, 1, "world")
    assert (message.log_time, message.publish_time) == (100_001_000_000, 2_000_000_001)
    battery = decoded["/battery"][1]
    assert battery.voltage == np.float32(12.345678901234567)
    assert battery.current == np.float32(-3.2)
    assert math.isnan(battery.percentage)
    assert (battery.power_supply_status, battery.present) == (2, True)
    assert decoded["/battery/exact"][1].values == [12.345678901234567, 3.2]
    assert decoded["/motors"][1].values == [500.0, 501.0, 502.0, 503.0]
    assert decoded["/motors"][1].kind == 0
    assert (decoded["/setpoint"][1].position.z, decoded["/setpoint"][1].yaw) == (0.3, -0.4)
    state = decoded["/state"][1]
    assert (state.pose.position.x, state.pose.orientation.w, state.velocity.y, state.rate.z) == (1.0, 0.8, 0.2, 0.7)
    assert (decoded["/events"][1].kind, decoded["/events"][1].text) == ("guard", "tilt 41° over 35°")
    raw = decoded["/mavlink/raw"][1]
    assert (raw.direction, bytes(raw.data)) == (1, bytes(range(7)))
    status = decoded["/status"][1]
    assert (status.phase, status.armed, status.text) == ("airborne", True, "12 s left")
    assert (status.device_s, status.received_s) == (5.0, 101.0)


def test_what_was_recorded_is_read_back(tmp_path):
    recording = read_recording(record(tmp_path / "a.mcap"))
    assert recording.notes == ()
    assert recording.metadata == {"scenario": "none"}
    assert recording.streams["imu"].values.tolist() == [[0.1, -0.2, 0.3, 0.01, 0.02, 9.81]]
    assert recording.streams["mocap"].values.tolist() == [[1.0, -2.0, 0.5, 0.8, 0.0, 0.6, 0.0]]
    assert recording.streams["battery"].values.tolist() == [[12.345678901234567, 3.2]]
    assert recording.streams["state"].values.tolist() == [[1, 2, 3, 0.1, 0.2, 0.3, 0.8, 0, 0.6, 0, 0.5, 0.6, 0.7]]
    assert recording.texts["events"].rows == (("guard", "tilt 41° over 35°"),)
    assert recording.texts["raw"].rows == (("out", "00010203040506"),)
    assert recording.texts["status"].rows == (("airborne", "1", "12 s left"),)
    assert recording.vehicle("a.mcap") == qball()


finite = st.floats(allow_nan=False, allow_infinity=False)


@settings(max_examples=60, deadline=None)
@given(times=st.lists(st.tuples(st.floats(), st.floats()), min_size=1, max_size=8), value=st.floats())
def test_every_time_and_value_survives_bit_for_bit(tmp_path_factory, times, value):
    path = tmp_path_factory.mktemp("bits") / "a.mcap"
    with McapRecorder(path) as recorder:
        for device_s, host_s in times:
            recorder.add(Imu(device_s, (value, 0.0, 1.0), (1.0, 2.0, value)), host_s)
            recorder.add(Motors(device_s, (value,) * 4), host_s)
            recorder.add(Battery(device_s, value, -value), host_s)
    streams = read_recording(path).streams
    for name, expected in (
        ("imu", [value, 0.0, 1.0, 1.0, 2.0, value]),
        ("motors", [value] * 4),
        ("battery", [value, -value]),
    ):
        stream = streams[name]
        assert same_bits(stream.t_s, times, 0)
        received = stream.received_s if stream.received_s is not None else np.full(len(times), np.nan)
        assert same_bits(received, times, 1)
        assert np.array_equal(stream.values, np.tile(expected, (len(times), 1)), equal_nan=True)


def same_bits(actual, times, index) -> bool:
    """Equal doubles, zeros with their sign, any NaN for a NaN."""
    expected = np.array([pair[index] for pair in times])
    signs = np.signbit(actual) == np.signbit(expected)
    return np.array_equal(actual, expected, equal_nan=True) and bool(np.all(signs | np.isnan(expected)))


def test_microsecond_stamps_need_no_companion(tmp_path):
    """Devices stamp in whole microseconds: such times survive in the standard message, without a second one."""
    path = tmp_path / "a.mcap"
    with McapRecorder(path) as recorder:
        for k in range(2000):
            recorder.add(Imu((39_240_817 + 1003 * k) / 1e6, (0.0,) * 3, (0.0,) * 3), (k * 997) / 1e9)
    contents = Contents()
    with path.open("rb") as file:
        assert sum(1 for _ in read_container(file, contents)) == 2000
    assert {channel.topic for channel in contents.channels.values()} == {"/imu"}
    t_s = read_recording(path).streams["imu"].t_s
    assert np.array_equal(t_s, (39_240_817 + 1003 * np.arange(2000)) / 1e6)


@pytest.fixture(scope="module")
def long_recording(tmp_path_factory) -> bytes:
    path = tmp_path_factory.mktemp("long") / "a.mcap"
    rng = np.random.default_rng(1)
    with McapRecorder(path, {}, {"vehicle.toml": vehicle_file(qball())}) as recorder:
        for k in range(3000):
            recorder.add(Imu(k / 500.0, tuple(rng.normal(size=3)), tuple(rng.normal(size=3))), 7.0 + k / 500.0)
            recorder.add(Motors(k / 500.0, tuple(rng.normal(size=4))), 7.0 + k / 500.0)
    return path.read_bytes()


@settings(max_examples=40, deadline=None)
@given(share=st.floats(0.0, 1.0))
def test_a_file_cut_anywhere_opens_up_to_the_cut(tmp_path_factory, long_recording, share):
    path = tmp_path_factory.mktemp("cut") / "a.mcap"
    at = int(share * len(long_recording))
    path.write_bytes(long_recording[:at])
    header_end = 200  # magic, header and metadata record
    if at < header_end:
        return
    try:
        recording = read_recording(path)
    except BadInput as error:
        assert "MCAP" in str(error)
        assert at < 400
        return
    kept = len(recording.streams["imu"]) if "imu" in recording.streams else 0
    total = 3000
    # 64 KiB chunks and a flush each second: at most one chunk of the data before the cut is missing.
    assert kept >= (share * total) - 400
    if at < len(long_recording) - 3000:
        assert any("cut off" in note for note in recording.notes)


def test_a_damaged_chunk_costs_its_own_samples_alone(tmp_path, long_recording):
    path = tmp_path / "a.mcap"
    data = bytearray(long_recording)
    middle = len(data) // 2
    data[middle : middle + 8] = bytes(8)
    path.write_bytes(bytes(data))
    recording = read_recording(path)
    assert 3000 - 300 <= len(recording.streams["imu"]) < 3000
    assert any("damaged" in note for note in recording.notes)


def test_a_killed_process_loses_less_than_a_second(tmp_path):
    """SIGKILL in the middle of recording on a slow link (20 samples a second: a chunk would fill in a minute)."""
    path = tmp_path / "killed.mcap"
    script = f"""
import itertools, os, signal
from drivers.samples import Battery
from groundstation.recording import McapRecorder
recorder = McapRecorder({str(path)!r})
for k in range(201):
    recorder.add(Battery(k / 20.0, 12.0, 1.0), k / 20.0)
os.kill(os.getpid(), signal.SIGKILL)
"""
    done = subprocess.run([sys.executable, "-P", "-c", script], check=False, cwd=Path(__file__).parents[1])
    assert done.returncode == -signal.SIGKILL
    t_s = read_recording(path).streams["battery"].t_s
    assert t_s[-1] >= 9.0


def test_a_full_disk_is_reported_and_what_was_written_stays_readable(tmp_path):
    class FullAt:
        def __init__(self, file, room):
            self.file, self.room, self.closed = file, room, False

        def write(self, data):
            if len(data) > self.room:
                self.file.write(bytes(data)[: self.room])
                self.room = 0
                raise OSError(errno.ENOSPC, "No space left on device")
            self.room -= len(data)
            return self.file.write(data)

        def close(self):
            self.closed = True
            self.file.close()

    path = tmp_path / "a.mcap"
    recorder = McapRecorder(path, {}, {"vehicle.toml": vehicle_file(qball())})
    recorder._file = FullAt(recorder._file, 200_000)
    recorder._writer._file = recorder._file
    rng = np.random.default_rng(2)
    for k in range(5000):
        recorder.add(Imu(k / 500.0, tuple(rng.normal(size=3)), tuple(rng.normal(size=3))), k / 500.0)
    recorder.close()
    assert "No space left on device" in recorder.failure
    assert recorder.lost + recorder.written == 5000
    kept = len(read_recording(path).streams["imu"])
    assert 0 < kept <= recorder.written
    assert recorder.written - kept < 500


def test_a_device_that_is_always_full_is_refused_or_reported():
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    with open("/dev/full", "wb", buffering=0) as full, pytest.raises(OSError, match="No space"):  # noqa: PTH123
        ContainerWriter(full, "ros2", "test")


def test_a_recording_is_never_written_over(tmp_path):
    path = record(tmp_path / "a.mcap")
    before = path.read_bytes()
    with pytest.raises(BadInput, match="exists already"):
        McapRecorder(path)
    assert path.read_bytes() == before


def test_metadata_set_late_holds(tmp_path):
    path = tmp_path / "a.mcap"
    with McapRecorder(path, {"scenario": "x"}) as recorder:
        recorder.add(Motors(1.0, (1.0,) * 4), 1.0)
        recorder.set_metadata({"window_start_s": repr(0.1 + 0.2), "window_end_s": "9.5"})
    recording = read_recording(path)
    assert recording.window_s == (0.1 + 0.2, 9.5)
    assert recording.metadata == {"scenario": "x"}


def test_a_second_device_of_a_kind_goes_to_its_own_topic(tmp_path):
    path = tmp_path / "a.mcap"
    with McapRecorder(path) as recorder:
        recorder.add(Imu(1.0, (1.0,) * 3, (2.0,) * 3), 1.0)
        recorder.add(Imu(1.0, (3.0,) * 3, (4.0,) * 3), 1.0, "/onboard/imu")
    recording = read_recording(path)
    assert recording.streams["imu"].values[0, 0] == 1.0
    assert recording.extras["onboard/imu"].values[0, 0] == 3.0


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"hello, this is no recording"])
def test_what_is_no_recording_is_refused_in_a_sentence(tmp_path, content):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(BadInput, match=r"a\.mcap"):
        load_flight(path)


def test_a_recording_without_motors_says_so(tmp_path):
    path = tmp_path / "a.mcap"
    with McapRecorder(path, {}, {"vehicle.toml": vehicle_file(qball())}) as recorder:
        recorder.add(SAMPLES[0], 1.0)
    with pytest.raises(BadInput, match="no motor samples"):
        load_flight(path)


def test_truth_is_kept_apart_from_what_is_declared(tmp_path):
    """The true vehicle is an attachment of its own; the declared one is what a flight's vehicle is."""
    true = flight().vehicle.model_copy(update={"mass_kg": 9.0})
    path = tmp_path / "a.mcap"
    files = {"vehicle.toml": vehicle_file(qball()), "truth.toml": vehicle_file(true)}
    with McapRecorder(path, {}, files) as recorder:
        for k in range(50):
            recorder.add(Motors(k / 100.0, (600.0,) * 4), k / 100.0)
    loaded = load_flight(path)
    assert loaded.vehicle.mass_kg == qball().mass_kg
    assert loaded.truth is not None
    assert loaded.truth.mass_kg == 9.0
