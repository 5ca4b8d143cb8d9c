"""Micro-SD logs of Bitcraze's Crazyflie ("usd log"), a binary format that its own header describes.

Layout, little endian: ``0xBC``, version (u16: 1 has millisecond, 2 microsecond stamps), number of event types (u16); for
each its id (u16), its name (zero-terminated), its number of variables (u16) and for each variable ``name(type)``,
zero-terminated, with the type as in Python's ``struct``. Then events: id (u16), time stamp (u32 in version 1, u64 in
version 2), variables, packed. The last four bytes are the CRC-32 of all that precedes them.
"""

from __future__ import annotations

import re
import struct
import zlib
from dataclasses import dataclass

import numpy as np

from groundstation.errors import BadInput
from groundstation.flightdata import (
    BATTERY_COLUMNS,
    IMU_COLUMNS,
    STATE_COLUMNS,
    Array,
    Stream,
    motor_columns,
)
from groundstation.frames import quat_from_euler
from groundstation.recording.autopilot import wanted_input
from groundstation.recording.derive import body_rates
from groundstation.recording.recorded import Recording
from groundstation.vehicle import Vehicle

MAGIC = 0xBC
_G = 9.80665
_FULL_COMMAND = 65535.0
_ROTORS = 4
_TYPES = {
    **{"b": "<i1", "B": "<u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "l": "<i4", "L": "<u4"},
    **{"q": "<i8", "Q": "<u8", "e": "<f2", "f": "<f4", "d": "<f8"},
}
"""Types of variables, as in Python's ``struct`` with standard sizes."""


@dataclass(frozen=True, slots=True)
class UsdLog:
    """Columns of each event type by name, under the name of the event, with stamps in seconds."""

    t_s: dict[str, Array]
    columns: dict[str, dict[str, Array]]
    notes: tuple[str, ...]


def is_usd_log(head: bytes) -> bool:
    """Whether the first bytes of a file are those of a usd log."""
    return len(head) >= 5 and head[0] == MAGIC and struct.unpack_from("<H", head, 1)[0] in (1, 2)


def decode_usd(data: bytes, source: str) -> UsdLog:
    """Decode a log; one that was cut off is read up to the cut, and a note says so.

    Raises:
        BadInput: the header is not that of a usd log.
    """
    try:
        version, records, position = _header(data)
    except (struct.error, ValueError, TypeError, IndexError):
        raise BadInput(f"{source}: the header is damaged; copy the log from the card again.") from None
    whole = len(data) - 4 > position and struct.unpack_from("<I", data, len(data) - 4)[0] == zlib.crc32(data[:-4])
    end = len(data) - 4 if whole else len(data)
    offsets: dict[int, list[int]] = {event: [] for event in records}
    sizes = {event: record.itemsize for event, (_, record) in records.items()}
    identify = struct.Struct("<H").unpack_from
    while position + 2 <= end:
        event = identify(data, position)[0]
        size = sizes.get(event)
        if size is None or position + size > end:
            break
        offsets[event].append(position)
        position += size
    notes = []
    if not whole:
        notes.append(
            f"{source}: the log was cut off or damaged (its checksum does not match); "
            f"read up to byte {position} of {len(data)}."
        )
    buffer = np.frombuffer(data, np.uint8)
    t_s, columns = {}, {}
    for event, (name, record) in records.items():
        where = np.asarray(offsets[event], dtype=np.int64)
        rows = buffer[where[:, None] + np.arange(record.itemsize)].reshape(-1).view(record)
        t_s[name] = rows["_t"] / (1e3 if version == 1 else 1e6)
        columns[name] = {key: rows[key].astype(float) for key in record.names or () if not key.startswith("_")}
    return UsdLog(t_s, columns, tuple(notes))


def _header(data: bytes) -> tuple[int, dict[int, tuple[str, np.dtype]], int]:
    magic, version, types = struct.unpack_from("<BHH", data)
    if magic != MAGIC or version not in (1, 2):
        raise ValueError("no usd log")
    position = 5
    stamp = ("_t", "<u4") if version == 1 else ("_t", "<u8")
    records: dict[int, tuple[str, np.dtype]] = {}
    for _ in range(types):
        event = struct.unpack_from("<H", data, position)[0]
        name, position = _text(data, position + 2)
        variables = struct.unpack_from("<H", data, position)[0]
        position += 2
        fields: list[tuple[str, str]] = [("_id", "<u2"), stamp]
        for _ in range(variables):
            variable, position = _text(data, position)
            match = re.fullmatch(r"(.+)\((\w)\)", variable)
            if match is None or match[2] not in _TYPES:
                raise ValueError(variable)
            fields.append((match[1], _TYPES[match[2]]))
        records[event] = (name, np.dtype(fields))
    return version, records, position


def _text(data: bytes, position: int) -> tuple[str, int]:
    end = data.index(b"\0", position)
    return data[position:end].decode("ascii"), end + 1


def read_usd(data: bytes, source: str, name: str, vehicle: Vehicle) -> Recording:
    """A log as streams in SI units.

    Args:
        data: the file.
        source: its path, for messages.
        name: of the flight.
        vehicle: declared; says which motor values are meant.

    Raises:
        BadInput: no usd log, or it lacks the motors.
    """
    log = decode_usd(data, source)
    motor_event = next((e for e, c in log.columns.items() if "motor.m1" in c or "rpm.m1" in c), None)
    if motor_event is None:
        found = ", ".join(sorted({v for c in log.columns.values() for v in c})) or "nothing"
        raise BadInput(f"{source}: holds no motor values (motor.m1 to motor.m4); it has {found}. Log them too.")
    t_s, columns = log.t_s[motor_event], log.columns[motor_event]
    motors, said = _motors(t_s, columns, vehicle, source)
    streams = {"motors": motors}
    notes = [*log.notes, *said]
    for event, found in log.columns.items():
        times = log.t_s[event]
        if {"acc.x", "gyro.x"} <= set(found):
            gyro = np.column_stack([found[f"gyro.{axis}"] for axis in "xyz"]) * (np.pi / 180.0)
            accel = np.column_stack([found[f"acc.{axis}"] for axis in "xyz"]) * _G
            streams["imu"] = Stream(times, np.hstack([gyro, accel]), IMU_COLUMNS)
        if "pm.vbatMV" in found or "pm.vbat" in found:
            volts = found["pm.vbatMV"] / 1000.0 if "pm.vbatMV" in found else found["pm.vbat"]
            streams["battery"] = Stream(times, np.column_stack([volts, np.full(len(volts), np.nan)]), BATTERY_COLUMNS)
        if {"stateEstimate.x", "stateEstimate.vx", "stateEstimate.yaw"} <= set(found):
            streams["state"], said = _state(times, found)
            notes.extend(said)
    extras = {
        f"usd_{event}": Stream(log.t_s[event], np.column_stack(list(found.values())), tuple(found))
        for event, found in log.columns.items()
        if len(log.t_s[event]) and found
    }
    return Recording(
        name=name,
        streams=streams,
        extras=extras,
        metadata={"format": "crazyflie usd log"},
        notes=tuple(notes),
        left_out=log.notes,
    )


def _motors(t_s: Array, columns: dict[str, Array], vehicle: Vehicle, source: str) -> tuple[Stream, list[str]]:
    """Commands as a fraction of full scale (65535), or the speeds of an rpm deck.

    A firmware that compensates the battery takes motor.m1..m4 for thrusts and raises pwm.m1_pwm..m4_pwm as the voltage falls
    (motors.c, motorsCompensateBatteryVoltage). Where both and the voltage are logged, the command is what the motors got:
    the share of the full battery's voltage.
    """
    prefixes = {"command": "motor", "rotor_speed": "rpm"}
    names = {kind: [f"{prefix}.m{i}" for i in range(1, _ROTORS + 1)] for kind, prefix in prefixes.items()}
    kind = wanted_input(vehicle, {kind: set(wanted) <= set(columns) for kind, wanted in names.items()}, source)
    if vehicle.rotors.count != _ROTORS:
        raise BadInput(
            f"{source}: has {_ROTORS} motors, the vehicle file {vehicle.rotors.count}; give the Crazyflie's."
        )
    scale = 1.0 / _FULL_COMMAND if kind == "command" else 2.0 * np.pi / 60.0
    values = np.column_stack([columns[w] for w in names[kind]]) * scale
    widths = [f"pwm.m{i}_pwm" for i in range(1, _ROTORS + 1)]
    full = vehicle.battery.full_v
    if kind != "command" or full is None or not {*widths, "pm.vbatMV"} <= set(columns):
        return Stream(t_s, values, motor_columns(kind, _ROTORS)), []
    applied = np.column_stack([columns[w] for w in widths]) / _FULL_COMMAND
    note = f"motors: commands are the voltage applied (pwm and battery), as a share of the full battery's {full:g} V."
    return Stream(t_s, applied * columns["pm.vbatMV"][:, None] / 1000.0 / full, motor_columns(kind, _ROTORS)), [note]


def _state(t_s: Array, columns: dict[str, Array]) -> tuple[Stream, list[str]]:
    """The vehicle's own estimate; pitch, where it was not logged, from the specific force.

    With the world's acceleration a (gravity removed) and yaw psi, f = Rz(-psi) (a + g e_z) is the specific force in the
    heading frame. Where the only force besides gravity acts along body z, f is parallel to
    Rz(-psi) R e_z = [sin(theta) cos(phi), -sin(phi), cos(theta) cos(phi)], so that tan(theta) = f_x / f_z whatever phi.
    Drag in the body's plane is what this neglects.
    """

    def get(name: str) -> Array:
        return columns[f"stateEstimate.{name}"]

    notes = []
    yaw = np.unwrap(np.radians(get("yaw")))
    force = np.column_stack([get(f"a{axis}") for axis in "xyz"]) * _G if "stateEstimate.ax" in columns else None
    has = {key.removeprefix("stateEstimate.") for key in columns}
    pitch = -np.radians(get("pitch")) if "pitch" in has else None  # its sign is the firmware's, nose up negative
    if force is not None:
        force[:, 2] += _G
        ahead = np.cos(yaw) * force[:, 0] + np.sin(yaw) * force[:, 1]
        left = -np.sin(yaw) * force[:, 0] + np.cos(yaw) * force[:, 1]
        if pitch is None:
            pitch = np.arctan2(ahead, force[:, 2])
            notes.append(
                "state: pitch was not logged; it is derived from the estimated acceleration and yaw, taking the thrust "
                "as the only force besides gravity (drag in the body's plane is neglected)."
            )
        derived_roll = np.arctan2(-left, np.hypot(ahead, force[:, 2]))
    else:
        derived_roll = np.full(len(t_s), np.nan)
    roll = np.radians(get("roll")) if "roll" in has else derived_roll
    if pitch is None:
        pitch = np.full(len(t_s), np.nan)
    if "roll" in has and "pitch" not in has and force is not None:
        flying = get("z") > 0.2
        if flying.any():
            miss = np.degrees(np.sqrt(np.mean((derived_roll - roll)[flying] ** 2)))
            notes.append(
                f"state: roll derived in the same way misses the logged roll by {miss:.1f} degrees rms in flight."
            )
    quaternion = quat_from_euler(roll, pitch, yaw)
    rates = body_rates(t_s, quaternion)
    notes.append("state: body rates are derived from the attitude by central differences.")
    position_velocity = [get(name) for name in ("x", "y", "z", "vx", "vy", "vz")]
    values = np.column_stack([*position_velocity, quaternion, rates])
    return Stream(t_s, values, STATE_COLUMNS), notes
