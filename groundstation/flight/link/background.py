"""Slow things beside a thread that must not wait: publishing, writing the raw log."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable


class Writer:
    """A thread that does slow things in order: publishing, and writing the raw log."""

    def __init__(self, name: str, work: Callable[[object], None]):
        self._queue: queue.SimpleQueue[object] = queue.SimpleQueue()
        self._work = work
        self.failure = ""
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def put(self, item: object) -> None:
        """Hand over; returns at once."""
        self._queue.put(item)

    def close(self) -> None:
        """Do what is queued, but not for longer than a second."""
        self._queue.put(None)
        self._thread.join(1.0)

    def _run(self) -> None:
        while (item := self._queue.get()) is not None:
            try:
                self._work(item)
            except Exception as error:  # a broken disk or bus must not reach the thread that flies
                self.failure = self.failure or str(error)
