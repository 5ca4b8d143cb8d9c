"""Fly until known: at each rest point of an excitation, whether it ends there, goes on, or leaves that to the operator.
No I/O, no clock.

A plan with ``[until]`` is checked before the flight at its full length, which is the stated maximum; it is flown for
``planned_periods`` unless it is told to end at an earlier rest point or to go on for a period more. So nothing goes
past what preflight allowed, and a flight that nobody decides about is the planned one. Intervals are those of
:mod:`groundstation.identification.sequential`.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from groundstation.errors import BadInput
from groundstation.identification.recursive import SHOWN
from groundstation.identification.results import Estimate
from groundstation.identification.sequential import Spending, at_any_time
from groundstation.targets import HALF_95, parse_targets
from groundstation.trajectory import Plan, PlannedUntil
from groundstation.vehicle import Until

Order = Literal["finish", "extend", ""]

VOLTAGE_MARGIN = 2.0
"""A further period is flown only where the battery would still hold so many periods' voltage drops above empty: one for
the period, one to land with."""


def lasting_until(plan: Plan, until: Until, *, automatic: bool) -> Plan:
    """A plan that is flown until its targets are met, ended or extended at whole periods.

    Raises:
        BadInput: a target that no flight estimates while it flies, or a maximum below the plan's first period.
    """
    targets = parse_targets(until.targets)
    if later := [name for name in targets if name not in SHOWN]:
        raise BadInput(
            f"{', '.join(later)}: is known only after landing; name mass, ixx, iyy or izz as targets of a flight."
        )
    period_s = plan.series().period_s
    most = math.floor(until.at_most_s / period_s + 1e-6)
    if most < 1:
        raise BadInput(
            f"one period of this plan takes {period_s:.1f} s, longer than the maximum of {until.at_most_s:g} s; allow "
            "more."
        )
    planned = min(max(1, math.floor(plan.periods + 1e-6)), most)
    section = PlannedUntil(targets=targets, planned_periods=planned, automatic=automatic)
    return plan.model_copy(update={"periods": float(most), "until": section})


@dataclass(frozen=True, slots=True)
class Goal:
    """What is to be known, and how long it may take.

    Attributes:
        targets: half widths of 95 % intervals as shares, by parameter.
        period_s: between two rest points.
        planned, at_most: periods.
        automatic: decided here; else the operator decides on each proposal.
        empty_v: of the battery; 0 where that is not declared.
    """

    targets: Mapping[str, float]
    period_s: float
    planned: int
    at_most: int
    automatic: bool
    empty_v: float = 0.0


@dataclass(frozen=True, slots=True)
class Progress:
    """One parameter: half widths over its target by the spent and by the any-time interval, and seconds until the first
    is met.

    Infinite where the motion has not revealed it.
    """

    spent: float = math.inf
    at_any_time: float = math.inf
    seconds: float = math.inf


@dataclass(frozen=True, slots=True)
class Look:
    """What is known at a moment, and what follows.

    Attributes:
        progress: by parameter.
        order: what would be done now: nothing (""), "finish" at the next rest point, or "extend" by a period.
        sentence: why, for people.
    """

    progress: Mapping[str, Progress]
    order: Order
    sentence: str

    @property
    def met(self) -> bool:
        """Every target is met by the spent interval."""
        return all(p.spent <= 1.0 for p in self.progress.values())


@dataclass(slots=True)
class UntilKnown:
    """The looks at a flight's rest points so far.

    Attributes:
        done: rest points looked at.
        length: periods that will be flown as it stands.
        agreed: the operator's answer to the proposal that was last shown; only where nothing is decided here.
    """

    goal: Goal
    done: int = 0
    length: int = 0
    agreed: Order = ""
    _spending: dict[str, Spending] = field(default_factory=dict)
    _volts: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.length = self.goal.planned
        self._spending = {name: Spending(self.goal.at_most) for name in self.goal.targets}

    def preview(self, estimates: Mapping[str, Estimate], volts: float) -> Look:
        """What the next look would say; for the screen. It spends nothing."""
        flown = self.done * self.goal.period_s
        return self._look(
            copy.deepcopy(self._spending), estimates, [*self._volts, volts], flown + 0.5 * self.goal.period_s
        )

    def look(self, estimates: Mapping[str, Estimate], volts: float) -> Look:
        """The look at the next rest point. What it orders is final: without the operator, or as the operator agreed."""
        self._volts.append(volts)
        now = self._look(self._spending, estimates, self._volts, (self.done + 1) * self.goal.period_s)
        order = now.order if self.goal.automatic or now.order == self.agreed else ""
        self.done, self.agreed = self.done + 1, ""
        self.length = self.done if order == "finish" else self.length + (order == "extend")
        return Look(now.progress, order, now.sentence)

    def agree(self, proposal: Order) -> str:
        """The operator takes what is proposed; why that cannot be, or nothing."""
        if self.goal.automatic:
            return "this flight decides by itself; 'land' ends it early."
        if not proposal:
            return "nothing is proposed now: the targets are not met, and the planned end is not near."
        self.agreed = proposal
        return ""

    def refused(self, order: Order) -> None:
        """The vehicle did not take an order: it flies as long as before."""
        if order == "extend":
            self.length -= 1

    def _look(
        self, spending: Mapping[str, Spending], estimates: Mapping[str, Estimate], volts: list[float], flown_s: float
    ) -> Look:
        progress = {
            n: _progress(spending[n], share, estimates.get(n), flown_s) for n, share in self.goal.targets.items()
        }
        at, goal = self.done + 1, self.goal
        if all(p.spent <= 1.0 for p in progress.values()):
            if at < self.length:
                return Look(progress, "finish", f"the targets are met; it can end after {at * goal.period_s:.0f} s")
            return Look(progress, "", "the targets are met; it ends as it stands")
        if at < self.length:
            return Look(progress, "", "the targets are not met yet")
        if at >= goal.at_most:
            return Look(
                progress, "", f"the targets are not met; the stated maximum of {at * goal.period_s:.0f} s is reached"
            )
        if not _battery_lasts(volts, goal.empty_v):
            return Look(progress, "", "the targets are not met, and the battery does not hold another period")
        return Look(progress, "extend", f"the targets are not met; it can go on for another {goal.period_s:.0f} s")


def _progress(spending: Spending, share: float, estimate: Estimate | None, flown_s: float) -> Progress:
    """Of one parameter, its next look taken."""
    if estimate is None or not estimate.value or not (math.isfinite(estimate.std) and estimate.std > 0.0):
        spending.look(math.inf)
        return Progress()
    width = share * abs(estimate.value)
    spent = spending.look(estimate.std) * estimate.std / width
    always = at_any_time(estimate.std, width / HALF_95) * estimate.std / width
    return Progress(spent, always, max(0.0, flown_s * (spent**2 - 1.0)))


def _battery_lasts(volts: list[float], empty_v: float) -> bool:
    """Whether another period and the landing are left, by the drop of those flown; yes where nothing tells."""
    if empty_v <= 0.0 or len(volts) < 2 or min(volts) <= 0.0:
        return True
    drop = max(0.0, (volts[0] - volts[-1]) / (len(volts) - 1))
    return volts[-1] - VOLTAGE_MARGIN * drop > empty_v
