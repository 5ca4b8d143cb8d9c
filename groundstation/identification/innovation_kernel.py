"""Kalman filters of a channel's noise, in two parts: gains, which know only noise and stamps, and the recursion they
drive.

The gains of one noise model serve every column that passes it, and every step of a fit until the noise is fitted anew.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True)
def _driven(sigma: float, tau: float, q: float, h: float, phi: float) -> tuple[float, float, float]:
    """Exact covariance of (integral over h, end value) driven by the Ornstein-Uhlenbeck noise: 00, 01, 11."""
    s2 = sigma * sigma
    q11 = s2 * (1.0 - phi * phi)
    q01 = s2 * tau * (1.0 - phi) * (1.0 - phi)
    q00 = s2 * tau * (2.0 * h - tau * (3.0 - 4.0 * phi + phi * phi)) + q * q * h
    return max(q00, q * q * h), q01, q11


@njit(cache=True)
def integrated_gains(dt: Array, restart: NDArray[np.bool_], noise: Array) -> tuple[Array, Array]:
    """Gains of z = integral(d + white) + white, state [integral, d], diffuse at restarts, and innovations' variances.

    Args:
        dt: time from sample i - 1 to i, (k,). restart: True where a segment begins. noise: as
            :meth:`.noise.NoiseModel.vector`, (4,).

    Returns:
        Each sample's share of the level, of the slope in the level and of the slope, and the gains of both, (k, 5); and
        variances, infinite at restarts, (k,).
    """
    sigma, tau, q, r = noise
    gains, variance = np.zeros((len(dt), 5)), np.empty(len(dt))
    p00, p01, p11 = 0.0, 0.0, 0.0
    for i in range(len(dt)):
        if restart[i] or i == 0:
            p00, p01, p11 = r * r, 0.0, sigma * sigma
            gains[i, 3], variance[i] = 1.0, np.inf  # the level is what was seen
            continue
        h = dt[i]
        phi = np.exp(-h / tau)
        g = tau * (1.0 - phi)
        q00, q01, q11 = _driven(sigma, tau, q, h, phi)
        n00 = p00 + 2.0 * g * p01 + g * g * p11 + q00
        n01 = phi * (p01 + g * p11) + q01
        n11 = phi * phi * p11 + q11
        s = n00 + r * r
        k0, k1 = n00 / s, n01 / s
        gains[i, 0], gains[i, 1], gains[i, 2], gains[i, 3], gains[i, 4] = 1.0, g, phi, k0, k1
        p00, p01, p11 = n00 - k0 * n00, n01 - k0 * n01, n11 - k1 * n01
        variance[i] = s
    return gains, variance


@njit(cache=True)
def direct_gains(dt: Array, restart: NDArray[np.bool_], noise: Array) -> tuple[Array, Array]:
    """The same of z = d + white, with stationary start at restarts; the level is d."""
    sigma, tau, q, r = noise
    gains, variance = np.zeros((len(dt), 5)), np.empty(len(dt))
    spread = 0.0
    for i in range(len(dt)):
        h, phi = dt[i], 0.0
        if restart[i] or i == 0:
            spread = sigma * sigma
            h = 1.0
        else:
            phi = np.exp(-h / tau)
            spread = phi * phi * spread + sigma * sigma * (1.0 - phi * phi)
        s = spread + r * r + q * q / h
        gain = spread / s
        gains[i, 0], gains[i, 3] = phi, gain
        spread -= gain * spread
        variance[i] = s
    return gains, variance


@njit(cache=True, error_model="numpy")
def filtered(z: Array, gains: Array, unit: Array, state: Array) -> Array:
    """Innovations of columns z (k, m) over ``unit`` (k,), by gains (k, 5).

    The state (2, m) goes in and comes out, so that a long series passes in parts.
    """
    samples, columns = z.shape
    out = np.empty((samples, columns))
    level, slope, row = state[0].copy(), state[1].copy(), np.empty(columns)
    for i in range(samples):
        held, carried, kept, to_level, to_slope = gains[i, 0], gains[i, 1], gains[i, 2], gains[i, 3], gains[i, 4]
        share = 1.0 / unit[i]
        for j in range(columns):
            row[j] = z[i, j]
        for j in range(columns):
            expected = held * level[j] + carried * slope[j]
            e = row[j] - expected
            row[j] = e * share
            level[j] = expected + to_level * e
            slope[j] = kept * slope[j] + to_slope * e
        for j in range(columns):
            out[i, j] = row[j]
    state[0], state[1] = level, slope
    return out


@njit(cache=True, error_model="numpy")
def filtered_one(z: Array, gains: Array, unit: Array) -> Array:
    """The same of one column (k,), from the beginning."""
    out = np.empty(len(z))
    level, slope = 0.0, 0.0
    for i in range(len(z)):
        expected = gains[i, 0] * level + gains[i, 1] * slope
        e = z[i] - expected
        out[i] = e * (1.0 / unit[i])
        level = expected + gains[i, 3] * e
        slope = gains[i, 2] * slope + gains[i, 4] * e
    return out


@njit(cache=True, error_model="numpy")
def huber_sum(y: Array, limit: float) -> float:
    """Half the square within the limit, linear beyond, summed over y (k,)."""
    total = 0.0
    for i in range(len(y)):
        size = abs(y[i])
        total += 0.5 * size * size if size <= limit else limit * size - 0.5 * limit * limit
    return total


@njit(cache=True)
def moving_average(polynomial: Array, columns: Array) -> Array:
    """Columns (k, m) through a moving average of coefficients (n,), nothing before the first."""
    samples, count = columns.shape
    out = np.empty((samples, count))
    for i in range(samples):
        last = min(len(polynomial) - 1, i)
        now = out[i]
        for j in range(count):
            now[j] = polynomial[last] * columns[i - last, j]
        for lag in range(last - 1, -1, -1):
            weight = polynomial[lag]
            for j in range(count):
                now[j] = weight * columns[i - lag, j] + now[j]
    return out
