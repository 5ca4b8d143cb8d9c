"""From starts to the best feasible plan: a coarse program, exchange of limit points, and a last repair.

Limits hold at every instant, a program holds them at finitely many phases. A coarse program finds the basin; then the
phases at which a limit is nearly reached on a fine grid join the program (an exchange method for semi-infinite
programs, Hettich and Kortanek 1993). What is left is removed by drawing the motion together by that much: hovering at
the start keeps every limit. The first starts are plans that were solved before, scaled to the task (``library``); the
others are random.
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
from groundstation.planning.library import Solved, scaled_starts
from groundstation.planning.limits import STEP_S, largest_violation
from groundstation.planning.problem import Problem
from groundstation.planning.program import COLD, HOT, WARM, Program
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
_NEAR = 0.03  # a point joins when this close to its bound, as a share of it
_EDGE = np.arange(-16, 17) / 4.0  # coarse steps about the start at which a height that starts on the floor is held
_REACHES = (0.02, 0.003)  # how far the unknowns may move in each round of the exchange
_ROUGH = 60  # steps per period and harmonic at which limits are looked at first
_DRAWN = 0.1  # share by which a random start is drawn in, so that it lies well inside
_SCALED = 0.01  # the same of a scaled solution
_KEPT = 1e-3  # the same of a coarse solution, to begin the next round of the exchange
ROUGHLY = 3e-4  # gap of a coarse solution
_LITTLE = 1e-4  # an excess that drawing in removes at no cost to speak of
_LAZY = ("thrust", "torque", "rotors")  # held only once a plan comes near them
_SLACK = 0.2  # how near a starting motion may come, as a share of the bound (of hover thrust for rotors)


@dataclass(frozen=True, slots=True)
class Outcome:
    """The best plan found.

    Attributes:
        series: one period.
        cost: its criterion (see :func:`cost`), smaller is better.
        violation: largest excess over any limit.
        sampled_bound: the best that a search found where limits hold at sampled phases only, less its gap: no plan
            within the limits was seen to go below; nan without a search.
        starts: starting points tried.
        seconds: time it took.
    """

    series: FourierSeries
    cost: float
    violation: float
    sampled_bound: float = float("nan")
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
    """A gentle motion strictly inside every limit but for its start: at rest, and (1 - cos)^2 off any edge of the
    room.
    """
    count = problem.harmonics
    a, b = np.zeros((2, 4, count))
    for channel, (low, high) in enumerate(problem.room):
        inward = float(start[channel] <= low) - float(start[channel] >= high)
        b[channel, :2] = 2.0 * inward, -1.0 * inward
    moving = _starting_at(start, a, b, problem.base_frequency_rad_s)
    resting = _starting_at(start, a, 0.0 * b, problem.base_frequency_rad_s)
    if not b.any():
        return resting
    return blend(_drawn_in(moving, problem, resting, 0.05, _rough_step_s(problem)), resting, 0.5)


def _starting_at(start: Array, a: Array, b: Array, base_frequency_rad_s: float) -> FourierSeries:
    harmonic = base_frequency_rad_s * np.arange(1, int(a.shape[1]) + 1)
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
    return _drawn_in(series, problem, inner, step, _rough_step_s(problem), STEP_S)


def _rough_step_s(problem: Problem) -> float:
    return 2.0 * np.pi / problem.base_frequency_rad_s / (_ROUGH * problem.harmonics)


def _drawn_in(
    series: FourierSeries, problem: Problem, inner: FourierSeries, step: float, *grids_s: float
) -> FourierSeries:
    """The same on grids of the given steps, one after the other: the coarse ones spare looks at the fine one."""
    share, candidate = 0.0, series
    for grid_s in grids_s:
        while largest_violation(candidate, problem.envelopes, grid_s) > VIOLATION_TOLERANCE and share < 50.0:
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
    return problem.unknowns_of(_drawn_in(rough, problem, inner, 0.05, _rough_step_s(problem)))


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
        if problem.start is not None and problem.start[2] in problem.room[2]:
            edge = np.mod(_EDGE * self._grid[1], 2.0 * np.pi)
            for groups in self.coarse:
                groups["z"] = np.union1d(groups["z"], edge)

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

    def near(self, series: FourierSeries) -> list[dict[str, Array]]:
        """Fine phases at which a limit is nearly reached or exceeded, beside the coarse ones, by vehicle and limit
        group.
        """
        samples = self._samples(series)
        found: list[dict[str, Array]] = []
        for groups, coarse in zip(self.groups, self.coarse, strict=True):
            here = {name: self._fine[(groups[name].excess(samples) > -_NEAR).any(axis=0)] for name in groups}
            found.append({name: np.union1d(coarse.get(name, np.zeros(0)), phases) for name, phases in here.items()})
        return found


def _phases(count: int) -> Array:
    return 2.0 * np.pi * np.arange(count) / count


def _inner_unknowns(problem: Problem, unknowns: Array) -> Array:
    """Unknowns of the inner motion at the start of a motion."""
    start = unknowns[-4:] if problem.start is None else np.array(problem.start)
    return problem.unknowns_of(inner_motion(problem, start))


def _polish(problem: Problem, exchange: _Exchange, unknowns: Array, watch: Callable[[Array], None]) -> FourierSeries:
    """Exchange points until the limits hold between them; the last bit by :func:`repair`."""
    inner = _inner_unknowns(problem, unknowns)
    for reach in _REACHES:
        program = Program(problem, exchange.groups, exchange.near(problem.series(unknowns)), watch=watch)
        unknowns = program.solve(program.inside(unknowns, inner, _KEPT), mu=HOT, reach=reach)
        if largest_violation(problem.series(unknowns), problem.envelopes, _rough_step_s(problem) / 4.0) < _LITTLE:
            break
    return repair_about_start(problem.series(unknowns), problem)


@dataclass(frozen=True, slots=True)
class Budget:
    """How long to search.

    Attributes:
        seed: of the random starting points.
        time_budget_s: for more starts; no new one is begun that would probably end later. None: each problem once.
        starts: number of starts instead.
    """

    seed: int = 3
    time_budget_s: float | None = None
    starts: int | None = None


def best_of(
    problems: Sequence[Problem],
    budget: Budget,
    *,
    library: Sequence[Solved] = (),
    progress: Progress = lambda fraction, text: None,
    watch: Watch = lambda series: None,
    clock: Callable[[], float] = time.monotonic,
) -> Outcome:
    """The best feasible plan found; an interrupt (Ctrl-C) ends the search early and keeps the best.

    Args:
        problems: the same task at different base frequencies; each is tried once, then starts go to the best one.
        budget: of starts or time.
        library: plans solved before; the nearest to each problem is its first start.
        progress: called with the share of the work that is done and a line of text.
        watch: called with each iterate of the solver; KeyboardInterrupt raised in it ends the search.
        clock: seconds, monotonic.
    """
    began, rng = clock(), np.random.default_rng(budget.seed)
    time_budget_s, starts = budget.time_budget_s, budget.starts
    longest, tried = 0.0, 0
    first = len(problems) if time_budget_s is None and starts is None else starts
    with threadpool_limits(limits=1):  # the matrices are small: threads would only wait for each other
        searches = [_Search(problem, watch, library) for problem in problems]
        best = Outcome(searches[0].hover(), float("inf"), 0.0)
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
                share = tried / first if first else used / (time_budget_s or 1.0)
                progress(min(share, 1.0), f"start {tried}: best feasible {best.cost:.5g}")
                if tried >= first if first else used + longest > (time_budget_s or 0.0):
                    break
        except KeyboardInterrupt:
            best = best if np.isfinite(best.cost) else searches[0].fallback(rng)
            best = min([best, *(each.salvaged() for each in searches if each.rough < best.cost)], key=lambda o: o.cost)
            progress(1.0, f"interrupted; best so far {best.cost:.5g}")
        if not np.isfinite(best.cost):
            best = searches[0].fallback(rng)
    bound = min((each.rough * float(np.exp(-ROUGHLY)) for each in searches if np.isfinite(each.rough)), default=np.nan)
    return replace(best, sampled_bound=bound, starts=tried, seconds=clock() - began)


class _Search:
    """Starts on one problem: from the library first, then at random."""

    def __init__(self, problem: Problem, watch: Watch, library: Sequence[Solved]) -> None:
        self._problem = problem
        self._watch: Callable[[Array], None] = lambda unknowns: watch(problem.series(unknowns))
        self._known = scaled_starts(library, problem)
        self._exchange = _Exchange(problem)
        self._program: Program | None = None
        self._found = np.zeros(0)
        self.rough = float("inf")

    def salvaged(self) -> Outcome:
        """The best coarse solution drawn in to keep its limits, where polishing was interrupted."""
        return _judge(self._problem, repair_about_start(self._problem.series(self._found), self._problem, step=1e-4))

    def hover(self) -> FourierSeries:
        """No motion at all, until there is a plan."""
        problem = self._problem
        return inner_motion(problem, np.array(problem.start if problem.start is not None else _middle(problem)))

    def fallback(self, rng: np.random.Generator) -> Outcome:
        """A feasible plan without any optimisation."""
        start = self._problem.series(random_start(self._problem, rng))
        return _judge(self._problem, repair_about_start(start, self._problem, step=1e-4))

    def try_once(self, rng: np.random.Generator) -> Outcome | None:
        """A feasible plan from one more start; None when its coarse solution is no better than those before."""
        problem, exchange = self._problem, self._exchange
        known = self._known.pop(0) if self._known else None
        start = random_start(problem, rng) if known is None else known
        if exchange.add_groups(problem.series(start), slack=_SLACK) or self._program is None:
            self._program = Program(problem, exchange.groups, exchange.coarse, watch=self._watch)
        inner = _inner_unknowns(problem, start)
        inside = self._program.inside(start, inner, _DRAWN if known is None else _SCALED)
        found = self._program.solve(inside, mu=COLD if known is None else WARM, gap=ROUGHLY)
        while exchange.add_groups(problem.series(found)):
            self._program = Program(problem, exchange.groups, exchange.coarse, watch=self._watch)
            inner = _inner_unknowns(problem, found)
            found = self._program.solve(self._program.inside(found, inner, _SCALED), mu=WARM)
        rough = cost(problem.series(found), problem)
        if not rough < self.rough:
            return None
        self.rough, self._found = rough, found
        return _judge(problem, _polish(problem, exchange, found, self._watch))


def _judge(problem: Problem, series: FourierSeries) -> Outcome:
    return Outcome(series, cost(series, problem), largest_violation(series, problem.envelopes))
