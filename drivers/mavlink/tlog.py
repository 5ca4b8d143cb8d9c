"""Telemetry logs: eight bytes of big-endian Unix microseconds before each frame, the form every MAVLink tool reads."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from drivers.mavlink.framing import V1, V2

_STAMP = struct.Struct(">Q")


def record(unix_s: float, frame: bytes) -> bytes:
    """One entry."""
    return _STAMP.pack(int(unix_s * 1e6)) + frame


def entries(data: bytes) -> Iterator[tuple[float, bytes]]:
    """(Unix time, bytes) per entry.

    Bytes that are no frame (recorders keep noise too) come as they stand; a cut end is left out.
    """
    at = 0
    while at + 8 < len(data):
        stamp = _STAMP.unpack_from(data, at)[0] * 1e-6
        begin = at + 8
        size = _size(data, begin)
        if size is None:
            return
        at = begin + size
        yield stamp, data[begin:at]


def _size(data: bytes, begin: int) -> int | None:
    if data[begin] == V2 and begin + 3 <= len(data):
        size = data[begin + 1] + 12 + (13 if data[begin + 2] & 1 else 0)
    elif data[begin] == V1 and begin + 2 <= len(data):
        size = data[begin + 1] + 8
    else:
        size = _noise(data, begin)
    return size if begin + size <= len(data) else None


def _noise(data: bytes, begin: int) -> int:
    """Bytes up to the next entry, known by a start marker that follows a stamp sharing the two top bytes of this
    one's.
    """
    top = data[begin - 8 : begin - 5]
    at = begin + 1
    while at + 9 <= len(data):
        if data[at : at + 3] == top and data[at + 8] in (V1, V2):
            return at - begin
        at += 1
    return len(data) - begin
