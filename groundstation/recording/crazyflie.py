"""Micro-SD logs of Bitcraze's Crazyflie ("usd log"), a binary format that its own header describes.

Layout, little endian: ``0xBC``, version (u16: 1 has millisecond, 2 microsecond stamps), number of event types (u16);
for each its id (u16), its name (zero-terminated), its number of variables (u16) and for each variable ``name(type)``,
zero-terminated, with the type as in Python's ``struct``. Then events: id (u16), time stamp (u32 in version 1, u64 in
version 2), variables, packed. The last four bytes are the CRC-32 of all that precedes them.
"""

from __future__ import annotations

import re
import struct
import zlib
from array import array
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

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
from groundstation.recording.autopilot import MOTORS_SLOW_HZ, check_count, present, slow_note, wanted_input
from groundstation.recording.derive import body_rates
from groundstation.recording.part import WHOLE, Part
from groundstation.recording.recorded import Recording
from groundstation.recording.tables import Bytes, MissingField, forget_pages, gather
from groundstation.vehicle import Vehicle

MAGIC = 0xBC
_G = 9.80665
_LONGEST_HEADER, _BLOCK = 1 << 16, 1 << 24
_FULL_COMMAND = 65535.0
_FASTER = "log them in an event of a higher rate."
_VERSIONS, _NEWEST_THINKABLE = (1, 2), 99  # a file of another kind has a larger number here
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
    return len(head) >= 5 and head[0] == MAGIC and 1 <= struct.unpack_from("<H", head, 1)[0] <= _NEWEST_THINKABLE


def decode_usd(data: Bytes, source: str, part: Part = WHOLE) -> UsdLog:
    """Decode a log or a part of it; one that was cut off is read up to the cut, and a note says so.

    Args:
        data: the whole file (it may be a memory map).
        source: its path, for messages.
        part: the events that are wanted.

    Raises:
        BadInput: the header is not that of a usd log.
    """
    head = data[:_LONGEST_HEADER].tobytes()
    version = struct.unpack_from("<H", head, 1)[0] if len(head) >= 5 else 0
    if version > max(_VERSIONS):
        raise BadInput(
            f"{source}: is a usd log of version {version}; this program reads versions 1 and 2. Update it, or convert "
            "the log with the Crazyflie firmware's own tools and `groundstation convert --map`."
        )
    try:
        version, records, position = _header(head)
    except (struct.error, ValueError, TypeError, IndexError):
        raise BadInput(f"{source}: the header is damaged; copy the log from the card again.") from None
    per_s = 1e3 if version == 1 else 1e6
    end = len(data) - 4 if _is_whole(data, position) else len(data)
    sizes = {event: record.itemsize for event, (_, record) in records.items()}
    offsets, stop = _places(data, (position, end), sizes, ("<I" if version == 1 else "<Q", part.ticks(per_s).tolist()))
    notes = []
    if end == len(data):
        notes.append(
            f"{source}: the log was cut off or damaged (its checksum does not match); read up to byte {stop} of "
            f"{len(data)}."
        )
    t_s, columns = {}, {}
    for event, (name, record) in records.items():
        rows = gather(data, np.frombuffer(offsets[event], np.int64), record)
        t_s[name] = rows["_t"] / per_s
        columns[name] = {key: rows[key].astype(float) for key in record.names or () if not key.startswith("_")}
    return UsdLog(t_s, columns, tuple(notes))


def _is_whole(data: Bytes, position: int) -> bool:
    """Whether the file ends with the checksum of all that precedes it."""
    if len(data) - 4 <= position:
        return False
    found = 0
    for first in range(0, len(data) - 4, _BLOCK):
        found = zlib.crc32(data[first : min(first + _BLOCK, len(data) - 4)].tobytes(), found)
        forget_pages(data)
    return int.from_bytes(data[-4:].tobytes(), "little") == found


def _places(
    data: Bytes, span: tuple[int, int], sizes: Mapping[int, int], clock: tuple[str, list[int]]
) -> tuple[dict[int, array[int]], int]:
    """Where each event of the part begins, by its number, and where events end.

    Args:
        data: the file.
        span: first and last byte of the events.
        sizes: bytes of an event by its number.
        clock: type of the stamps, and the first, the last and the least step that are wanted.
    """
    (position, end), (kind, (start, last, step)) = span, clock
    offsets = {event: array("q") for event in sizes}
    before: dict[int, int] = {}
    read = struct.Struct("<H" + kind[1:])
    bytes_read, given_back = data.data, position
    while position + read.size <= end:
        event, stamp = read.unpack_from(bytes_read, position)
        size = sizes.get(event)
        if size is None or position + size > end:
            break
        if start <= stamp <= last and (not step or abs(stamp - before.get(event, -step)) >= step):
            offsets[event].append(position)
            before[event] = stamp
        position += size
        if position - given_back > _BLOCK:
            forget_pages(data)
            given_back = position
    return offsets, position


def _header(data: bytes) -> tuple[int, dict[int, tuple[str, np.dtype]], int]:
    magic, version, types = struct.unpack_from("<BHH", data)
    if magic != MAGIC or version not in _VERSIONS:
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


def read_usd(path: Path, vehicle: Vehicle, part: Part = WHOLE) -> Recording:
    """A log, or a part of it, as streams in SI units.

    Args:
        path: of the log, whose name is that of the flight.
        vehicle: declared; says which motor values are meant.
        part: what is wanted of it.

    Raises:
        BadInput: no usd log, or it lacks the motors.
    """
    source = str(path)
    log = decode_usd(np.memmap(path, np.uint8, mode="r"), source, part)
    variables = _Variables(log)
    streams: dict[str, Stream] = {}
    streams["motors"], said = _motors(variables, vehicle, source)
    notes = [*log.notes, *said]
    for name, read in (("imu", _imu), ("battery", _battery), ("state", _state)):
        stream, said = present(name, lambda read=read: read(variables))
        notes += said
        if stream is not None:
            streams[name] = stream
    extras = {
        f"usd_{event}": Stream(log.t_s[event], np.column_stack(list(found.values())), tuple(found))
        for event, found in log.columns.items()
        if len(log.t_s[event]) and found and part == WHOLE
    }
    return Recording(
        name=path.name,
        streams=streams,
        extras=extras,
        metadata={"format": "crazyflie usd log"},
        notes=tuple(notes),
        left_out=log.notes,
    )


class _Variables:
    """The log's variables by name, whichever event each is in."""

    def __init__(self, log: UsdLog):
        self._log = log
        self._event = {name: event for event, columns in log.columns.items() for name in columns if len(log.t_s[event])}

    def __contains__(self, name: str) -> bool:
        return name in self._event

    def together(self, *names: str) -> tuple[Array, Array]:
        """Stamps and columns of what may be in several events, while all of these go on.

        The stamps are the first one's, to which others are interpolated; an event that has less than half as many a
        second sets the pace instead, since nobody measured what lies between its samples.

        Raises:
            MissingField: the log has none of that name, or not while it has the others.
        """
        missing = next((name for name in names if name not in self._event), None)
        if missing is not None:
            raise MissingField("the configuration", missing)
        stamps = {event: self._log.t_s[event] for event in dict.fromkeys(self._event[name] for name in names)}
        rates = {event: _rate_hz(t_s) for event, t_s in stamps.items()}
        lead, slowest = self._event[names[0]], min(rates, key=lambda event: rates[event])
        t_s = stamps[slowest if rates[slowest] < 0.5 * rates[lead] else lead]
        if len(stamps) > 1:
            begin, end = max(own.min() for own in stamps.values()), min(own.max() for own in stamps.values())
            t_s = t_s[(t_s >= begin) & (t_s <= end)]
        if not len(t_s):
            raise MissingField("the configuration", f"{names[-1]} at the time of {names[0]}")
        return t_s, np.column_stack([self.at(name, t_s) for name in names])

    def at(self, name: str, t_s: Array) -> Array:
        """A variable at some times, its first and last value before and after it."""
        own, values = self._log.t_s[self._event[name]], self._log.columns[self._event[name]][name]
        return values if own is t_s else np.interp(t_s, own, values)

    def everything(self) -> str:
        """All names, for messages."""
        return ", ".join(sorted(self._event)) or "nothing"


def _rate_hz(t_s: Array) -> float:
    """Median rate; 0 for fewer than two samples."""
    return 1.0 / max(float(np.median(np.diff(t_s))), 1e-6) if len(t_s) > 1 else 0.0


def _axes(stem: str) -> tuple[str, ...]:
    return tuple(f"{stem}.{axis}" for axis in "xyz")


def _imu(variables: _Variables) -> tuple[Stream | None, list[str]]:
    if not any(name in variables for name in (*_axes("gyro"), *_axes("acc"))):
        return None, []
    t_s, values = variables.together(*_axes("gyro"), *_axes("acc"))
    stream = Stream(t_s, values * [*[np.pi / 180.0] * 3, *[_G] * 3], IMU_COLUMNS)
    return stream, slow_note("imu", stream, 100.0, _FASTER)


_BATTERY = (("pm.vbatMV", 1e-3), ("pm.vbat", 1.0))
"""The battery's voltage by name and volts per unit; millivolts since firmware 2016."""


def _battery(variables: _Variables) -> tuple[Stream | None, list[str]]:
    for name, unit in _BATTERY:
        if name in variables:
            t_s, volts = variables.together(name)
            return Stream(t_s, np.column_stack([volts[:, 0] * unit, np.full(len(t_s), np.nan)]), BATTERY_COLUMNS), []
    return None, []


def _motors(variables: _Variables, vehicle: Vehicle, source: str) -> tuple[Stream, list[str]]:
    """Commands as a fraction of full scale (65535), or the speeds of an rpm deck.

    A firmware that compensates the battery takes motor.m1 and on for thrusts and raises pwm.m1_pwm and on as the
    voltage falls (motors.c, motorsCompensateBatteryVoltage). Where both and the voltage are logged, the command is what
    the motors got: the share of the full battery's voltage.
    """
    prefixes = {"command": "motor", "rotor_speed": "rpm"}
    count = vehicle.rotors.count
    logged = {kind: sum(f"{prefix}.m{i}" in variables for i in range(1, 17)) for kind, prefix in prefixes.items()}
    if not any(logged.values()):
        raise BadInput(
            f"{source}: holds no motor values (motor.m1 and on); it has {variables.everything()}. Log them too."
        )
    kind = wanted_input(vehicle, {kind: bool(number) for kind, number in logged.items()}, source)
    check_count(vehicle, logged[kind], f"{prefixes[kind]}.m1 to m{logged[kind]}", source)
    t_s, values = variables.together(*(f"{prefixes[kind]}.m{i}" for i in range(1, count + 1)))
    columns = motor_columns(kind, count)
    slow = slow_note("motors", Stream(t_s, values, columns), MOTORS_SLOW_HZ, _FASTER)
    if kind == "rotor_speed":
        return Stream(t_s, values * (2.0 * np.pi / 60.0), columns), slow
    plain = Stream(t_s, values / _FULL_COMMAND, columns)
    widths = [f"pwm.m{i}_pwm" for i in range(1, count + 1)]
    if not all(name in variables for name in widths):
        return plain, slow
    battery, full = next((known for known in _BATTERY if known[0] in variables), None), vehicle.battery.full_v
    if battery is None or full is None:
        lacking = "no voltage is logged (pm.vbatMV)" if battery is None else "the vehicle file lacks [battery] full_v"
        return plain, [
            *slow,
            "motors: pwm.m1_pwm and on, which a firmware that compensates the battery sends to the motors, are not "
            f"used: {lacking}. The commands are motor.m1 and on.",
        ]
    t_s, sent = variables.together(*widths)
    applied = sent / _FULL_COMMAND * variables.at(battery[0], t_s)[:, None] * battery[1] / full
    note = (
        f"motors: commands are the voltage applied (pwm and {battery[0]}), as a share of the full battery's {full:g} V."
    )
    stream = Stream(t_s, applied, columns)
    return stream, [*slow_note("motors", stream, MOTORS_SLOW_HZ, _FASTER), note]


_STATE = tuple(f"stateEstimate.{name}" for name in ("x", "y", "z", "vx", "vy", "vz", "yaw"))
_STATE_MORE = tuple(f"stateEstimate.{name}" for name in ("roll", "pitch", "ax", "ay", "az"))


def _state(variables: _Variables) -> tuple[Stream | None, list[str]]:
    """The vehicle's own estimate; pitch, where it was not logged, from the specific force.

    Pitch: :func:`_level_from_acceleration`.
    """
    if "stateEstimate.x" not in variables:
        return None, []
    wanted = (*_STATE, *(name for name in _STATE_MORE if name in variables))
    t_s, values = variables.together(*wanted)
    columns = dict(zip(wanted, values.T, strict=True))

    columns = {name.removeprefix("stateEstimate."): column for name, column in columns.items()}
    yaw = np.unwrap(np.radians(columns["yaw"]))
    derived_roll, derived_pitch = _level_from_acceleration(columns, yaw)
    roll = np.radians(columns["roll"]) if "roll" in columns else derived_roll
    # The firmware's pitch is negative with the nose up.
    pitch = -np.radians(columns["pitch"]) if "pitch" in columns else derived_pitch
    notes = []
    if "pitch" not in columns and "ax" in columns:
        notes = _said_of_pitch(columns["z"] > 0.2, derived_roll - roll if "roll" in columns else None)
    quaternion = quat_from_euler(roll, pitch, yaw)
    rates = body_rates(t_s, quaternion)
    notes.append("state: body rates are derived from the attitude by central differences.")
    position_velocity = [columns[name] for name in ("x", "y", "z", "vx", "vy", "vz")]
    values = np.column_stack([*position_velocity, quaternion, rates])
    return Stream(t_s, values, STATE_COLUMNS), notes


def _level_from_acceleration(columns: dict[str, Array], yaw: Array) -> tuple[Array, Array]:
    """Roll and pitch from the estimated acceleration, rad; NaN where it was not logged.

    With the world's acceleration a (gravity removed) and yaw psi, f = Rz(-psi) (a + g e_z) is the specific force in the
    heading frame. Where the only force besides gravity acts along body z, f is parallel to
    Rz(-psi) R e_z = [sin(theta) cos(phi), -sin(phi), cos(theta) cos(phi)], so that tan(theta) = f_x / f_z whatever phi.
    Drag in the body's plane is what this neglects.
    """
    if "ax" not in columns:
        return np.full(len(yaw), np.nan), np.full(len(yaw), np.nan)
    force = np.column_stack([columns[f"a{axis}"] for axis in "xyz"]) * _G
    force[:, 2] += _G
    ahead = np.cos(yaw) * force[:, 0] + np.sin(yaw) * force[:, 1]
    left = -np.sin(yaw) * force[:, 0] + np.cos(yaw) * force[:, 1]
    return np.arctan2(-left, np.hypot(ahead, force[:, 2])), np.arctan2(ahead, force[:, 2])


def _said_of_pitch(flying: NDArray[np.bool_], roll_error: Array | None) -> list[str]:
    """That pitch is derived, and how well roll comes out by the same way where it was logged."""
    notes = [
        "state: pitch was not logged; it is derived from the estimated acceleration and yaw, taking the thrust "
        "as the only force besides gravity (drag in the body's plane is neglected)."
    ]
    if roll_error is not None and flying.any():
        miss = np.degrees(np.sqrt(np.mean(roll_error[flying] ** 2)))
        notes.append(f"state: roll derived in the same way misses the logged roll by {miss:.1f} degrees rms in flight.")
    return notes
