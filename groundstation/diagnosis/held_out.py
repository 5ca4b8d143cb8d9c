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
    whole = (0, 0.0)  # no block and no guard
    if whole not in evidence.folds:
        evidence.folds[whole] = [(flights != number, flights == number) for number in range(evidence.suspects)]
    return evidence.folds[whole]


def folds(
    evidence: Evidence, count: int = THRESHOLDS.held_out_blocks, guard_s: float = THRESHOLDS.held_out_guard_s
) -> list[tuple[Rows, Rows]]:
    """Train and test rows for blocks of time, the guard around each test block left out of training; the same ones
    whenever they are asked for.
    """
    if (count, guard_s) not in evidence.folds:
        evidence.folds[count, guard_s] = _folds(evidence, count, guard_s)
    return evidence.folds[count, guard_s]


def _folds(evidence: Evidence, count: int, guard_s: float) -> list[tuple[Rows, Rows]]:
    times, _, flights = evidence.time_of_rows()
    out: list[tuple[Rows, Rows]] = []
    owns = [times[flights == number] for number in range(len(evidence.flights))]
    relative = times - np.array([own.min() for own in owns])[flights]
    span = np.array([np.ptp(own) for own in owns])[flights]
    for index in range(count):
        low, high = index * span / count, (index + 1) * span / count
        test = (relative >= low) & (relative < high)
        train = (relative < low - guard_s) | (relative >= high + guard_s)
        out.append((train, test))
    return out
