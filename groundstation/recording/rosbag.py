"""ROS 2 bags (folders, MCAP and sqlite files) as streams, decoded by the ``rosbags`` library.

Standard messages are in REP 103's frames, which are ours: body x ahead, y left, z up; world z up; Odometry's twist is
in its child's frame, the body. Messages of ``px4_msgs`` mean what the same topics of a ULog mean, and go the same way.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.flightdata import (
    BATTERY_COLUMNS,
    IMU_COLUMNS,
    MOCAP_COLUMNS,
    STATE_COLUMNS,
    Stream,
    motor_columns,
)
from groundstation.frames import quat_rotate
from groundstation.recording.autopilot import check_count, one_line, present, wanted_input
from groundstation.recording.confined import confined
from groundstation.recording.px4_motors import read_motors
from groundstation.recording.recorded import Recording
from groundstation.recording.settings import Settings
from groundstation.recording.tables import Table, table_of
from groundstation.recording.ulog import TOPICS, other_streams
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

_IMU = ("sensor_msgs/msg/Imu",)
_POSES = {
    "geometry_msgs/msg/PoseStamped": ("pose.position", "pose.orientation"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": ("pose.pose.position", "pose.pose.orientation"),
    "geometry_msgs/msg/TransformStamped": ("transform.translation", "transform.rotation"),
}
_ODOMETRY = ("nav_msgs/msg/Odometry",)
_BATTERY = ("sensor_msgs/msg/BatteryState",)
_MOTORS = {"actuator_msgs/msg/Actuators": "velocity", "mav_msgs/msg/Actuators": "angular_velocities"}
_MOST_ELEMENTS = 64
_EARLIER = re.compile(r"(?<!^)(?=[A-Z])")


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """The library's reader on a bag.

    Raises:
        BadInput: the library cannot read it.
    """
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except (BadInput, MemoryError):
        raise
    except (AnyReaderError, KeyError, ValueError, OSError, AssertionError) as error:
        raise BadInput(f"{path}: is no ROS 2 bag that can be read ({one_line(error)}); record it again.") from None
    except Exception as error:  # the library has no one error for a file that is damaged or unfinished
        raise BadInput(
            f"{path}: is a damaged ROS 2 bag ({one_line(error)}); repair it with `ros2 bag reindex`."
        ) from None


@confined
def topics_of(path: Path) -> dict[str, tuple[str, int]]:
    """Type and number of messages of each topic."""
    with opened(path) as reader:
        return {c.topic: (c.msgtype, c.msgcount) for c in reader.connections}


@confined
def read_topic(path: Path, topic: str) -> Table:
    """All numbers of a topic, under their paths in the message, with ``header.stamp`` as seconds where it has one.

    Raises:
        BadInput: the bag has no such topic, or its type is not known.
    """
    with opened(path) as reader:
        mine = [c for c in reader.connections if c.topic == topic]
        if not mine:
            raise BadInput(f"{path}: has no topic {topic}; it has {', '.join(sorted(reader.topics))}.")
        rows: list[dict[str, float]] = []
        for connection, received_ns, data in reader.messages(connections=mine):
            row = {"_received": received_ns * 1e-9}
            _flatten(reader.deserialize(data, connection.msgtype), "", row)
            rows.append(row)
    names = list(rows[0]) if rows else ["_received"]
    columns = {name: np.array([row.get(name, np.nan) for row in rows]) for name in names}
    stamp = "_received"
    if "header.stamp.sec" in columns:
        columns["_stamp"] = columns["header.stamp.sec"] + 1e-9 * columns["header.stamp.nanosec"]
        stamp = "_stamp" if columns["_stamp"].any() else "_received"
    if "timestamp" in columns:  # px4_msgs
        return table_of(topic, columns, ("timestamp", 1e6))
    return table_of(topic, columns, (stamp, 1.0))


def _flatten(message: Any, prefix: str, out: dict[str, float]) -> None:
    """Numbers of a message under their paths; arrays written out up to 64 elements, texts and longer ones left out."""
    for name in message.__dataclass_fields__:
        if name.startswith("__"):
            continue
        value = getattr(message, name)
        if isinstance(value, (bool, int, float, np.number)):
            out[prefix + name] = float(value)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.size <= _MOST_ELEMENTS:
            out |= {f"{prefix}{name}[{i}]": float(v) for i, v in enumerate(value.reshape(-1))}
        elif hasattr(value, "__dataclass_fields__"):
            _flatten(value, f"{prefix}{name}.", out)
        elif isinstance(value, (list, tuple)) and len(value) <= _MOST_ELEMENTS:
            for i, item in enumerate(value):
                if hasattr(item, "__dataclass_fields__"):
                    _flatten(item, f"{prefix}{name}[{i}].", out)


@confined
def read_bag(path: Path, vehicle: Vehicle) -> Recording:
    """The streams of a bag by the types of its topics.

    Raises:
        BadInput: it holds no motors, several topics that could be the same stream, or messages of no known type.
    """
    found = {topic: kind for topic, (kind, count) in topics_of(path).items() if count > 1}
    read: dict[str, Table] = {}

    def table(topic: str) -> Table:
        return read.setdefault(topic, read_topic(path, topic))

    px4 = {_px4_name(kind): table(topic) for topic, kind in found.items() if _px4_name(kind) in TOPICS}
    streams: dict[str, Stream] = {}
    streams["motors"], notes = _motors(path, found, table, px4, vehicle)
    others, said = other_streams(px4, Settings())
    notes += said
    choices: dict[str, tuple[Mapping[str, Any], Callable[[Table, str], Stream]]] = {
        "imu": (dict.fromkeys(_IMU), _imu),
        "mocap": (_POSES, _pose),
        "state": (dict.fromkeys(_ODOMETRY), _odometry),
        "battery": (dict.fromkeys(_BATTERY), _battery),
    }
    for name, (kinds, meaning) in choices.items():
        topic = _chosen(path, name, [t for t, kind in found.items() if kind in kinds], vehicle)
        if topic is not None:
            stream, said = present(name, lambda t=topic, f=meaning: (f(table(t), found[t]), []))
            notes += said
            if stream is not None:
                others[name] = stream
                notes.append(f"{name}: topic {topic}.")
    streams |= others
    left = [f"{topic} ({kind}): is not read." for topic, kind in sorted(found.items()) if topic not in read]
    name = path.stem if path.is_file() else path.name
    return Recording(name, streams, metadata={"format": "ROS 2 bag"}, notes=tuple(notes), left_out=tuple(left))


def _px4_name(kind: str) -> str:
    """The topic of a px4_msgs type: VehicleOdometry is vehicle_odometry."""
    package, _, name = kind.partition("/msg/")
    return _EARLIER.sub("_", name).lower() if package == "px4_msgs" else ""


def _chosen(path: Path, name: str, topics: list[str], vehicle: Vehicle) -> str | None:
    """The one topic of a kind, or the one that bears the vehicle's name.

    Raises:
        BadInput: several could be meant.
    """
    if len(topics) <= 1:
        return topics[0] if topics else None
    named = [topic for topic in topics if vehicle.name in topic.split("/")]
    if len(named) == 1:
        return named[0]
    raise BadInput(
        f"{path}: {', '.join(sorted(topics))} could each be the stream {name}; none alone bears the vehicle's name "
        f"'{vehicle.name}'. Say which with `groundstation convert --map`."
    )


def _motors(
    path: Path, found: Mapping[str, str], table: Callable[[str], Table], px4: Mapping[str, Table], vehicle: Vehicle
) -> tuple[Stream, list[str]]:
    if px4.keys() & {"actuator_motors", "actuator_outputs", "esc_status"}:
        stream, notes = read_motors({(name, 0): t for name, t in px4.items()}, Settings(), vehicle, str(path))
        return stream, [*notes, "motors: a bag holds no parameters; THR_MDL_FAC is taken as 0."]
    topic = _chosen(path, "motors", [t for t, kind in found.items() if kind in _MOTORS], vehicle)
    if topic is None:
        kinds = ", ".join(sorted({*_MOTORS, "px4_msgs/msg/ActuatorMotors", "px4_msgs/msg/EscStatus"}))
        raise BadInput(
            f"{path}: holds no motor values (topics of {kinds}); it has {', '.join(sorted(found)) or 'nothing'}. "
            "Record them, or "
            "say which topic they are with `groundstation convert --map`."
        )
    values, field = table(topic), _MOTORS[found[topic]]
    count = sum(name.startswith(f"{field}[") for name in values.fields)
    check_count(vehicle, count, f"{topic}, {field}[0] and on", str(path))
    wanted_input(vehicle, {"rotor_speed": True}, str(path))
    stream = Stream(values.seconds(), values.array(field, count), motor_columns("rotor_speed", count), _arrival(values))
    return stream, [f"motors: topic {topic}, {field}[i] is rotor i + 1."]


def _arrival(table: Table) -> Array | None:
    return table.column("_received") if table.clock[0] != "_received" else None


def _vector(table: Table, stem: str) -> Array:
    return table.columns(*(f"{stem}.{axis}" for axis in "xyz"))


def _quaternion(table: Table, stem: str) -> Array:
    return table.columns(*(f"{stem}.{axis}" for axis in "wxyz"))


def _imu(table: Table, kind: str) -> Stream:
    values = np.hstack([_vector(table, "angular_velocity"), _vector(table, "linear_acceleration")])
    return Stream(table.seconds(), values, IMU_COLUMNS, _arrival(table))


def _pose(table: Table, kind: str) -> Stream:
    position, orientation = _POSES[kind]
    values = np.hstack([_vector(table, position), _quaternion(table, orientation)])
    return Stream(table.seconds(), values, MOCAP_COLUMNS, _arrival(table))


def _odometry(table: Table, kind: str) -> Stream:
    attitude = _quaternion(table, "pose.pose.orientation")
    velocity = quat_rotate(attitude, _vector(table, "twist.twist.linear"))
    values = [_vector(table, "pose.pose.position"), velocity, attitude, _vector(table, "twist.twist.angular")]
    return Stream(table.seconds(), np.hstack(values), STATE_COLUMNS, _arrival(table))


def _battery(table: Table, kind: str) -> Stream:
    """Voltage, and the current drawn (the message's is negative while it discharges)."""
    values = table.columns("voltage", "current") * [1.0, -1.0]
    return Stream(table.seconds(), values, BATTERY_COLUMNS, _arrival(table))
