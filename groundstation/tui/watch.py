"""Follows one core over the bus on a thread of its own and gives it orders.

Frames may be dropped, samples never pass.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from drivers.access import Access
from drivers.bus import Answer
from groundstation.flight.client.client import CoreClient, connect
from groundstation.flight.messages import CommandName, CoreStatus, LeaseAnswer
from groundstation.flight.sequence import FINAL

HISTORY = 1200
"""Statuses kept for the live plots: two minutes at ten a second."""
CONNECT_S = 15.0
"""How long a core may take to come up."""
SILENT_S = 3.0
"""Wall time without a status after which the core is said to be silent."""


class Client(Protocol):
    """What gives orders: a client of a core, or of a station's gate."""

    name: str

    def command(self, name: CommandName, timeout_s: float = 5.0) -> Answer:
        """Give an order."""
        ...

    def take_lease(self, *, force: bool = False) -> LeaseAnswer:
        """Become the operator."""
        ...


class CoreWatch:
    """A client of a core. Its attributes may be read from any thread.

    Args:
        endpoint: of the core, and as whom to connect.
        folder: of the flight.
        clock: monotonic seconds.

    Attributes:
        newest: the last status; None before the first.
        history: the last statuses, oldest first.
        fault: why nothing more will come; empty while the core is followed, and after a flight that ended.
        place: name of the station, where it is another machine's.
        may_operate: this client may take the lease.
    """

    def __init__(self, endpoint: Access, folder: Path, clock: Callable[[], float] = time.monotonic):
        self.endpoint, self.folder = endpoint, folder
        self.name, self.place, self.fault, self.may_operate = "", "", "", True
        self.newest: CoreStatus | None = None
        self.history: deque[CoreStatus] = deque(maxlen=HISTORY)
        self._clock, self._heard_s = clock, clock()
        self._client: Client | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="core-watch", daemon=True)
        self._thread.start()

    @property
    def silent_s(self) -> float:
        """Wall time since the last status, once that is long enough to be worth a word and the flight has not ended."""
        quiet = self._clock() - self._heard_s
        return quiet if quiet > SILENT_S and self.following and self.newest is not None else 0.0

    @property
    def following(self) -> bool:
        """The core is being followed: it has not ended its flight."""
        return self._thread.is_alive()

    @property
    def operator(self) -> bool:
        """This client holds the lease, as far as the core says."""
        return self.newest is not None and self.newest.lease == self.name

    def order(self, name: CommandName) -> str:
        """Give an order; returns why it was not taken, empty when it was. Waits for the answer: call it on a thread."""
        if self._client is None:
            return self.fault or "the core has not answered yet; try again in a moment."
        try:
            answer = self._client.command(name)
        except ConnectionError as error:
            return f"the core does not answer: {error}"
        return "" if answer.ok else answer.reason

    def take_lease(self) -> str:
        """Become the operator even if another is; returns why not, empty when this client is."""
        if self._client is None:
            return "the core has not answered yet; try again in a moment."
        try:
            answer = self._client.take_lease(force=True)
        except ConnectionError as error:
            return f"the core does not answer: {error}"
        return "" if answer.ok else answer.reason

    def stop(self) -> None:
        """Stop following. The flight goes on."""
        self._stop.set()
        self._thread.join(5.0)

    def _run(self) -> None:
        try:
            with connect(self.endpoint, timeout_s=CONNECT_S) as client:
                self._client, self.name = client, client.name
                client.take_lease()
                self._follow(client)
        except ConnectionError as error:
            self.fault = f"no core answers at {self.endpoint} ({error}); see core.log in {self.folder}."
        finally:
            self._client = None

    def _follow(self, client: CoreClient) -> None:
        while not self._stop.is_set():
            status = client.status(0.2)
            if status is None:
                continue
            self._take(status)
            if status.phase in FINAL:
                return

    def _take(self, status: CoreStatus) -> None:
        self._heard_s = self._clock()
        self.newest = status
        self.history.append(status)
