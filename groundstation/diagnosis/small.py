r"""What a small effect has to show beside larger ones, where their formulas may leave as much as it explains.

:mod:`.discrepancy` allows the formulas of others to miss a share of their amplitude in whatever shape looks most like
the effect in question: none of less than a hundredth of their energy stands beside them. Two things are known of what a
formula misses, though. It takes a form: it goes with a power of the speed, the height, the thrust or the rates, or acts
on one axis (:mod:`.left_open`). Those are estimated along, and an effect in such a shape goes into them. And a formula
that misses something else leaves that in no effect's shape alone: it shows in the residual. So the mean square r of
what is left in the channels and bands where the effect lives is the variance that it is judged by,

.. math:: W_f / \max(1, r) > w,

with :math:`W_f` the Wald statistic beside the forms and w what chance passes too rarely: an F test, whose threshold
knows already how few values lie in those bands (:meth:`.Evidence.threshold`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.beside import beside
from groundstation.diagnosis.columns import Candidate, Columns
from groundstation.diagnosis.discrepancy import Discrepancy, allowance, allowance_by_band
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.left_open import forms_of
from groundstation.diagnosis.rivals import Entry, Kind
from groundstation.diagnosis.thresholds import THRESHOLDS

Array = NDArray[np.float64]
Threshold = Callable[[Candidate, Columns, Sequence[int]], float]
"""Wald statistic of some parameters of an entry that chance passes too rarely."""


class SmallEffects:
    """Those of a selection.

    Args:
        lag: what rotor lag beyond the declared one does, (rows,). It has no forms, so that what its formula may leave
            is allowed as in :mod:`.discrepancy`, and no more than in its own frequencies.
        kinds: what stands so already.
    """

    def __init__(
        self, evidence: Evidence, discrepancy: Discrepancy, lag: Array, threshold: Threshold, kinds: Iterable[Kind]
    ):
        self.kinds = set(kinds)
        self._evidence, self._discrepancy, self._threshold = evidence, discrepancy, threshold
        self._lag, self._lag_bands = discrepancy.by_channel(lag), evidence.power(lag) if lag.any() else lag
        self._margins: dict[tuple[frozenset[int], int], float] = {}
        self._forms: dict[int, list[Entry]] = {}

    def margins(self, others: Sequence[Entry], entries: Sequence[Entry]) -> list[float]:
        """By how much each of several entries beats chance beside the forms of others; -inf where it is implausible
        then.

        Args:
            others: what is there in any case and what was chosen, without any of the entries.
        """
        there = frozenset(columns.number for _, columns in others)
        new = [entry for entry in entries if (there, entry[1].number) not in self._margins]
        if new:
            found = margins_beside_forms(self._evidence, others, self._forms_beside(others), new, self._threshold)
            left = [margin - self._left_by_lag(others, entry) for margin, entry in zip(found, new, strict=True)]
            self._margins |= {(there, entry[1].number): m for entry, m in zip(new, left, strict=True)}
        return [self._margins[there, columns.number] for _, columns in entries]

    def _left_by_lag(self, others: Sequence[Entry], entry: Entry) -> float:
        if not self._lag.any():
            return 0.0
        values = self._evidence.solve([*others, entry]).theta[-len(entry[0].effect.parameters) :]
        own = self._evidence.power(entry[1].instrument @ values * np.sqrt(self._evidence.weight))
        by_channel = allowance(self._discrepancy.energy(entry[1], values), self._lag)
        return min(by_channel, allowance_by_band(own, self._lag_bands))

    def _forms_beside(self, others: Sequence[Entry]) -> list[Entry]:
        """The forms of those whose formula may leave more than noise does; of each by the size that it first had."""
        solution, first = self._evidence.solve(others), 0
        out: list[Entry] = []
        for candidate, columns in others:
            count = len(candidate.effect.parameters)
            values = solution.part(first, count)[0]
            first += count
            if columns.number not in self._forms:
                missed = THRESHOLDS.form_error_share**2 * self._discrepancy.energy(columns, values).sum()
                shown = missed > 1.0
                self._forms[columns.number] = list(forms_of(self._evidence, candidate, values)) if shown else []
            out += self._forms[columns.number]
        return out


def margins_beside_forms(
    evidence: Evidence,
    others: Sequence[Entry],
    forms: Sequence[Entry],
    entries: Sequence[Entry],
    threshold: Threshold,
) -> list[float]:
    """By how much each of several entries beats chance where the forms of the others are estimated along; -inf where it
    is implausible then.

    Args:
        others: what is there in any case and what was chosen, without any of the entries. forms: of these.
    """
    there = [*others, *forms]
    out = [-np.inf] * len(entries)
    for found in beside(evidence, there, entries):
        for index, wald, right in zip(found.index, found.walds(), found.plausible(), strict=True):
            if not right:
                continue
            entry = entries[index]
            rest = evidence.remainder([*there, entry], evidence.solve([*there, entry]))
            left = evidence.mean_square(rest, entry[1])
            out[index] = float(wald) / max(1.0, left) - threshold(*entry, found.telling)
    return out
