"""Several starts, the best feasible plan kept: coarse program, exchange of limit points, and a last repair.

Limits hold at every instant, a program holds them at finitely many phases. A coarse program finds the basin; then the
phases at which a limit is nearly reached on a fine grid join the program (an exchange method for semi-infinite programs,
Hettich and Kortanek 1993) until nothing is exceeded that matters. What is left is removed by drawing the motion
together by that much: hovering at the start is strictly inside every limit.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.planning.criteria import condition_number
from groundstation.planning.information import information, parameter_scales
from groundstation.planning.limits import largest_violation
from groundstation.planning.program import Problem, Program, limit_groups
from groundstation.trajectory import FourierSeries

Array = NDArray[np.float64]
Progress = Callable[[float, str], None]

VIOLATION_TOLERANCE = 1e-7
"""Largest excess over a limit, in its own unit, that counts as rounding."""

_COARSE = 24  # phases per period and harmonic on which a limit is held from the beginning
_FINE = 1024  # phases per period on which the exchange looks for points
_NEAR = 0.05  # a point joins when this close to its bound, as a share of it
_REACHES = (0.02, 0.005, 0.001)  # how far the unknowns may move in each round of the exchange
_ALWAYS = ("x", "y", "z", "yaw", "speed", "yaw_rate", "tilt", "acceleration")


@dataclass(frozen=True, slots=True)
class Outcome:
    """The best plan found.

    Attributes:
        series: one period.
        cost: its criterion (see :func:`cost`), smaller is better.
        violation: largest excess over any limit.
        starts: starting points tried.
        seconds: time it took.
    """

    series: FourierSeries
    cost: float
    violation: float
    starts: int
    seconds: float


def cost(series: FourierSeries, problem: Problem) -> float:
    """The criterion in plain numbers, smaller is better, over the flight's duration and the worst of the vehicles.

    condition: cond(W). D: geometric mean, A: root mean square, E: largest (along any direction) of the predicted
    relative standard deviations.
    """
    if problem.criterion == "condition":
        return condition_number(series, problem.vehicles[0].gravity_m_s2)
    whole = replace(series, periods=problem.duration_s / series.period_s)
    worst = 0.0
    for vehicle in problem.vehicles:
        scales = parameter_scales(vehicle)
        values = np.linalg.eigvalsh(information(whole, vehicle, problem.noise) * np.outer(scales, scales))
        if values[0] <= 1e-12 * values[-1]:
            return float("inf")
        variances = 1.0 / values
        worst = max(
            worst,
            {
                "D": float(np.exp(np.mean(np.log(variances)) / 2.0)),
                "A": float(np.sqrt(np.mean(variances))),
                "E": float(np.sqrt(variances[0])),
            }[problem.criterion],
        )
    return worst


def shrink(series: FourierSeries, factor: float) -> FourierSeries:
    """The same motion drawn together about its start, so that the ends stay where they are."""
    harmonic = series.base_frequency_rad_s * np.arange(1, series.a.shape[1] + 1)
    offset = series.c - (1.0 - factor) * (series.b / harmonic).sum(axis=1)
    return replace(series, a=factor * series.a, b=factor * series.b, c=offset)


def repair(series: FourierSeries, problem: Problem, step: float = 1e-8) -> FourierSeries:
    """The series, drawn together as little as it takes to keep every limit on the fine grid."""
    share = 0.0
    candidate = series
    while largest_violation(candidate, problem.envelopes) > VIOLATION_TOLERANCE:
        share = step if share == 0.0 else 1.5 * share
        candidate = shrink(series, float(np.exp(-share)))
    return candidate


def random_start(problem: Problem, rng: np.random.Generator) -> Array:
    """Unknowns of a random motion that keeps every limit and uses most of one of them.

    Where the start touches the room's edge, that channel moves inward as (1 - cos)^2, which starts and ends at rest.
    """
    count = problem.harmonics
    harmonic = np.arange(1, count + 1)
    a, b = rng.normal(size=(2, 4, count))
    start = np.array(problem.start if problem.start is not None else _middle(problem))
    for channel, (low, high) in enumerate(problem.room):
        inward = float(start[channel] <= low) - float(start[channel] >= high)
        if inward:
            a[channel], b[channel] = 0.0, 0.0
            b[channel, :2] = 2.0 * inward, -1.0 * inward
    low, high = problem.base_frequency_rad_s
    frequency = rng.uniform(low, high)
    rough = FourierSeries(a, b, start + (b / (frequency * harmonic)).sum(axis=1), frequency)
    resting = problem.series(problem.unknowns_of(rough))
    return problem.unknowns_of(repair(resting, problem, step=0.05))


def _middle(problem: Problem) -> list[float]:
    """Middle of the room; one metre up where it has neither floor nor ceiling."""
    floor, ceiling = problem.room[2]
    finite = [edge for edge in (floor, ceiling) if np.isfinite(edge)]
    return [0.0, 0.0, float(np.mean(finite)) if finite else 1.0, 0.0]


class _Exchange:
    """Limit phases in force, and the points that a trajectory nearly touching its limits adds to them."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._groups = [limit_groups(envelope) for envelope in problem.envelopes]
        grid = 2.0 * np.pi * np.arange(_COARSE * problem.harmonics) / (_COARSE * problem.harmonics)
        self.coarse = [{name: grid for name in groups if name in _ALWAYS} for groups in self._groups]
        self._fine = 2.0 * np.pi * np.arange(_FINE) / _FINE

    def _values(self, series: FourierSeries, name: str, which: int) -> Array:
        """Excess over the nearer bound as a share of it, shape (values, phases)."""
        group = self._groups[which][name]
        d = series.derivatives(self._fine / series.base_frequency_rad_s, 4)
        flat = np.hstack([*d[:, :, :3], d[:3, :, 3].T]).T
        value = np.array(group.function.map(_FINE)(flat))
        return np.maximum(value - group.upper[:, None], group.lower[:, None] - value)

    def add_groups(self, series: FourierSeries) -> bool:
        """Hold at all coarse phases what the trajectory exceeds clearly and the program did not hold at all."""
        added = False
        for which, groups in enumerate(self._groups):
            for name in set(groups) - set(self.coarse[which]):
                if self._values(series, name, which).max() > 0.0:
                    self.coarse[which][name] = next(iter(self.coarse[which].values()))
                    added = True
        return added

    def touched(self, series: FourierSeries) -> list[dict[str, Array]]:
        """Phases of every local maximum near or over a bound, by vehicle and limit group."""
        found: list[dict[str, Array]] = []
        for which, groups in enumerate(self._groups):
            here: dict[str, Array] = {}
            for name in groups:
                excess = self._values(series, name, which)
                peak = (excess >= np.roll(excess, 1, axis=1)) & (excess >= np.roll(excess, -1, axis=1))
                near = (peak & (excess > -_NEAR)).any(axis=0)
                here[name] = self._fine[near | np.roll(near, 2) | np.roll(near, -2)]
            found.append(here)
        return found


def _merge(first: list[dict[str, Array]], second: list[dict[str, Array]]) -> list[dict[str, Array]]:
    return [
        {name: np.union1d(a.get(name, np.zeros(0)), b.get(name, np.zeros(0))) for name in a | b}
        for a, b in zip(first, second, strict=True)
    ]


def _polish(problem: Problem, exchange: _Exchange, unknowns: Array) -> FourierSeries:
    """Exchange points within a shrinking reach until the limits hold between them; the last bit by :func:`repair`."""
    phases = exchange.touched(problem.series(unknowns))
    for reach in _REACHES:
        unknowns = Program(problem, phases, unknowns, warm=True).solve(unknowns, reach)
        series = problem.series(unknowns)
        if largest_violation(series, problem.envelopes) < VIOLATION_TOLERANCE:
            break
        phases = _merge(phases, exchange.touched(series))
    return repair(problem.series(unknowns), problem)


def optimise(
    problem: Problem,
    *,
    seed: int = 0,
    time_budget_s: float = 8.0,
    starts: int | None = None,
    progress: Progress = lambda fraction, text: None,
    clock: Callable[[], float] = time.monotonic,
) -> Outcome:
    """The best feasible plan found in the time given; an interrupt (Ctrl-C) ends the search early and keeps the best.

    Args:
        seed: of the random starting points.
        time_budget_s: no new start is begun that would probably end later.
        starts: number of starts; default as many as the time allows, at least one.
        progress: called with the share of the budget that is used and a line of text.
        clock: seconds, monotonic.
    """
    began = clock()
    rng = np.random.default_rng(seed)
    exchange = _Exchange(problem)
    first = random_start(problem, rng)
    best = _judge(problem, problem.series(first), 0, clock() - began)
    coarse_best, longest, tried = np.inf, 0.0, 0
    try:
        program = Program(problem, exchange.coarse, first)
        while True:
            start_time = clock()
            found = program.solve(first if tried == 0 else random_start(problem, rng))
            tried += 1
            if exchange.add_groups(problem.series(found)):
                program = Program(problem, exchange.coarse, first)
                found = program.solve(found)
            rough = cost(problem.series(found), problem)
            if rough < coarse_best:
                coarse_best = rough
                candidate = _judge(problem, _polish(problem, exchange, found), tried, clock() - began)
                if candidate.cost < best.cost:
                    best = candidate
            used = clock() - began
            longest = max(longest, clock() - start_time)
            progress(min(used / time_budget_s, 1.0), f"start {tried}: {rough:.4g}, best feasible {best.cost:.5g}")
            if (starts is not None and tried >= starts) or (starts is None and used + longest > time_budget_s):
                break
    except KeyboardInterrupt:
        progress(1.0, f"interrupted; best so far {best.cost:.5g}")
    return replace(best, starts=tried, seconds=clock() - began)


def _judge(problem: Problem, series: FourierSeries, starts: int, seconds: float) -> Outcome:
    return Outcome(series, cost(series, problem), largest_violation(series, problem.envelopes), starts, seconds)
