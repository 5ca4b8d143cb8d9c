"""Algebra of a joint estimate: its inverse, and the rigid body that a linear step means."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.model.parameters import BASIS, PAIRS

Array = NDArray[np.float64]

WELL_CONDITIONED = 1e9
"""Condition number below which no direction of a scaled joint estimate is near what a pseudo-inverse leaves out (1e12).
"""


def updated_rigid_body(about: Array, step: Array) -> tuple[Array, Array] | None:
    """Mass and tensor, in the order of RIGID_BODY, that a linear step from others means, and their Jacobian by the
    step.

    What a wrench does is linear in the inverses of mass and tensor, d(1/m) = -dm / m0^2 and d(J^-1) = -J0^-1 dJ J0^-1:
    taken in these, a far step lands where one in m and J would not. None where it is as large as what it starts from:
    no rigid body lies there.
    """
    lightness = 1.0 - step[0] / about[0]
    tensor: Array
    change: Array
    tensor, change = (np.einsum("k,kij->ij", values[1:], BASIS) for values in (about, step))
    left = tensor - change
    if lightness <= 0.0 or np.linalg.eigvalsh(left)[0] <= 0.0:
        return None
    turn = tensor @ np.linalg.inv(left)
    jacobian = np.zeros((7, 7))
    jacobian[0, 0] = lightness**-2
    rows, columns = np.array(PAIRS).T
    jacobian[1:, 1:] = (turn @ BASIS @ turn.T)[:, rows, columns].T
    return np.array([about[0] / lightness, *(turn @ tensor)[rows, columns]]), jacobian


def pseudo_inverse(matrix: Array, scale: Array) -> Array:
    """The pseudo-inverse, (p, p), small and large told in units of ``scale``; the plain inverse where nothing is small.

    The plain one is several times cheaper. A bound on the condition number (1-norms) decides.
    """
    outer = np.outer(scale, scale)
    scaled = matrix / outer
    try:
        inverse = np.linalg.inv(scaled)
    except np.linalg.LinAlgError:
        inverse = np.full_like(scaled, np.inf)
    if not np.linalg.norm(inverse, 1) * np.linalg.norm(scaled, 1) < WELL_CONDITIONED:
        inverse = np.linalg.pinv(scaled, rcond=1e-12)
    return inverse / outer
