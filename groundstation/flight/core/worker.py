"""The worker that analyses a flight after landing, as the core sees it: started early, told to go, followed to its
end.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from pathlib import Path

import msgspec

from groundstation.flight.children import module_command, start_child


class Progress(msgspec.Struct, frozen=True):
    """A line of the worker: how far it is, in words, and the estimates it has (null: not told)."""

    progress: float
    text: str = ""
    table: dict[str, tuple[float | None, float | None, float | None, float | None]] = {}

    def numbers(self) -> dict[str, tuple[float, float, float, float]]:
        """The table with NaN for what is not told."""

        def number(value: float | None) -> float:
            return math.nan if value is None else value

        return {name: (number(a), number(b), number(c), number(d)) for name, (a, b, c, d) in self.table.items()}


class AnalysisWorker:
    """Starts ``groundstation.analysis.analyse`` on a flight's folder; it imports and then waits for :meth:`go`.

    Args:
        folder: of the flight.
        on_progress: called on a thread of its own with every line.
        on_end: called there once, with the exit status and the last words.
    """

    def __init__(self, folder: Path, on_progress: Callable[[Progress], None], on_end: Callable[[int, str], None]):
        self._on_progress, self._on_end = on_progress, on_end
        command = module_command("groundstation.analysis.analyse", str(folder))
        self._child = start_child(command, folder / "analysis.log", piped=True)

    def go(self) -> None:
        """The recording is closed: begin."""
        self._child.tell("go")
        threading.Thread(target=self._follow, name="analysis", daemon=True).start()

    def stop(self) -> None:
        """End it, whatever it does."""
        self._child.stop()

    def _follow(self) -> None:
        last = Progress(0.0)
        for line in self._child.lines():
            try:
                last = msgspec.json.decode(line, type=Progress)
            except msgspec.DecodeError:
                continue  # a library's own output, which is none of ours
            self._on_progress(last)
        status = self._child.wait()
        self._on_end(status, last.text if status in (0, 2, 3) else "the analysis failed; see analysis.log")
