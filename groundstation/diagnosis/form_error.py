r"""What the formulas of found effects leave open in a joint estimate: a part of its intervals that no noise tells.

An effect's formula may miss a share :math:`\epsilon` (``form_error_share``) of its amplitude. Left out altogether the
effect moves the other parameters by :math:`b_v = \theta - \theta_{-v}` (omitted variables); what is missing of it in
its own shape moves them by :math:`\epsilon b_v`. What is missing in any other shape acts as noise of the same size: an
effect whose whitened energy is E over n rows adds :math:`\epsilon^2 E / n` to a variance that is one, and so that share
of the covariance. Effects err independently of each other:

.. math:: \Sigma = \Sigma_0 \left(1 + \epsilon^2 \sum_v E_v / n\right) + \epsilon^2 \sum_v b_v b_v^T

Brynjarsdottir and O'Hagan 2014 (Inverse Problems 30) show what an interval without such a term is worth.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.columns import Candidate, Columns, Solution
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.thresholds import THRESHOLDS

Array = NDArray[np.float64]


def form_covariance(evidence: Evidence, chosen: Sequence[tuple[Candidate, Columns]], solution: Solution) -> Array:
    """Covariance (p, p), in the order of a joint estimate, that the chosen effects' formulas add to it.

    An effect's own parameters are its size by its formula: what this is short of by a factor is not theirs.

    Args:
        chosen: the effects of the joint estimate, in its order.
        solution: the joint estimate, linear about the base.
    """
    total = np.zeros_like(solution.covariance)
    first = 0
    for number, (candidate, columns) in enumerate(chosen):
        count = len(candidate.effect.parameters)
        effect = columns.sensitivity @ solution.part(first, count)[0]
        others = np.delete(np.arange(len(solution.theta)), solution.base + first + np.arange(count))
        first += count
        rest = evidence.solve([entry for other, entry in enumerate(chosen) if other != number])
        moved = solution.theta[others] - rest.theta
        total[np.ix_(others, others)] += np.outer(moved, moved)
        total += solution.covariance * float(np.mean(effect**2))
    return THRESHOLDS.form_error_share**2 * total
