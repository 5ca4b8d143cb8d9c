"""Algebra of a joint estimate: Fuller's, and the rigid body that a linear step means."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.model.parameters import BASIS, PAIRS

Array = NDArray[np.float64]

WELL_CONDITIONED = 1e9
"""Condition number below which no direction of a scaled joint estimate is near what a pseudo-inverse leaves out (1e12).
"""

FULLER = 1.0
"""Fuller's constant: one makes his estimate unbiased to the order of one over the instruments' strength."""


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


@dataclass(frozen=True, slots=True)
class Products:
    """Sums of products over whitened rows, of sensitivities x and instruments z (p columns each) and the output y.

    Of many joint estimates at once a leading axis counts them.

    Attributes:
        zx, zz, xx: (p, p). zy, xy: (p,).
        rows: how many.
    """

    zx: Array
    zz: Array
    xx: Array
    zy: Array
    xy: Array
    rows: int

    def with_prior(self, precision: Array) -> Products:
        """The same with a prior of zero mean and this precision (p, p) as further rows, instruments of their own."""
        return replace(self, zx=self.zx + precision, zz=self.zz + precision, xx=self.xx + precision)


def estimated(found: Products) -> tuple[Array, Array]:
    r"""Fuller's estimate (p,) and its covariance (p, p), where the noise of the rows has variance one.

    With one instrument for each parameter (:math:`P` projects on what all of them span, :math:`M = 1 - P`) the plain
    instrumental estimate makes :math:`|P (y - X \theta)|` zero. It has no moments (Kinal 1980): along a direction whose
    instruments are weak it divides by next to nothing, and what the model lacks takes it anywhere. Fuller's (1977,
    Econometrica 45(4), with :math:`\alpha = 1`) minimises

    .. math:: (1 - s) |P (y - X \theta)|^2 + s |y - X \theta|^2, \qquad s = \alpha / (n - p).

    It has all moments, and is unbiased to the order of one over the instruments' strength :math:`F = n \rho^2 / (1 -
    \rho^2)`, with :math:`\rho` the canonical correlation of instruments and sensitivities along a direction (Cragg and
    Donald 1993; Stock and Yogo 2005). Where F is large it is the plain estimate less 1/F of what separates that from
    least squares. Where F is nothing it is least squares, with the deviation that a single row would leave. In units of
    that deviation the bias of feedback is the correlation of regressor and noise over :math:`\sqrt{1 + F}`: never more
    than one.
    """
    share = FULLER / max(found.rows - found.zx.shape[-1], 1)
    through = (1.0 - share) * np.swapaxes(found.zx, -1, -2) @ pseudo_inverse(found.zz)
    covariance = pseudo_inverse(through @ found.zx + share * found.xx)
    right = through @ found.zy[..., None] + share * found.xy[..., None]
    return (covariance @ right)[..., 0], covariance


def strengths(found: Products) -> Array:
    """F of the instruments of each parameter beside all others, (p,), from Shea's (1997) partial R squared.

    That is the variance that least squares would have over that of the plain instrumental estimate (Godfrey 1999). Ten
    is the least by which an estimate is commonly believed (Staiger and Stock 1997; Stock and Yogo 2005).
    """
    plain = np.diag(pseudo_inverse(found.zx.T @ pseudo_inverse(found.zz) @ found.zx))
    share = np.clip(np.diag(pseudo_inverse(found.xx)) / np.maximum(plain, 1e-300), 0.0, 1.0 - 1e-9)
    return found.rows * share / (1.0 - share)


def pseudo_inverse(matrix: Array) -> Array:
    """The pseudo-inverse of a symmetric matrix, (p, p), or of each of many, (many, p, p), in units in which its
    diagonal is one; the plain inverse where nothing is small.

    The plain one is several times cheaper. A bound on the condition number (1-norms) decides.
    """
    scale = np.sqrt(np.diagonal(matrix, axis1=-2, axis2=-1))
    scale = np.where(scale == 0.0, 1.0, scale)  # what no row is of stays as it is
    outer = scale[..., :, None] * scale[..., None, :]
    scaled = matrix / outer
    try:
        inverse = np.linalg.inv(scaled)
    except np.linalg.LinAlgError:
        if matrix.ndim > 2:
            return np.stack([pseudo_inverse(one) for one in matrix])
        inverse = np.full_like(scaled, np.inf)
    norms = (np.abs(each).sum(axis=-2).max(axis=-1) for each in (inverse, scaled))
    near = ~(np.prod(list(norms), axis=0) < WELL_CONDITIONED)
    if near.any():
        inverse[near] = np.linalg.pinv(scaled[near], rcond=1e-12, hermitian=True)
    return 0.5 * (inverse + np.swapaxes(inverse, -1, -2)) / outer
