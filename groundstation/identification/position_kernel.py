"""The likelihood of position errors under eight noises at once, one in each lane of a vector register (see
:mod:`.noise_kernel`).

The filter is that of :func:`.smoothing.position_filter`; only the cost of its innovations is kept.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from groundstation.identification.noise_kernel import LANES, LOGARITHM_EVERY

Array = NDArray[np.float64]

LARGEST = 25.0
"""Squared innovation, in units of its variance, beyond which an outlier costs no more."""
FREE = 3
"""Samples that only initialise."""
PLACE, SPEED, PUSH = (LANES * 3 * row for row in range(3))
P00, P01, P02, P11, P12, P22, A, B, R, COST, PRODUCT, SQUARES, K0, K1, K2, ROWS = (
    LANES * (9 + row) for row in range(16)
)
"""Where the rows begin: states of three axes; covariances; densities and the poses' variance; the cost; what squares
count and the gains of a step.
"""


@njit(cache=True, error_model="numpy")
def _prepared(noises: Array, first: Array) -> Array:
    s = np.zeros(ROWS)
    for lane in range(LANES):
        r, qv, qa, a0 = noises[min(lane, len(noises) - 1)]
        for axis in range(3):
            s[PLACE + axis * LANES + lane] = first[axis]
        s[A + lane], s[B + lane], s[R + lane], s[PRODUCT + lane] = qv * qv, qa * qa, r * r, 1.0
        s[P00 + lane], s[P11 + lane], s[P22 + lane] = r * r, 25.0, a0 * a0
    return s


@njit(cache=True, error_model="numpy")
def _covariances(s: Array, h: float, counts: bool) -> None:
    """Predicted and corrected covariances, gains, and the product of variances."""
    g, h2, h3 = 0.5 * h * h, h * h, h * h * h
    h4, h5 = h2 * h2 / 8.0, h3 * h2 / 20.0
    for n in range(LANES):
        p00, p01, p02, p11, p12, p22 = s[P00 + n], s[P01 + n], s[P02 + n], s[P11 + n], s[P12 + n], s[P22 + n]
        a, b, r2 = s[A + n], s[B + n], s[R + n]
        f00, f01, f02 = p00 + h * p01 + g * p02, p01 + h * p11 + g * p12, p02 + h * p12 + g * p22
        f11, f12 = p11 + h * p12, p12 + h * p22
        p00 = f00 + h * f01 + g * f02 + a * (h3 / 3.0) + b * h5
        p01 = f01 + h * f02 + a * (h2 / 2.0) + b * h4
        p02 = f02 + b * (h3 / 6.0)
        p11 = f11 + h * f12 + a * h + b * (h3 / 3.0)
        p12 = f12 + b * (h2 / 2.0)
        p22 = p22 + b * h
        inverse = 1.0 / (p00 + r2)
        k0, k1, k2 = p00 * inverse, p01 * inverse, p02 * inverse
        left = r2 * inverse
        s[P22 + n], s[P12 + n], s[P11 + n] = p22 - k2 * p02, p12 - k1 * p02, p11 - k1 * p01
        s[P00 + n], s[P01 + n], s[P02 + n] = left * p00, left * p01, left * p02
        s[K0 + n], s[K1 + n], s[K2 + n] = k0, k1, k2
        s[SQUARES + n] = inverse if counts else 0.0
        s[PRODUCT + n] *= p00 + r2 if counts else 1.0


@njit(cache=True, error_model="numpy")
def _axis(s: Array, place: int, y: float, h: float) -> None:
    """Innovation of one axis, and its cost."""
    for n in range(LANES):
        x1, x2 = s[place + SPEED + n], s[place + PUSH + n]
        x0 = s[place + n] + (h * x1 + 0.5 * h * h * x2)
        x1 = x1 + h * x2
        e = y - x0
        s[place + n] = x0 + s[K0 + n] * e
        s[place + SPEED + n] = x1 + s[K1 + n] * e
        s[place + PUSH + n] = x2 + s[K2 + n] * e
        s[COST + n] += 0.5 * min(e * e * s[SQUARES + n], LARGEST)


@njit(cache=True, nogil=True, error_model="numpy")
def position_costs(z: Array, dt: Array, noises: Array) -> Array:
    """Half the minus-log-likelihood of z (k, 3) under each of at most LANES noises (n, 4), constants dropped, (n,)."""
    s = _prepared(noises, z[0])
    for i in range(1, len(z)):
        _covariances(s, dt[i], i >= FREE)
        _axis(s, 0, z[i, 0], dt[i])  # by name: the compiler has to know where each lies
        _axis(s, LANES, z[i, 1], dt[i])
        _axis(s, 2 * LANES, z[i, 2], dt[i])
        if i % LOGARITHM_EVERY == 0 or i == len(z) - 1:
            for n in range(LANES):
                s[COST + n] += 1.5 * np.log(s[PRODUCT + n])
                s[PRODUCT + n] = 1.0
    return s[COST : COST + len(noises)]
