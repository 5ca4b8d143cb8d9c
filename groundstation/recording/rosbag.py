"""ROS 2 bags (folders, MCAP and sqlite files) as streams, decoded by the ``rosbags`` library.

Standard messages are in REP 103's frames, which are ours: body x ahead, y left, z up; world z up; Odometry's twist is
in its child's frame, the body. Messages of ``px4_msgs`` mean what the same topics of a ULog mean, and go the same way.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
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
from groundstation.recording.autopilot import check_count, present, wanted_input
from groundstation.recording.bagclock import require_steady_clock
from groundstation.recording.bagfile import RECEIVED, as_received, last_message, opened, tables_in, topics_in
from groundstation.recording.confined import confined
from groundstation.recording.part import WHOLE, Part
from groundstation.recording.px4_motors import PX4_MOTORS, read_motors
from groundstation.recording.recorded import Recording
from groundstation.recording.settings import Settings
from groundstation.recording.tables import Table
from groundstation.recording.ulog import TOPICS, other_streams
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

_IMU = ("sensor_msgs/msg/Imu",)
_POSES = {
    "geometry_msgs/msg/PoseStamped": ("pose.position", "pose.orientation"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": ("pose.pose.position", "pose.pose.orientation"),
    "geometry_msgs/msg/TransformStamped": ("transform.translation", "transform.rotation"),
}
_PATH = ("nav_msgs/msg/Path",)
_ODOMETRY = ("nav_msgs/msg/Odometry",)
_BATTERY = ("sensor_msgs/msg/BatteryState",)
_MOTORS = {
    "actuator_msgs/msg/Actuators": {"velocity": "rotor_speed", "normalized": "command"},
    "mav_msgs/msg/Actuators": {"angular_velocities": "rotor_speed", "normalized": "command"},
}
"""Fields of messages of motors: rad/s, or 0 to 1."""
_EARLIER = re.compile(r"(?<!^)(?=[A-Z])")


@confined
def topics_of(path: Path) -> dict[str, tuple[str, int]]:
    """Type and number of messages of each topic."""
    with opened(path) as reader:
        return topics_in(reader)


@confined
def read_topic(path: Path, topic: str) -> Table:
    """All numbers of a topic, under their paths in the message, with ``header.stamp`` as seconds where it has one.

    Raises:
        BadInput: the bag has no such topic, or its type is not known.
    """
    with opened(path) as reader:
        if topic not in topics_in(reader):
            raise BadInput(f"{path}: has no topic {topic}; it has {', '.join(sorted(reader.topics))}.")
        require_steady_clock(path)
        return tables_in(reader, path, [topic])[topic]


@confined
def read_bag(path: Path, vehicle: Vehicle, part: Part = WHOLE) -> Recording:
    """The streams of a bag by the types of its topics.

    Args:
        path: of the bag, or of one of its files.
        vehicle: declared.
        part: what is wanted, on the motors' clock.

    Raises:
        BadInput: it holds no motors, several topics that could be the same stream, or messages of no known type.
    """
    with opened(path) as reader:
        require_steady_clock(path)
        found = {topic: kind for topic, (kind, count) in topics_in(reader).items() if count > 1}
        wanted = _wanted(path, found, vehicle)
        motors = next(topic for topic, stream in wanted.items() if stream == "motors")
        tables = tables_in(reader, path, wanted, as_received(reader, path, motors, part))
        path_topic = None if "mocap" in wanted.values() else _chosen(path, "mocap", _of_type(found, _PATH), vehicle)
        trail = last_message(reader, path_topic) if path_topic is not None else None
        losses = list(getattr(reader, "notes", ()))
    streams, notes = _streams(path, found, wanted, {t: table for t, table in tables.items() if len(table)}, vehicle)
    notes = [*losses, *notes]
    if path_topic is not None and trail is not None:
        streams["mocap"] = _trail(trail)
        notes.append(f"mocap: the poses in the last message of topic {path_topic}.")
    left = losses + [
        f"{t} ({k}): is not read." for t, k in sorted(found.items()) if t not in wanted and t != path_topic
    ]
    name = path.stem if path.is_file() else path.name
    return Recording(name, streams, metadata={"format": "ROS 2 bag"}, notes=tuple(notes), left_out=tuple(left))


def _of_type(found: Mapping[str, str], kinds: Collection[str]) -> list[str]:
    return [topic for topic, kind in found.items() if kind in kinds]


def _streams(
    path: Path, found: Mapping[str, str], wanted: Mapping[str, str], tables: Mapping[str, Table], vehicle: Vehicle
) -> tuple[dict[str, Stream], list[str]]:
    """The streams of tables, by what each topic is, and what to say of them.

    Raises:
        BadInput: the motors have no samples, or those of another vehicle.
    """
    motors = next(topic for topic, stream in wanted.items() if stream == "motors")
    if motors not in tables:
        raise BadInput(f"{path}: holds no motor samples (topic {motors}) in the part that is read.")
    names = {t: _px4_name(t, found[t]) for t in tables if wanted[t] == "px4" or t == motors}
    px4 = {name: replace(tables[t], name=name) for t, name in names.items()}
    if found[motors] in _MOTORS:
        stream, notes = _motors(path, found[motors], tables[motors], vehicle)
    else:
        stream, notes = read_motors({(name, 0): t for name, t in px4.items()}, Settings(), vehicle, str(path))
        notes = [*notes, "motors: a bag holds no parameters; THR_MDL_FAC is taken as 0."]
    others, said = other_streams(px4, Settings())
    notes += said
    for topic, name in wanted.items():
        if name in _MEANINGS and topic in tables:
            meaning = _MEANINGS[name][1]
            other, said = present(name, lambda t=topic, f=meaning: (f(tables[t], found[t]), []))
            notes += [*said, *([f"{name}: topic {topic}."] if other is not None else [])]
            others |= {name: other} if other is not None else {}
    return {"motors": stream, **others}, notes


def _trail(message: Any) -> Stream:
    """The poses of a nav_msgs/Path, each with its own stamp."""
    stamps = [p.header.stamp.sec + 1e-9 * p.header.stamp.nanosec for p in message.poses]
    places = [(p.pose.position.x, p.pose.position.y, p.pose.position.z) for p in message.poses]
    turns = [tuple(getattr(p.pose.orientation, axis) for axis in "wxyz") for p in message.poses]
    return Stream(np.array(stamps), np.hstack([np.array(places), np.array(turns)]).reshape(-1, 7), MOCAP_COLUMNS)


def _wanted(path: Path, found: Mapping[str, str], vehicle: Vehicle) -> dict[str, str]:
    """The topics that are read, and the stream that each is, or "px4" of those that go the way of a ULog's.

    Raises:
        BadInput: none is the motors', or several could be one stream.
    """
    px4: dict[str, list[str]] = {}
    for topic, kind in found.items():
        if _px4_name(topic, kind) in TOPICS:
            px4.setdefault(_px4_name(topic, kind), []).append(topic)
    wanted = {chosen: "px4" for name, topics in px4.items() if (chosen := _chosen(path, name, topics, vehicle))}
    own = [topic for name in PX4_MOTORS for topic in px4.get(name, ()) if topic in wanted]
    motors = own[0] if own else _chosen(path, "motors", _of_type(found, _MOTORS), vehicle)
    if motors is None:
        kinds = ", ".join(sorted({*_MOTORS, "px4_msgs/msg/ActuatorMotors", "px4_msgs/msg/EscStatus"}))
        raise BadInput(
            f"{path}: holds no motor values (topics of {kinds}); it has {', '.join(sorted(found)) or 'nothing'}. "
            "Record them, or say which topic they are with `groundstation convert --map`."
        )
    wanted[motors] = "motors"
    for name, (kinds, _) in _MEANINGS.items():
        topic = _chosen(path, name, _of_type(found, kinds), vehicle)
        if topic is not None:
            wanted[topic] = name
    return wanted


def _px4_name(topic: str, kind: str) -> str:
    """The uORB topic of a topic of px4_msgs: by its own last name (less a version, 1.16 on), else by the type's.

    VehicleOdometry is the type of vehicle_odometry, vehicle_visual_odometry and vehicle_mocap_odometry.
    """
    package, _, name = kind.partition("/msg/")
    if package != "px4_msgs":
        return ""
    last = re.sub(r"_v\d+$", "", topic.rsplit("/", 1)[-1])
    return last if last in TOPICS else _EARLIER.sub("_", name).lower()


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


def _motors(path: Path, kind: str, values: Table, vehicle: Vehicle) -> tuple[Stream, list[str]]:
    """Speeds, or commands: whichever field of the message the sender filled."""
    counts = {
        field: (input_kind, count)
        for field, input_kind in _MOTORS[kind].items()
        if (count := sum(name.startswith(f"{field}[") for name in values.fields))
    }
    wanted = wanted_input(vehicle, {kind: True for kind, _ in counts.values()}, str(path))
    field, (_, count) = next(item for item in counts.items() if item[1][0] == wanted)
    check_count(vehicle, count, f"{values.name}, {field}[0] and on", str(path))
    stream = Stream(values.seconds(), values.array(field, count), motor_columns(wanted, count), _arrival(values))
    return stream, [f"motors: topic {values.name}, {field}[i] is rotor i + 1."]


def _arrival(table: Table) -> Array | None:
    return table.column(RECEIVED) if table.clock[0] != RECEIVED else None


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


_MEANINGS: Mapping[str, tuple[Collection[str], Callable[[Table, str], Stream]]] = {
    "imu": (_IMU, _imu),
    "mocap": (_POSES, _pose),
    "state": (_ODOMETRY, _odometry),
    "battery": (_BATTERY, _battery),
}
"""By stream: the types of messages that can be it, and what their numbers mean."""
