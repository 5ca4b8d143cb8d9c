"""Orders of clients: from whom, each once, and how many a second."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from groundstation.flight import sequence as seq
from groundstation.flight.core.lease import OperatorLease
from groundstation.flight.core.orders import BURST, KNOWN, PER_S, ClientOrders, OrderGate
from groundstation.flight.messages import CoreCommand, Lease


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_a_client_that_floods_is_limited_per_second_and_leaves_the_operator_alone():
    clock = Clock()
    gate = OrderGate(clock)
    taken = sum(not gate.refusal(f"stranger-{n}", 1, "operator") for n in range(1000))
    assert taken == BURST
    assert not gate.refusal("operator", 1, "operator")
    taken = 0
    for n in range(10_000):
        clock.now += 0.001
        taken += not gate.refusal("flooder", n + 1, "operator")
    assert taken == pytest.approx(10.0 * PER_S, abs=1)


def test_an_order_is_taken_once_and_the_holder_s_number_is_never_forgotten():
    clock = Clock()
    gate = OrderGate(clock)
    assert not gate.refusal("operator", 7, "operator")
    for n in range(2 * KNOWN):
        clock.now += 1.0
        assert not gate.refusal(f"other-{n}", 5, "operator")
    for old in (0, 6, 7):
        assert "not newer" in gate.refusal("operator", old, "operator")
    assert "not newer" in gate.refusal(f"other-{2 * KNOWN - 1}", 5, "operator")
    assert not gate.refusal("operator", 8, "operator")


def test_a_replayed_land_does_nothing_and_aborts_are_taken_without_a_number_as_one():
    jobs: list[Callable[[], None]] = []
    events: list[seq.Event] = []
    clients = ClientOrders(OperatorLease(), Clock(), lambda: seq.Phase.CHECKED, jobs.append, events.append, lambda: "")
    assert clients.lease(Lease("operator", sequence=1)).ok
    land = CoreCommand("land", "operator", 2)
    assert clients.command(land).ok and not clients.command(land).ok
    assert not clients.lease(Lease("operator", take=False, sequence=1)).ok
    assert all(clients.abort(CoreCommand("abort", "guest")).ok for _ in range(500))
    assert clients.command(CoreCommand("abort", "guest")).ok
    assert len(jobs) == 2
    for job in jobs:
        job()
    assert events == [seq.LandRequested(), seq.AbortRequested("aborted by guest")]
    assert clients.abort(CoreCommand("abort", "guest")).ok and len(jobs) == 3
