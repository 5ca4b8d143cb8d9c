"""What an effect's formula may get wrong of the effect itself, before anything else is blamed for it.

A model of the library is an expansion about hover, right to a share of (``form_error_share``) what it describes. On a
quiet flight the rest of a large effect beats chance by far, and would be named as a second effect of the same shape, or
pass for something unknown. So whatever is claimed beside other effects has to explain more than that share of their
amplitude in the channels it acts on.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.beside import Beside
from groundstation.diagnosis.columns import Candidate, Columns, Solution
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.identification.parts import by_parts, coefficients, sizes
from groundstation.identification.record_model import CHANNELS
from groundstation.model.parameters import FREE

Array = NDArray[np.float64]


class Discrepancy:
    """Whitened energy of effects by channel, less what mass and tensor absorb of them."""

    def __init__(self, evidence: Evidence):
        self._evidence = evidence
        _, self._channels, _ = evidence.time_of_rows()
        self._base = evidence.table.of_base()
        self._absorbing: Array = np.linalg.inv(self._base.sum(axis=0) + evidence.prior)
        self._grams: dict[int, Array] = {}

    def _gram(self, columns: Columns) -> Array:
        """Products (6, p, p) of what the base leaves of a candidate's columns."""
        if columns.number not in self._grams:
            crossed, own = self._evidence.table.by_channel(columns)
            taken = self._absorbing @ crossed.sum(axis=0)
            across = taken.T @ crossed
            self._grams[columns.number] = own - across - across.transpose(0, 2, 1) + taken.T @ self._base @ taken
        return self._grams[columns.number]

    def energy(self, columns: Columns, values: Array) -> Array:
        """Squared whitened size of an effect of these values by channel, shape (6,)."""
        return np.einsum("i,cij,j->c", values, self._gram(columns), values)

    def energy_of_each(self, found: Beside) -> Array:
        """The same of each of several, shape (several, 6)."""
        grams = np.stack([self._gram(columns) for _, columns in found.entries])
        return np.einsum("mi,mcij,mj->mc", found.values, grams, found.values)

    def of_lag(self, solution: Solution) -> Array:
        """Of rotor lag and dead time beyond what is declared, shape (6,): a first-order lag is a formula, too."""
        return self.by_channel(self.lag(solution))

    def by_channel(self, values: Array) -> Array:
        """Sum of squares of whitened rows, (6,)."""
        return np.array([float(np.sum(values[self._channels == channel] ** 2)) for channel in range(len(CHANNELS))])

    def lag(self, solution: Solution) -> Array:
        """What they do, less what mass and tensor absorb of it, whitened, (rows,)."""
        first = self._evidence.flights[0]
        vehicle, names = first.prepared.record.vehicle, self._evidence.names
        timing = {e.name: e for e in FREE if e.timing and e.declared is not None and e.name in names}
        if "rotor_lag_up_s" not in timing:
            return np.zeros(len(self._channels))
        index = [names.index(name) for name in timing]
        found = [e.get(first.parameters) - e.declared(vehicle) for e in timing.values() if e.declared is not None]
        kept = [i for i in range(len(names)) if i not in index]
        values = np.array(found) + solution.theta[index]
        z, root = self._evidence.z, np.sqrt(self._evidence.weight)
        moved: Array = z[:, index] @ values

        def rest(rows: slice) -> Array:
            return z[rows][:, kept] * root[rows, None]

        scale = sizes(rest, len(z)) + 1e-30
        shown = coefficients(
            lambda rows: np.column_stack([rest(rows) / scale, moved[rows] * root[rows]]), len(z), rcond=1e-8
        )
        return by_parts(lambda rows: moved[rows] * root[rows] - rest(rows) / scale @ shown, len(z))

    def energies(self, chosen: Sequence[tuple[Candidate, Columns]], solution: Solution, first: int = 0) -> Array:
        """Of each member of a joint estimate, shape (members, 6); ``first`` parameters of others stand before
        theirs.
        """
        out = np.zeros((len(chosen), len(CHANNELS)))
        for index, (candidate, columns) in enumerate(chosen):
            count = len(candidate.effect.parameters)
            out[index] = self.energy(columns, solution.part(first, count)[0])
            first += count
        return out


def allowance_by_band(own: Array, others: Array) -> float:
    """The most that a share ``form_error_share`` of others' amplitude in each band can do for an effect, both in step
    in all of them (Cauchy and Schwarz).

    What a formula misses of a linear effect lies in the frequencies of that effect: a lag leaves nothing to a steady
    torque.

    Args:
        own, others: sum of squares by band, (bands,).
    """
    total = float(own.sum())
    return THRESHOLDS.form_error_share**2 * float(np.sqrt(own * others).sum()) ** 2 / total if total > 0.0 else 0.0


def allowance(own: Array, others: Array) -> float:
    """Evidence the formulas of other effects may leave to one whose energy lies in certain channels.

    Args:
        own: energy by channel of the effect in question, shape (6,).
        others: of all the others together, shape (6,).
    """
    total = float(own.sum())
    return THRESHOLDS.form_error_share**2 * float(own @ others) / total if total > 0.0 else 0.0
