"""Whether the clock that stamped a bag's messages was set back while it was recorded.

A bag is read in the order of its stamps, so that messages of two times with the same stamps come out interleaved: one
stream at twice its rate, of which no sample follows the one before. The order in the file tells them apart.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.recording.container import MAGIC, indexed_times
from groundstation.recording.one_clock import pieces_of


def require_steady_clock(path: Path) -> None:
    """Refuse a bag whose clock was set back.

    Args:
        path: of a bag that was opened already; a file of another store is passed over.

    Raises:
        BadInput: says by how much, and when.
    """
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        for stamps in _stamps(file).values():
            t_s = 1e-9 * (stamps - stamps[0]).astype(float)
            back = [at for at, _ in pieces_of(t_s)[1:] if t_s[at] < t_s[at - 1]]
            if back:
                raise BadInput(
                    f"{path}: the clock of the computer that recorded it was set back by "
                    f"{t_s[back[0] - 1] - t_s[back[0]]:.3g} s, {t_s[back[0] - 1]:.2f} s into {file.name}, so that "
                    "messages of two times have the same stamps. Cut the bag there (`ros2 bag convert` with an end "
                    "time), or record it again."
                )


def _stamps(file: Path) -> Mapping[int, NDArray[np.int64]]:
    """Nanoseconds of the messages of each topic in the file's order; empty of what does not tell."""
    try:
        if file.suffix == ".mcap":
            with file.open("rb") as opened:
                return indexed_times(opened) if opened.read(len(MAGIC)) == MAGIC else {}
        if file.suffix == ".db3":
            return _of_sqlite(file)
    except (OSError, ValueError, TypeError, OverflowError, MemoryError, sqlite3.Error):
        pass  # whoever reads it says what is wrong with it
    return {}


def _of_sqlite(file: Path) -> dict[int, NDArray[np.int64]]:
    with closing(sqlite3.connect(f"{file.resolve().as_uri()}?immutable=1", uri=True)) as base:
        rows = np.fromiter(
            base.execute("SELECT topic_id, timestamp FROM messages ORDER BY id"), np.dtype((np.int64, 2))
        )
    return {topic: rows[rows[:, 0] == topic, 1] for topic in np.unique(rows[:, 0]).tolist()} if len(rows) else {}
