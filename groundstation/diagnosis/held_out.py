"""What a finding is judged on: data that no estimate saw."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.thresholds import THRESHOLDS

WHOLE_FLIGHTS = 3
"""Flights from which each is held out as a whole: two are left to estimate from, whose wind, battery and clock it does
not share.
"""

Rows = NDArray[np.bool_]


def held_out(evidence: Evidence) -> list[tuple[Rows, Rows]]:
    """Train and test rows: each flight by all others where there are three or more, else blocks of time by the rest.

    Blocks of one flight share its wind, battery and clock; what is learnt of these helps on other blocks, and on no
    other flight.
    """
    if evidence.suspects < WHOLE_FLIGHTS:
        return folds(evidence)
    _, _, flights = evidence.time_of_rows()
    return [(flights != number, flights == number) for number in range(evidence.suspects)]


def folds(
    evidence: Evidence, count: int = THRESHOLDS.held_out_blocks, guard_s: float = THRESHOLDS.held_out_guard_s
) -> list[tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
    """Train and test rows for blocks of time, the guard around each test block left out of training."""
    times, _, flights = evidence.time_of_rows()
    out: list[tuple[NDArray[np.bool_], NDArray[np.bool_]]] = []
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
