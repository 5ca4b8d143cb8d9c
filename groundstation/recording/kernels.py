"""Compiled scans of binary logs. Import where they are used: numba takes a third of a second to load.

A scan goes through the file block by block and gives back the pages of each, so that what it takes is the places of the
records that are kept. It goes through twice: once to count them, once to note them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

from groundstation.recording.part import WHOLE, Part
from groundstation.recording.tables import Bytes, forget_pages

Places = NDArray[np.int64]

CLOCK_ALONE = 1
"""Kind of a ULog sample outside the part that is kept for its stamp: a parameter or a dropout follows it."""

_KINDS = np.zeros(256, np.bool_)
_KINDS[np.frombuffer(b"BFIMPQALCDSOR", np.uint8)] = True
_BLOCK = 1 << 24


@njit(cache=True)
def _number(data, at, size):
    value = np.int64(0)
    for byte in range(size):
        value |= np.int64(data[at + byte]) << 8 * byte
    return value


@njit(cache=True)
def _kept(stamp, which, limits, last):
    """Whether a record is of the part: within its stretch, and a step from the one of its kind that was kept last."""
    if stamp < limits[0] or stamp > limits[1]:
        return False
    if limits[2] > 0:
        if last[which] >= 0 and abs(stamp - last[which]) < limits[2]:
            return False
        last[which] = stamp
    return True


@njit(cache=True)
def _chain(data, at, known, links):
    """Whether that many messages follow each other from a place, or as many as the file still holds."""
    size = len(data)
    for _ in range(links):
        if at + 3 > size:
            return True
        length = data[at] | data[at + 1] << 8
        if length == 0 or not known[data[at + 2]]:
            return False
        at += 3 + length
    return True


@njit(cache=True)
def _scan_ulog(data, stop, limits, last, known, state, where, kinds):
    """Go on from ``state`` (place, records kept, bytes skipped, bytes missing, sample not kept) up to a byte."""
    size, at, found, skipped, before = len(data), state[0], state[1], state[2], state[4]
    noting = len(where) > 0
    while at + 3 <= size and at < stop:
        length = np.int64(data[at]) | np.int64(data[at + 1]) << 8
        kind = data[at + 2]
        if not known[kind] or length == 0 or (kind == 0x44 and length < 10):
            skipped += 1
            at += 1
            while at + 3 <= size and not _chain(data, at, known, 6):
                at += 1
                skipped += 1
            continue
        if at + 3 + length > size:
            state[3] = at + 3 + length - size
            break
        keep = True
        if kind == 0x44:
            keep = _kept(_number(data, at + 5, 8), np.int64(data[at + 3]) | np.int64(data[at + 4]) << 8, limits, last)
            before = -1 if keep else at
        elif before >= 0 and (kind == 0x50 or kind == 0x4F):
            if noting:
                where[found], kinds[found] = before, 1
            found, before = found + 1, -1
        if keep:
            if noting:
                where[found], kinds[found] = at, kind
            found += 1
        at += 3 + length
    state[0], state[1], state[2], state[4] = at, found, skipped, before


def scan_ulog(data: Bytes, start: int, part: Part = WHOLE) -> tuple[Places, Bytes, int, int]:
    """Borders of a ULog's messages from a byte on, samples as far as they are of the part.

    Returns:
        where each begins (k,), its type (k,), bytes skipped as damaged, bytes the last one lacks.
    """
    limits = part.ticks(1e6)
    where, kinds, state = _twice(
        data,
        start,
        lambda stop, state, where, kinds, last: _scan_ulog(data, stop, limits, last, _KINDS, state, where, kinds),
    )
    skipped, missing = int(state[2]), int(state[3])
    if missing == 0 and state[0] < len(data):
        missing = 3 - (len(data) - int(state[0]))
    return where, kinds, skipped, missing


_Scan = Callable[[int, Places, Places, Bytes, Places], None]


def _twice(data: Bytes, start: int, scan: _Scan) -> tuple[Places, Bytes, Places]:
    """Count, then note; places, kinds and the last state (place, found, skipped, missing, sample not kept)."""
    where, kinds = np.empty(0, np.int64), np.empty(0, np.uint8)
    state = np.empty(0, np.int64)
    for _ in range(2):
        state, last = np.array([start, 0, 0, 0, -1]), np.full(1 << 16, -1, np.int64)
        for stop in range(start + _BLOCK, len(data) + _BLOCK, _BLOCK):
            scan(stop, state, where, kinds, last)
            if len(data) > _BLOCK:
                forget_pages(data)
        if len(where) or not state[1]:
            break
        where, kinds = np.empty(state[1], np.int64), np.empty(state[1], np.uint8)
    return where, kinds, state


@njit(cache=True)
def _clock_of(data, at):
    """How a FMT record says that its records begin: 1 with microseconds, 2 with milliseconds, 4 more with an instance.

    0 of records that are kept whatever their time: those without, parameters (PARM) and messages (MSG).
    """
    name, label, clock = at + 5, at + 25, 0
    if data[name] == 0x50 and data[name + 1] == 0x41 and data[name + 2] == 0x52 and data[name + 3] == 0x4D:
        return 0
    if data[name] == 0x4D and data[name + 1] == 0x53 and data[name + 2] == 0x47 and data[name + 3] == 0:
        return 0
    if data[label] == 0x54 and data[label + 1] == 0x69 and data[label + 2] == 0x6D and data[label + 3] == 0x65:
        if data[label + 4] == 0x55 and data[at + 9] == 0x51:  # TimeUS, Q
            clock = 1
        elif data[label + 4] == 0x4D and data[at + 9] == 0x49:  # TimeMS, I
            clock = 2
    return clock + 4 if clock and data[at + 10] == 0x42 else clock


@njit(cache=True)
def _scan_dataflash(data, stop, limits, last, sizes, clocks, state, where, kinds):
    """Go on from ``state`` (place, records kept, bytes skipped, bytes missing) up to a byte."""
    size, at, found, skipped = len(data), state[0], state[1], state[2]
    noting = len(where) > 0
    while at + 3 <= size and at < stop and state[3] == 0:
        if data[at] == 0xA3 and data[at + 1] == 0x95:
            kind = data[at + 2]
            if kind == 128 and at + 89 <= size:
                sizes[data[at + 3]] = data[at + 4]
                clocks[data[at + 3]] = _clock_of(data, at)
            length = sizes[kind]
            if length >= 3:
                if at + length > size:
                    state[3] = at + length - size
                    break
                after = at + length
                follows = after + 2 > size or (data[after] == 0xA3 and data[after + 1] == 0x95)
                if follows or kind == 128:
                    keep, clock = True, clocks[kind]
                    if clock & 3 == 1 and length >= 12:
                        which = np.int64(kind) << 8 | (data[at + 11] if clock & 4 else 0)
                        keep = _kept(_number(data, at + 3, 8), which, limits, last)
                    elif clock & 3 == 2 and length >= 8:
                        which = np.int64(kind) << 8 | (data[at + 7] if clock & 4 else 0)
                        keep = _kept(1000 * _number(data, at + 3, 4), which, limits, last)
                    if keep:
                        if noting:
                            where[found], kinds[found] = at, kind
                        found += 1
                    at = after
                    continue
        at += 1
        skipped += 1
    state[0], state[1], state[2] = at, found, skipped


def scan_dataflash(data: Bytes, part: Part = WHOLE) -> tuple[Places, Bytes, int, int]:
    """Borders of a DataFlash log's records, of those with a stamp as far as they are of the part, parameters all.

    A record counts where another follows it, so that stray marks do not.

    Returns:
        where each begins (k,), its type (k,), bytes skipped as damaged, bytes the last one lacks.
    """
    limits = part.ticks(1e6)
    sizes, clocks = np.zeros(256, np.int64), np.zeros(256, np.int64)

    def scan(stop: int, state: Places, where: Places, kinds: Bytes, last: Places) -> None:
        if state[0] == 0:
            sizes[:], clocks[:], sizes[128] = 0, 0, 89
        _scan_dataflash(data, stop, limits, last, sizes, clocks, state, where, kinds)

    where, kinds, state = _twice(data, 0, scan)
    return where, kinds, int(state[2]), int(state[3])
