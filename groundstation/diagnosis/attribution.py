"""Which effects the evidence asks for: forward selection with backward checks, rivals told, chance excluded."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.effect import Effect, library
from groundstation.diagnosis.evidence import Candidate, Columns, Evidence, Solution
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

CHANCE = 1e-5
"""Chance that noise alone would name an effect, shared by its variants; fixed before any study was run."""
INSEPARABLE = 9.0
"""Two explanations whose evidence differs by less than this (three standard deviations) are not told apart."""
MATERIAL = 1e-3
"""Least RMS of an effect that is a finding, as a share of weight (forces) or of weight times arm (torques)."""
MOST = 6


@dataclass(frozen=True, slots=True)
class Named:
    """A candidate that stands, with the evidence for it and the rivals that explain as much."""

    candidate: Candidate
    columns: Columns
    evidence: float
    alternatives: tuple[str, ...]
    confidence: float


def candidates(vehicle: Vehicle, signals: Signals, effects: Iterable[Effect] | None = None) -> list[Candidate]:
    """Every effect that applies, in every variant."""
    chosen = library().values() if effects is None else effects
    return [
        Candidate(effect, settings)
        for effect in chosen
        if effect.applies(vehicle)
        for settings in effect.variants(signals, vehicle)
    ]


def threshold(candidate: Candidate, variants: int) -> float:
    """Wald statistic that chance passes with probability CHANCE, for this many parameters and variants."""
    from scipy.stats import chi2

    return float(chi2.isf(CHANCE / max(variants, 1), len(candidate.effect.parameters)))


def material(evidence: Evidence, columns: Columns, values: Array) -> bool:
    """Whether an effect of these values is large enough to matter to anyone."""
    vehicle = evidence.flights[0].prepared.record.vehicle
    weight = vehicle.mass_kg * vehicle.gravity_m_s2
    size = np.abs(columns.wrench_rms @ np.abs(values))
    scale = np.array([weight] * 3 + [weight * vehicle.arm_m()] * 3)
    return bool(np.any(size / scale > MATERIAL))


def plausible(candidate: Candidate, values: Array, covariance: Array) -> bool:
    """Values within the physical range, two standard deviations allowed."""
    std = np.sqrt(np.diag(covariance))
    ranges = [p.plausible for p in candidate.effect.parameters]
    return all(low - 2.0 * s <= v <= high + 2.0 * s for v, s, (low, high) in zip(values, std, ranges, strict=True))


class Selection:
    """Forward selection over columns computed once."""

    def __init__(
        self,
        evidence: Evidence,
        pool: Sequence[Candidate],
        baseline: Sequence[tuple[Candidate, Columns]] = (),
        progress: Callable[[float], None] = lambda fraction: None,
    ):
        self.evidence = evidence
        self.baseline = list(baseline)
        self.pool: list[tuple[Candidate, Columns]] = []
        for number, candidate in enumerate(pool):
            columns = evidence.columns(candidate)
            if (
                columns is not None
                and np.any(columns.wrench_rms > 0.0)
                and np.all(np.any(columns.sensitivity != 0.0, axis=0))
            ):
                self.pool.append((candidate, columns))
            progress((number + 1) / len(pool))
        self.variants = {c.identifier: sum(o.identifier == c.identifier for o, _ in self.pool) for c, _ in self.pool}

    def _score(self, chosen: Sequence[tuple[Candidate, Columns]]) -> tuple[float, Solution]:
        """Evidence of a set beyond chance: joint Wald statistic less each member's threshold."""
        solution = self.evidence.solve([*self.baseline, *chosen])
        first = sum(len(c.effect.parameters) for c, _ in self.baseline)
        count = sum(len(c.effect.parameters) for c, _ in chosen)
        cost = sum(threshold(c, self.variants[c.identifier]) for c, _ in chosen)
        return (solution.wald(first, count) - cost if count else 0.0), solution

    def _stands(self, chosen: Sequence[tuple[Candidate, Columns]], index: int, solution: Solution) -> float:
        """Margin of one member over chance in the joint estimate; -inf if implausible or immaterial."""
        first = sum(len(c.effect.parameters) for c, _ in [*self.baseline, *chosen[:index]])
        candidate, columns = chosen[index]
        count = len(candidate.effect.parameters)
        values, covariance = solution.part(first, count)
        if not plausible(candidate, values, covariance) or not material(self.evidence, columns, values):
            return -np.inf
        return solution.wald(first, count) - threshold(candidate, self.variants[candidate.identifier])

    def _best_addition(self, chosen: list[tuple[Candidate, Columns]]) -> tuple[float, tuple[Candidate, Columns] | None]:
        taken = {c.identifier for c, _ in chosen}
        best, found = 0.0, None
        for entry in self.pool:
            if entry[0].identifier in taken:
                continue
            trial = [*chosen, entry]
            _, solution = self._score(trial)
            margin = self._stands(trial, len(trial) - 1, solution)
            if margin > best:
                best, found = margin, entry
        return best, found

    def run(self) -> tuple[list[Named], Solution]:
        """Select, prune, swap, and name the rivals."""
        chosen: list[tuple[Candidate, Columns]] = []
        for _ in range(MOST):
            _, entry = self._best_addition(chosen)
            if entry is None or self.held_out_gain(chosen, entry) <= 0.0:
                break
            chosen.append(entry)
            chosen = self._pruned(self._swapped(chosen))
        score, solution = self._score(chosen)
        named = []
        for index, (candidate, columns) in enumerate(chosen):
            rivals = self._rivals(chosen, index, score)
            margin = self._stands(chosen, index, solution)
            odds = [0.5 * (rival - score) for _, rival in rivals]
            alternatives = tuple(dict.fromkeys(name for name, rival in rivals if rival > score - INSEPARABLE))
            total = 1.0 + np.exp(-0.5 * min(margin, 200.0)) + float(np.sum(np.exp(np.clip(odds, -200.0, 0.0))))
            named.append(Named(candidate, columns, margin, alternatives, float(1.0 / total)))
        named.sort(key=lambda n: -n.evidence)
        order = [(n.candidate, n.columns) for n in named]
        return named, self._score(order)[1]

    def _pruned(self, chosen: list[tuple[Candidate, Columns]]) -> list[tuple[Candidate, Columns]]:
        while len(chosen) > 1:
            _, solution = self._score(chosen)
            margins = [self._stands(chosen, i, solution) for i in range(len(chosen))]
            worst = int(np.argmin(margins))
            if margins[worst] > 0.0:
                break
            chosen = chosen[:worst] + chosen[worst + 1 :]
        return chosen

    def _swapped(self, chosen: list[tuple[Candidate, Columns]]) -> list[tuple[Candidate, Columns]]:
        """Replace a member by whatever serves the set better, the last added excepted (it was the best already)."""
        for index in range(len(chosen) - 1):
            score, _ = self._score(chosen)
            others = {c.identifier for i, (c, _) in enumerate(chosen) if i != index}
            for entry in self.pool:
                if entry[0].identifier in others or entry is chosen[index]:
                    continue
                trial = [*chosen[:index], entry, *chosen[index + 1 :]]
                other, solution = self._score(trial)
                if other > score and self._stands(trial, index, solution) > 0.0:
                    score, chosen = other, trial
        return chosen

    def _rivals(self, chosen: list[tuple[Candidate, Columns]], index: int, score: float) -> list[tuple[str, float]]:
        best: dict[str, float] = {}
        others = {c.identifier for c, _ in chosen}
        for entry in self.pool:
            if entry[0].identifier in others:
                continue
            trial = [*chosen[:index], entry, *chosen[index + 1 :]]
            other, solution = self._score(trial)
            if other > score - 30.0 and self._stands(trial, index, solution) > -np.inf:
                best[entry[0].identifier] = max(other, best.get(entry[0].identifier, -np.inf))
        return sorted(best.items(), key=lambda item: -item[1])

    def held_out_gain(self, chosen: Sequence[tuple[Candidate, Columns]], entry: tuple[Candidate, Columns]) -> float:
        """Fall of the whitened squared residual on blocks no estimate saw, guard gaps left out, when ``entry`` is added."""
        before = [*self.baseline, *chosen]
        after = [*before, entry]
        gain = 0.0
        for train, test in folds(self.evidence):
            old = self.evidence.remainder(before, self.evidence.solve(before, train))[test]
            new = self.evidence.remainder(after, self.evidence.solve(after, train))[test]
            w = self.evidence.weight[test]
            gain += float(np.sum(w * (old**2 - new**2)))
        return gain


def folds(
    evidence: Evidence, count: int = 6, guard_s: float = 1.5
) -> list[tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
    """Train and test rows for blocks of time, the guard around each test block left out of training."""
    times, _, flights = evidence.time_of_rows()
    out = []
    starts = {n: times[flights == n].min() for n in np.unique(flights)}
    spans = {n: np.ptp(times[flights == n]) for n in np.unique(flights)}
    relative = np.array([times - np.vectorize(starts.get)(flights)])[0]
    span = np.vectorize(spans.get)(flights)
    for index in range(count):
        low, high = index * span / count, (index + 1) * span / count
        test = (relative >= low) & (relative < high)
        train = (relative < low - guard_s) | (relative >= high + guard_s)
        out.append((train, test))
    return out
