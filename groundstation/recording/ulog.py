"""PX4 logs (ULog, https://docs.px4.io/main/en/dev_log/ulog_file_format) as streams."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.flightdata import (
    BATTERY_COLUMNS,
    IMU_COLUMNS,
    MOCAP_COLUMNS,
    SETPOINT_COLUMNS,
    STATE_COLUMNS,
    Stream,
    resampled,
)
from groundstation.frames import quat_normalise, slerp
from groundstation.recording.autopilot import one_line, present, slow_note, z_up, z_up_quaternion
from groundstation.recording.part import WHOLE, Part
from groundstation.recording.px4_motors import SETTINGS_REMEDY, Topics, read_motors
from groundstation.recording.recorded import Recording
from groundstation.recording.settings import Settings
from groundstation.recording.tables import Table
from groundstation.recording.ulogfile import ULogFile, decode_ulog
from groundstation.texts import shown
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

NAMES: Mapping[str, Mapping[str, tuple[tuple[str, ...], ...]]] = {
    "vehicle_visual_odometry": {
        "position": (("position[0]", "position[1]", "position[2]"), ("x", "y", "z")),  # 1.14 on; to 1.13
    },
    "vehicle_mocap_odometry": {"position": (("position[0]", "position[1]", "position[2]"), ("x", "y", "z"))},
    "trajectory_setpoint": {"position": (("position[0]", "position[1]", "position[2]"), ("x", "y", "z"))},
    "vehicle_local_position_setpoint": {"position": (("x", "y", "z"),)},  # to 1.10 the setpoints' topic
    "battery_status": {
        "voltage": (("voltage_v",), ("voltage_filtered_v",)),
        "current": (("current_a",), ("current_filtered_a",)),
    },
}
"""Per topic what is read, and the names of its fields from the newest version to the oldest."""
TOPICS = (
    *("sensor_combined", "vehicle_angular_velocity", "vehicle_acceleration"),
    *("actuator_motors", "actuator_outputs", "esc_status", "battery_status"),
    *("trajectory_setpoint", "vehicle_local_position_setpoint"),
    *("vehicle_attitude_groundtruth", "vehicle_local_position_groundtruth"),
    *("vehicle_mocap_odometry", "vehicle_visual_odometry", "vehicle_attitude", "vehicle_local_position"),
)


_REPLAYED = "replay"
"""Information of a log that PX4 wrote while it replayed another one: that one's name (ULog file format, table of
keys).
"""


def load_ulog(path: Path, part: Part = WHOLE) -> ULogFile:
    """The file, or a part, decoded.

    Raises:
        BadInput: its definitions are torn.
    """
    data = np.memmap(path, np.uint8, mode="r")
    try:
        return decode_ulog(data, part)
    except (ValueError, IndexError) as error:
        raise BadInput(f"{path}: its definitions are damaged ({one_line(error)}); download the log again.") from None


def read_ulog(path: Path, vehicle: Vehicle, part: Part = WHOLE) -> Recording:
    """Read the topics that identification needs, of a part of the log.

    IMU: ``sensor_combined``, or ``vehicle_angular_velocity`` with ``vehicle_acceleration`` where those are faster.
    Motors: ``actuator_motors`` (or ``actuator_outputs``) as commands, ``esc_status`` as speeds, sorted into the vehicle
    file's order. Motion capture: what was received from it, or in simulation the ground truth.

    Raises:
        BadInput: it is damaged at the start, a replay, holds no motor outputs, or those of another vehicle.
    """
    log = load_ulog(path, part)
    if _REPLAYED in log.info:
        raise BadInput(
            f"{path}: is a replay of {shown(log.info[_REPLAYED], limit=100)}: modules ran again on that log's data, so "
            "that what they computed moved no vehicle. Give the log that was replayed."
        )
    topics = {key: topic for key, topic in log.topics.items() if len(topic) > 1}
    lost = _losses(path, log)
    streams: dict[str, Stream] = {}
    streams["motors"], said = read_motors(topics, log.settings, vehicle, str(path))
    notes = [*lost, *said]
    first = {name: topic for (name, instance), topic in sorted(topics.items(), reverse=True)}
    if (battery := _connected_battery(topics)) is not None:
        first["battery_status"] = battery
    others, said = other_streams(first, log.settings)
    streams |= others
    notes += said
    return Recording(
        name=path.stem,
        streams=streams,
        metadata=_metadata(log),
        notes=tuple(notes),
        left_out=(*lost, *_left_out(topics)),
    )


def other_streams(topics: Mapping[str, Table], settings: Settings) -> tuple[dict[str, Stream], list[str]]:
    """All streams but the motors, as far as the topics give them, and what to say of them."""
    streams: dict[str, Stream] = {}
    notes: list[str] = []
    for name, read in _OTHERS.items():
        stream, said = present(name, lambda read=read: read(topics, settings))
        notes += said
        if stream is not None and len(stream):
            streams[name] = stream
    return streams, notes


def _connected_battery(topics: Topics) -> Table | None:
    """The first instance of battery_status that tells a voltage."""
    for (name, _), topic in sorted(topics.items()):
        fields = next((f for f in NAMES["battery_status"]["voltage"] if all(x in topic for x in f)), None)
        if name == "battery_status" and fields is not None and np.any(topic.columns(*fields) > 0.0):
            return topic
    return None


def _battery(topics: Mapping[str, Table], settings: Settings) -> tuple[Stream | None, list[str]]:
    topic = topics.get("battery_status")
    if topic is None:
        return None, []
    volts = topic.first_of(NAMES[topic.name]["voltage"])
    if not np.any(volts > 0.0):
        return None, ["battery: battery_status tells no voltage; it is left out."]
    current = topic.first_of(NAMES[topic.name]["current"])
    values = np.hstack([volts, np.where(current >= 0.0, current, np.nan)])
    note = [f"battery: battery_status, instance {topic.instance}."] if topic.instance else []
    return Stream(topic.seconds(), values, BATTERY_COLUMNS), note


def _setpoint(topics: Mapping[str, Table], settings: Settings) -> tuple[Stream | None, list[str]]:
    """Where the vehicle was told to be, by the first topic that says so."""
    for name in ("trajectory_setpoint", "vehicle_local_position_setpoint"):
        topic = topics.get(name)
        if topic is None:
            continue
        values = np.column_stack([z_up(topic.first_of(NAMES[topic.name]["position"])), -topic.column("yaw")])
        stream = Stream(topic.seconds(), values, SETPOINT_COLUMNS).select(np.all(np.isfinite(values[:, :3]), axis=1))
        if len(stream):
            return stream, []
    return None, []


def _left_out(topics: Topics) -> list[str]:
    """One line per topic that is not read, with its size."""
    return [
        f"{name}{f' (instance {instance})' if instance else ''}: {len(topic)} samples at {_rate_hz(topic):.0f} Hz are "
        "not read."
        for (name, instance), topic in sorted(topics.items())
        if name not in TOPICS
    ]


def _metadata(log: ULogFile) -> dict[str, str]:
    info = {key: value for key, value in log.info.items() if key in ("sys_name", "ver_sw", "ver_hw")}
    # The simulator's own parameters are the answer, not an input: they are carried for reports and read by nothing
    # else.
    truth = {key: log.settings.value(key, np.inf, 0.0) for key in log.settings.names() if key.startswith("SIH_")}
    return {"format": "PX4 ULog", **info, **({"simulator_parameters": json.dumps(truth)} if truth else {})}


def _losses(path: Path, log: ULogFile) -> list[str]:
    """What the logger or a copy lost."""
    notes = []
    if log.missing:
        notes.append(
            f"{path.name}: the log is cut off in the middle of a message ({log.missing} bytes of it are missing); "
            "it was read up to there."
        )
    if log.damaged:
        notes.append(f"{path.name}: {log.damaged} damaged bytes of the log were skipped.")
    if log.dropouts_s:
        lost = sum(duration for _, duration in log.dropouts_s)
        notes.append(f"{path.name}: the logger dropped data {len(log.dropouts_s)} times, {lost:.2f} s in all.")
    return notes


def _sampled(topic: Table) -> Array:
    """When a sample was taken, where the topic says (PX4's simulator link leaves it 0), else when it was published."""
    if "timestamp_sample" in topic and (taken := topic.column("timestamp_sample") / 1e6).any():
        return taken
    return topic.seconds()


def _rate_hz(topic: Table | None) -> float:
    return 0.0 if topic is None else topic.rate_hz()


def _imu(topics: Mapping[str, Table], settings: Settings) -> tuple[Stream | None, list[str]]:
    combined = topics.get("sensor_combined")
    rate, accel = topics.get("vehicle_angular_velocity"), topics.get("vehicle_acceleration")
    fast = min(_rate_hz(rate), _rate_hz(accel))
    if combined is not None and _rate_hz(combined) >= 0.9 * fast:
        # A sample is the mean over the interval that ends at its stamp: it belongs to the middle.
        middle = combined.seconds() - 0.5e-6 * combined.column("gyro_integral_dt")
        values = np.hstack([z_up(combined.array("gyro_rad", 3)), z_up(combined.array("accelerometer_m_s2", 3))])
        stream = Stream(middle, values, IMU_COLUMNS)
        notes = ["imu: sensor_combined; its stamps are moved to the middle of the interval each sample is the mean of."]
    elif rate is not None and accel is not None:
        t_s, t_accel = _sampled(rate), _sampled(accel)
        inside = (t_s >= t_accel[0]) & (t_s <= t_accel[-1])
        force = z_up(accel.array("xyz", 3))
        force = resampled(t_s[inside], t_accel, force)
        values = np.hstack([z_up(rate.array("xyz", 3))[inside], force])
        stream = Stream(t_s[inside], values, IMU_COLUMNS)
        cut = {key: settings.value(key, np.inf, np.nan) for key in ("IMU_GYRO_CUTOFF", "IMU_ACCEL_CUTOFF")}
        notes = [
            f"imu: vehicle_angular_velocity and vehicle_acceleration, low-passed on board at "
            f"{cut['IMU_GYRO_CUTOFF']:.0f} and {cut['IMU_ACCEL_CUTOFF']:.0f} Hz; say so with [imu] filter_hz."
        ]
    else:
        return None, ["imu: not in the log; log sensor_combined."]
    return stream, notes + slow_note("imu", stream, 100.0, SETTINGS_REMEDY)


def _mocap(topics: Mapping[str, Table], settings: Settings) -> tuple[Stream | None, list[str]]:
    for name in ("vehicle_mocap_odometry", "vehicle_visual_odometry"):
        topic = topics.get(name)
        if topic is not None and np.any(np.isfinite(topic.column("q[0]"))):
            values = np.hstack(
                [z_up(topic.first_of(NAMES[topic.name]["position"])), z_up_quaternion(topic.array("q", 4))]
            )
            return Stream(_sampled(topic), values, MOCAP_COLUMNS), [f"mocap: {name}, as the vehicle received it."]
    attitude = topics.get("vehicle_attitude_groundtruth")
    position = topics.get("vehicle_local_position_groundtruth")
    if attitude is None or position is None:
        return None, []
    t_s, xyz, q = _joined(position, attitude)
    return Stream(t_s, np.hstack([xyz, q]), MOCAP_COLUMNS), [
        "mocap: the simulator's ground truth stands in for it, attitude at the stamps of position."
    ]


def _joined(position: Table, attitude: Table) -> tuple[Array, Array, Array]:
    """Position's stamps within those of attitude, positions there, and attitude by interpolation on the great
    circle.
    """
    t_attitude, t_s = _rising(_sampled(attitude)), _sampled(position)
    q = z_up_quaternion(attitude.array("q", 4))[t_attitude]
    t_attitude = _sampled(attitude)[t_attitude]
    inside = (t_s >= t_attitude[0]) & (t_s <= t_attitude[-1])
    xyz = z_up(np.column_stack([position.column(axis) for axis in "xyz"]))
    return t_s[inside], xyz[inside], slerp(t_s[inside], t_attitude, quat_normalise(q))


def _rising(t_s: Array) -> NDArray[np.int64]:
    """Indices of samples later than all before them."""
    latest = np.maximum.accumulate(t_s)
    return np.flatnonzero(np.concatenate([[True], t_s[1:] > latest[:-1]]))


def _state(topics: Mapping[str, Table], settings: Settings) -> tuple[Stream | None, list[str]]:
    attitude, position = topics.get("vehicle_attitude"), topics.get("vehicle_local_position")
    rate = topics.get("vehicle_angular_velocity")
    if attitude is None or position is None or rate is None:
        return None, []
    t_s, xyz, q = _joined(position, attitude)
    velocity = z_up(np.column_stack([position.column(f"v{axis}") for axis in "xyz"]))
    velocity = velocity[np.isin(_sampled(position), t_s)]
    t_rate = _sampled(rate)
    rates = resampled(t_s, t_rate, z_up(rate.array("xyz", 3)))
    inside = (t_s >= t_rate[0]) & (t_s <= t_rate[-1])
    values = np.hstack([xyz, velocity, q, rates])[inside]
    return Stream(t_s[inside], values, STATE_COLUMNS), [
        "state: the estimator's, attitude and rates at the stamps of position."
    ]


_OTHERS = {"imu": _imu, "mocap": _mocap, "state": _state, "battery": _battery, "setpoint": _setpoint}
