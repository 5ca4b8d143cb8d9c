"""Whether the clock that stamped a bag's messages was set back while it was recorded.

A bag is read in the order of its stamps, so that messages of two times with the same stamps come out interleaved: one
stream at twice its rate, of which no sample follows the one before. The order in the file tells them apart.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.recording.container import MAGIC, indexed_times
from groundstation.recording.one_clock import BESIDE, MOST_STEPS, pieces_of

Stamps = NDArray[np.int64]

_AT_ONCE = 1 << 14
"""Stamps of a topic that are looked at together: those of a long bag are more than the part of it that is used."""


def require_steady_clock(path: Path) -> None:
    """Refuse a bag whose clock was set back.

    Args:
        path: of a bag that was opened already; a file of another store is passed over.

    Raises:
        BadInput: says by how much, and when.
    """
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        for clock in _clocks(file):
            if back := clock.back():
                before, after = back[0]
                raise BadInput(
                    f"{path}: the clock of the computer that recorded it was set back by {before - after:.3g} s, "
                    f"{before:.2f} s into {file.name}, so that messages of two times have the same stamps. Cut the bag "
                    "there (`ros2 bag convert` with an end time), or record it again."
                )


@dataclass(slots=True)
class _Clock:
    """The steps of one topic's stamps, found as they come.

    A step shows in the samples on both sides of it, so that the last ones are kept for those that follow.
    """

    origin_ns: int
    steps: list[tuple[float, float]] = field(default_factory=list)
    _waiting: list[Stamps] = field(default_factory=list)
    _count: int = 0

    def add(self, stamps: Stamps) -> None:
        self._waiting.append(stamps)
        self._count += len(stamps)
        if self._count >= _AT_ONCE:
            self._settle()

    def back(self) -> list[tuple[float, float]]:
        """Seconds from the first stamp before and after each step back; none where the stamps step all the time."""
        self._settle()
        return [step for step in self.steps if step[1] < step[0]] if len(self.steps) <= MOST_STEPS else []

    def _settle(self) -> None:
        stamps = np.concatenate(self._waiting)
        t_s = 1e-9 * (stamps - self.origin_ns).astype(float)
        steps = [at for at, _ in pieces_of(t_s, most=len(t_s))[1:]]
        self.steps += zip(t_s[np.array(steps, int) - 1].tolist(), t_s[np.array(steps, int)].tolist(), strict=True)
        self._waiting = [stamps[-(2 * BESIDE - 1) :]]
        self._count = 0


def _clocks(file: Path) -> list[_Clock]:
    """One for each topic of a file; none of a file that does not tell."""
    found: dict[int, _Clock] = {}
    try:
        for topic, stamps in _stamps(file):
            if len(stamps):
                found.setdefault(topic, _Clock(int(stamps[0]))).add(stamps)
    except (OSError, ValueError, TypeError, OverflowError, MemoryError, sqlite3.Error):
        return []  # whoever reads it says what is wrong with it
    return list(found.values())


def _stamps(file: Path) -> Iterator[tuple[int, Stamps]]:
    """Topic by topic nanoseconds of messages in the file's order, some at a time."""
    if file.suffix == ".mcap":
        with file.open("rb") as opened:
            if opened.read(len(MAGIC)) == MAGIC:
                yield from indexed_times(opened)
    if file.suffix == ".db3":
        yield from _of_sqlite(file)


def _of_sqlite(file: Path) -> Iterator[tuple[int, Stamps]]:
    with closing(sqlite3.connect(f"{file.resolve().as_uri()}?immutable=1", uri=True)) as base:
        cursor = base.execute("SELECT topic_id, timestamp FROM messages ORDER BY id")
        while some := cursor.fetchmany(_AT_ONCE):
            rows = np.fromiter(some, np.dtype((np.int64, 2)), len(some))
            for topic in np.unique(rows[:, 0]).tolist():
                yield topic, rows[rows[:, 0] == topic, 1]
