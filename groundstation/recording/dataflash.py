"""ArduPilot logs (DataFlash binary) as streams."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundstation.flightdata import (
    BATTERY_COLUMNS,
    IMU_COLUMNS,
    MOCAP_COLUMNS,
    SETPOINT_COLUMNS,
    STATE_COLUMNS,
    Stream,
    resampled,
)
from groundstation.frames import quat_from_euler, quat_normalise, slerp
from groundstation.recording.autopilot import present, slow_note, z_up, z_up_quaternion
from groundstation.recording.dataflash_motors import Tables, read_motors
from groundstation.recording.dataflashfile import DataFlashFile, decode_dataflash
from groundstation.recording.part import WHOLE, Part
from groundstation.recording.recorded import Recording
from groundstation.recording.tables import Table
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

NAMES: Mapping[str, tuple[tuple[str, str | None], ...]] = {
    "imu": (("IMU", "I"), ("IMU", None)),  # 4.1 on with an instance; before IMU, IMU2, IMU3
    "gyr": (("GYR", "I"), ("GYR1", None)),
    "acc": (("ACC", "I"), ("ACC1", None)),
    "position": (("XKF1", "C"), ("XKF1", None), ("NKF1", "C"), ("NKF1", None)),  # EKF3, EKF2; 4.1 on with a core
    "attitude": (("XKQ", "C"), ("XKQ1", None), ("NKQ", "C"), ("NKQ1", None)),
    "battery": (("BAT", "Inst"), ("BAT", "Instance"), ("BAT", None), ("CURR", None)),  # 4.1, 4.0, 3.5 and before
}
"""What is read, and under which message and instance field, from the newest version to the oldest."""
_READ = (
    *("FMT", "PARM", "MSG", "RCOU", "RCO2", "ESC", "VISP", "SIM", "SIM2", "GUIP"),
    *(message for choices in NAMES.values() for message, _ in choices),
    *(f"ESC{i}" for i in range(1, 13)),
    *("XKF4", "NKF4"),
)
_GYRO, _ACCEL = ("GyrX", "GyrY", "GyrZ"), ("AccX", "AccY", "AccZ")
_IMU_REMEDY = (
    "set LOG_BITMASK to include fast attitude and fast (raw) IMU, and INS_LOG_BAT_OPT as docs/formats.md says."
)


def read_dataflash(path: Path, vehicle: Vehicle, part: Part = WHOLE) -> Recording:
    """Read the messages that identification needs, of a part of the log.

    GYR and ACC where raw logging was on, else IMU (first instance of each), RCOU as commands or ESC as speeds, the
    filter's position and attitude as the vehicle's own state, VISP (or in simulation SIM and SIM2) for motion capture,
    BAT, GUIP as setpoints.

    Raises:
        BadInput: it is damaged at the start, holds no motor outputs, or those of another vehicle.
    """
    log = decode_dataflash(np.memmap(path, np.uint8, mode="r"), part)
    tables = {name: table for name, table in log.tables.items() if len(table) > 1}
    lost = _losses(path, log)
    streams: dict[str, Stream] = {}
    streams["motors"], said = read_motors(tables, log.settings, vehicle, str(path))
    notes = [*lost, *said]
    for name, read in _OTHERS.items():
        stream, said = present(name, lambda read=read: read(tables))
        notes += said
        if stream is not None and len(stream):
            streams[name] = stream
    firmware = next((text for text in log.texts if text.startswith(("Ardu", "Blimp"))), "")
    return Recording(
        name=path.stem,
        streams=streams,
        metadata={"format": "ArduPilot DataFlash", **({"ver_sw": firmware} if firmware else {})},
        notes=tuple(notes),
        left_out=(*lost, *_left_out(log.tables)),
    )


def _losses(path: Path, log: DataFlashFile) -> list[str]:
    """What a copy lost."""
    notes = [f"{path.name}: {log.damaged} damaged bytes were skipped."] if log.damaged else []
    if log.missing:
        notes.append(
            f"{path.name}: the log is cut off in the middle of a record ({log.missing} bytes of it are missing); it "
            "was read up to there."
        )
    return notes


def _left_out(tables: Tables) -> list[str]:
    return [
        f"{name}: {len(table)} records at {table.rate_hz():.0f} Hz are not read."
        for name, table in sorted(tables.items())
        if name not in _READ
    ]


def _instances(tables: Tables, what: str) -> dict[int, Table]:
    """What is wanted by its instance, under whichever name the version gave it; empty where the log has none."""
    for message, instance in NAMES[what]:
        table = tables.get(message)
        if table is None or (instance is not None and instance not in table):
            continue
        if instance is None:
            return {0: table}
        numbers = table.raw(instance)
        return {int(number): table.select(numbers == number) for number in np.unique(numbers)}
    return {}


def _named(tables: Tables, what: str, instance: int | None = None) -> Table | None:
    """An instance of what is wanted, the first unless another is asked for and there."""
    found = _instances(tables, what)
    return found.get(min(found) if instance not in found else instance) if found else None


def _primary_core(tables: Tables) -> tuple[int | None, list[str]]:
    """The core of the filter that the vehicle flew by for longest (XKF4.PI), and a note where it changed cores."""
    table = next((tables[name] for name in ("XKF4", "NKF4") if name in tables and "PI" in tables[name]), None)
    if table is None:
        return None, []
    primary = table.raw("PI").astype(int)
    cores, counts = np.unique(primary, return_counts=True)
    core = int(cores[np.argmax(counts)])
    if len(cores) == 1:
        return core, []
    share = float(counts.max()) / len(primary)
    switches = int(np.count_nonzero(np.diff(primary)))
    return core, [
        f"state: the filter changed its primary core {switches} times; core {core} is read, which it "
        f"was for {share:.0%}."
    ]


def _imu(tables: Tables) -> tuple[Stream | None, list[str]]:
    gyro, accel = _named(tables, "gyr"), _named(tables, "acc")
    if gyro is not None and accel is not None:
        t_s, t_accel = gyro.column("SampleUS") / 1e6, accel.column("SampleUS") / 1e6
        inside = (t_s >= t_accel[0]) & (t_s <= t_accel[-1])
        t_s = t_s[inside]
        force = [np.interp(t_s, t_accel, column) for column in z_up(accel.columns(*_ACCEL)).T]
        values = np.hstack([z_up(gyro.columns(*_GYRO))[inside], np.column_stack(force)])
        return Stream(t_s, values, IMU_COLUMNS), ["imu: raw (GYR and ACC), accelerations at the gyro's stamps."]
    imu = _named(tables, "imu")
    if imu is None:
        return None, [f"imu: not in the log; {_IMU_REMEDY}"]
    values = np.hstack([z_up(imu.columns(*_GYRO)), z_up(imu.columns(*_ACCEL))])
    stream = Stream(imu.seconds(), values, IMU_COLUMNS)
    return stream, slow_note("imu", stream, 100.0, _IMU_REMEDY)


def _battery(tables: Tables) -> tuple[Stream | None, list[str]]:
    tables_of = _instances(tables, "battery")
    for instance, table in tables_of.items():
        values = table.columns("Volt", "Curr")
        if np.any(values[:, 0] > 0.0):
            note = (
                [] if instance == min(tables_of) else [f"battery: instance {instance}; those before tell no voltage."]
            )
            return Stream(table.seconds(), values, BATTERY_COLUMNS), note
    names = {table.name for table in tables_of.values()}
    return None, [f"battery: {name} tells no voltage; it is left out." for name in names]


def _setpoint(tables: Tables) -> tuple[Stream | None, list[str]]:
    table = tables.get("GUIP")
    if table is None:
        return None, []
    values = np.column_stack([z_up(table.columns("pX", "pY", "pZ")), np.full(len(table), np.nan)])
    return Stream(table.seconds(), values, SETPOINT_COLUMNS), []


def _mocap(tables: Tables) -> tuple[Stream | None, list[str]]:
    pose = tables.get("VISP")
    if pose is not None:
        attitude = z_up_quaternion(quat_from_euler(*np.radians(pose.columns("R", "P", "Y")).T))
        values = np.hstack([z_up(pose.columns("PX", "PY", "PZ")), attitude])
        # Spaced by the sender's clock, which stamped the exposure, and set to the vehicle's as they arrived.
        remote, t_s = pose.column("RTimeUS") / 1e6, pose.seconds()
        return Stream(remote + np.median(t_s - remote), values, MOCAP_COLUMNS, t_s), [
            "mocap: VISP, as the vehicle received it, spaced by the sender's stamps."
        ]
    attitude, position = tables.get("SIM"), tables.get("SIM2")
    if attitude is None or position is None:
        return None, []
    q = z_up_quaternion(attitude.columns("Q1", "Q2", "Q3", "Q4"))
    t_s, t_position = attitude.seconds(), position.seconds()
    inside = (t_s >= t_position[0]) & (t_s <= t_position[-1])
    xyz = z_up(position.columns("PN", "PE", "PD"))
    xyz = resampled(t_s[inside], t_position, xyz)
    stream = Stream(t_s[inside], np.hstack([xyz, q[inside]]), MOCAP_COLUMNS)
    return stream, ["mocap: the simulator's ground truth stands in for it, position at the stamps of attitude."]


def _state(tables: Tables) -> tuple[Stream | None, list[str]]:
    core, notes = _primary_core(tables)
    position, attitude = (_named(tables, what, core) for what in ("position", "attitude"))
    imu = _named(tables, "imu")
    if position is None or attitude is None or imu is None:
        return None, []
    t_attitude, t_imu, t_s = attitude.seconds(), imu.seconds(), position.seconds()
    inside = (t_s >= max(t_attitude[0], t_imu[0])) & (t_s <= min(t_attitude[-1], t_imu[-1]))
    t_s = t_s[inside]
    q = slerp(t_s, t_attitude, quat_normalise(z_up_quaternion(attitude.columns("Q1", "Q2", "Q3", "Q4"))))
    rates = resampled(t_s, t_imu, z_up(imu.columns(*_GYRO)))
    values = [
        z_up(position.columns("PN", "PE", "PD"))[inside],
        z_up(position.columns("VN", "VE", "VD"))[inside],
        q,
        rates,
    ]
    stream = Stream(t_s, np.hstack(values), STATE_COLUMNS)
    return stream, [*notes, f"state: {position.name} and {attitude.name}; body rates from the gyro."]


_OTHERS = {"imu": _imu, "mocap": _mocap, "state": _state, "battery": _battery, "setpoint": _setpoint}
