"""What the core takes of its clients' orders: from whom, each once, and no more a second than people give."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable

from drivers import bus
from groundstation.flight import sequence as seq
from groundstation.flight.core.lease import OperatorLease
from groundstation.flight.messages import CoreCommand, Lease, LeaseAnswer
from groundstation.texts import shown

PER_S = 10.0
"""Orders and lease requests a second, of the lease's holder and of all others together.

A key held down repeats at about 30.
"""
BURST = 20.0
"""How many may come at once."""
KNOWN = 256
"""Clients whose newest number is kept; the longest unheard is forgotten first, the holder never."""


class OrderGate:
    """Counts orders and remembers their numbers. Its methods may be called from any thread.

    The holder of the lease has an allowance of its own, so that nobody else's flood costs the operator an order; all
    others share one, so that a new name brings no new allowance. What is refused costs nothing. Aborts do not pass
    here.

    Args:
        clock: monotonic seconds.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._left = {True: BURST, False: BURST}
        self._seen_s = {True: clock(), False: clock()}
        self._newest: OrderedDict[str, int] = OrderedDict()

    def refusal(self, client: str, sequence: int, holder: str) -> str:
        """Why an order is not taken; empty, and the order counted, when it is.

        Args:
            client: who gives it.
            sequence: its number, which grows from order to order of a client.
            holder: of the lease now.
        """
        with self._lock:
            if sequence <= self._newest.get(client, 0):
                return (
                    f"order {sequence} is not newer than the last of this client; it was given before and is not "
                    "repeated."
                )
            own, now = client == holder, self._clock()
            self._left[own] = min(BURST, self._left[own] + PER_S * (now - self._seen_s[own]))
            self._seen_s[own] = now
            if self._left[own] < 1.0:
                return (
                    f"more than {PER_S:g} orders a second; wait a second and give it again ('abort' is always taken)."
                )
            self._left[own] -= 1.0
            self._remember(client, sequence, holder)
            return ""

    def _remember(self, client: str, sequence: int, holder: str) -> None:
        self._newest[client] = sequence
        self._newest.move_to_end(client)
        if holder in self._newest:
            self._newest.move_to_end(holder)
        if len(self._newest) > KNOWN:
            self._newest.popitem(last=False)


class ClientOrders:
    """Answers clients on the bus's threads, and hands what is taken to the main thread.

    Args:
        lease: who may start and land.
        clock: monotonic seconds.
        phase: of the flight now.
        later: runs a function on the main thread.
        happen: takes an event into the sequence, on the main thread.
        agree: the operator takes what a flight until known proposes; says why that cannot be.
    """

    def __init__(
        self,
        lease: OperatorLease,
        clock: Callable[[], float],
        phase: Callable[[], seq.Phase],
        later: Callable[[Callable[[], None]], None],
        happen: Callable[[seq.Event], None],
        agree: Callable[[], str],
    ) -> None:
        self._lease, self._phase, self._later, self._happen, self._agree = lease, phase, later, happen, agree
        self._gate = OrderGate(clock)
        self._abort_waits = threading.Event()

    def lease(self, request: Lease) -> LeaseAnswer:
        """Take the lease or give it back."""
        holder = self._lease.holder
        if refusal := self._gate.refusal(request.client, request.sequence, holder):
            return LeaseAnswer(False, holder, refusal)
        return self._lease.request(request)

    def _who(self, client: str) -> str:
        """The operator, or a watcher by its name."""
        return "the operator" if client == self._lease.holder else shown(client, limit=80)

    def abort(self, command: CoreCommand) -> bus.Answer:
        """What is asked under the key that every role may use is an abort, whatever it says.

        It is never refused, however often it comes; while one waits for the main thread, that one is the answer to all.
        """

        def handle() -> None:
            self._abort_waits.clear()
            self._happen(seq.AbortRequested(f"aborted by {self._who(command.client)}"))

        if not self._abort_waits.is_set():
            self._abort_waits.set()
            self._later(handle)
        return bus.Answer(True)

    def command(self, command: CoreCommand) -> bus.Answer:
        """An order of the lease's holder, or an abort."""
        if command.name == "abort":
            return self.abort(command)
        refusal = self._lease.refusal(command.client, command.name) or self._gate.refusal(
            command.client, command.sequence, command.client
        )
        if refusal:
            return bus.Answer(False, refusal)
        if command.name == "start" and (phase := self._phase()) is not seq.Phase.CHECKED:
            return bus.Answer(False, f"the flight is {phase}; it can be started once it is checked.")
        if command.name == "agree":
            refusal = self._agree()
            return bus.Answer(not refusal, refusal)
        event = {
            "start": seq.StartRequested(),
            "land": seq.LandRequested(),
            "kill": seq.AbortRequested(f"rotors stopped by {self._who(command.client)}", rotors_off=True),
        }[command.name]
        self._later(lambda: self._happen(event))
        return bus.Answer(True)
