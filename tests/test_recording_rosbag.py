"""ROS 2 bags of both stores: standard messages and PX4's, written by the rosbags library, come back in our frames."""

from __future__ import annotations

import sqlite3
import tempfile

import numpy as np
import pytest
import zstandard

from groundstation.errors import BadInput
from groundstation.frames import quat_from_euler, quat_rotate
from groundstation.recording import confined, convert, read_recording
from groundstation.recording.airframes import ARDUPILOT
from groundstation.recording.recorded import vehicle_file
from groundstation.recording.rosbag import read_topic
from tests.test_recording_settings import like
from tests.written_logs import truth

rosbags = pytest.importorskip("rosbags")

from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer  # noqa: E402
from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: E402

ACTUATORS = "std_msgs/Header header\nfloat64[] position\nfloat64[] velocity\nfloat64[] normalized\n"
PX4_MOTORS = "uint64 timestamp\nuint64 timestamp_sample\nfloat32[12] control\n"
PX4_IMU = "uint64 timestamp\nfloat32[3] gyro_rad\nuint32 gyro_integral_dt\nfloat32[3] accelerometer_m_s2\n"
QUAD = like(ARDUPILOT[1, 1], "rotor_speed")
EULER = (0.1, -0.2, 0.7)
NONE = np.empty(0)


def types(more=None):
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in (
        ("actuator_msgs/msg/Actuators", ACTUATORS),
        ("px4_msgs/msg/ActuatorMotors", PX4_MOTORS),
        ("px4_msgs/msg/SensorCombined", PX4_IMU),
        *(more or {}).items(),
    ):
        store.register(get_types_from_msg(text, name))
    return store


def bag(folder, plugin, topics, mode=None, more=None):
    """A bag of topics: name to (type, [(time, fields)]); its files or messages compressed where a mode says so."""
    store = types(more)
    writer = Writer(folder, version=9, storage_plugin=plugin)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        for topic, (kind, rows) in topics.items():
            connection = writer.add_connection(topic, kind, typestore=store)
            for time, message in rows:
                writer.write(connection, round((time + 0.002) * 1e9), store.serialize_cdr(message(store, time), kind))
    return folder


def header(store, time):
    stamp = store.types["builtin_interfaces/msg/Time"](int(time), round((time % 1.0) * 1e9))
    return store.types["std_msgs/msg/Header"](stamp, "map")


def standard():
    t, u = truth()
    q = quat_from_euler(*EULER)

    def imu(s, time):
        v, quaternion = s.types["geometry_msgs/msg/Vector3"], s.types["geometry_msgs/msg/Quaternion"]
        cov = np.zeros(9)
        return s.types["sensor_msgs/msg/Imu"](
            header(s, time), quaternion(0.0, 0.0, 0.0, 1.0), cov, v(0.1, 0.2, 0.3), cov, v(0.0, 0.5, 9.8), cov
        )

    def pose_of(s):
        point = s.types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0)
        return s.types["geometry_msgs/msg/Pose"](point, s.types["geometry_msgs/msg/Quaternion"](q[1], q[2], q[3], q[0]))

    def pose(s, time):
        return s.types["geometry_msgs/msg/PoseStamped"](header(s, time), pose_of(s))

    def odometry(s, time):
        v = s.types["geometry_msgs/msg/Vector3"]
        twist = s.types["geometry_msgs/msg/Twist"](v(1.0, 0.0, 0.0), v(0.0, 0.0, 0.4))
        cov = np.zeros(36)
        return s.types["nav_msgs/msg/Odometry"](
            header(s, time),
            "base_link",
            s.types["geometry_msgs/msg/PoseWithCovariance"](pose_of(s), cov),
            s.types["geometry_msgs/msg/TwistWithCovariance"](twist, cov),
        )

    def motors(row):
        return lambda s, time: s.types["actuator_msgs/msg/Actuators"](header(s, time), NONE, row, NONE)

    speeds = 300.0 + 400.0 * u
    return speeds, {
        "/imu/data": ("sensor_msgs/msg/Imu", [(x, imu) for x in t]),
        "/vrpn/qball2/pose": ("geometry_msgs/msg/PoseStamped", [(x, pose) for x in t[::2]]),
        "/odom": ("nav_msgs/msg/Odometry", [(x, odometry) for x in t[::4]]),
        "/motors": ("actuator_msgs/msg/Actuators", [(x, motors(row)) for x, row in zip(t, speeds, strict=True)]),
    }


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_bag_of_standard_messages_is_read_from_either_store(tmp_path, plugin):
    speeds, topics = standard()
    recording = read_recording(bag(tmp_path / "bag", plugin, topics), QUAD)
    s = recording.streams
    assert np.allclose(s["motors"].values, speeds)
    assert s["imu"].values[0].tolist() == [0.1, 0.2, 0.3, 0.0, 0.5, 9.8]
    assert np.allclose(s["mocap"].values[0], [1.0, 2.0, 3.0, *quat_from_euler(*EULER)])
    assert np.allclose(s["state"].values[0, 3:6], quat_rotate(quat_from_euler(*EULER), np.array([1.0, 0.0, 0.0])))
    assert np.allclose(s["imu"].received_s - s["imu"].t_s, 0.002, atol=1e-6)
    assert s["imu"].t_s == pytest.approx(truth()[0], abs=1e-9)


def test_one_file_of_a_bag_is_enough_and_converts(tmp_path):
    _, topics = standard()
    bag(tmp_path / "bag", StoragePlugin.MCAP, topics)
    (file,) = (tmp_path / "bag").glob("*.mcap")
    (tmp_path / "quad.toml").write_bytes(vehicle_file(QUAD))
    convert(file, tmp_path / "out", vehicle=tmp_path / "quad.toml")
    assert len(read_recording(tmp_path / "out").streams["imu"]) == len(truth()[0])


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_messages_of_px4_go_the_way_of_its_logs(tmp_path, plugin):
    t, u = truth()

    def motors(row):
        return lambda s, time: s.types["px4_msgs/msg/ActuatorMotors"](
            round(time * 1e6), 0, np.array([*row, *[np.nan] * 8], np.float32)
        )

    def imu(s, time):
        f = np.float32
        return s.types["px4_msgs/msg/SensorCombined"](
            round(time * 1e6), np.array([0.1, 0.2, 0.3], f), 0, np.array([0.0, 0.0, -9.8], f)
        )

    topics = {
        "/fmu/out/actuator_motors": (
            "px4_msgs/msg/ActuatorMotors",
            [(x, motors(r)) for x, r in zip(t, u, strict=True)],
        ),
        "/fmu/out/sensor_combined": ("px4_msgs/msg/SensorCombined", [(x, imu) for x in t]),
    }
    recording = read_recording(bag(tmp_path / "bag", plugin, topics), like(ARDUPILOT[1, 1]))
    assert np.allclose(recording.streams["motors"].values, u, atol=1e-6)
    assert np.allclose(recording.streams["imu"].values[0], [0.1, -0.2, -0.3, 0.0, 0.0, 9.8])
    assert any("THR_MDL_FAC is taken as 0" in note for note in recording.notes)


def test_two_bodies_of_which_neither_is_named_are_refused_and_one_named_is_taken(tmp_path):
    _, topics = standard()
    topics["/vrpn/wand/pose"] = topics["/vrpn/qball2/pose"]
    recording = read_recording(bag(tmp_path / "one", StoragePlugin.MCAP, topics), QUAD)
    assert any("/vrpn/qball2/pose" in note for note in recording.notes)
    topics["/vrpn/other/pose"] = topics.pop("/vrpn/qball2/pose")
    with pytest.raises(BadInput, match="/vrpn/other/pose, /vrpn/wand/pose could each be the stream mocap"):
        read_recording(bag(tmp_path / "two", StoragePlugin.MCAP, topics), QUAD)


def test_a_bag_without_motors_or_a_damaged_one_is_refused(tmp_path):
    _, topics = standard()
    del topics["/motors"]
    with pytest.raises(BadInput, match=r"holds no motor values.*actuator_msgs.*/imu/data"):
        read_recording(bag(tmp_path / "bag", StoragePlugin.MCAP, topics), QUAD)
    (file,) = (tmp_path / "bag").glob("*.mcap")
    file.write_bytes(file.read_bytes()[:700])
    with pytest.raises(BadInput):
        read_recording(tmp_path / "bag", QUAD)
    (tmp_path / "x.db3").write_bytes(b"SQLite format 3\0" + bytes(2000))
    with pytest.raises(BadInput, match=r"x\.db3"):
        read_recording(tmp_path / "x.db3", QUAD)


@pytest.mark.parametrize(
    ("plugin", "mode"),
    [(StoragePlugin.SQLITE3, CompressionMode.FILE), (StoragePlugin.MCAP, CompressionMode.MESSAGE)],
)
def test_a_compressed_bag_is_read_in_a_process_of_its_own_and_comes_back_the_same(tmp_path, monkeypatch, plugin, mode):
    speeds, topics = standard()
    elsewhere = []
    real = confined._elsewhere
    monkeypatch.setattr(confined, "_elsewhere", lambda *a: elsewhere.append(a[0]) or real(*a))
    plain = read_recording(bag(tmp_path / "plain", plugin, topics), QUAD)
    assert not elsewhere
    recording = read_recording(bag(tmp_path / "squeezed", plugin, topics, mode), QUAD)
    assert elsewhere == ["read_bag"]
    assert np.allclose(recording.streams["motors"].values, speeds)
    for name, stream in plain.streams.items():
        assert np.array_equal(stream.values, recording.streams[name].values)
    del topics["/motors"]
    with pytest.raises(BadInput, match="holds no motor values"):
        read_recording(bag(tmp_path / "refused", plugin, topics, mode), QUAD)


def test_a_bag_that_expands_without_end_is_refused_and_leaves_nothing_on_the_disk(tmp_path, monkeypatch):
    monkeypatch.setattr(confined, "FREE", 1 << 27)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "scratch"))
    (tmp_path / "scratch").mkdir()
    folder = bag(tmp_path / "bag", StoragePlugin.SQLITE3, standard()[1], CompressionMode.FILE)
    (file,) = folder.glob("*.zstd")
    file.write_bytes(zstandard.compress(bytes(1 << 26)) * 64)  # 4 GiB
    with pytest.raises(BadInput, match="File too large") as refused:
        read_recording(folder, QUAD)
    assert len(str(refused.value)) < 400
    assert list((tmp_path / "scratch").iterdir()) == []


def test_a_message_that_expands_beyond_memory_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(confined, "FREE", 1 << 27)
    huge = "x" * (200 << 20)
    topics = {"/text": ("std_msgs/msg/String", [(1.0, lambda s, t: s.types["std_msgs/msg/String"](huge))] * 2)}
    folder = bag(tmp_path / "bag", StoragePlugin.SQLITE3, topics, CompressionMode.MESSAGE)
    assert sum(file.stat().st_size for file in folder.iterdir()) < 1_000_000
    with pytest.raises(BadInput, match=r"more than the 1[0-9]+ MiB that they may"):
        read_topic(folder, "/text")


def test_a_bag_that_takes_for_ever_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(confined, "LEAST_S", 0.01)
    folder = bag(tmp_path / "bag", StoragePlugin.MCAP, standard()[1], CompressionMode.MESSAGE)
    with pytest.raises(BadInput, match="could not be read within 0 s"):
        read_recording(folder, QUAD)


def test_a_recording_that_was_not_ended_and_an_export_without_a_profile_are_read(tmp_path):
    """As a crash leaves it, and as Foxglove writes it; the library takes neither."""
    speeds, topics = standard()
    bag(tmp_path / "bag", StoragePlugin.MCAP, topics)
    (file,) = (tmp_path / "bag").glob("*.mcap")
    data = file.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: data.rindex(b"\x0f", 0, len(data) - 100)])
    recording = read_recording(tmp_path / "cut.mcap", QUAD)
    assert np.allclose(recording.streams["motors"].values, speeds[: len(recording.streams["motors"])])
    assert "cut.mcap: the recording was not ended; it was read up to its last whole piece." in recording.notes
    (tmp_path / "export.mcap").write_bytes(data.replace(b"\x04\x00\x00\x00ros2", b"\x04\x00\x00\x00else", 1))
    assert np.allclose(read_recording(tmp_path / "export.mcap", QUAD).streams["motors"].values, speeds)


def test_the_files_of_a_bag_without_their_metadata(tmp_path):
    """One is read; several are asked to be joined."""
    speeds, topics = standard()
    folder = bag(tmp_path / "bag", StoragePlugin.SQLITE3, topics)
    (folder / "metadata.yaml").unlink()
    assert np.allclose(read_recording(folder, QUAD).streams["motors"].values, speeds)
    (file,) = folder.glob("*.db3")
    (folder / "bag_1.db3").write_bytes(file.read_bytes())
    with pytest.raises(BadInput, match=r"holds 2 files of a ROS 2 bag, and no metadata\.yaml that joins them"):
        read_recording(folder, QUAD)


def test_a_split_bag_is_one_flight(tmp_path):
    speeds, topics = standard()
    half = {name: (kind, rows[: len(rows) // 2]) for name, (kind, rows) in topics.items()}
    rest = {name: (kind, rows[len(rows) // 2 :]) for name, (kind, rows) in topics.items()}
    folder, second = bag(tmp_path / "bag", StoragePlugin.MCAP, half), bag(tmp_path / "second", StoragePlugin.MCAP, rest)
    (one,), (other,) = folder.glob("*.mcap"), second.glob("*.mcap")
    (folder / other.name).write_bytes(other.read_bytes())
    text = (folder / "metadata.yaml").read_text()
    (folder / "metadata.yaml").write_text(text.replace(f"- {one.name}", f"- {one.name}\n  - {other.name}", 1))
    streams = read_recording(folder, QUAD).streams
    assert np.allclose(streams["motors"].values, speeds)
    assert np.all(np.diff(streams["imu"].t_s) > 0.0)


def test_a_path_gives_its_poses_and_actuators_their_commands(tmp_path):
    t, u = truth()
    _, topics = standard()
    place = topics["/vrpn/qball2/pose"][1][0][1]

    def path(s, time):
        return s.types["nav_msgs/msg/Path"](header(s, time), [place(s, x) for x in t if x <= time])

    def motors(row):
        return lambda s, time: s.types["actuator_msgs/msg/Actuators"](header(s, time), np.empty(0), np.empty(0), row)

    topics = {
        "/imu/data": topics["/imu/data"],
        "/path": ("nav_msgs/msg/Path", [(x, path) for x in t[:: len(t) // 4]]),
        "/motors": ("actuator_msgs/msg/Actuators", [(x, motors(row)) for x, row in zip(t, u, strict=True)]),
    }
    recording = read_recording(bag(tmp_path / "bag", StoragePlugin.MCAP, topics), like(ARDUPILOT[1, 1]))
    assert np.allclose(recording.streams["motors"].values, u)
    assert np.allclose(recording.streams["mocap"].values[0], [1.0, 2.0, 3.0, *quat_from_euler(*EULER)])
    assert "mocap: the poses in the last message of topic /path." in recording.notes


def test_topics_of_px4_go_by_their_own_names_and_vehicles_by_theirs(tmp_path):
    """VehicleOdometry is the type of three topics; a swarm has each of them several times."""
    t, u = truth()
    odometry = "uint64 timestamp\nuint64 timestamp_sample\nfloat32[3] position\nfloat32[4] q\n"

    def pose(x):
        return lambda s, time: s.types["px4_msgs/msg/VehicleOdometry"](
            round(time * 1e6), round(time * 1e6), np.array([x, 0.0, 0.0], "f4"), np.array([1.0, 0.0, 0.0, 0.0], "f4")
        )

    def motors(row):
        return lambda s, time: s.types["px4_msgs/msg/ActuatorMotors"](
            round(time * 1e6), round(time * 1e6), np.array([*row, *[np.nan] * 8], "f4")
        )

    def of(prefix, x):
        return {
            f"{prefix}/fmu/out/vehicle_odometry": ("px4_msgs/msg/VehicleOdometry", [(k, pose(99.0)) for k in t]),
            f"{prefix}/fmu/in/vehicle_visual_odometry": ("px4_msgs/msg/VehicleOdometry", [(k, pose(x)) for k in t]),
            f"{prefix}/fmu/out/actuator_motors_v1": (
                "px4_msgs/msg/ActuatorMotors",
                [(k, motors(row)) for k, row in zip(t, u, strict=True)],
            ),
        }

    quad, more = like(ARDUPILOT[1, 1]), {"px4_msgs/msg/VehicleOdometry": odometry}
    one = bag(tmp_path / "one", StoragePlugin.MCAP, of("", 1.0), more=more)
    recording = read_recording(one, quad)
    assert np.allclose(recording.streams["mocap"].values[:, 0], 1.0)
    assert np.allclose(recording.streams["motors"].values, u, atol=1e-6)
    swarm = bag(tmp_path / "swarm", StoragePlugin.MCAP, of("/x1", 1.0) | of(f"/{quad.name}", 2.0), more=more)
    assert np.allclose(read_recording(swarm, quad).streams["mocap"].values[:, 0], 2.0)


def test_a_bag_without_definitions_of_its_types_says_so(tmp_path):
    """sqlite before ROS 2 Iron."""
    _, topics = standard()
    extra = {"my_msgs/msg/Actuators": "std_msgs/Header header\nfloat64[] velocity\n"}
    rows = [(x, lambda s, time: s.types["my_msgs/msg/Actuators"](header(s, time), np.zeros(4))) for x in (1.0, 2.0)]
    folder = bag(
        tmp_path / "bag", StoragePlugin.SQLITE3, topics | {"/mine": ("my_msgs/msg/Actuators", rows)}, more=extra
    )
    (file,) = folder.glob("*.db3")
    with sqlite3.connect(file) as base:
        base.execute("delete from message_definitions")
    with pytest.raises(BadInput, match="does not say what my_msgs/msg/Actuators is"):
        read_topic(file, "/mine")
