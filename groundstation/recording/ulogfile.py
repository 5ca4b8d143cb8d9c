"""PX4's ULog container (docs.px4.io, "ULog File Format"): topics by column, parameters with their times, losses.

A file is scanned once for the borders of its messages; a column is gathered when it is asked for. Damaged bytes are
skipped up to the next place from which messages follow each other, and counted.
"""

from __future__ import annotations

import itertools
import re
import struct
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.recording.part import WHOLE, Part
from groundstation.recording.settings import Settings, settings_of
from groundstation.recording.tables import Bytes, Table, forget_pages, gather

MAGIC = b"ULog\x01\x12\x35"
_HEADER = 16
_TYPES = {
    **{"int8_t": "<i1", "uint8_t": "<u1", "bool": "<u1", "char": "<u1", "int16_t": "<i2", "uint16_t": "<u2"},
    **{"int32_t": "<i4", "uint32_t": "<u4", "int64_t": "<i8", "uint64_t": "<u8", "float": "<f4", "double": "<f8"},
}
_DATA, _FLAGS, _FORMAT, _SUBSCRIBE, _PARAMETER, _INFO, _DROPOUT = map(ord, "DBFAPIO")
_DEEPEST = 8  # formats within formats; PX4 nests once
_MOST_FIELDS = 5000


@dataclass(frozen=True, slots=True)
class ULogFile:
    """What a file holds.

    Attributes:
        topics: (name, instance) to samples.
        settings: parameters with the times (seconds) from which each value held.
        info: key-value pairs.
        damaged: bytes that were skipped.
        missing: bytes by which the last message is longer than the file.
        dropouts_s: (time, duration) of what the logger itself lost.
    """

    topics: Mapping[tuple[str, int], Table]
    settings: Settings
    info: Mapping[str, str]
    damaged: int
    missing: int
    dropouts_s: tuple[tuple[float, float], ...]


def decode_ulog(data: Bytes, part: Part = WHOLE) -> ULogFile:
    """Decode a file.

    Args:
        data: the whole file (it may be a memory map).
        part: the samples that are wanted; settings and losses are those of the whole file.

    Raises:
        ValueError: its definitions are torn.
    """
    from groundstation.recording.kernels import CLOCK_ALONE, scan_ulog

    position, kind, damaged, missing = [], [], 0, 0
    for start, end in _segments(data):
        found, types, skipped, lacking = scan_ulog(data[:end], start, part)
        position.append(found)
        kind.append(types)
        damaged, missing = damaged + int(skipped), int(lacking)
    where, types = (part[0] if len(part) == 1 else np.concatenate(part) for part in (position, kind))
    position.clear()
    forget_pages(data)
    formats = dict(_format(data, at) for at in where[types == _FORMAT].tolist())
    topics, torn = _topics(data, where, types, formats)
    clock = _Clock(data, where[(types == _DATA) | (types == CLOCK_ALONE)])
    settings = settings_of(_parameters(data, where[types == _PARAMETER].tolist(), clock))
    lost = tuple((clock.before(at), _u16(data, at + 3) / 1000.0) for at in where[types == _DROPOUT].tolist())
    info = dict(filter(None, (_text_info(data, at) for at in where[types == _INFO].tolist())))
    return ULogFile(topics, settings, info, damaged + torn, missing, lost)


def _u16(data: Bytes, at: int) -> int:
    return int(data[at]) | int(data[at + 1]) << 8


def _segments(data: Bytes) -> list[tuple[int, int]]:
    """Stretches that each begin with a message: the file, and what was appended to it after a crash."""
    appended: list[int] = []
    if len(data) >= _HEADER + 43 and data[_HEADER + 2] == _FLAGS and data[_HEADER + 3 + 8] & 1:
        offsets = struct.unpack_from("<3Q", data[_HEADER + 3 + 16 : _HEADER + 3 + 40].tobytes())
        appended = sorted(offset for offset in offsets if _HEADER < offset < len(data))
    borders = [_HEADER, *appended, len(data)]
    return list(itertools.pairwise(borders))


class _Clock:
    """The log's time at a place of the file: that of the last sample before it."""

    def __init__(self, data: Bytes, where: NDArray[np.int64]):
        self._data, self._where = data, where

    def before(self, at: int) -> float:
        """Seconds; minus infinity before the first sample."""
        index = bisect_right(self._where, at) - 1
        if index < 0:
            return float("-inf")
        begin = int(self._where[index]) + 5
        return int.from_bytes(self._data[begin : begin + 8].tobytes(), "little") / 1e6


def _text(data: Bytes, begin: int, end: int) -> str:
    return data[begin:end].tobytes().decode("utf-8", "replace")


def _body(data: Bytes, at: int) -> tuple[int, int]:
    return at + 3, at + 3 + _u16(data, at)


def _format(data: Bytes, at: int) -> tuple[str, str]:
    name, _, fields = _text(data, *_body(data, at)).partition(":")
    return name, fields


def _parameters(data: Bytes, places: list[int], clock: _Clock) -> list[tuple[str, float, float]]:
    found = []
    for at in places:
        begin, end = _body(data, at)
        length = int(data[begin])
        kind, _, name = _text(data, begin + 1, begin + 1 + length).partition(" ")
        if kind in ("float", "int32_t") and end - begin - 1 - length >= 4:
            value = struct.unpack_from("<f" if kind == "float" else "<i", data[begin + 1 + length : end].tobytes())[0]
            found.append((name, clock.before(at), float(value)))
    return found


def _text_info(data: Bytes, at: int) -> tuple[str, str] | None:
    begin, end = _body(data, at)
    length = int(data[begin])
    kind, _, name = _text(data, begin + 1, begin + 1 + length).partition(" ")
    return (name, _text(data, begin + 1 + length, end).rstrip("\0")) if kind.startswith("char[") else None


def _topics(
    data: Bytes, where: NDArray[np.int64], types: Bytes, formats: Mapping[str, str]
) -> tuple[dict[tuple[str, int], Table], int]:
    """Samples of each subscribed topic, and the bytes of those that are torn."""
    samples = where[types == _DATA]
    ids, sizes = gather(data, samples, "<u2", 3), gather(data, samples, "<u2")
    order = np.argsort(ids, kind="stable")
    ids = ids[order]
    first = np.flatnonzero(np.diff(ids, prepend=~ids[:1]))  # where each topic's rows begin
    rows = dict(zip(ids[first].tolist(), np.split(order, first[1:]), strict=True))
    topics: dict[tuple[str, int], Table] = {}
    torn = 0
    for at in where[types == _SUBSCRIBE].tolist():
        begin, end = _body(data, at)
        instance, number, name = int(data[begin]), _u16(data, begin + 1), _text(data, begin + 3, end)
        mine = rows.pop(number, None)
        if mine is None or name not in formats:
            continue
        fields, size = _layout(name, formats)
        fitting = sizes[mine] >= size + 2
        torn += int(np.sum(sizes[mine][~fitting], dtype=np.int64)) + 3 * int(np.sum(~fitting))
        places = samples[mine] if fitting.all() else samples[mine[fitting]]
        places += 5
        topics[name, instance] = Table(name, instance, fields, data, places)
    lost = sum(int(np.sum(sizes[mine], dtype=np.int64)) + 3 * len(mine) for mine in rows.values())
    return topics, torn + lost


def _layout(name: str, formats: Mapping[str, str]) -> tuple[dict[str, tuple[int, str, float]], int]:
    """Offset and type of each field, arrays and nested formats written out, and the size of a sample."""
    fields: dict[str, tuple[int, str, float]] = {}
    items = [item for item in formats[name].split(";") if item]
    while items and items[-1].partition(" ")[2].startswith("_padding"):
        items.pop()  # padding at the end is not logged
    size = _place(items, "", 0, formats, fields, 0)
    return fields, size


def _place(
    items: list[str],
    prefix: str,
    at: int,
    formats: Mapping[str, str],
    fields: dict[str, tuple[int, str, float]],
    depth: int,
) -> int:
    """Lay out fields from a byte on; returns the byte after them."""
    for item in items:
        match = re.fullmatch(r"(\w+)(?:\[(\d+)\])? (\w+)", item.strip())
        if match is None or depth > _DEEPEST or len(fields) > _MOST_FIELDS:
            raise ValueError(f"the format '{item[:40]}' cannot be read")
        kind, count, name = match[1], match[2], match[3]
        for index in range(int(count or 1)):
            label = f"{prefix}{name}[{index}]" if count else prefix + name
            if kind in _TYPES:
                fields[label] = (at, _TYPES[kind], 1.0)
                at += np.dtype(_TYPES[kind]).itemsize
            elif kind in formats:
                inner = [part for part in formats[kind].split(";") if part]
                at = _place(inner, f"{label}.", at, formats, fields, depth + 1)
            else:
                raise ValueError(f"the format '{kind[:40]}' is not defined")
            if len(fields) > _MOST_FIELDS:
                raise ValueError(f"the format of '{name[:40]}' has too many fields")
    return at
