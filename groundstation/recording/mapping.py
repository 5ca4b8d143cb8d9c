"""``convert --map``: which columns of any log are which stream, said by hand, with units and frames."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from groundstation.errors import BadInput
from groundstation.flightdata import Stream, motor_columns
from groundstation.frames import quat_from_euler
from groundstation.outside import read_toml
from groundstation.recording.autopilot import z_up, z_up_quaternion
from groundstation.recording.guesses import Guess, guessed
from groundstation.recording.recorded import COLUMNS, Recording
from groundstation.recording.sources import Source, sources_of
from groundstation.recording.tables import MissingField, Table
from groundstation.texts import shown
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_VECTORS = {
    "imu": (("gyro_x_rad_s", "gyro_y_rad_s", "gyro_z_rad_s"), ("accel_x_m_s2", "accel_y_m_s2", "accel_z_m_s2")),
    "mocap": (("x_m", "y_m", "z_m"),),
    "setpoint": (("x_m", "y_m", "z_m"),),
    "state": (("x_m", "y_m", "z_m"), ("vx_m_s", "vy_m_s", "vz_m_s"), ("wx_rad_s", "wy_rad_s", "wz_rad_s")),
}
_QUATERNION = ("qw", "qx", "qy", "qz")
_EULER = ("roll_rad", "pitch_rad", "yaw_rad")
"""What may stand for a quaternion: yaw, pitch, roll, each about the turned axes, in the stream's own frame."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Column(_Section):
    """A column and what makes it the contract's unit: (value + offset) * factor."""

    column: str
    factor: float = 1.0
    offset: float = 0.0


class StreamMap(_Section):
    """Where a stream is. ``where`` keeps the rows in which these columns have these values (an instance)."""

    source: str = ""
    time: str
    time_unit: Literal["s", "ms", "us", "ns"] = "s"
    frame: Literal["z-up", "FLU", "NED", "FRD", "y-up"] = "z-up"
    where: Mapping[str, float] = {}
    columns: Annotated[Mapping[str, str | Column], Field(min_length=1)]


class LogMap(_Section):
    """A map file."""

    motors: StreamMap
    imu: StreamMap | None = None
    mocap: StreamMap | None = None
    battery: StreamMap | None = None
    setpoint: StreamMap | None = None
    state: StreamMap | None = None


def load_map(path: str | Path) -> LogMap:
    """Read a map file.

    Raises:
        BadInput: it is missing, no TOML, or wrong; all faults at once.
    """
    try:
        return LogMap.model_validate(read_toml(Path(path), "a map file (--map-template writes one)"))
    except ValidationError as error:
        faults = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg'].lower()}" for e in error.errors())
        raise BadInput(
            f"{path}: {shown(faults, limit=1000)}. Correct it; --map-template writes one with every key."
        ) from None


def read_mapped(path: Path, wanted: LogMap, vehicle: Vehicle) -> Recording:
    """The log's streams as the map says.

    Raises:
        BadInput: a table or column is missing, or a stream lacks columns.
    """
    if wanted.imu is None and wanted.mocap is None and wanted.state is None:
        raise BadInput(f"{path}: the map needs the motion too; give [imu], [mocap] or [state].")
    sources = sources_of(path)
    motors = motor_columns(vehicle.rotors.input, vehicle.rotors.count)
    by_source: dict[str, list[str]] = {}
    for name, section in _sections(wanted).items():
        by_source.setdefault(_source_of(path, name, section, sources), []).append(name)
    streams: dict[str, Stream] = {}
    for source, names in by_source.items():  # each table is read once, and given up before the next
        sections = {name: getattr(wanted, name) for name in names}
        for name, section in sections.items():
            _check_columns(name, section, motors if name == "motors" else COLUMNS[name])
        fields = sorted({field for section in sections.values() for field in _fields_of(section)})
        table = replace(sources[source](fields), name=source)
        for name, section in sections.items():
            streams[name] = _stream(path, name, section, table, motors if name == "motors" else COLUMNS[name])
    left = tuple(f"{name}: is not in the map." for name in sources if name not in by_source)
    note = "every stream is what the map file says; units, frames and order were not read from the log."
    return Recording(path.stem, streams, metadata={"format": "mapped log"}, notes=(note,), left_out=left)


def _sections(wanted: LogMap) -> dict[str, StreamMap]:
    return {name: section for name in LogMap.model_fields if (section := getattr(wanted, name)) is not None}


def _source_of(path: Path, name: str, section: StreamMap, sources: Mapping[str, Source]) -> str:
    chosen = section.source or (next(iter(sources)) if len(sources) == 1 else "")
    if chosen not in sources:
        raise BadInput(f"{path}: has no table '{chosen}' for [{name}]; it has {', '.join(sources)}.")
    return chosen


def _fields_of(section: StreamMap) -> set[str]:
    """The fields of its table that a section names."""
    columns = {column if isinstance(column, str) else column.column for column in section.columns.values()}
    return {section.time, *section.where, *columns}


def _asked(section: StreamMap, columns: tuple[str, ...]) -> tuple[bool, tuple[str, ...]]:
    """Whether angles stand for the quaternion, and the columns that the section is asked for."""
    given = set(section.columns)
    euler = set(_QUATERNION) <= set(columns) and not given & set(_QUATERNION) and given.issuperset(_EULER)
    return euler, tuple(c for c in columns if not (euler and c in _QUATERNION)) + (_EULER if euler else ())


def _check_columns(name: str, section: StreamMap, columns: tuple[str, ...]) -> None:
    """Raise where a section lacks columns, or has others."""
    euler, asked = _asked(section, columns)
    optional = {"current_a"} if euler else {"yaw_rad", "current_a"}
    missing = [column for column in asked if column not in {*section.columns, *optional}]
    surplus = [column for column in section.columns if column not in asked]
    if missing or surplus:
        wrong = f"lacks {', '.join(missing)}" if missing else f"has {', '.join(surplus)}"
        instead = f" (or {', '.join(_EULER)} for the quaternion)" if set(_QUATERNION) <= set(columns) else ""
        raise BadInput(f"the map's [{name}.columns] {wrong}; it must give {', '.join(columns)}{instead}.")


def _stream(path: Path, name: str, section: StreamMap, table: Table, columns: tuple[str, ...]) -> Stream:
    euler, asked = _asked(section, columns)
    try:
        for column, value in section.where.items():
            table = table.select(table.column(column) == value)
        t_s = table.column(section.time) * _UNITS[section.time_unit]
        found = {column: _values(table, section.columns.get(column)) for column in asked}
    except MissingField as error:
        raise BadInput(
            f"{path}: {error}, which the map names for [{name}]; it has {', '.join(table.fields)}."
        ) from None
    if euler:
        attitude = quat_from_euler(*(found[column] for column in _EULER))
        found |= dict(zip(_QUATERNION, attitude.T, strict=True))
    values = np.column_stack([found.pop(column) for column in columns])
    # Tables that join several series have empty cells where one has no sample.
    filled = np.isfinite(t_s) & np.isfinite(values).any(axis=1)
    if not filled.any():
        raise BadInput(f"{path}: table '{table.name}' has no rows for [{name}]; correct [{name}.where].")
    if not filled.all():
        t_s, values = t_s[filled], values[filled]
    return Stream(t_s, _turned(values, columns, section.frame, name), columns)


def _values(table: Table, column: str | Column | None) -> Array:
    if column is None:
        return np.full(len(table), np.nan)
    if isinstance(column, str):
        return table.column(column)
    return (table.column(column.column) + column.offset) * column.factor


def _turned(values: Array, columns: tuple[str, ...], frame: str, name: str) -> Array:
    """Vectors, quaternions and yaw in our frames: x ahead or north, z up."""
    if frame in ("z-up", "FLU"):
        return values
    values = values.copy()
    for vector in _VECTORS.get(name, ()):
        at = [columns.index(column) for column in vector]
        values[:, at] = (
            z_up(values[:, at]) if frame in ("NED", "FRD") else values[:, [at[0], at[2], at[1]]] * [1, -1, 1]
        )
    if set(_QUATERNION) <= set(columns):
        at = [columns.index(column) for column in _QUATERNION]
        q = values[:, at]
        values[:, at] = z_up_quaternion(q) if frame in ("NED", "FRD") else q[:, [0, 1, 3, 2]] * [1, 1, -1, 1]
    if "yaw_rad" in columns and frame in ("NED", "FRD"):
        values[:, columns.index("yaw_rad")] *= -1.0
    return values


def template(path: Path, vehicle: Vehicle | None = None) -> str:
    """A map file for a log: its tables and columns as comments, and what the names of columns tell filled in."""
    lines = [
        f"# Which columns of {path.name} are which stream. Leave out the sections the log does not have.",
        "# What is filled in was taken from the names of columns, units from what stands beside them: check each line.",
        "# time_unit: s, ms, us or ns. frame: z-up (or FLU), NED (or FRD), y-up.",
        "# A column is a name, or { column = NAME, factor = F, offset = O }: (value + O) * F in the unit of the key.",
        "# where = { I = 0 } keeps the rows of one instance. roll_rad, pitch_rad, yaw_rad may stand for a quaternion.",
        "#",
    ]
    tables = {name: source([]) for name, source in sources_of(path).items()}
    for name, table in tables.items():
        lines.append(f"# {name}: {len(table)} rows at {table.rate_hz():.0f} Hz: {', '.join(list(table.fields)[:60])}")
    kind, count = (vehicle.rotors.input, vehicle.rotors.count) if vehicle else ("command", 4)
    for name in LogMap.model_fields:
        columns = motor_columns(kind, count) if name == "motors" else COLUMNS[name]
        lines += ["", *_template_of(name, columns, guessed(tables, name, columns))]
    return "\n".join(lines) + "\n"


def _template_of(name: str, columns: tuple[str, ...], found: Guess | None) -> list[str]:
    """A section: filled in and active where the names of columns tell all of it, else a comment (motors are needed)."""
    mark = "" if name == "motors" or found is not None else "# "
    source, time, unit = (found.source, found.time, found.time_unit) if found else ("", "", "us")
    lines = [
        f"[{name}]",
        f"source = {json.dumps(source, ensure_ascii=False)}",
        f"time = {json.dumps(time, ensure_ascii=False)}",
        f'time_unit = "{unit}"',
    ]
    if name in _VECTORS:
        lines.append('frame = "z-up"')
    lines.append(f"[{name}.columns]")
    if found is None:
        lines += [f'{column} = ""' for column in columns]
    for column, (field, factor) in (found.columns if found else {}).items():
        plain = json.dumps(field, ensure_ascii=False)
        lines.append(f"{column} = {plain if factor == 1.0 else f'{{ column = {plain}, factor = {factor!r} }}'}")
    return [mark + line for line in lines]
