"""The operator's lease: of any number of clients one may start and land; everyone may abort."""

from __future__ import annotations

import threading

from groundstation.flight.messages import CLIENT_ALIVE, Lease, LeaseAnswer


class OperatorLease:
    """Who holds the lease. Its methods may be called from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.holder = ""

    def request(self, request: Lease) -> LeaseAnswer:
        """Take or give back; ``force`` takes it from another."""
        with self._lock:
            free = self.holder in ("", request.client)
            if request.take and (free or request.force):
                self.holder = request.client
            elif not request.take and free:
                self.holder = ""
            held = self.holder == request.client
            ok = held if request.take else not held
            return LeaseAnswer(ok, self.holder, "" if ok else f"client {self.holder} holds the lease")

    def client_alive(self, key: str, is_alive: bool) -> None:
        """A client's liveliness token came or went; with its holder the lease is free."""
        with self._lock:
            if not is_alive and self.holder and key == CLIENT_ALIVE.format(client=self.holder):
                self.holder = ""

    def refusal(self, client: str, order: str) -> str:
        """Why this client may not give an order that needs the lease; empty when it may."""
        if client == self.holder:
            return ""
        held = f"client {self.holder} holds it" if self.holder else "nobody holds it"
        return f"'{order}' needs the operator's lease; {held}."
