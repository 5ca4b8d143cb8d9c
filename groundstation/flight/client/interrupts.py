"""Ctrl-C (and SIGTERM) of a command that flies: from its first line on nothing is lost, whoever swallows the exception.

A solver written in C may take KeyboardInterrupt for its own and go on; the word stays here, and is asked for before
each further step. Once the core runs, the signal is an order to it: before arming nothing is ever armed, afterwards it
lands.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from groundstation.errors import FlightAborted

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
STOPPED = "stopped before anything was armed."


class Interrupts:
    """Takes the signals while it is active.

    Attributes:
        asked: the operator wants it to end.
    """

    def __init__(self) -> None:
        self.asked = False
        self._order: Callable[[], None] | None = None
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._take) for number in _SIGNALS}
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        if kind is KeyboardInterrupt:
            raise FlightAborted(STOPPED) from None

    def check(self) -> None:
        """Go on only if nobody wants it to end.

        Raises:
            FlightAborted: somebody does; nothing was armed.
        """
        if self.asked:
            raise FlightAborted(STOPPED)

    @contextmanager
    def ordering(self, order: Callable[[], None]) -> Iterator[None]:
        """While a core runs the signal is an order to it, and raises nothing; one that came before is given at once."""
        before, self._order = self._order, order
        try:
            if self.asked:
                order()
            yield
        finally:
            self._order = before

    @contextmanager
    def raising(self) -> Iterator[None]:
        """While somebody is waited for, the signal ends the waiting (KeyboardInterrupt) once its order is given."""

        def raise_too() -> None:
            if order is not None:
                order()
            raise KeyboardInterrupt

        order = self._order
        with self.ordering(raise_too):
            yield

    def _take(self, _number: int, _frame: FrameType | None) -> None:
        self.asked = True
        if self._order is None:
            raise KeyboardInterrupt
        self._order()
