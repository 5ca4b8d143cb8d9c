"""Blackbox logs of Betaflight, INAV and their kin: headers by name, main frames by column.

Format: Betaflight's "Blackbox internals" documentation. A file may hold several logs, one after the other.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.recording.part import WHOLE, Part
from groundstation.recording.tables import Bytes, MissingField, forget_pages

Array = NDArray[np.float64]

MAGIC = b"H Product:Blackbox"
_KINDS = "IPSGH"
_LONGEST_HEADER, _MOST_FIELDS, _BLOCK = 200_000, 512, 1 << 24


@dataclass(frozen=True, slots=True, eq=False)
class BlackboxLog:
    """One log.

    Attributes:
        headers: by name, as they were written.
        names: of the main frames' fields.
        rows: their values as logged, but the time without the run-overs of its 32 bits, shape (k, len(names)).
        damaged: bytes that were skipped.
        ended: whether the log ends as it should.
    """

    headers: Mapping[str, str]
    names: tuple[str, ...]
    rows: NDArray[np.int64]
    damaged: int
    ended: bool

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def column(self, name: str) -> Array:
        """A field of the main frames as logged, shape (k,).

        Raises:
            MissingField: the log has no such field.
        """
        if name not in self.names:
            raise MissingField("the main frame", name)
        return self.rows[:, self.names.index(name)].astype(float)

    def array(self, name: str) -> Array:
        """The elements of a field that is an array, as many as there are, shape (k, n)."""
        return np.column_stack([self.column(f"{name}[{i}]") for i in range(self.elements(name))])

    def elements(self, name: str) -> int:
        """How many elements an array field has."""
        return sum(re.fullmatch(rf"{name}\[\d+\]", field) is not None for field in self.names)

    def number(self, name: str, default: float) -> float:
        """A header as a number; a hexadecimal one is the bits of a float."""
        text = self.headers.get(name, "").split(",")[0].strip()
        try:
            if text.lower().startswith("0x"):
                return struct.unpack("<f", int(text, 16).to_bytes(4, "little"))[0]
            return float(text)
        except (ValueError, OverflowError, struct.error):
            return default


def decode_blackbox(data: Bytes, part: Part = WHOLE) -> list[BlackboxLog]:
    """Decode all logs of a file that have main frames in a part of their time.

    Raises:
        ValueError: a header is torn.
    """
    starts = _places(data, MAGIC)
    logs = [_log(data[begin:end], part) for begin, end in zip(starts, [*starts[1:], len(data)], strict=True)]
    return [log for log in logs if log is not None and len(log.rows)]


def _places(data: Bytes, pattern: bytes) -> list[int]:
    """Where a pattern stands in a file, which is gone through block by block."""
    found: list[int] = []
    for first in range(0, len(data), _BLOCK):
        block = data[first : first + _BLOCK + len(pattern) - 1].tobytes()
        found += [first + match.start() for match in re.finditer(re.escape(pattern), block)]
        forget_pages(data)
    return found


def _log(data: Bytes, part: Part) -> BlackboxLog | None:
    headers, start = _headers(data[:_LONGEST_HEADER].tobytes())
    names = _listed(headers, "Field I name")
    if not names:
        return None
    if len(names) > _MOST_FIELDS:
        raise ValueError(f"{len(names)} fields in a frame")
    most = max(len(_listed(headers, f"Field {kind} name")) for kind in _KINDS)
    fields = np.zeros((3, len(_KINDS), most), np.int64)
    counts = np.zeros(len(_KINDS), np.int64)
    for row, kind in enumerate(_KINDS):
        counts[row] = len(names) if kind == "P" else len(_listed(headers, f"Field {kind} name"))
        for table, word in zip(fields, ("encoding", "predictor"), strict=False):
            values = _numbers(headers, f"Field {kind} {word}")
            if len(values) < counts[row]:
                raise ValueError(f"'Field {kind} {word}' has {len(values)} of {counts[row]} entries")
            table[row, : counts[row]] = values[: counts[row]]
    signed = _numbers(headers, "Field I signed") or [1] * len(names)
    if len(signed) < len(names):
        raise ValueError("'Field I signed' is too short")
    fields[2, :2, : len(names)] = signed[: len(names)]
    from groundstation.recording.blackboxkernel import decode_frames

    places = np.array([names.index(name) if name in names else -1 for name in ("motor[0]", "time")], np.int64)
    layout = (fields, counts, _constants(headers), _interval(headers), places)
    rows, damaged, ended = decode_frames(data, start, layout, part)
    return BlackboxLog(headers, names, rows, damaged, ended)


def _headers(data: bytes) -> tuple[dict[str, str], int]:
    """Headers by name, and where the frames begin."""
    headers: dict[str, str] = {}
    at = 0
    while data[at : at + 2] == b"H " and at < _LONGEST_HEADER:
        end = data.find(b"\n", at)
        if end < 0:
            raise ValueError("the header has no end")
        name, _, value = data[at + 2 : end].decode("utf-8", "replace").partition(":")
        headers[name.strip()] = value.strip()
        at = end + 1
    return headers, at


def _listed(headers: Mapping[str, str], name: str) -> tuple[str, ...]:
    return tuple(filter(None, headers.get(name, "").split(",")))


def _numbers(headers: Mapping[str, str], name: str) -> list[int]:
    return [int(value) for value in _listed(headers, name)]


def _constants(headers: Mapping[str, str]) -> NDArray[np.int64]:
    def first(name: str, default: int) -> int:
        match = re.match(r"\s*(-?\d+)", headers.get(name, ""))
        return int(match[1]) if match else default

    return np.array([first("minthrottle", 1150), first("vbatref", 4095), first("motorOutput", 0)], np.int64)


def _interval(headers: Mapping[str, str]) -> NDArray[np.int64]:
    every = max(int(headers.get("I interval", "32") or 32), 1)
    match = re.match(r"(\d+)(?:/(\d+))?", headers.get("P interval", "1/1"))
    if match is None:
        return np.array([every, 1, 1], np.int64)
    part, whole = (int(match[1]), int(match[2])) if match[2] else (1, int(match[1]))
    return np.array([every, max(part, 1), max(whole, 1)], np.int64)
