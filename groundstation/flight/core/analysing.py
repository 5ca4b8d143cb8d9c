"""What the core has analysed: suspects while it flies, everything after landing, each in a process of its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from groundstation.flight import sequence as seq
from groundstation.flight.core.overview import FlightView
from groundstation.flight.core.settings import Settings
from groundstation.flight.core.suspects import LiveSuspects, Suspicion
from groundstation.flight.core.worker import AnalysisWorker, Progress
from groundstation.flight.journal import Journal


class Core(Protocol):
    """Whose flight it is; called on the main thread only."""

    settings: Settings
    view: FlightView
    journal: Journal
    digested_s: float

    def event(self, event: seq.Event) -> None:
        """Take an event into the sequence."""
        ...

    def tell(self, kind: str, text: str, **figures: Any) -> None:
        """One line in the flight's log and for the clients."""
        ...


class FlightAnalysis:
    """Starts, asks and ends the processes that analyse one flight.

    Args:
        core: whose flight it is, by way of ``later``, which runs a function on the main thread.
    """

    def __init__(self, core: Core, later: Callable[[Callable[[], None]], None]) -> None:
        self._core, self._later = core, later
        self._worker: AnalysisWorker | None = None
        self._suspects: LiveSuspects | None = None

    def watch(self, phase: seq.Phase, now_s: float, *, lock_step: bool) -> None:
        """A flight at the wall clock's pace is diagnosed while it flies; a simulated one is over before that would tell
        anything.

        In the hover before the excitation its declarations are checked, which no effect can be told behind.
        """
        if phase in (seq.Phase.AIRBORNE, seq.Phase.EXCITING) and not lock_step and self._core.settings.analyse:
            if self._suspects is None:
                self._suspects = LiveSuspects(
                    self._core.settings.folder, lambda found: self._later(lambda: self._suspected(found))
                )
            self._suspects.ask(now_s)
        elif self._suspects is not None:
            self._suspects.stop()

    def _suspected(self, found: Suspicion) -> None:
        view = self._core.view
        view.suspects, view.suspects_s = found.suspects, found.seconds
        if found.suspects:
            likely = ", ".join(f"{s.effect} {s.odds:.0f}:1" for s in found.suspects)
            self._core.tell("suspects", f"likely after {found.seconds:.0f} s of excitation: {likely}")

    def prepare(self) -> None:
        """Start the worker during the flight, so that it is warm at landing."""
        if self._core.settings.analyse:
            self._worker = AnalysisWorker(
                self._core.settings.folder,
                on_progress=lambda message: self._later(lambda: self._on_progress(message)),
                on_end=lambda status, text: self._later(lambda: self._core.event(seq.AnalysisFinished(status, text))),
            )

    def begin(self) -> bool:
        """The recording is closed; False where no analysis was asked for."""
        if self._worker is None:
            return False
        self._worker.go()
        return True

    def _on_progress(self, message: Progress) -> None:
        core = self._core
        core.view.progress, core.view.text = message.progress, message.text
        if message.table:
            core.view.table = message.numbers()
            core.journal.write("estimates", message.text, host_s=core.digested_s, table=message.table)

    def stop(self) -> None:
        """End what still runs."""
        if self._worker is not None:
            self._worker.stop()
        if self._suspects is not None:
            self._suspects.stop()
