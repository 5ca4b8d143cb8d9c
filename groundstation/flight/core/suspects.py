"""The diagnosis of a flight while it flies, as the core sees it: a process that is asked every few seconds, and that
nothing waits for.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from pathlib import Path

import msgspec

from groundstation.flight import timeouts
from groundstation.flight.children import module_command, start_child
from groundstation.flight.messages import SuspectStatus


class Suspicion(msgspec.Struct, frozen=True):
    """A line of the process: what the first ``seconds`` of excitation let suspect."""

    seconds: float
    suspects: tuple[SuspectStatus, ...] = ()


class LiveSuspects:
    """Asks ``groundstation.analysis.suspects`` again as soon as it has answered and some seconds have passed.

    Args:
        folder: of the flight.
        on_found: called on a thread of its own with every answer.
    """

    def __init__(self, folder: Path, on_found: Callable[[Suspicion], None]):
        self._on_found = on_found
        command = module_command("groundstation.analysis.suspects", str(folder))
        self._child = start_child(command, folder / "suspects.log", piped=True)
        self._free, self._asked_s = threading.Event(), -math.inf
        self._free.set()
        threading.Thread(target=self._follow, name="suspects", daemon=True).start()

    def ask(self, now_s: float) -> None:
        """Ask, where it is time to; returns at once."""
        if self._free.is_set() and now_s - self._asked_s >= timeouts.SUSPECTS_EVERY_S:
            self._free.clear()
            self._asked_s = now_s
            self._child.tell("go")

    def stop(self) -> None:
        """End it, whatever it does."""
        self._child.kill()

    def _follow(self) -> None:
        for line in self._child.lines():
            try:
                found = msgspec.json.decode(line, type=Suspicion)
            except msgspec.DecodeError:
                continue  # a library's own output, which is none of ours
            self._on_found(found)
            self._free.set()
