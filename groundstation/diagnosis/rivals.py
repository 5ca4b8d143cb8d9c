"""What may contest a place among findings, how large and how likely it has to be, and which of several sets to go on
with.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.columns import Candidate, Columns
from groundstation.diagnosis.effect import Effect, Settings
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.thresholds import THRESHOLDS

Array = NDArray[np.float64]
Entry = tuple[Candidate, Columns]
Kind = tuple[str, float | None]
"""An effect, and of which rotor: what a finding names, whatever its instant or length."""

INSTANTS = frozenset({"at_s", "from_s"})
"""Settings that are instants."""


def kind_of(entry: Entry) -> Kind:
    """What a candidate would name."""
    candidate, _ = entry
    return candidate.identifier, candidate.settings.get("rotor")


def began_once(entry: Entry) -> bool:
    """Whether an instant of a candidate was looked for."""
    return bool(INSTANTS.intersection(entry[0].settings))


def preferred(sets: Sequence[Sequence[Entry]], scores: Sequence[float], misfit: float) -> int:
    """Which set to go on with: the first, unless another explains clearly more, or more with fewer numbers, or as much
    with fewer instants that were looked for.

    What the formulas of the first may leave (``form_error_share`` of their amplitude) is no reason to prefer another.
    Of two explanations that are not told apart the one with fewer numbers is the likelier (Schwarz 1978): a steady
    wrench of five holds the mean of what one weak rotor beside an offset of the centre of mass does with three.
    """
    best = int(np.argmax(scores))
    if scores[best] - scores[0] > clearly(scores[0]) * misfit:
        return best
    numbers = [_numbers(chosen) for chosen in sets]
    leaner = [i for i, score in enumerate(scores) if score > scores[0] and numbers[i] < numbers[0]]
    if leaner:
        return max(leaner, key=lambda index: scores[index])
    instants = [sum(map(began_once, chosen)) for chosen in sets]
    simpler = [
        index
        for index, chosen in enumerate(sets)
        if scores[index] > scores[0] - THRESHOLDS.inseparable * misfit
        and len(chosen) == len(sets[0])
        and instants[index] < instants[0]
    ]
    return max(simpler, key=lambda index: scores[index], default=0)


def clearly(score: float) -> float:
    """By how much another explanation has to beat one of this score: by what noise could do, and by what the formulas
    of this one may miss.
    """
    return max(THRESHOLDS.inseparable, THRESHOLDS.form_error_share**2 * score)


def _numbers(chosen: Sequence[Entry]) -> int:
    """How many numbers a set takes from the flight: parameters, and instants that were looked for."""
    return sum(len(entry[0].effect.parameters) + began_once(entry) for entry in chosen)


def has_changes(effect: Effect) -> bool:
    """Whether some of an effect's parameters are changes of its settings."""
    return any(parameter.changes for parameter in effect.parameters)


def nearby(evidence: Evidence, baseline: Sequence[Entry], chosen: Sequence[Entry], index: int) -> list[Settings]:
    """Settings to try in the place of a member's: finer ones, and those that its changes of settings point at."""
    effect, settings = chosen[index][0].effect, chosen[index][0].settings
    found = list(effect.finer(settings))
    if has_changes(effect):
        before = [*baseline, *chosen[:index]]
        offset = sum(len(candidate.effect.parameters) for candidate, _ in before)
        values = evidence.solve([*baseline, *chosen]).part(offset, len(effect.parameters))[0]
        found.append(effect.settled(settings, values))
    return found


def in_settings(evidence: Evidence, others: Sequence[Entry], entry: Entry, settings: Settings) -> Entry:
    """A member in other settings. What else these let be estimated of it is, where it is told by more than twice its
    number of parameters (Akaike 1974): less would make a prediction worse.
    """
    effect = entry[0].effect
    for form in (effect.of(settings), effect):
        candidate = Candidate(form, settings)
        columns = evidence.columns(candidate)
        more = range(len(effect.parameters), len(form.parameters))
        if columns is None:
            continue
        if not more:
            return candidate, columns
        first = sum(len(other.effect.parameters) for other, _ in others)
        if evidence.solve([*others, (candidate, columns)]).wald(first, more) > 2.0 * len(more):
            return candidate, columns
    return entry


def material(evidence: Evidence, columns: Columns, values: Array) -> bool:
    """Whether an effect of these values is large enough to matter to anyone."""
    return bool(share_of(columns.wrench_rms @ np.abs(values) / evidence.scale) > THRESHOLDS.material_share)


def share_of(size: Array) -> Array:
    """The larger of a force and a torque by the RMS of their components (..., 6), whichever way the axes point."""
    return np.maximum(np.linalg.norm(size[..., :3], axis=-1), np.linalg.norm(size[..., 3:], axis=-1))


def plausible(candidate: Candidate, values: Array, covariance: Array) -> bool:
    """Values within the physical range, some standard deviations beyond it allowed."""
    std = np.sqrt(np.diag(covariance))
    ranges = [p.plausible for p in candidate.effect.parameters]
    margin = THRESHOLDS.plausible_margin_std
    return all(
        low - margin * s <= v <= high + margin * s for v, s, (low, high) in zip(values, std, ranges, strict=True)
    )


def posterior(rivals: Sequence[float]) -> float:
    """Share of an explanation among rivals (chance is one) whose evidence stands this far from its own, as chi
    squared.
    """
    return float(1.0 / (1.0 + np.sum(np.exp(0.5 * np.clip(rivals, -200.0, 0.0)))))
