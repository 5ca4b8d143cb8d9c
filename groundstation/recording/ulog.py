"""PX4 logs (ULog, https://docs.px4.io/main/en/dev_log/ulog_file_format) as streams."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.foreign import Decoded
from groundstation.flightdata import (
    BATTERY_COLUMNS,
    IMU_COLUMNS,
    MOCAP_COLUMNS,
    SETPOINT_COLUMNS,
    STATE_COLUMNS,
    Stream,
    motor_columns,
)
from groundstation.recording.autopilot import (
    MOTORS_SLOW_HZ,
    QUAD_X,
    motor_order,
    slow_note,
    spin_notes,
    wanted_input,
    z_up,
    z_up_quaternion,
)
from groundstation.recording.computed_speeds import commands_behind
from groundstation.recording.derive import slerp
from groundstation.recording.foreign import read_tables
from groundstation.recording.recorded import Recording
from groundstation.texts import shown
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Topic = dict[str, Any]

_TOPICS = (
    *("sensor_combined", "vehicle_angular_velocity", "vehicle_acceleration"),
    *("actuator_motors", "actuator_outputs", "esc_status", "battery_status", "trajectory_setpoint"),
    *("vehicle_attitude_groundtruth", "vehicle_local_position_groundtruth"),
    *("vehicle_mocap_odometry", "vehicle_visual_odometry", "vehicle_attitude", "vehicle_local_position"),
)
_SETTINGS = "set SDLOG_PROFILE to 25, and IMU_INTEG_RATE and IMU_GYRO_RATEMAX to 1000."


def read_ulog(path: Path, vehicle: Vehicle) -> Recording:
    """Read the topics that identification needs.

    IMU: ``sensor_combined``, or ``vehicle_angular_velocity`` with ``vehicle_acceleration`` where those are faster.
    Motors: ``actuator_motors`` (or ``actuator_outputs``) as commands, ``esc_status`` as speeds, sorted into the vehicle
    file's order. Motion capture: what was received from it, or in simulation the ground truth.

    Raises:
        BadInput: it is damaged at the start, or holds no motor outputs.
    """
    return recording_of_ulog(path, read_tables("ulog", path, _TOPICS), vehicle)


def recording_of_ulog(path: Path, log: Decoded, vehicle: Vehicle) -> Recording:
    """The streams in a log's tables.

    Raises:
        BadInput: it holds no motor outputs.
    """
    topics, parameters = log.tables, log.parameters
    lost = _losses(path, log)
    notes = [*lost]
    streams: dict[str, Stream] = {}
    streams["motors"], said = _motors(topics, parameters, vehicle, str(path))
    notes += said
    for name, read in (("imu", _imu), ("mocap", _mocap), ("state", _state)):
        stream, said = read(topics, parameters)
        notes += said
        if stream is not None:
            streams[name] = stream
    if "battery_status" in topics and np.any(topics["battery_status"]["voltage_v"] > 0.0):
        battery = topics["battery_status"]
        current = np.where(battery["current_a"] >= 0.0, battery["current_a"], np.nan)
        streams["battery"] = _stream(battery, np.column_stack([battery["voltage_v"], current]), BATTERY_COLUMNS)
    if "trajectory_setpoint" in topics:
        setpoint = topics["trajectory_setpoint"]
        values = np.column_stack([z_up(_columns(setpoint, "position", 3)), -setpoint["yaw"]])
        stream = _stream(setpoint, values, SETPOINT_COLUMNS)
        stream = stream.select(np.all(np.isfinite(values[:, :3]), axis=1))
        if len(stream):
            streams["setpoint"] = stream
    return Recording(
        name=path.stem,
        streams=streams,
        metadata=_metadata(log, parameters),
        notes=tuple(notes),
        left_out=(
            *lost,
            f"topics of the log other than {', '.join(_TOPICS)}.",
        ),
    )


def _metadata(log: Decoded, parameters: dict[str, float]) -> dict[str, str]:
    info = {key: shown(value) for key, value in log.info.items() if key in ("sys_name", "ver_sw", "ver_hw")}
    # The simulator's own parameters are the answer, not an input: they are carried for reports and read by nothing else.
    truth = {key: value for key, value in parameters.items() if key.startswith("SIH_")}
    return {"format": "PX4 ULog", **info, **({"simulator_parameters": json.dumps(truth)} if truth else {})}


def _losses(path: Path, log: Decoded) -> list[str]:
    """What the logger or a copy lost. The library reads a truncated file without a word."""
    notes = []
    missing = _missing_bytes(path.read_bytes())
    if missing:
        notes.append(
            f"{path.name}: the log is cut off in the middle of a message ({missing} bytes of it are missing); "
            "it was read up to there."
        )
    if "corrupt" in log.complaints:
        notes.append(f"{path.name}: parts of the log are damaged and were left out.")
    if log.dropouts_ms:
        lost = sum(log.dropouts_ms) / 1000.0
        notes.append(f"{path.name}: the logger dropped data {len(log.dropouts_ms)} times, {lost:.2f} s in all.")
    return notes


def _missing_bytes(data: bytes) -> int:
    """By how much the last message is longer than what is left of the file: 0 for a whole one."""
    position, size = 16, len(data)
    length = struct.Struct("<H").unpack_from
    while position + 3 <= size:
        position += 3 + length(data, position)[0]
    return position - size if position > size else (3 - (size - position)) % 3


def _seconds(topic: Topic, key: str = "timestamp") -> Array:
    return topic[key].astype(float) / 1e6


def _sampled(topic: Topic) -> Array:
    """When a sample was taken, where the topic says (PX4's simulator link leaves it 0), else when it was published."""
    return _seconds(topic, "timestamp_sample" if np.any(topic.get("timestamp_sample", 0)) else "timestamp")


def _columns(topic: Topic, name: str, count: int) -> Array:
    return np.column_stack([topic[f"{name}[{i}]"].astype(float) for i in range(count)])


def _stream(topic: Topic, values: Array, columns: tuple[str, ...], t_s: Array | None = None) -> Stream:
    return Stream(_seconds(topic) if t_s is None else t_s, np.asarray(values, dtype=float), columns)


def _rate_hz(topic: Topic | None) -> float:
    return 0.0 if topic is None else 1e6 / float(np.median(np.diff(topic["timestamp"].astype(float))))


def _imu(topics: dict[str, Topic], parameters: dict[str, float]) -> tuple[Stream | None, list[str]]:
    combined = topics.get("sensor_combined")
    rate, accel = topics.get("vehicle_angular_velocity"), topics.get("vehicle_acceleration")
    fast = min(_rate_hz(rate), _rate_hz(accel))
    if combined is not None and _rate_hz(combined) >= 0.9 * fast:
        # A sample is the mean over the interval that ends at its stamp: it belongs to the middle.
        middle = _seconds(combined) - 0.5e-6 * combined["gyro_integral_dt"]
        values = np.hstack([z_up(_columns(combined, "gyro_rad", 3)), z_up(_columns(combined, "accelerometer_m_s2", 3))])
        stream = Stream(middle, values, IMU_COLUMNS)
        notes = ["imu: sensor_combined; its stamps are moved to the middle of the interval each sample is the mean of."]
    elif rate is not None and accel is not None:
        t_s, t_accel = _sampled(rate), _sampled(accel)
        inside = (t_s >= t_accel[0]) & (t_s <= t_accel[-1])
        force = z_up(_columns(accel, "xyz", 3))
        force = np.column_stack([np.interp(t_s[inside], t_accel, column) for column in force.T])
        values = np.hstack([z_up(_columns(rate, "xyz", 3))[inside], force])
        stream = Stream(t_s[inside], values, IMU_COLUMNS)
        cut = {key: parameters.get(key, float("nan")) for key in ("IMU_GYRO_CUTOFF", "IMU_ACCEL_CUTOFF")}
        notes = [
            f"imu: vehicle_angular_velocity and vehicle_acceleration, low-passed on board at "
            f"{cut['IMU_GYRO_CUTOFF']:.0f} and {cut['IMU_ACCEL_CUTOFF']:.0f} Hz; say so with [imu] filter_hz."
        ]
    else:
        return None, ["imu: not in the log; log sensor_combined."]
    return stream, notes + slow_note("imu", stream, 100.0, _SETTINGS)


def _motors(
    topics: dict[str, Topic], parameters: dict[str, float], vehicle: Vehicle, source: str
) -> tuple[Stream, list[str]]:
    count = vehicle.rotors.count
    order, notes = _order(parameters, vehicle)
    commands, said = _commands(topics, parameters, count)
    speeds = _speeds(topics, count)
    computed = commands_behind(speeds, commands) if speeds is not None and commands is not None else None
    if computed is not None:
        speeds, commands, said = None, computed[0], [*said, computed[1]]
    there = {name: s for name, s in (("command", commands), ("rotor_speed", speeds)) if s is not None}
    kind = wanted_input(vehicle, {name: name in there for name in ("command", "rotor_speed")}, source)
    notes = [*notes, *said] if kind == "command" else notes
    stream = there[kind]
    stream = replace(stream, values=stream.values[:, order])
    return stream, notes + slow_note("motors", stream, MOTORS_SLOW_HZ, _SETTINGS)


def _speeds(topics: dict[str, Topic], count: int) -> Stream | None:
    """What the ESCs report, where a rotor was ever seen to turn; rad/s in the autopilot's order."""
    escs = topics.get("esc_status")
    if escs is None:
        return None
    rpm = np.column_stack([escs[f"esc[{i}].esc_rpm"].astype(float) for i in range(count)])
    return _stream(escs, np.abs(rpm) * (2.0 * np.pi / 60.0), motor_columns("rotor_speed", count)) if rpm.any() else None


def _commands(topics: dict[str, Topic], parameters: dict[str, float], count: int) -> tuple[Stream | None, list[str]]:
    """What the ESCs are sent, 0..1 in the autopilot's order."""
    columns = motor_columns("command", count)
    if "actuator_motors" in topics:
        topic = topics["actuator_motors"]
        command = _columns(topic, "control", count)
        command[np.all(np.isnan(command), axis=1)] = 0.0  # disarmed
        return _stream(topic, _thrust_curve(command, parameters.get("THR_MDL_FAC", 0.0)), columns), []
    if "actuator_outputs" not in topics:
        return None, []
    topic = topics["actuator_outputs"]
    command = np.clip((_columns(topic, "output", count) - 1000.0) / 1000.0, 0.0, None)
    note = "motors: from actuator_outputs, as (microseconds - 1000) / 1000 of outputs 1 and on."
    return _stream(topic, command, columns), [note]


def _thrust_curve(thrust: Array, factor: float) -> Array:
    """The command that reaches the ESC: PX4 inverts thrust = f u^2 + (1 - f) u with f = THR_MDL_FAC before it sends u."""
    if factor <= 0.0:
        return thrust
    return (factor - 1.0 + np.sqrt((1.0 - factor) ** 2 + 4.0 * factor * np.maximum(thrust, 0.0))) / (2.0 * factor)


def _order(parameters: dict[str, float], vehicle: Vehicle) -> tuple[list[int], list[str]]:
    """Motor order by the control allocator's geometry (CA_ROTORi_PX, _PY in FRD), else PX4's quad X."""
    count = int(parameters.get("CA_ROTOR_COUNT", 0))
    if not count:
        if vehicle.rotors.count != len(QUAD_X):
            return list(range(vehicle.rotors.count)), ["motors: the log has no geometry; motor i is taken for rotor i."]
        return motor_order(vehicle, np.array(QUAD_X))
    x, y = (np.array([parameters.get(f"CA_ROTOR{i}_P{axis}", 0.0) for i in range(count)]) for axis in "XY")
    order, notes = motor_order(vehicle, np.column_stack([x, -y]))
    spin = [1 if parameters.get(f"CA_ROTOR{i}_KM", 0.05) > 0.0 else -1 for i in range(count)]
    return order, notes + spin_notes(vehicle, order, spin)


def _mocap(topics: dict[str, Topic], parameters: dict[str, float]) -> tuple[Stream | None, list[str]]:
    for name in ("vehicle_mocap_odometry", "vehicle_visual_odometry"):
        if name in topics and np.any(np.isfinite(topics[name]["q[0]"])):
            topic = topics[name]
            values = np.hstack([z_up(_columns(topic, "position", 3)), z_up_quaternion(_columns(topic, "q", 4))])
            return Stream(_sampled(topic), values, MOCAP_COLUMNS), [f"mocap: {name}, as the vehicle received it."]
    attitude = topics.get("vehicle_attitude_groundtruth")
    position = topics.get("vehicle_local_position_groundtruth")
    if attitude is None or position is None:
        return None, []
    t_s, xyz, q = _joined(position, attitude)
    return Stream(t_s, np.hstack([xyz, q]), MOCAP_COLUMNS), [
        "mocap: the simulator's ground truth stands in for it, attitude at the stamps of position."
    ]


def _joined(position: Topic, attitude: Topic) -> tuple[Array, Array, Array]:
    """Position's stamps within those of attitude, positions there, and attitude by interpolation on the great circle."""
    t_attitude, t_s = _rising(_sampled(attitude)), _sampled(position)
    q = z_up_quaternion(_columns(attitude, "q", 4))[t_attitude]
    t_attitude = _sampled(attitude)[t_attitude]
    inside = (t_s >= t_attitude[0]) & (t_s <= t_attitude[-1])
    xyz = z_up(np.column_stack([position[axis].astype(float) for axis in "xyz"]))
    return t_s[inside], xyz[inside], slerp(t_attitude, q, t_s[inside])


def _rising(t_s: Array) -> NDArray[np.int64]:
    """Indices of samples later than all before them."""
    latest = np.maximum.accumulate(t_s)
    return np.flatnonzero(np.concatenate([[True], t_s[1:] > latest[:-1]]))


def _state(topics: dict[str, Topic], parameters: dict[str, float]) -> tuple[Stream | None, list[str]]:
    attitude, position = topics.get("vehicle_attitude"), topics.get("vehicle_local_position")
    rate = topics.get("vehicle_angular_velocity")
    if attitude is None or position is None or rate is None:
        return None, []
    t_s, xyz, q = _joined(position, attitude)
    velocity = z_up(np.column_stack([position[f"v{axis}"].astype(float) for axis in "xyz"]))
    velocity = velocity[np.isin(_sampled(position), t_s)]
    t_rate = _sampled(rate)
    rates = np.column_stack([np.interp(t_s, t_rate, column) for column in z_up(_columns(rate, "xyz", 3)).T])
    inside = (t_s >= t_rate[0]) & (t_s <= t_rate[-1])
    values = np.hstack([xyz, velocity, q, rates])[inside]
    return Stream(t_s[inside], values, STATE_COLUMNS), [
        "state: the estimator's, attitude and rates at the stamps of position."
    ]
