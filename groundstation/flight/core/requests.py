"""What the core asks of the vehicle's process: each request waits for its answer on a thread, never on the main one."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Protocol

import zenoh

from drivers import bus
from groundstation.flight import sequence as seq


class Core(Protocol):
    """What answers go to; called on the main thread only."""

    def event(self, event: seq.Event) -> None:
        """Take an event into the sequence."""
        ...

    def tell(self, kind: str, text: str, **figures: str) -> None:
        """One line in the flight's log and for the clients."""
        ...

    def described(self, description: bus.Description) -> None:
        """The vehicle said what it is."""
        ...

    def abort_answered(self) -> None:
        """An abort was answered, even if it was refused: there may be nothing to abort, which the status shows."""
        ...


class Requests:
    """Asks the vehicle. Requests run two at a time; rotors off has a thread of its own, so that it waits for no other
    answer.

    Args:
        session, keys: how the vehicle is reached.
        core: what answers go to, by way of ``later``, which runs a function on the main thread.
        aborting: whether the flight is being ended; may be asked from any thread.
    """

    def __init__(
        self,
        session: zenoh.Session,
        keys: bus.DroneKeys,
        core: Core,
        later: Callable[[Callable[[], None]], None],
        aborting: Callable[[], bool],
    ) -> None:
        self._session, self._keys, self._core = session, keys, core
        self._later, self._aborting = later, aborting
        self._orders = ThreadPoolExecutor(2, thread_name_prefix="orders")
        self._kill = ThreadPoolExecutor(1, thread_name_prefix="kill")

    def describe(self) -> None:
        """Ask what the vehicle is."""

        def ask() -> None:
            description = bus.ask(self._session, self._keys.describe, bus.Describe(), bus.Description)
            self._later(lambda: self._core.described(description))

        self._run(self._orders, ask)

    def upload(self, plan: Path) -> None:
        """Send the plan."""

        def ask() -> None:
            answer = bus.ask(self._session, self._keys.upload, bus.make_upload(plan.read_bytes()))
            if answer.ok and answer.reason:
                self._later(lambda: self._core.tell("upload", answer.reason))
            self._happened(seq.UploadAnswered(answer.ok, answer.reason))

        self._run(self._orders, ask)

    def start(self) -> None:
        """Arm and start, unless the flight is aborted meanwhile; an order that left before the abort is taken back."""

        def ask() -> None:
            for name in ("arm", "start"):
                if self._aborting() or not self._command(name):
                    break
            if self._aborting():
                self._command("abort")

        self._run(self._orders, ask)

    def command(self, name: bus.CommandName) -> None:
        """Give one order."""
        self._run(self._kill if name == "kill" else self._orders, lambda: self._command(name))

    def change_length(self, order: bus.CommandName, answered: Callable[[bool], None]) -> None:
        """Ask for an earlier or a later end of the excitation; ``answered`` is told whether the vehicle agreed."""

        def ask() -> None:
            ok = self._command(order)
            self._later(lambda: answered(ok))

        self._run(self._orders, ask)

    def close(self) -> None:
        """Once everything asked was answered."""
        for pool in (self._orders, self._kill):
            pool.shutdown(wait=True)

    def _command(self, name: bus.CommandName) -> bool:
        answer = bus.ask(self._session, self._keys.command, bus.Command(name))
        if not answer.ok:
            reason = answer.reason
            self._later(lambda: self._core.tell("refused", f"the vehicle refused '{name}'", reason=reason))
            if name in ("arm", "start"):
                self._happened(seq.StartRefused(reason))
            elif name == "kill":
                self._happened(seq.AbortRequested(f"the vehicle refused to stop its rotors: {reason}"))
        if name == "abort":
            self._later(self._core.abort_answered)
        return answer.ok

    def _happened(self, event: seq.Event) -> None:
        self._later(lambda: self._core.event(event))

    def _run(self, pool: ThreadPoolExecutor, job: Callable[[], object]) -> None:
        def guarded() -> None:
            try:
                job()
            except (ConnectionError, ValueError) as error:
                self._happened(seq.AbortRequested(str(error)))

        pool.submit(guarded)
