"""ArduPilot's DataFlash container (AP_Logger): self-describing records behind A3 95, by column; parameters with their
times.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.recording.part import WHOLE, Part
from groundstation.recording.settings import Settings, settings_of
from groundstation.recording.tables import Bytes, Table, gather

MAGIC = b"\xa3\x95\x80"
_TYPES = {
    **{"b": "<i1", "B": "<u1", "M": "<u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8"},
    **{"f": "<f4", "d": "<f8", "g": "<f2", "c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4", "L": "<i4"},
    **{"n": "S4", "N": "S16", "Z": "S64", "a": "S64"},
}
_FACTORS = {"c": 0.01, "C": 0.01, "e": 0.01, "E": 0.01, "L": 1e-7}
_FORMAT, _PARAMETER, _MESSAGE = 128, "PARM", "MSG"


@dataclass(frozen=True, slots=True)
class DataFlashFile:
    """What a file holds.

    Attributes:
        tables: records by their name.
        settings: parameters with the times (seconds) from which each value held.
        texts: the messages of MSG.
        damaged: bytes that were skipped.
        missing: bytes by which the last record is longer than the file.
    """

    tables: Mapping[str, Table]
    settings: Settings
    texts: tuple[str, ...]
    damaged: int
    missing: int


def decode_dataflash(data: Bytes, part: Part = WHOLE) -> DataFlashFile:
    """Decode a file.

    Args:
        data: the whole file (it may be a memory map).
        part: the records that are wanted; settings and messages are those of the whole file.
    """
    from groundstation.recording.kernels import scan_dataflash

    where, kinds, damaged, missing = scan_dataflash(data, part)
    tables: dict[str, Table] = {}
    for number, name, letters, columns in _formats(data, where[kinds == _FORMAT]):
        fields = _layout(letters, columns)
        clock = next(((c, per_s) for c, per_s in (("TimeUS", 1e6), ("TimeMS", 1e3)) if c in fields), None)
        rows = where[kinds == number]
        if fields and clock is not None and len(rows):
            tables[name] = Table(name, 0, fields, data, rows, clock)
    return DataFlashFile(tables, _settings(tables), _texts(tables), int(damaged), int(missing))


def _formats(data: Bytes, where: NDArray[np.int64]) -> list[tuple[int, str, str, str]]:
    """Number, name, letters and columns of each kind of record; the last of a number holds."""
    found: dict[int, tuple[int, str, str, str]] = {}
    for at in where.tolist():
        record = data[at + 3 : at + 89].tobytes()
        name, letters, columns = (
            part.split(b"\0")[0].decode("ascii", "replace") for part in (record[2:6], record[6:22], record[22:86])
        )
        found[record[0]] = (record[0], name, letters, columns)
    return list(found.values())


def _layout(letters: str, columns: str) -> dict[str, tuple[int, str, float]]:
    """Offset (the head of three bytes included), type and factor of each column; empty for letters that are not
    known.
    """
    fields: dict[str, tuple[int, str, float]] = {}
    at = 3
    for letter, name in zip(letters, columns.split(","), strict=False):
        if letter not in _TYPES:
            return {}
        fields[name] = (at, _TYPES[letter], _FACTORS.get(letter, 1.0))
        at += np.dtype(_TYPES[letter]).itemsize
    return fields


def _words(table: Table, name: str) -> list[str] | None:
    """The texts of a column; None where the log's own layout has numbers or nothing there."""
    offset, kind, _ = table.fields.get(name, (0, "", 1.0))
    if not kind.startswith("S"):
        return None
    return [word.decode("ascii", "replace") for word in gather(table.data, table.where + offset, kind).tolist()]


def _settings(tables: Mapping[str, Table]) -> Settings:
    table = tables.get(_PARAMETER)
    names = None if table is None else _words(table, "Name")
    if table is None or names is None or "Value" not in table or _words(table, "Value") is not None:
        return Settings()
    return settings_of(zip(names, table.seconds().tolist(), table.column("Value").tolist(), strict=True))


def _texts(tables: Mapping[str, Table]) -> tuple[str, ...]:
    table = tables.get(_MESSAGE)
    return () if table is None else tuple(_words(table, "Message") or ())
