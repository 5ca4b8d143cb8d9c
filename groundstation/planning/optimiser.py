"""Several starts, the best feasible plan kept: coarse program, exchange of limit points, and a last repair.

Limits hold at every instant, a program holds them at finitely many phases. A coarse program finds the basin; then the
phases at which a limit is nearly reached on a fine grid join the program (an exchange method for semi-infinite programs,
Hettich and Kortanek 1993) until nothing is exceeded that matters. What is left is removed by drawing the motion
together by that much: hovering at the start keeps every limit.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from groundstation.planning.criteria import condition_number
from groundstation.planning.information import information
from groundstation.planning.limits import largest_violation
from groundstation.planning.problem import Problem
from groundstation.planning.program import Program
from groundstation.planning.samples import limit_groups
from groundstation.trajectory import FourierSeries
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Progress = Callable[[float, str], None]
Watch = Callable[[FourierSeries], None]

VIOLATION_TOLERANCE = 1e-7
"""Largest excess over a limit, in its own unit, that counts as rounding."""

_COARSE = 24  # phases per period and harmonic on which a limit is held from the beginning
_FINE = 200  # phases per period and harmonic on which the exchange looks for points
_NEAR = 0.05  # a point joins when this close to its bound, as a share of it
_REACHES = (0.02, 0.003, 0.0003)  # how far the unknowns may move in each round of the exchange
_LAZY = ("thrust", "torque", "rotors")  # held only once a plan comes near them
_SLACK = 0.2  # how near a starting motion may come, as a share of the bound (of hover thrust for rotors)


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
    starts: int = 0
    seconds: float = 0.0


def cost(series: FourierSeries, problem: Problem) -> float:
    """The criterion in plain numbers, smaller is better, over the flight's duration and the worst of the vehicles.

    condition: cond(W). D: geometric mean, A: root mean square, E: largest (along any direction) of the predicted
    relative standard deviations.
    """
    if problem.criterion == "condition":
        return condition_number(series, problem.vehicles[0].gravity_m_s2)
    whole = replace(series, periods=problem.duration_s / series.period_s)
    return max(_expected_cost(whole, vehicle, problem) for vehicle in problem.vehicles)


def _expected_cost(series: FourierSeries, vehicle: Vehicle, problem: Problem) -> float:
    values = np.linalg.eigvalsh(information(series, vehicle, problem.noise, problem.effects))
    if values[0] <= 1e-14 * values[-1]:
        return float("inf")
    variances = 1.0 / values
    measures = {"D": np.exp(np.mean(np.log(variances))), "A": np.mean(variances), "E": variances[0]}
    return float(np.sqrt(measures[problem.criterion]))


def inner_motion(problem: Problem, start: Array) -> FourierSeries:
    """A gentle motion strictly inside every limit but for its start: at rest, and (1 - cos)^2 off any edge of the room."""
    count = problem.harmonics
    a, b = np.zeros((2, 4, count))
    for channel, (low, high) in enumerate(problem.room):
        inward = float(start[channel] <= low) - float(start[channel] >= high)
        b[channel, :2] = 2.0 * inward, -1.0 * inward
    moving = _starting_at(start, a, b, problem.base_frequency_rad_s)
    resting = _starting_at(start, a, 0.0 * b, problem.base_frequency_rad_s)
    if not b.any():
        return resting
    return blend(repair(moving, problem, resting, step=0.05), resting, 0.5)


def _starting_at(start: Array, a: Array, b: Array, base_frequency_rad_s: float) -> FourierSeries:
    harmonic = base_frequency_rad_s * np.arange(1, a.shape[1] + 1)
    return FourierSeries(a, b, start + (b / harmonic).sum(axis=1), base_frequency_rad_s)


def blend(series: FourierSeries, inner: FourierSeries, factor: float) -> FourierSeries:
    """The share ``factor`` of a series and the rest of another with the same start, frequency and harmonics."""
    rest = 1.0 - factor
    return replace(
        series,
        a=factor * series.a + rest * inner.a,
        b=factor * series.b + rest * inner.b,
        c=factor * series.c + rest * inner.c,
    )


def repair(series: FourierSeries, problem: Problem, inner: FourierSeries, step: float = 1e-8) -> FourierSeries:
    """The series, drawn toward an inner motion as little as it takes to keep every limit on the fine grid."""
    share, candidate = 0.0, series
    while largest_violation(candidate, problem.envelopes) > VIOLATION_TOLERANCE and share < 50.0:
        share = step if share == 0.0 else 1.5 * share
        candidate = blend(series, inner, float(np.exp(-share)))
    return candidate


def repair_about_start(series: FourierSeries, problem: Problem, step: float = 1e-8) -> FourierSeries:
    """:func:`repair` toward the inner motion at the series' own start."""
    start = series.derivatives(0.0, 0)[0, 0] if problem.start is None else np.array(problem.start)
    return repair(series, problem, inner_motion(problem, start), step)


def random_start(problem: Problem, rng: np.random.Generator) -> Array:
    """Unknowns of a random motion that keeps every limit and uses most of one of them."""
    start = np.array(problem.start if problem.start is not None else _middle(problem))
    a, b = rng.normal(size=(2, 4, problem.harmonics))
    inner = inner_motion(problem, start)
    rough = _starting_at(start, a, b, problem.base_frequency_rad_s)
    resting = problem.series(problem.unknowns_of(rough))
    edge = np.abs(inner.b).any(axis=1)
    resting.a[edge], resting.b[edge] = 0.0, 20.0 * inner.b[edge]
    rough = _starting_at(start, resting.a, resting.b, problem.base_frequency_rad_s)
    return problem.unknowns_of(repair(rough, problem, inner, step=0.05))


def _middle(problem: Problem) -> list[float]:
    """Middle of the room; one metre up where it has neither floor nor ceiling."""
    floor, ceiling = problem.room[2]
    finite = [edge for edge in (floor, ceiling) if np.isfinite(edge)]
    return [0.0, 0.0, float(np.mean(finite)) if finite else 1.0, 0.0]


class _Exchange:
    """Limit phases in force, and the points that a trajectory nearly touching its limits adds to them."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self.groups = [limit_groups(envelope) for envelope in problem.envelopes]
        self._grid = _phases(_COARSE * problem.harmonics)
        self._fine = _phases(_FINE * problem.harmonics)
        self.coarse = [{name: self._grid for name in groups if name not in _LAZY} for groups in self.groups]

    def _samples(self, series: FourierSeries) -> Array:
        d = series.derivatives(self._fine / series.base_frequency_rad_s, 4)
        return np.hstack([*d[:, :, :3], d[:3, :, 3].T]).T

    def add_groups(self, series: FourierSeries, slack: float = 0.0) -> bool:
        """Hold from now on what the trajectory exceeds, or nearly so, and no program has held yet."""
        samples, added = self._samples(series), False
        for groups, coarse in zip(self.groups, self.coarse, strict=True):
            for name in set(groups) - set(coarse):
                if groups[name].excess(samples).max() > -slack:
                    coarse[name] = self._grid
                    added = True
        return added

    def touched(self, series: FourierSeries) -> list[dict[str, Array]]:
        """Phases of every local maximum near or over a bound, and one to either side, by vehicle and limit group."""
        samples, step = self._samples(series), self._fine[1]
        found: list[dict[str, Array]] = []
        for groups in self.groups:
            here: dict[str, Array] = {}
            for name, group in groups.items():
                excess = group.excess(samples)
                peak = (excess >= np.roll(excess, 1, axis=1)) & (excess >= np.roll(excess, -1, axis=1))
                rows, columns = np.nonzero(peak & (excess > -_NEAR))
                here[name] = np.unique(
                    [self._fine[columns] + step * k for k in (-2, 0, 2)] + _summit(excess, rows, columns) * step
                )
            found.append(here)
        return found


def _summit(values: Array, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Array:
    """Where between its neighbours each peak lies, in steps from -1/2 to 1/2: top of the parabola through the three."""
    before, here, after = (values[rows, (columns + k) % values.shape[1]] for k in (-1, 0, 1))
    bend = before - 2.0 * here + after
    offset = np.where(bend < 0.0, 0.5 * (before - after) / np.where(bend < 0.0, bend, 1.0), 0.0)
    return np.clip(offset, -0.5, 0.5)


def _phases(count: int) -> Array:
    return 2.0 * np.pi * np.arange(count) / count


def _merge(first: list[dict[str, Array]], second: list[dict[str, Array]]) -> list[dict[str, Array]]:
    return [
        {name: np.union1d(a.get(name, np.zeros(0)), b.get(name, np.zeros(0))) for name in a | b}
        for a, b in zip(first, second, strict=True)
    ]


def _polish(problem: Problem, exchange: _Exchange, unknowns: Array, watch: Callable[[Array], None]) -> FourierSeries:
    """Exchange points within a shrinking reach until the limits hold between them; the last bit by :func:`repair`."""
    phases = exchange.touched(problem.series(unknowns))
    for reach in _REACHES:
        unknowns = Program(problem, exchange.groups, phases, warm=True, watch=watch).solve(unknowns, reach)
        series = problem.series(unknowns)
        if largest_violation(series, problem.envelopes) < VIOLATION_TOLERANCE:
            break
        phases = _merge(phases, exchange.touched(series))
    return repair_about_start(problem.series(unknowns), problem)


def best_of(
    problems: Sequence[Problem],
    *,
    seed: int = 3,
    time_budget_s: float = 8.0,
    starts: int | None = None,
    progress: Progress = lambda fraction, text: None,
    watch: Watch = lambda series: None,
    clock: Callable[[], float] = time.monotonic,
) -> Outcome:
    """The best feasible plan found in the time given; an interrupt (Ctrl-C) ends the search early and keeps the best.

    Args:
        problems: the same task at different base frequencies; each is tried once, then starts go to the best one.
        seed: of the random starting points.
        time_budget_s: no new start is begun that would probably end later.
        starts: number of starts; default as many as the time allows, at least one.
        progress: called with the share of the budget that is used and a line of text.
        watch: called with each iterate of the solver, feasible or not; KeyboardInterrupt raised in it ends the search.
        clock: seconds, monotonic.
    """
    began, rng = clock(), np.random.default_rng(seed)
    searches = [_Search(problem, watch) for problem in problems]
    longest, tried = 0.0, 0
    with threadpool_limits(limits=1):  # the matrices are small: threads would only wait for each other
        best = searches[0].fallback(rng)
        try:
            while True:
                before = clock()
                search = searches[tried] if tried < len(searches) else min(searches, key=lambda each: each.rough)
                candidate = search.try_once(rng)
                tried += 1
                if candidate is not None and candidate.cost < best.cost:
                    best = candidate
                used = clock() - began
                longest = max(longest, clock() - before)
                share = tried / starts if starts else used / time_budget_s
                progress(min(share, 1.0), f"start {tried}: best feasible {best.cost:.5g}")
                if tried >= starts if starts else used + longest > time_budget_s:
                    break
        except KeyboardInterrupt:
            best = min([best, *(each.salvaged() for each in searches if each.rough < best.cost)], key=lambda o: o.cost)
            progress(1.0, f"interrupted; best so far {best.cost:.5g}")
    return replace(best, starts=tried, seconds=clock() - began)


class _Search:
    """Starts on one problem; the coarse program is compiled at the first."""

    def __init__(self, problem: Problem, watch: Watch) -> None:
        self._problem = problem
        self._watch: Callable[[Array], None] = lambda unknowns: watch(problem.series(unknowns))
        self._exchange: _Exchange | None = None
        self._program: Program | None = None
        self._found = np.zeros(0)
        self.rough = float("inf")

    def salvaged(self) -> Outcome:
        """The best coarse solution drawn in to keep its limits, where polishing was interrupted."""
        return _judge(self._problem, repair_about_start(self._problem.series(self._found), self._problem, step=1e-4))

    def fallback(self, rng: np.random.Generator) -> Outcome:
        """A feasible plan without any optimisation."""
        return _judge(self._problem, self._problem.series(random_start(self._problem, rng)))

    def try_once(self, rng: np.random.Generator) -> Outcome | None:
        """A feasible plan from one more start; None when its coarse solution is no better than those before."""
        problem = self._problem
        if self._exchange is None:
            self._exchange = _Exchange(problem)
        start = random_start(problem, rng)
        if self._exchange.add_groups(problem.series(start), slack=_SLACK) or self._program is None:
            self._program = Program(problem, self._exchange.groups, self._exchange.coarse, watch=self._watch)
        found = self._program.solve(start)
        while self._exchange.add_groups(problem.series(found)):
            self._program = Program(problem, self._exchange.groups, self._exchange.coarse, watch=self._watch)
            found = self._program.solve(random_start(problem, rng))
        rough = cost(problem.series(found), problem)
        if not rough < self.rough:
            return None
        self.rough, self._found = rough, found
        return _judge(problem, _polish(problem, self._exchange, found, self._watch))


def _judge(problem: Problem, series: FourierSeries) -> Outcome:
    return Outcome(series, cost(series, problem), largest_violation(series, problem.envelopes))
