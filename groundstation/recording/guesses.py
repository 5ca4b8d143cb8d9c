"""What the names of a table's columns tell of streams, for a map file that somebody then checks: quantity, axis, unit.

Only what names say is filled in, a stream whole or not at all. A unit stands behind the name, in brackets, or in a
line of its own below the names; where none is told, the contract's is assumed and the line shows it. Elements of a
quaternion that are numbered say nothing of their order, so they are left to whoever knows.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from groundstation.recording.tables import Table

_G, _RPM, _DEGREE = 9.80665, np.pi / 30.0, np.pi / 180.0
_FACTORS: Mapping[str, Mapping[str, float]] = {
    "rate": {"rad/s": 1.0, "deg/s": _DEGREE, "dps": _DEGREE, "°/s": _DEGREE, "mrad/s": 1e-3},
    "force": {"m/s^2": 1.0, "m/s2": 1.0, "m/s²": 1.0, "m/s/s": 1.0, "g": _G, "mg": 1e-3 * _G},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "angle": {"rad": 1.0, "deg": _DEGREE, "°": _DEGREE},
    "turning": {"rad/s": 1.0, "rpm": _RPM, "krpm": 1e3 * _RPM, "rps": 2.0 * np.pi, "hz": 2.0 * np.pi},
    "share": {"": 1.0, "%": 0.01},
    "volts": {"v": 1.0, "mv": 1e-3},
    "amperes": {"a": 1.0, "ma": 1e-3},
    "none": {"": 1.0},
}
"""Units of each quantity, and what makes them the contract's."""
_TIMES = {"s": "s", "sec": "s", "seconds": "s", "ms": "ms", "us": "us", "µs": "us", "ns": "ns"}
_BEFORE = r"(?:.*[^a-z])?"
_AXES = {"x": "(?:x|0)", "y": "(?:y|1)", "z": "(?:z|2)"}
_QUANTITIES = {
    "gyro": (
        "rate",
        rf"{_BEFORE}(?:gyr|gyro|gyroscope|angularvelocity|angular velocity|ang ?vel|omega|w|rates?|body ?rate)",
    ),
    "accel": ("force", rf"{_BEFORE}(?:acc|accel|acceleration|accelerometer|linear ?acceleration|specific ?force|a|f)"),
    "position": ("length", rf"(?:{_BEFORE}(?:pos|position|translation|p|t))?"),
    "velocity": ("speed", rf"{_BEFORE}(?:vel|velocity|v)"),
}
_KEYS = {"gyro": "gyro", "accel": "accel", "w": "gyro", "v": "velocity", "": "position"}


@dataclass(frozen=True, slots=True)
class Guess:
    """A stream of a table: column and factor of each of its columns, by the contract's names."""

    source: str
    time: str
    time_unit: str
    columns: Mapping[str, tuple[str, float]]


@dataclass(frozen=True, slots=True)
class _Named:
    """A column: its name without a unit, in lower case with single spaces, and its unit."""

    field: str
    words: str
    unit: str


def guessed(tables: Mapping[str, Table], stream: str, columns: tuple[str, ...]) -> Guess | None:
    """The first table whose names tell all that a stream needs; None where none does."""
    for source, table in tables.items():
        named = [_named(field, table.units.get(field, "")) for field in table.fields]
        time = next(
            (n for n in named if re.fullmatch(r"(?:.*[^a-z])?(?:t|time|timestamp|stamp|timeus|time us)", n.words)), None
        )
        found = _columns(named, stream, columns)
        if time is not None and found is not None:
            return Guess(source, time.field, _TIMES.get(time.unit, _time_unit(table, time)), found)
    return None


def _named(field: str, told: str) -> _Named:
    """Name and unit of a column: ``gyro_x [deg/s]``, ``gyro_x_deg_s``, ``Acc X (g)``, ``TimeUS``."""
    text = field.strip()
    match = re.fullmatch(r"(.*?)\s*[\[(]([^\])]*)[\])]\s*", text)
    if match and not re.fullmatch(r"\d+", match[2]):
        text, told = match[1], match[2]
    words = re.sub(r"([a-z])([A-Z])", r"\1 \2", text).lower()
    words = re.sub(r"[\W_]+", " ", words).strip()
    if not told:
        words, told = _with_suffix(words)
    return _Named(field, words, told.strip().lower().replace("degrees", "deg").replace("per ", "/").replace(" ", ""))


_SUFFIXES = {
    "rad s": "rad/s",
    "deg s": "deg/s",
    "m s2": "m/s^2",
    "m s 2": "m/s^2",
    "m s": "m/s",
    **{unit: unit for unit in ("dps", "rpm", "rad", "deg", "mm", "mv", "ma", "us", "ms", "ns", "percent")},
}


def _with_suffix(words: str) -> tuple[str, str]:
    """A unit behind the name; a single letter counts only where more than an axis stands before it, or time."""
    for suffix, unit in _SUFFIXES.items():
        if words.endswith(f" {suffix}"):
            return words.removesuffix(f" {suffix}"), unit
    match = re.fullmatch(r"(.{3,}|t) (s|g|v|a|m)", words)
    return (match[1], match[2]) if match else (words, "")


def _columns(named: list[_Named], stream: str, columns: tuple[str, ...]) -> dict[str, tuple[str, float]] | None:
    found: dict[str, tuple[str, float]] = {}
    for column in columns:
        hit = _found(named, stream, column)
        if hit is None and column in ("current_a", "yaw_rad"):
            continue
        if hit is None and column in ("qw", "qx", "qy", "qz"):
            continue
        if hit is None or hit[0] in {field for field, _ in found.values()}:
            return None
        found[column] = hit
    if "qw" in columns and not {"qw", "qx", "qy", "qz"} <= found.keys():
        euler = {f"{a}_rad": _matching(named, rf"{_BEFORE}(?:{a})", "angle") for a in ("roll", "pitch", "yaw")}
        told = {key: hit for key, hit in euler.items() if hit is not None}
        if len(told) < 3:
            return None
        found = {key: hit for key, hit in found.items() if not key.startswith("q")} | told
    return found


def _found(named: list[_Named], stream: str, column: str) -> tuple[str, float] | None:
    """The column of a table that is one of the contract's."""
    if motor := re.fullmatch(r"m(\d+)_(rad_s|command)", column):
        return _motor(named, int(motor[1]), motor[2])
    if column in ("voltage_v", "current_a"):
        words = r"(?:volt|voltage|vbat|battery|v)" if column == "voltage_v" else r"(?:current|curr|amps?|amperes?)"
        return _matching(named, rf"{_BEFORE}{words}", "volts" if column == "voltage_v" else "amperes")
    if quaternion := re.fullmatch(r"q([wxyz])", column):
        return _matching(
            named, rf"{_BEFORE}(?:q|quat|quaternion|orientation|rotation|attitude) ?{quaternion[1]}", "none"
        )
    if axis := re.fullmatch(r"(?:(gyro|accel)_|(w|v))?([xyz])_.*", column):
        quantity, pattern = _QUANTITIES[_KEYS[axis[1] or axis[2] or ""]]
        return _matching(named, rf"{pattern} ?{_AXES[axis[3]]}", quantity)
    return None


def _motor(named: list[_Named], number: int, unit: str) -> tuple[str, float] | None:
    """Motors are counted from 1, or from 0 where one is called so."""
    words, quantity = (r"(?:rpm|speed|omega|w|motor|rotor|esc|m)", "turning") if unit == "rad_s" else (
        r"(?:motor|rotor|esc|cmd|command|control|throttle|pwm|m|u)", "share"
    )  # fmt: skip
    pattern = rf"{_BEFORE}{words}(?: (?:rpm|speed|cmd|command))? ?"
    from_zero = any(re.fullmatch(f"{pattern}0", n.words) for n in named)
    at = number - 1 if from_zero else number
    hit = _matching(named, rf"{pattern}{at}(?: (?:rpm|speed))?", quantity)
    if hit is not None and quantity == "turning" and "rpm" in hit[0].lower() and hit[1] == 1.0:
        return hit[0], _RPM
    return hit


def _matching(named: list[_Named], pattern: str, quantity: str) -> tuple[str, float] | None:
    """The first column of a name whose unit is one of the quantity's, and its factor; 1 where no unit is told."""
    for column in named:
        if re.fullmatch(pattern, column.words):
            factor = _FACTORS[quantity].get(column.unit, 1.0 if not column.unit else None)
            if factor is not None:
                return column.field, factor
    return None


def _time_unit(table: Table, time: _Named) -> str:
    """Of stamps whose name tells no unit, by their step: motion is sampled every 0.2 ms to 0.5 s."""
    step = float(np.nanmedian(np.diff(table.column(time.field)))) if len(table) > 1 else 0.0
    return next((unit for unit, per_s in (("s", 1.0), ("ms", 1e3), ("us", 1e6)) if step < 0.5 * per_s), "ns")
