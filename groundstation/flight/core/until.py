"""Fly until known, as the core does it: when to look, what is told to clients, which order leaves.

The decision is :mod:`flight.until`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from drivers.bus import DroneStatus
from groundstation.flight import timeouts
from groundstation.flight.messages import KnownStatus, UntilStatus
from groundstation.flight.until import Goal, Look, Order, UntilKnown
from groundstation.identification.results import Estimate
from groundstation.trajectory import Plan
from groundstation.vehicle import Vehicle


class FlyUntil:
    """Looks shortly before each rest point.

    Args:
        plan: with ``until``.
        vehicle: as declared.
        lock_step: simulated time waits for each look, so that one seed gives one flight.
    """

    def __init__(self, plan: Plan, vehicle: Vehicle, *, lock_step: bool):
        assert plan.until is not None  # noqa: S101 - asked by the caller
        period_s = plan.series().period_s
        goal = Goal(
            plan.until.targets,
            period_s,
            plan.until.planned_periods,
            round(plan.periods),
            plan.until.automatic,
            vehicle.battery.empty_v or 0.0,
        )
        self._known = UntilKnown(goal)
        self._lock_step = lock_step
        self._start_s: float | None = None
        self._waiting, self._looked_s = False, -math.inf
        self._preview_s = -math.inf
        self._newest: Look | None = None

    def follow(self, status: DroneStatus) -> None:
        """The excitation's start on the host's clock."""
        if status.phase == "exciting" and status.window_s is not None and self._start_s is None:
            self._start_s = status.host_s + status.window_s[0] - status.device_s

    def hold_s(self) -> float:
        """How far lock-stepped time may run: to the next look, until what it orders is answered."""
        if not self._lock_step:
            return math.inf
        return self._looked_s if self._waiting else self._look_s()

    def _look_s(self) -> float:
        if self._start_s is None or self._known.done >= self._known.length:
            return math.inf
        ahead = timeouts.UNTIL_SIMULATED_AHEAD_S if self._lock_step else timeouts.UNTIL_AHEAD_S
        return self._start_s + (self._known.done + 1) * self._known.goal.period_s - ahead

    def moment(
        self, host_s: float, batch_s: float, estimates: Mapping[str, Estimate], volts: float
    ) -> tuple[Order, str]:
        """Everything up to a moment is known: the order that leaves now, and the sentence for the log; both empty
        between looks.
        """
        if self._waiting or self._start_s is None:
            return "", ""
        if host_s + (batch_s if self._lock_step else 0.0) <= self._look_s():
            if host_s - self._preview_s >= timeouts.UNTIL_PREVIEW_S:
                self._preview_s, self._newest = host_s, self._known.preview(estimates, volts)
            return "", ""
        self._looked_s = self._look_s()
        self._newest = look = self._known.look(estimates, volts)
        self._waiting = bool(look.order)
        after = self._known.done * self._known.goal.period_s
        return look.order, f"after {after:.0f} s of excitation {look.sentence}" + (
            f": {look.order}" if look.order else ""
        )

    def answered(self, order: Order, *, ok: bool) -> None:
        """The vehicle took the order, or did not."""
        self._waiting = False
        if not ok:
            self._known.refused(order)

    def agree(self) -> str:
        """The operator takes what is proposed; why that cannot be, or nothing."""
        return self._known.agree("" if self._newest is None else self._newest.order)

    def status(self) -> UntilStatus | None:
        """For the clients; None before the excitation."""
        look, known = self._newest, self._known
        if look is None:
            return None
        rows = {
            n: KnownStatus(*(_finite(v) for v in (p.spent, p.at_any_time, p.seconds))) for n, p in look.progress.items()
        }
        proposal = (
            ""
            if known.goal.automatic or not look.order
            else f"{look.sentence}; u agrees"
            if not known.agreed
            else f"agreed: {look.sentence}"
        )
        period_s = known.goal.period_s
        return UntilStatus(rows, look.sentence, proposal, known.length * period_s, known.goal.at_most * period_s)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
