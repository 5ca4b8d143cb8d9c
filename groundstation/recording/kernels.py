"""Compiled scans of binary logs. Import where they are used: numba takes a third of a second to load."""

from __future__ import annotations

import numpy as np
from numba import njit

_KINDS = np.zeros(256, np.bool_)
_KINDS[np.frombuffer(b"BFIMPQALCDSOR", np.uint8)] = True


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
def _scan_ulog(data, start, known, count_only, where, kinds):
    size, at, found, skipped, missing = len(data), start, 0, 0, 0
    while at + 3 <= size:
        length = np.int64(data[at]) | np.int64(data[at + 1]) << 8
        if not known[data[at + 2]] or length == 0 or (data[at + 2] == 0x44 and length < 10):
            skipped += 1
            at += 1
            while at + 3 <= size and not _chain(data, at, known, 6):
                at += 1
                skipped += 1
            continue
        if at + 3 + length > size:
            missing = at + 3 + length - size
            break
        if not count_only:
            where[found] = at
            kinds[found] = data[at + 2]
        found += 1
        at += 3 + length
    if missing == 0 and at < size:
        missing = 3 - (size - at)
    return found, skipped, missing


def scan_ulog(data, start):
    """Borders of a ULog's messages from a byte on.

    Returns:
        where each begins (k,), its type (k,), bytes skipped as damaged, bytes the last one lacks.
    """
    nothing = np.empty(0, np.int64), np.empty(0, np.uint8)
    count, _, _ = _scan_ulog(data, start, _KINDS, True, *nothing)
    where, kinds = np.empty(count, np.int64), np.empty(count, np.uint8)
    _, skipped, missing = _scan_ulog(data, start, _KINDS, False, where, kinds)
    return where, kinds, skipped, missing


@njit(cache=True)
def _scan_dataflash(data, sizes, count_only, where, kinds):
    size, at, found, skipped, missing = len(data), 0, 0, 0, 0
    while at + 3 <= size:
        if data[at] == 0xA3 and data[at + 1] == 0x95:
            kind = data[at + 2]
            if kind == 128 and at + 89 <= size:
                sizes[data[at + 3]] = data[at + 4]
            length = sizes[kind]
            if length >= 3:
                if at + length > size:
                    missing = at + length - size
                    break
                after = at + length
                follows = after + 2 > size or (data[after] == 0xA3 and data[after + 1] == 0x95)
                if follows or kind == 128:
                    if not count_only:
                        where[found] = at
                        kinds[found] = kind
                    found += 1
                    at = after
                    continue
        at += 1
        skipped += 1
    return found, skipped, missing


def scan_dataflash(data):
    """Borders of a DataFlash log's records. A record counts where another follows it, so that stray marks do not.

    Returns:
        where each begins (k,), its type (k,), bytes skipped as damaged, bytes the last one lacks.
    """
    sizes = np.zeros(256, np.int64)
    sizes[128] = 89
    nothing = np.empty(0, np.int64), np.empty(0, np.uint8)
    count, _, _ = _scan_dataflash(data, sizes.copy(), True, *nothing)
    where, kinds = np.empty(count, np.int64), np.empty(count, np.uint8)
    _, skipped, missing = _scan_dataflash(data, sizes.copy(), False, where, kinds)
    return where, kinds, skipped, missing
