r"""What the formulas of found effects leave open in mass and tensor: a part of the interval that no noise tells.

An effect's formula may miss a share :math:`\epsilon` (``form_error_share``) of its amplitude. Left out altogether the
effect moves the base by :math:`b_v = \theta - \theta_{-v}` (omitted variables); what is missing of it in its own shape
moves the base by :math:`\epsilon b_v`. What is missing in any other shape acts as noise of the same size: an effect
whose whitened energy is E over n rows adds :math:`\epsilon^2 E / n` to a variance that is one, and so that share of the
base's covariance. Effects err independently of each other:

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
from groundstation.model.parameters import RIGID_BODY

Array = NDArray[np.float64]


def form_covariance(evidence: Evidence, chosen: Sequence[tuple[Candidate, Columns]], solution: Solution) -> Array:
    """Covariance (7, 7), in the order of RIGID_BODY, that the chosen effects' formulas add to a joint estimate's mass
    and tensor.

    Args:
        chosen: the effects of the joint estimate, in its order.
        solution: the joint estimate, linear about the base.
    """
    index = [evidence.names.index(name) for name in RIGID_BODY]
    own = solution.covariance[np.ix_(index, index)]
    total = np.zeros((len(index), len(index)))
    first = 0
    for number, (candidate, columns) in enumerate(chosen):
        count = len(candidate.effect.parameters)
        effect = columns.sensitivity @ solution.part(first, count)[0]
        first += count
        rest = evidence.solve([entry for other, entry in enumerate(chosen) if other != number])
        moved = solution.theta[index] - rest.theta[index]
        total += np.outer(moved, moved) + own * float(np.mean(effect**2))
    return THRESHOLDS.form_error_share**2 * total
