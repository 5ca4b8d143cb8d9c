"""Compiled recursions of the flight-path reconstruction: rates to attitude, and Kalman filters and smoothers of what
poses differ by.

The smoothers are those of Rauch, Tung and Striebel (1965).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from groundstation.identification.noise import driven

Array = NDArray[np.float64]
Upper = tuple[float, float, float, float, float, float]
"""Entries 00, 01, 02, 11, 12, 22 of a covariance."""


@njit(cache=True, nogil=True)
def integrate_rates(start: Array, dt: Array, rate: Array) -> Array:
    """Attitude at each sample from rates, trapezoidal rotation vectors, shape (k, 4)."""
    k = rate.shape[0]
    out = np.empty((k, 4))
    out[0] = start
    for i in range(1, k):
        hx = 0.25 * dt[i] * (rate[i, 0] + rate[i - 1, 0])
        hy = 0.25 * dt[i] * (rate[i, 1] + rate[i - 1, 1])
        hz = 0.25 * dt[i] * (rate[i, 2] + rate[i - 1, 2])
        n = np.sqrt(hx * hx + hy * hy + hz * hz)
        c = np.cos(n)
        s = np.sin(n) / n if n > 1e-12 else 1.0
        x, y, z = s * hx, s * hy, s * hz
        a, b, d, e = out[i - 1, 0], out[i - 1, 1], out[i - 1, 2], out[i - 1, 3]
        out[i, 0] = a * c - b * x - d * y - e * z
        out[i, 1] = a * x + b * c + d * z - e * y
        out[i, 2] = a * y - b * z + d * c + e * x
        out[i, 3] = a * z + b * y - d * x + e * c
    return out


@njit(cache=True, nogil=True)
def integrated_level(z: Array, dt: Array, noise: Array) -> tuple[Array, Array]:
    """Filtered and smoothed level of z = level + white noise, columns alike, shapes (k, m).

    The level is the integral of an Ornstein-Uhlenbeck rate and of white noise, as
    :func:`~groundstation.identification.noise.innovations` has it: a gyro's bias that walks is such a rate.

    Args:
        z: shape (k, m). dt: before each sample, (k,).
        noise: standard deviation of the rate and its correlation time (s), root of the white noise's density, standard
            deviation of one sample, (4,).
    """
    sigma, tau, q, r = noise
    k, m = z.shape
    level, rate = np.empty((k, m)), np.zeros((k, m))
    seen, ahead = np.empty((k, 3)), np.empty((k, 3))  # entries 00, 01, 11 of covariances
    level[0] = z[0]
    seen[0, 0], seen[0, 1], seen[0, 2] = r * r, 0.0, sigma * sigma
    for i in range(1, k):
        phi = np.exp(-dt[i] / tau)
        g = tau * (1.0 - phi)
        q00, q01, q11 = driven(sigma, tau, q, dt[i], phi)
        a, b, c = seen[i - 1]
        p00, p01, p11 = a + g * (2.0 * b + g * c) + q00, phi * (b + g * c) + q01, phi * phi * c + q11
        k0, k1 = p00 / (p00 + r * r), p01 / (p00 + r * r)
        for j in range(m):
            before = level[i - 1, j] + g * rate[i - 1, j]
            error = z[i, j] - before
            level[i, j], rate[i, j] = before + k0 * error, phi * rate[i - 1, j] + k1 * error
        ahead[i, 0], ahead[i, 1], ahead[i, 2] = p00, p01, p11
        left = r * r / (p00 + r * r)  # 1 - k0 without the cancellation
        seen[i, 0], seen[i, 1], seen[i, 2] = left * p00, left * p01, max(p11 - k1 * p01, 0.0)
    smooth_level, smooth_rate = level.copy(), rate.copy()
    for i in range(k - 2, -1, -1):
        phi = np.exp(-dt[i + 1] / tau)
        g = tau * (1.0 - phi)
        a, b, c = seen[i]
        p00, p01, p11 = ahead[i + 1]
        f00, f01, f10, f11 = a + g * b, phi * b, b + g * c, phi * c
        det = p00 * p11 - p01 * p01
        if det > 1e-12 * p00 * p11:
            c00, c01 = (f00 * p11 - f01 * p01) / det, (f01 * p00 - f00 * p01) / det
            c10, c11 = (f10 * p11 - f11 * p01) / det, (f11 * p00 - f10 * p01) / det
        else:  # no rate to speak of
            c00, c01, c10, c11 = f00 / p00 if p00 > 0.0 else 0.0, 0.0, 0.0, 0.0
        for j in range(m):
            d0 = smooth_level[i + 1, j] - (level[i, j] + g * rate[i, j])
            d1 = smooth_rate[i + 1, j] - phi * rate[i, j]
            smooth_level[i, j] += c00 * d0 + c01 * d1
            smooth_rate[i, j] += c10 * d0 + c11 * d1
    return level, smooth_level


@njit(cache=True)
def _ahead(p: Upper, h: float, a: float, b: float) -> Upper:
    """F P F' + Q with F = [[1, h, h^2/2], [0, 1, h], [0, 0, 1]]."""
    p00, p01, p02, p11, p12, p22 = p
    g = 0.5 * h * h
    f00, f01, f02 = p00 + h * p01 + g * p02, p01 + h * p11 + g * p12, p02 + h * p12 + g * p22
    f11, f12 = p11 + h * p12, p12 + h * p22
    return (
        f00 + h * f01 + g * f02 + a * h**3 / 3 + b * h**5 / 20,
        f01 + h * f02 + a * h**2 / 2 + b * h**4 / 8,
        f02 + b * h**3 / 6,
        f11 + h * f12 + a * h + b * h**3 / 3,
        f12 + b * h**2 / 2,
        p22 + b * h,
    )


@njit(cache=True)
def _seen(p: Upper, r: float) -> Upper:
    """The covariance after a position of variance r^2 was seen."""
    p00, p01, p02, p11, p12, p22 = p
    s = p00 + r * r
    k1, k2 = p01 / s, p02 / s
    left = r * r / s  # 1 - k0 without the cancellation
    return left * p00, left * p01, left * p02, p11 - k1 * p01, p12 - k1 * p02, p22 - k2 * p02


@njit(cache=True)
def _fill(out: Array, p: Upper) -> None:
    """The symmetric matrix (3, 3) of its upper entries."""
    out[0, 0], out[0, 1], out[0, 2] = p[0], p[1], p[2]
    out[1, 0], out[1, 1], out[1, 2] = p[1], p[3], p[4]
    out[2, 0], out[2, 1], out[2, 2] = p[2], p[4], p[5]


@njit(cache=True, nogil=True)
def position_filter(z: Array, dt: Array, noise: Array, held: bool) -> tuple[Array, Array, Array, Array, Array]:
    """Kalman filter of [position, velocity, acceleration] errors seen in position; columns alike.

    ``noise`` is (pose noise, white acceleration density, acceleration random walk density, initial acceleration).
    Returns innovations (k, m), variances (k,), filtered states (k, 3, m), filtered and predicted covariances (k, 3, 3).
    The first three samples only initialise (variance inf). Unless ``held``, states and covariances are empty.
    """
    r, qv, qa, a0 = noise
    k, m = z.shape
    out = np.zeros((k, m))
    variance = np.full(k, np.inf)
    length = k if held else 0
    states = np.empty((length, 3, m))
    pf = np.empty((length, 3, 3))
    pp = np.empty((length, 3, 3))
    x0, x1, x2 = z[0].copy(), np.zeros(m), np.zeros(m)
    p = (r * r, 0.0, 0.0, 25.0, 0.0, a0 * a0)
    if held:
        _fill(pp[0], p)
    for i in range(k):
        h = dt[i]
        if i > 0:
            p = _ahead(p, h, qv * qv, qa * qa)
            if held:
                _fill(pp[i], p)
            s = p[0] + r * r
            k0, k1, k2 = p[0] / s, p[1] / s, p[2] / s
            for j in range(m):
                x0[j] += h * x1[j] + 0.5 * h * h * x2[j]
                x1[j] += h * x2[j]
                out[i, j] = z[i, j] - x0[j]
                x0[j] += k0 * out[i, j]
                x1[j] += k1 * out[i, j]
                x2[j] += k2 * out[i, j]
            p = _seen(p, r)
            if i >= 3:
                variance[i] = s
        if held:
            states[i, 0], states[i, 1], states[i, 2] = x0, x1, x2
            _fill(pf[i], p)
    return out, variance, states, pf, pp


@njit(cache=True, nogil=True)
def position_smoother(dt: Array, states: Array, pf: Array, pp: Array) -> Array:
    """Rauch-Tung-Striebel pass over :func:`position_filter`, shape (k, 3, m)."""
    k = len(dt)
    out = states.copy()
    f = np.eye(3)
    for i in range(k - 2, -1, -1):
        h = dt[i + 1]
        f[0, 1], f[0, 2], f[1, 2] = h, 0.5 * h * h, h
        ahead: Array = pp[i + 1]
        here: Array = pf[i]
        gain = np.linalg.solve(ahead, f @ here).T
        out[i] = states[i] + gain @ (out[i + 1] - f @ states[i])
    return out
