"""The flight's own structured log: what was decided, when, on which figures; one JSON document per line."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from groundstation.errors import BadInput
from groundstation.json_types import JsonObject
from groundstation.outside import parse_json, read_bytes

NAME = "flight.log.jsonl"
ENDPOINT_FILE = "core.endpoint"
"""Where the flight's core listens and an operator's secret, for as long as it runs."""
WATCH_FILE = "watch.endpoint"
"""Beside it: what to give to somebody who may watch and abort."""
RAW_LOG = "raw.tlog"
"""What came over a MAVLink line and left on it, byte by byte."""


class Journal:
    """Appends to a file and flushes each line, so that a crash loses none. A disk that takes nothing ends no flight.

    Args:
        path: the file; its folder is made.
        clock: monotonic seconds.
    """

    def __init__(self, path: Path, clock: Callable[[], float]):
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a", encoding="utf-8")
        self._clock = clock

    def write(self, kind: str, text: str, **figures: Any) -> None:
        """One line: ``monotonic_s``, ``kind``, ``text`` and the figures it rests on."""
        line = {"monotonic_s": round(self._clock(), 6), "kind": kind, "text": text, **figures}
        with contextlib.suppress(OSError):  # the recording on the same disk fails as well, and that is told
            self._file.write(json.dumps(line, default=str) + "\n")
            self._file.flush()

    def close(self) -> None:
        """Close the file."""
        with contextlib.suppress(OSError):
            self._file.close()


def _is_line(entry: JsonObject) -> bool:
    """Whether a document has what every line has."""
    stamp = entry.get("monotonic_s")
    return isinstance(stamp, int | float) and all(isinstance(entry.get(key), str) for key in ("kind", "text"))


def read_journal(path: Path) -> list[JsonObject]:
    """The lines of a log; a last line that was cut off is left out."""
    entries = []
    for line in read_bytes(path, "a flight's log").decode("utf-8", "replace").split("\n"):
        try:
            entry = parse_json(line, str(path))
        except BadInput:
            break
        if not isinstance(entry, dict) or not _is_line(entry):
            break
        entries.append(entry)
    return entries
