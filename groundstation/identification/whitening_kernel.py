"""Columns through a channel's Kalman filter and the autoregression behind it, eight at a time.

Gains depend on stamps and noise alone, so they are worked out once for all columns and all steps under one noise. Both
kinds of channel are the same recursion with other numbers,

    x0 <- a x0 + g x1,   e = z - x0,   x0 <- x0 + k0 e,   x1 <- phi x1 + k1 e,   white = e share,

with share = 1 / sqrt(variance of e), zero where a level is only initialised. What the filter keeps of eight columns
lies in one array, a row of LANES for each quantity; samples pass in chunks that a core's own cache holds.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Restarts = NDArray[np.bool_]

LANES = 8
CHUNK = 128
"""Samples at a time."""
TAPS = 4
"""Of the autoregression that are added at once."""
KEEP, TURN, FADE, GAIN, SLOPE_GAIN, SHARE, GAINS = range(7)
"""Columns of the gains: a, g, phi, k0, k1 and share."""


@njit(cache=True, nogil=True, error_model="numpy")
def integrated_gains(dt: Array, restart: Restarts, noise: Array, spread: Array) -> tuple[Array, float]:
    """Gains (k, GAINS) of z = integral(d + white) + white, and half the sum of the logarithms of its variances.

    Args:
        spread: covariance of the state before, and whether there is one, (4,); a long series goes on part by part.
    """
    sigma, tau, q, r = noise
    out, half = np.zeros((len(dt), GAINS)), 0.0
    p00, p01, p11, begun = spread
    for i in range(len(dt)):
        row = out[i]
        if restart[i] or (i == 0 and begun == 0.0):
            row[KEEP], row[GAIN] = 1.0, 1.0
            p00, p01, p11 = r * r, 0.0, sigma * sigma
            continue
        h = dt[i]
        phi = np.exp(-h / tau)
        g, s2, white = tau * (1.0 - phi), sigma * sigma, q * q * h
        q00 = max(s2 * tau * (2.0 * h - tau * (3.0 - 4.0 * phi + phi * phi)) + white, white)
        n00 = p00 + 2.0 * g * p01 + g * g * p11 + q00
        n01 = phi * (p01 + g * p11) + s2 * tau * (1.0 - phi) * (1.0 - phi)
        n11 = phi * phi * p11 + s2 * (1.0 - phi * phi)
        s = n00 + r * r
        k0, k1 = n00 / s, n01 / s
        row[KEEP], row[TURN], row[FADE], row[GAIN], row[SLOPE_GAIN] = 1.0, g, phi, k0, k1
        row[SHARE] = 1.0 / np.sqrt(s)
        p00, p01, p11 = n00 - k0 * n00, n01 - k0 * n01, n11 - k1 * n01
        half += 0.5 * np.log(s)
    spread[0], spread[1], spread[2], spread[3] = p00, p01, p11, 1.0
    return out, half


@njit(cache=True, nogil=True, error_model="numpy")
def direct_gains(dt: Array, restart: Restarts, noise: Array, spread: Array) -> tuple[Array, float]:
    """The same of z = d + white."""
    sigma, tau, q, r = noise
    out, half, p, begun = np.zeros((len(dt), GAINS)), 0.0, spread[0], spread[3]
    for i in range(len(dt)):
        row, h, phi = out[i], 1.0, 0.0
        if not (restart[i] or (i == 0 and begun == 0.0)):
            h = dt[i]
            phi = np.exp(-h / tau)
        p = phi * phi * p + sigma * sigma * (1.0 - phi * phi)
        s = p + r * r + q * q / h
        row[KEEP], row[GAIN], row[SHARE] = phi, p / s, 1.0 / np.sqrt(s)
        p -= row[GAIN] * p
        half += 0.5 * np.log(s)
    spread[0], spread[3] = p, 1.0
    return out, half


@njit(cache=True, error_model="numpy")
def _filtered(s: Array, work: Array, place: int, gains: Array) -> None:
    """One sample of LANES columns: level and slope lie at the start of ``s``; what is white replaces the sample."""
    a, g, phi, k0, k1, share = gains[0], gains[1], gains[2], gains[3], gains[4], gains[5]
    for n in range(LANES):
        level, slope = a * s[n] + g * s[LANES + n], s[LANES + n]
        e = work[place + n] - level
        s[n] = level + k0 * e
        s[LANES + n] = phi * slope + k1 * e
        work[place + n] = e * share


@njit(cache=True, error_model="numpy")
def _regressed(work: Array, polynomial: Array, first: int, count: int, out: Array) -> None:
    """The moving average of the samples from ``first`` on into ``out``, (count * LANES,)."""
    size = count * LANES
    out[:size] = work[first : first + size]
    for k in range(1, len(polynomial), TAPS):
        c0, c1, c2, c3 = polynomial[k], polynomial[k + 1], polynomial[k + 2], polynomial[k + 3]
        begin = first - (k + 3) * LANES
        w3, w2 = work[begin : begin + size], work[begin + LANES : begin + LANES + size]
        w1, w0 = work[begin + 2 * LANES : begin + 2 * LANES + size], work[begin + 3 * LANES : begin + 3 * LANES + size]
        for n in range(size):
            out[n] += c0 * w0[n] + c1 * w1[n] + c2 * w2[n] + c3 * w3[n]


@njit(cache=True, nogil=True, error_model="numpy")
def white_columns(
    z: Array, more: Array, shown: NDArray[np.intp], gains: Array, polynomial: Array, state: Array
) -> Array:
    """Normalised innovations of columns, behind the autoregression, (k, m).

    Args:
        z: the first columns, each of them in a row, (n, k).
        more: rows of which those that are ``shown`` are the columns behind them, (P, k) and (m - n,).
        gains: of :func:`integrated_gains` or :func:`direct_gains`, (k, GAINS).
        polynomial: coefficients, the first of them one, and as many more as TAPS divide (zeros at the end).
        state: what the filters of each eight columns hold, and the samples that the polynomial still needs, (groups,
            (1 + len(polynomial)) * LANES); zero at first, and changed.
    """
    own, k = z.shape
    m = own + len(shown)
    before = (len(polynomial) - 1) * LANES
    out = np.empty((k, m))
    for first in range(0, m, LANES):
        count = min(LANES, m - first)
        s, work, white = state[first // LANES], np.zeros(before + CHUNK * LANES), np.empty(CHUNK * LANES)
        work[:before] = s[2 * LANES :]
        for begin in range(0, k, CHUNK):
            size = min(CHUNK, k - begin)
            for n in range(count):
                row = first + n
                column = z[row] if row < own else more[shown[row - own]]
                for i in range(size):
                    work[before + i * LANES + n] = column[begin + i]
            for i in range(size):
                _filtered(s, work, before + i * LANES, gains[begin + i])
            _regressed(work, polynomial, before, size, white)
            for i in range(size):
                for n in range(count):
                    out[begin + i, first + n] = white[i * LANES + n]
            if before > 0:
                work[:before] = work[size * LANES : size * LANES + before].copy()
        s[2 * LANES :] = work[:before]
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def burg(innovation: Array, restart: Restarts, highest: int) -> Array:
    """See :func:`.noise.whitening_polynomial`; ``innovation`` is (k,), clipped."""
    k = len(innovation)
    forward, backward = innovation.copy(), innovation.copy()
    polynomial, best = np.zeros(highest + 1), np.zeros(highest + 1)
    polynomial[0] = best[0] = 1.0
    error, chosen = np.mean(innovation**2), 0
    lowest = k * np.log(error)
    for order in range(1, min(highest, k // 20) + 1):
        product, square = 0.0, 0.0
        for i in range(order, k):
            if not restart[i]:
                f, b = forward[i], backward[i - 1]
                product += f * b
                square += f * f + b * b
        if square <= 0.0:
            break
        reflection = -2.0 * product / square
        for i in range(k - 1, order - 1, -1):
            f, b = forward[i], backward[i - 1]
            forward[i], backward[i] = f + reflection * b, b + reflection * f
        before = polynomial.copy()
        for i in range(order + 1):
            polynomial[i] = before[i] + reflection * before[order - i]
        error *= 1.0 - reflection**2
        cost = k * np.log(error) + order * np.log(k)
        if cost < lowest:
            lowest, chosen, best = cost, order, polynomial.copy()
    return best[: chosen + 1]
