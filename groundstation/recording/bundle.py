"""Flight bundles: a flight as a folder of CSV files, read and written without loss (contract: docs/formats.md)."""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.errors import BadInput
from groundstation.flightdata import Array, FlightData, Stream, motor_columns
from groundstation.json_types import JsonObject
from groundstation.outside import inside, read_bytes, read_json, require_file
from groundstation.recording.csvfile import Columns, columns_in, header, parse_csv, write_csv
from groundstation.recording.part import WHOLE, Part
from groundstation.recording.recorded import (
    COLUMNS,
    LOG_COLUMNS,
    STREAMS,
    VEHICLE_FILE,
    Recording,
    Texts,
    recording_of,
)
from groundstation.texts import holdable, shown
from groundstation.vehicle import Vehicle
from groundstation.writing import write_whole

FLIGHT_FILE = "flight.json"
"""Name, metadata, excitation window and the names of extra streams; only bundles written here have it."""
_SCHEMA = "groundstation.bundle/1"


def _require_files(folder: Path, files: Collection[str], vehicle: Vehicle | None) -> None:
    """Refuse a bundle that lacks what no flight can do without."""
    if "motors.csv" not in files:
        raise BadInput(f"{folder}: motors.csv is missing; a flight bundle needs it ({_NEEDS}).")
    if vehicle is None and VEHICLE_FILE not in files:
        raise BadInput(f"{folder}: vehicle.toml is missing; add it or give one with --vehicle FILE.")
    if not {"imu.csv", "mocap.csv", "state.csv"} & set(files):
        raise BadInput(f"{folder}: imu.csv, mocap.csv and state.csv are all missing; the motion must come from one.")


def read_bundle(folder: Path, vehicle: Vehicle | None = None, part: Part = WHOLE) -> Recording:
    """Read a bundle as it is.

    Args:
        folder: the bundle.
        vehicle: overrides the one in the bundle; decides which motor columns are meant.
        part: what is wanted of streams in large files, on the motors' clock.

    Raises:
        BadInput: names file, line or column, what is wrong and what to do.
    """
    files = _files(folder)
    _require_files(folder, files, vehicle)
    about = _about(files.pop(FLIGHT_FILE)) if _is_about(files.get(FLIGHT_FILE)) else _checked({}, "")
    taken = {f"{name}.csv" for name in STREAMS}
    verbatim = {name: read_bytes(path, "a file of a bundle") for name, path in files.items() if name not in taken}
    shell = Recording(name=about["name"] or folder.resolve().name, files=verbatim)
    declared = vehicle or shell.vehicle(str(folder))

    tables = _Tables()
    for name in STREAMS:
        path = files.get(f"{name}.csv")
        if path is not None:
            ahead_s = _ahead_s(path) - _ahead_s(files["motors.csv"])
            tables.add_stream(name, path, declared, part.later(ahead_s if math.isfinite(ahead_s) else 0.0))
    for name in about["extras"]:
        if f"{name}.csv" not in verbatim:
            raise BadInput(f"{folder}: {shown(name, limit=60)}.csv is missing, which {FLIGHT_FILE} names; put it back.")
        tables.add_extra(name, verbatim.pop(f"{name}.csv"), f"{folder}/{name}.csv")
    for name, columns_of_log in LOG_COLUMNS.items():
        log = _log(verbatim.get(f"{name}.csv"), columns_of_log, f"{folder}/{name}.csv")
        if log is not None:
            tables.texts[name] = log
            verbatim.pop(f"{name}.csv")
    return Recording(
        name=shell.name,
        streams=tables.streams,
        extras=tables.extras,
        texts=tables.texts,
        files=verbatim,
        metadata=about["metadata"],
        window_s=about["window_s"],
        notes=(*about["notes"], *tables.notes),
        left_out=tuple(tables.notes),
    )


@dataclass(slots=True)
class _Tables:
    """What the CSV files of a bundle hold, filled file by file."""

    streams: dict[str, Stream] = field(default_factory=dict)
    extras: dict[str, Stream] = field(default_factory=dict)
    texts: dict[str, Texts] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def add_stream(self, name: str, path: Path, declared: Vehicle | None, part: Part) -> None:
        """A stream of a kind that the program knows; its other columns are kept beside it."""
        source = str(path)
        require_file(path, "a file of a bundle")
        with path.open("rb") as file:
            first = file.readline()
        wanted = _motor_columns(first, declared, source) if name == "motors" else COLUMNS[name]
        required = frozenset((*wanted, "t_s", "received_s"))
        columns = columns_in(path, required, part) if path.stat().st_size >= _LARGE_BYTES else None
        if columns is None:
            columns = parse_csv(read_bytes(path, "a file of a bundle"), source, required)
        columns = _without_current(columns) if name == "battery" else columns
        self.streams[name], rest, words = _split(columns, wanted, source)
        if rest is not None:
            self.extras[name] = rest
        if words is not None:
            self.texts[name] = words
        self.notes.extend(columns.notes)

    def add_extra(self, name: str, data: bytes, source: str) -> None:
        """A stream that only ``flight.json`` names."""
        columns = parse_csv(data, source)
        wanted = tuple(key for key in columns.numbers if key not in ("t_s", "received_s"))
        self.extras[name] = _split(columns, wanted, name)[0]


_NEEDS = "vehicle.toml, motors.csv, and imu.csv, mocap.csv or state.csv"


_LARGE_BYTES = 1 << 22


def _ahead_s(path: Path) -> float:
    """How far a stream's stamps are ahead of its arrivals, by its first sample; NaN where it tells no arrivals."""
    with path.open("rb") as file:
        names, first = header(file.readline()), file.readline().decode("ascii", "replace").split(",")
    row = dict(zip(names, first, strict=False))
    try:
        return float(row["t_s"]) - float(row["received_s"])
    except (KeyError, ValueError):
        return math.nan


def _files(folder: Path) -> dict[str, Path]:
    """The regular files of a bundle by their name in it.

    Raises:
        BadInput: one is a link: what it points to is not the bundle's.
    """
    files: dict[str, Path] = {}
    for path in sorted(folder.rglob("*")):
        if path.is_symlink():
            raise BadInput(f"{path}: is a link; put the file itself into the bundle.")
        if path.is_file():
            files[path.relative_to(folder).as_posix()] = path
    return files


def _is_about(path: Path | None) -> bool:
    return path is not None and f'"{_SCHEMA}"'.encode() in read_bytes(path, "a bundle's own description")


def _about(path: Path) -> JsonObject:
    return _checked(read_json(path, "a bundle's own description"), str(path))


def _checked(document: Any, source: str) -> JsonObject:
    """The parts of ``flight.json``, each of its own type.

    Raises:
        BadInput: one is of another.
    """
    about = document if isinstance(document, dict) else {}
    window, extras, notes = about.get("window_s"), about.get("extras", []), about.get("notes", [])
    metadata = about.get("metadata", {})
    lists = isinstance(extras, list) and isinstance(notes, list) and isinstance(metadata, dict)
    pair = window is None or (
        isinstance(window, list)
        and len(window) == 2
        and all(isinstance(t, int | float) and math.isfinite(t) for t in window)
    )
    if not lists or not pair or not all(isinstance(name, str) for name in extras):
        raise BadInput(
            f"{source}: extras and notes are lists of texts, metadata is a table, window_s two numbers; correct it."
        )
    return {
        "name": str(about.get("name", "")),
        "extras": list(dict.fromkeys(extras)),
        "notes": tuple(map(str, notes)),
        "metadata": {str(key): str(value) for key, value in metadata.items()},
        "window_s": None if window is None else (float(window[0]), float(window[1])),
    }


def _motor_columns(data: bytes, vehicle: Vehicle | None, source: str) -> tuple[str, ...]:
    """The motor columns the vehicle file asks for.

    Raises:
        BadInput: the file has others, or those of another number of rotors.
    """
    present = list(header(data))
    assert vehicle is not None  # noqa: S101 - read_bundle has refused a bundle without
    kind, count = vehicle.rotors.input, vehicle.rotors.count
    wanted = motor_columns(kind, count)
    suffix = {"rotor_speed": "_rad_s", "command": "_command", "wrench": ""}[kind]
    if kind == "wrench" or all(name in present for name in wanted):
        more = f"m{count + 1}{suffix}"
        if kind != "wrench" and more in present:
            raise BadInput(
                f"{source}: has column {more}, but the vehicle file declares {count} rotors; correct position_m and "
                "spin."
            )
        return wanted
    same_kind = [name for name in present if name.startswith("m") and name.endswith(suffix)]
    if same_kind:
        raise BadInput(
            f"{source}: column {next(name for name in wanted if name not in present)} is missing: the vehicle file "
            f"declares {count} rotors, the file has {len(same_kind)}; correct one of them."
        )
    for other in ("rotor_speed", "command", "wrench"):
        if set(motor_columns(other, 1)) <= set(present):
            raise BadInput(
                f'{source}: has {motor_columns(other, count)[0]}, but the vehicle file says input = "{kind}"; '
                f'set [rotors] input = "{other}".'
            )
    return wanted


def _without_current(columns: Columns) -> Columns:
    """A battery whose current nobody measured: the voltage alone tells its sag."""
    if "current_a" in columns.names or "voltage_v" not in columns.numbers:
        return columns
    unknown = np.full(len(columns.numbers["voltage_v"]), np.nan)
    return replace(columns, names=(*columns.names, "current_a"), numbers={**columns.numbers, "current_a": unknown})


def _split(columns: Columns, wanted: tuple[str, ...], source: str) -> tuple[Stream, Stream | None, Texts | None]:
    """The contract's columns, the other columns of numbers, and the columns of texts."""
    for name in ("t_s", *wanted):
        if name not in columns.numbers:
            raise BadInput(f"{source}: column {name} is missing; the first line must name t_s, {', '.join(wanted)}.")
    t_s, received = columns.numbers["t_s"], columns.numbers.get("received_s")
    if not len(t_s):
        raise BadInput(f"{source}: holds no samples; record them or remove the file.")
    values = np.column_stack([columns.numbers[name] for name in wanted])
    rest = tuple(name for name in columns.numbers if name not in (*wanted, "t_s", "received_s"))
    extra = Stream(t_s, np.column_stack([columns.numbers[name] for name in rest]), rest, received) if rest else None
    words = tuple(columns.texts)
    texts = Texts(t_s, tuple(zip(*columns.texts.values(), strict=True)), words, received) if words else None
    return Stream(t_s, values, wanted, received), extra, texts


def _log(data: bytes | None, wanted: tuple[str, ...], source: str) -> Texts | None:
    """events.csv, raw.csv or status.csv where it is one of ours; any other file of that name is carried verbatim."""
    if data is None or data.split(b"\n", 1)[0].decode("utf-8", "replace") != ",".join(("t_s", "received_s", *wanted)):
        return None
    columns = parse_csv(data, source, frozenset(("t_s", "received_s")), frozenset(wanted))
    words = [columns.texts[name] for name in wanted]
    return Texts(columns.numbers["t_s"], tuple(zip(*words, strict=True)), wanted, columns.numbers["received_s"])


def write_recording_as_bundle(recording: Recording, folder: Path) -> None:
    """Write a recording as a bundle into a new or empty folder: the whole of it, or nothing.

    Raises:
        BadInput: the folder holds something already, or cannot be written.
    """
    place = folder.resolve()
    beside = place.with_name(f".{place.name}.{os.getpid()}.new")
    try:
        if place.exists() and (not place.is_dir() or any(place.iterdir())):
            raise BadInput(f"{folder}: is not empty; name a new folder.")
        beside.mkdir(parents=True)
        _write(recording, beside)
        beside.rename(place)
    except OSError as error:
        raise BadInput(f"{folder}: cannot be written ({error.strerror}); name a folder on a disk with room.") from None
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def unholdable(recording: Recording) -> tuple[str, ...]:
    """What a bundle cannot hold: files and streams whose names lead out of the folder, or are those of its own
    files.
    """
    own = [name for name in (*recording.extras, *recording.texts) if name not in (*STREAMS, *LOG_COLUMNS)]
    return (
        *(_unheld("attachment", name) for name in recording.files if not _is_extra_file(name)),
        *(_unheld("stream", name) for name in dict.fromkeys(own) if not _is_extra_file(f"{name}.csv")),
    )


def _unheld(what: str, name: str) -> str:
    return f"{what} '{shown(name, limit=60)}': its name is not one a bundle can give to a file."


_OWN = frozenset({*(f"{stream}.csv" for stream in (*STREAMS, *LOG_COLUMNS)), FLIGHT_FILE})


def _is_extra_file(name: str) -> bool:
    return holdable(name) and name not in _OWN


def _write(recording: Recording, folder: Path) -> None:
    for name in filter(_is_extra_file, recording.files):
        data, path = recording.files[name], inside(folder, name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    for name, stream in recording.streams.items():
        names, columns = _with_times(stream.t_s, stream.received_s)
        for part in (stream, recording.extras.get(name)):
            if part is not None:
                names += part.columns
                columns += list(part.values.T)
        words = recording.texts.get(name)
        if words is not None:
            names += words.columns
            columns += list(zip(*words.rows, strict=True))
        write_csv(folder / f"{name}.csv", names, columns)
    own = [name for name in recording.extras if name not in recording.streams and _is_extra_file(f"{name}.csv")]
    for name in own:
        extra = recording.extras[name]
        names, columns = _with_times(extra.t_s, extra.received_s)
        path = inside(folder, f"{name}.csv")
        path.parent.mkdir(parents=True, exist_ok=True)
        write_csv(path, names + extra.columns, columns + list(extra.values.T))
    for name in LOG_COLUMNS:
        log = recording.texts.get(name)
        if log is not None:
            received = log.received_s if log.received_s is not None else np.full(len(log), np.nan)
            names, columns = _with_times(log.t_s, received)
            words_of = list(zip(*log.rows, strict=True)) or [() for _ in log.columns]
            write_csv(folder / f"{name}.csv", names + log.columns, columns + words_of)
    about = {
        "schema": _SCHEMA,
        "name": recording.name,
        "window_s": recording.window_s,
        "metadata": dict(recording.metadata),
        "extras": own,
        "notes": list(recording.notes),
    }
    write_whole(folder / FLIGHT_FILE, json.dumps(about, indent=1) + "\n")


def _with_times(t_s: Array, received_s: Array | None) -> tuple[tuple[str, ...], list[Any]]:
    return (("t_s",), [t_s]) if received_s is None else (("t_s", "received_s"), [t_s, received_s])


def write_bundle(flight: FlightData, folder: str | Path) -> Path:
    """Write a flight as a bundle; returns the folder.

    Raises:
        BadInput: the folder holds something already, or cannot be written.
    """
    folder = Path(folder)
    write_recording_as_bundle(recording_of(flight), folder)
    return folder
