"""ArduPilot logs (DataFlash binary) as streams."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.foreign import Decoded
from groundstation.errors import BadInput
from groundstation.flightdata import (
    BATTERY_COLUMNS,
    IMU_COLUMNS,
    MOCAP_COLUMNS,
    SETPOINT_COLUMNS,
    STATE_COLUMNS,
    Stream,
    motor_columns,
)
from groundstation.frames import quat_from_euler
from groundstation.recording.autopilot import (
    MOTORS_SLOW_HZ,
    QUAD_X,
    motor_order,
    slow_note,
    wanted_input,
    z_up,
    z_up_quaternion,
)
from groundstation.recording.derive import slerp
from groundstation.recording.foreign import read_tables
from groundstation.recording.recorded import Recording
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Tables = dict[str, dict[str, Array]]

_FIELDS: dict[str, tuple[str, ...]] = {
    "IMU": ("I", "GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"),
    "RCOU": tuple(f"C{i}" for i in range(1, 15)),
    "ESC": ("Instance", "RPM"),
    "XKF1": ("C", "PN", "PE", "PD", "VN", "VE", "VD"),
    "XKQ": ("C", "Q1", "Q2", "Q3", "Q4"),
    "ATT": ("Roll", "Pitch", "Yaw"),
    "GYR": ("I", "SampleUS", "GyrX", "GyrY", "GyrZ"),
    "ACC": ("I", "SampleUS", "AccX", "AccY", "AccZ"),
    "VISP": ("RTimeUS", "PX", "PY", "PZ", "R", "P", "Y"),
    "SIM": ("Q1", "Q2", "Q3", "Q4"),
    "SIM2": ("PN", "PE", "PD"),
    "BAT": ("Inst", "Volt", "Curr"),
    "GUIP": ("pX", "pY", "pZ"),
    "PARM": ("Name", "Value"),
}
_FIRST_MOTOR_FUNCTION = 33
_MOTOR_REMEDY = (
    "ArduPilot writes RCOU at 10 Hz whatever the setting: record SERVO_OUTPUT_RAW over the link at full rate, or use "
    'ESC telemetry (a vehicle file with input = "rotor_speed").'
)
_IMU_REMEDY = (
    "set LOG_BITMASK to include fast attitude and fast (raw) IMU, and INS_LOG_BAT_OPT as docs/formats.md says."
)


def read_dataflash(path: Path, vehicle: Vehicle) -> Recording:
    """Read the messages that identification needs.

    GYR and ACC where raw logging was on, else IMU (first instance of each), RCOU as commands or ESC as speeds, XKF1 and XKQ as the vehicle's own state, VISP (or in
    simulation SIM and SIM2) for motion capture, BAT, GUIP as setpoints.

    Raises:
        BadInput: it is damaged at the start, or holds no motor outputs.
    """
    return recording_of_dataflash(path, read_tables("dataflash", path, _FIELDS), vehicle)


def recording_of_dataflash(path: Path, log: Decoded, vehicle: Vehicle) -> Recording:
    """The streams in a log's tables.

    Raises:
        BadInput: it holds no motor outputs.
    """
    tables, parameters, lost = _tables(path, log)
    notes = [*lost]
    streams: dict[str, Stream] = {}
    streams["motors"], said = _motors(tables, parameters, vehicle, str(path))
    notes += said
    imu, said = _imu(tables)
    notes += said
    if imu is not None:
        streams["imu"] = imu
    for name, read in (("mocap", _mocap), ("state", _state)):
        stream, said = read(tables)
        notes += said
        if stream is not None and len(stream):
            streams[name] = stream
    if "BAT" in tables and np.any(tables["BAT"]["Volt"] > 0.0):
        battery = _instance(tables["BAT"], "Inst", 0)
        streams["battery"] = Stream(battery["t_s"], _stack(battery, "Volt", "Curr"), BATTERY_COLUMNS)
    if "GUIP" in tables:
        guided = tables["GUIP"]
        values = np.column_stack([z_up(_stack(guided, "pX", "pY", "pZ")), np.full(len(guided["t_s"]), np.nan)])
        streams["setpoint"] = Stream(guided["t_s"], values, SETPOINT_COLUMNS)
    return Recording(
        name=path.stem,
        streams=streams,
        metadata={"format": "ArduPilot DataFlash"},
        notes=tuple(notes),
        left_out=(
            *lost,
            f"messages of the log other than {', '.join(_FIELDS)}.",
        ),
    )


def _tables(path: Path, log: Decoded) -> tuple[Tables, dict[str, float], list[str]]:
    """Columns of each message type with ``t_s``, the parameters, and a note on damage."""
    skipped = sum(map(int, re.findall(r"Skipped (\d+) bad bytes", log.complaints)))
    notes = [f"{path.name}: {skipped} damaged bytes were skipped."] if skipped else []
    tables = {name: {"t_s": columns["TimeUS"] / 1e6, **columns} for name, columns in log.tables.items()}
    return tables, log.parameters, notes


def _stack(table: dict[str, Array], *names: str) -> Array:
    return np.column_stack([table[name] for name in names])


def _instance(table: dict[str, Array], key: str, wanted: int) -> dict[str, Array]:
    mask = table[key] == wanted
    return {name: column[mask] for name, column in table.items()}


def _imu(tables: Tables) -> tuple[Stream | None, list[str]]:
    if {"GYR", "ACC"} <= set(tables):
        gyro, accel = _instance(tables["GYR"], "I", 0), _instance(tables["ACC"], "I", 0)
        t_s, t_accel = gyro["SampleUS"] / 1e6, accel["SampleUS"] / 1e6
        inside = (t_s >= t_accel[0]) & (t_s <= t_accel[-1])
        t_s = t_s[inside]
        force = [np.interp(t_s, t_accel, column) for column in z_up(_stack(accel, "AccX", "AccY", "AccZ")).T]
        values = np.hstack([z_up(_stack(gyro, "GyrX", "GyrY", "GyrZ"))[inside], np.column_stack(force)])
        return Stream(t_s, values, IMU_COLUMNS), ["imu: raw (GYR and ACC), accelerations at the gyro's stamps."]
    if "IMU" not in tables:
        return None, [f"imu: not in the log; {_IMU_REMEDY}"]
    imu = _instance(tables["IMU"], "I", 0)
    values = np.hstack([z_up(_stack(imu, "GyrX", "GyrY", "GyrZ")), z_up(_stack(imu, "AccX", "AccY", "AccZ"))])
    stream = Stream(imu["t_s"], values, IMU_COLUMNS)
    return stream, slow_note("imu", stream, 100.0, _IMU_REMEDY)


def _motors(tables: Tables, parameters: dict[str, float], vehicle: Vehicle, source: str) -> tuple[Stream, list[str]]:
    count = vehicle.rotors.count
    spinning = "ESC" in tables and bool(np.any(tables["ESC"]["RPM"] != 0.0))
    kind = wanted_input(vehicle, {"command": "RCOU" in tables, "rotor_speed": spinning}, source)
    if count == len(QUAD_X):
        order, notes = motor_order(vehicle, np.array(QUAD_X))
    else:
        order, notes = list(range(count)), ["motors: not a quadrotor; motor i is taken for rotor i."]
    if kind == "rotor_speed":
        stream = _speeds(tables["ESC"], order, source)
        notes.append("motors: ESC telemetry; speeds of the other rotors are interpolated to the stamps of the first.")
        return stream, notes + slow_note("motors", stream, MOTORS_SLOW_HZ, "raise the ESC telemetry rate.")
    outputs = tables["RCOU"]
    low, high = parameters.get("MOT_PWM_MIN", 1000.0), parameters.get("MOT_PWM_MAX", 2000.0)
    values = np.column_stack([outputs[f"C{channel}"] for channel in _channels(parameters, count)])
    command = np.clip((values - low) / (high - low), 0.0, 1.0)[:, order]
    stream = Stream(outputs["t_s"], command, motor_columns("command", count))
    return stream, notes + slow_note("motors", stream, MOTORS_SLOW_HZ, _MOTOR_REMEDY)


def _channels(parameters: dict[str, float], count: int) -> Iterable[int]:
    """Output channel of each motor, from 1, by SERVOn_FUNCTION (33: motor 1, and so on)."""
    by_function = {int(parameters.get(f"SERVO{channel}_FUNCTION", 0)): channel for channel in range(14, 0, -1)}
    return [by_function.get(_FIRST_MOTOR_FUNCTION + motor, motor + 1) for motor in range(count)]


def _speeds(escs: dict[str, Array], order: list[int], source: str) -> Stream:
    by_motor = [_instance(escs, "Instance", motor) for motor in range(len(order))]
    if any(len(motor["t_s"]) < 2 for motor in by_motor):
        raise BadInput(
            f"{source}: ESC telemetry covers {sum(len(m['t_s']) > 1 for m in by_motor)} of {len(order)} rotors."
        )
    begin, end = max(m["t_s"][0] for m in by_motor), min(m["t_s"][-1] for m in by_motor)
    t_s = by_motor[0]["t_s"]
    t_s = t_s[(t_s >= begin) & (t_s <= end)]
    rpm = np.column_stack([np.interp(t_s, by_motor[motor]["t_s"], by_motor[motor]["RPM"]) for motor in order])
    return Stream(t_s, np.abs(rpm) * (2.0 * np.pi / 60.0), motor_columns("rotor_speed", len(order)))


def _mocap(tables: Tables) -> tuple[Stream | None, list[str]]:
    if "VISP" in tables:
        pose = tables["VISP"]
        attitude = z_up_quaternion(quat_from_euler(*np.radians(_stack(pose, "R", "P", "Y")).T))
        values = np.hstack([z_up(_stack(pose, "PX", "PY", "PZ")), attitude])
        # Spaced by the sender's clock, which stamped the exposure, and set to the vehicle's as they arrived.
        remote = pose["RTimeUS"] / 1e6
        return Stream(remote + np.median(pose["t_s"] - remote), values, MOCAP_COLUMNS, pose["t_s"]), [
            "mocap: VISP, as the vehicle received it, spaced by the sender's stamps."
        ]
    if "SIM" not in tables or "SIM2" not in tables:
        return None, []
    attitude, position = tables["SIM"], tables["SIM2"]
    q = z_up_quaternion(_stack(attitude, "Q1", "Q2", "Q3", "Q4"))
    xyz = z_up(_stack(position, "PN", "PE", "PD"))
    t_s = attitude["t_s"]
    inside = (t_s >= position["t_s"][0]) & (t_s <= position["t_s"][-1])
    xyz = np.column_stack([np.interp(t_s[inside], position["t_s"], column) for column in xyz.T])
    stream = Stream(t_s[inside], np.hstack([xyz, q[inside]]), MOCAP_COLUMNS)
    return stream, ["mocap: the simulator's ground truth stands in for it, position at the stamps of attitude."]


def _state(tables: Tables) -> tuple[Stream | None, list[str]]:
    if not {"XKF1", "XKQ", "IMU"} <= set(tables):
        return None, []
    position, attitude = _instance(tables["XKF1"], "C", 0), _instance(tables["XKQ"], "C", 0)
    imu = _instance(tables["IMU"], "I", 0)
    begin = max(attitude["t_s"][0], imu["t_s"][0])
    end = min(attitude["t_s"][-1], imu["t_s"][-1])
    t_s = position["t_s"]
    inside = (t_s >= begin) & (t_s <= end)
    t_s = t_s[inside]
    q = slerp(attitude["t_s"], z_up_quaternion(_stack(attitude, "Q1", "Q2", "Q3", "Q4")), t_s)
    gyro = z_up(_stack(imu, "GyrX", "GyrY", "GyrZ"))
    rates = np.column_stack([np.interp(t_s, imu["t_s"], column) for column in gyro.T])
    values = [
        z_up(_stack(position, "PN", "PE", "PD"))[inside],
        z_up(_stack(position, "VN", "VE", "VD"))[inside],
        q,
        rates,
    ]
    return Stream(t_s, np.hstack(values), STATE_COLUMNS), ["state: XKF1 and XKQ; body rates from the gyro."]
