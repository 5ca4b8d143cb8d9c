r"""The likelihood of a channel under eight noise models at once, one in each lane of a vector register.

Lanes that differ from the first one by a little in one number each tell the derivatives of innovations e and variances
s by that number, and with them the information of a Gaussian innovation (Ljung 1999, System Identification, 2nd ed.,
section 7.4, with the variances' part of Whittle 1953),

    F = sum of w de de^T / s + ds ds^T / (2 s^2),

with the weight w that the robust cost gives the innovation. It is never indefinite: its step always leads down.

All that the filters keep and all that they are told lies in one array, a row of LANES for each quantity: rows lie a
constant distance apart, so the compiler knows that lanes do not touch each other.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Steps = tuple[Array, NDArray[np.bool_], float]

LANES = 8
"""The doubles of the widest vector registers."""
LOGARITHM_EVERY = 8
"""Variances are multiplied before their logarithm is taken, few enough that the product stays within a double's range.
"""
LEVEL, SLOPE, P00, P01, P11, COST, PRODUCT, SQUARE, TIME, WHITE, SENSOR, KEPT, USUAL, ERROR, SPREAD, INFORMATION = (
    LANES * row for row in range(16)
)
"""Where the rows begin: states, covariances, cost and product of variances; squares and time of the noise; share kept
over a step; the last innovation and its variance; sums of products of differences between each of the next NUMBERS
lanes and all.
"""
NUMBERS = 4
"""Of a noise model."""
ROWS = INFORMATION + NUMBERS * LANES


@njit(cache=True, error_model="numpy")
def _prepared(noises: Array, usual: float) -> Array:
    """The array at the start, of noises (n, 4), the last one in the lanes beyond them."""
    s = np.zeros(ROWS)
    for lane in range(LANES):
        sigma, tau, q, r = noises[min(lane, len(noises) - 1)]
        s[SQUARE + lane], s[TIME + lane], s[WHITE + lane], s[SENSOR + lane] = sigma * sigma, tau, q * q, r * r
        s[USUAL + lane], s[PRODUCT + lane] = np.exp(-usual / tau), 1.0
    return s


@njit(inline="always")
def _kept(usual: float, tau: float, beyond: float) -> float:
    """exp(-h / tau) by its series about the usual step, ``beyond`` which h lies: right to 1e-14 within 0.005 tau."""
    d = beyond / tau
    return usual * (1.0 - d * (1.0 - d * (0.5 - d * (1.0 / 6.0 - d * (1.0 / 24.0 - d * (1.0 / 120.0))))))


@njit(cache=True, error_model="numpy")
def _near(s: Array, h: float, usual: float, shortest: float) -> bool:
    """Whether a step is near the usual one; where it is not, its shares are put into the array."""
    if abs(h - usual) <= 0.005 * shortest:
        return True
    for n in range(LANES):
        s[KEPT + n] = np.exp(-h / s[TIME + n])
    return False


@njit(cache=True, error_model="numpy")
def _logarithms(s: Array, noises: int) -> None:
    """Move products of variances into the costs before they leave the range of floats."""
    for n in range(noises):
        s[COST + n] += 0.5 * np.log(s[PRODUCT + n])
    s[PRODUCT : PRODUCT + LANES] = 1.0


@njit(cache=True, error_model="numpy")
def _integrated_step(s: Array, y: float, h: float, beyond: float, near: bool) -> None:
    for n in range(LANES):
        s2, tau, r2 = s[SQUARE + n], s[TIME + n], s[SENSOR + n]
        f = _kept(s[USUAL + n], tau, beyond) if near else s[KEPT + n]
        white = s[WHITE + n] * h
        x1, p00, p01, p11 = s[SLOPE + n], s[P00 + n], s[P01 + n], s[P11 + n]
        g = tau * (1.0 - f)
        q00 = max(s2 * tau * (2.0 * h - tau * (3.0 - 4.0 * f + f * f)) + white, white)
        n00 = p00 + 2.0 * g * p01 + g * g * p11 + q00
        n01 = f * (p01 + g * p11) + s2 * tau * (1.0 - f) * (1.0 - f)
        n11 = f * f * p11 + s2 * (1.0 - f * f)
        spread = n00 + r2
        inverse = 1.0 / spread
        k0, k1 = n00 * inverse, n01 * inverse
        level = s[LEVEL + n] + g * x1
        e = y - level
        s[LEVEL + n], s[SLOPE + n] = level + k0 * e, f * x1 + k1 * e
        s[P00 + n], s[P01 + n], s[P11 + n] = n00 - k0 * n00, n01 - k0 * n01, n11 - k1 * n01
        s[COST + n] += 16.0 * (np.sqrt(1.0 + e * e * inverse / 16.0) - 1.0)
        s[PRODUCT + n] *= spread
        s[ERROR + n], s[SPREAD + n] = e, spread


@njit(cache=True, error_model="numpy")
def _inform_row(s: Array, row: int, lane: int, first: float, second: float) -> None:
    by_error, by_spread = first * (s[ERROR + lane] - s[ERROR]), second * (s[SPREAD + lane] - s[SPREAD])
    error, spread = s[ERROR], s[SPREAD]
    for n in range(LANES):
        s[row + n] += by_error * (s[ERROR + n] - error) + by_spread * (s[SPREAD + n] - spread)


@njit(cache=True, error_model="numpy")
def _inform(s: Array) -> None:
    """Add a step's part of F."""
    inverse, error = 1.0 / s[SPREAD], s[ERROR]
    first = inverse / np.sqrt(1.0 + error * error * inverse / 16.0)
    second = 0.5 * inverse * inverse
    _inform_row(s, INFORMATION, 1, first, second)  # by name: the compiler has to know where each lies
    _inform_row(s, INFORMATION + LANES, 2, first, second)
    _inform_row(s, INFORMATION + 2 * LANES, 3, first, second)
    _inform_row(s, INFORMATION + 3 * LANES, 4, first, second)


@njit(cache=True, error_model="numpy")
def _told(s: Array, noises: int, informed: bool) -> Array:
    if not informed:
        return s[COST : COST + noises]
    return np.concatenate((s[COST : COST + noises], s[INFORMATION:]))


@njit(cache=True, nogil=True, error_model="numpy")
def integrated_costs(z: Array, step: Steps, noises: Array, informed: bool) -> Array:
    """Of an integrated channel z (k,) under each of at most LANES noises (n, 4), shape (n,).

    Args:
        step: time before each sample (k,), where segments begin (k,), and the usual time.
        informed: the sums for F come behind the costs, (NUMBERS * LANES,).
    """
    dt, restart, usual = step
    s, shortest = _prepared(noises, usual), np.min(noises[:, 1])
    for i in range(len(z)):
        if i % LOGARITHM_EVERY == 0:
            _logarithms(s, len(noises))
        if restart[i] or i == 0:
            for n in range(LANES):
                s[LEVEL + n], s[SLOPE + n] = z[i], 0.0
                s[P00 + n], s[P01 + n], s[P11 + n] = s[SENSOR + n], 0.0, s[SQUARE + n]
            continue
        near = _near(s, dt[i], usual, shortest)
        _integrated_step(s, z[i], dt[i], dt[i] - usual, near)
        if informed:
            _inform(s)
    _logarithms(s, len(noises))
    return _told(s, len(noises), informed)


@njit(cache=True, error_model="numpy")
def _direct_step(s: Array, y: float, h: float, beyond: float, near: bool) -> None:
    for n in range(LANES):
        f = _kept(s[USUAL + n], s[TIME + n], beyond) if near else s[KEPT + n]
        spread = f * f * s[P00 + n] + s[SQUARE + n] * (1.0 - f * f)
        total = spread + s[SENSOR + n] + s[WHITE + n] / h
        inverse = 1.0 / total
        level = f * s[LEVEL + n]
        e = y - level
        s[LEVEL + n] = level + spread * inverse * e
        s[P00 + n] = spread - spread * inverse * spread
        s[COST + n] += 16.0 * (np.sqrt(1.0 + e * e * inverse / 16.0) - 1.0)
        s[PRODUCT + n] *= total
        s[ERROR + n], s[SPREAD + n] = e, total


@njit(cache=True, nogil=True, error_model="numpy")
def direct_costs(z: Array, step: Steps, noises: Array, informed: bool) -> Array:
    """The same for z = d + white."""
    dt, restart, usual = step
    s, shortest = _prepared(noises, usual), np.min(noises[:, 1])
    for i in range(len(z)):
        if i % LOGARITHM_EVERY == 0:
            _logarithms(s, len(noises))
        if restart[i] or i == 0:
            s[KEPT : KEPT + LANES] = 0.0
            _direct_step(s, z[i], 1.0, 0.0, False)
        else:
            near = _near(s, dt[i], usual, shortest)
            _direct_step(s, z[i], dt[i], dt[i] - usual, near)
        if informed:
            _inform(s)
    _logarithms(s, len(noises))
    return _told(s, len(noises), informed)
