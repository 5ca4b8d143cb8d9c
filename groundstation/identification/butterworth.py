"""Butterworth filters without phase, and the correlation of two signals at every lag.

These are what an identification needs of SciPy's signal package, which takes longer to import than the filters take.
Sections are those of that package: b0, b1, b2, 1, a1, a2 of each, (n, 6).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def low_pass(order: int, edge_hz: float, rate_hz: float) -> Array:
    """Sections of a low-pass of even order (Oppenheim and Schafer, Discrete-Time Signal Processing, section 7.2)."""
    edge = np.tan(np.pi * edge_hz / rate_hz)
    poles = edge * np.exp(1j * np.pi * (np.arange(order // 2) + 0.5 * (order + 1)) / order)
    return _sections(poles, np.array([1.0, 2.0, 1.0]), 1.0)


def band_pass(edges_hz: tuple[float, float], rate_hz: float) -> Array:
    """Sections of a band-pass of second order at either edge."""
    low, high = np.tan(np.pi * np.array(edges_hz) / rate_hz)
    prototype = (high - low) * np.exp(0.75j * np.pi)
    # s + w^2 / s = p (high - low): two poles of the band for the prototype's one.
    root = np.sqrt(prototype**2 / 4.0 - low * high)
    poles = np.array([prototype / 2.0 + root, prototype / 2.0 - root])
    centre = np.exp(2j * np.arctan(np.sqrt(low * high)))
    return _sections(poles, np.array([1.0, 0.0, -1.0]), centre)


def _sections(poles: Complex, numerator: Array, passed: complex) -> Array:
    """Sections by the bilinear transform of analog poles, one of each conjugate pair, of gain one at ``passed``."""
    turned = (1.0 + poles) / (1.0 - poles)
    turned = turned[np.argsort(np.abs(turned))]  # the sharpest last, where the signal is smallest
    out = np.zeros((len(turned), 6))
    for section, pole in zip(out, turned, strict=True):
        section[3:] = 1.0, -2.0 * pole.real, abs(pole) ** 2
        section[:3] = numerator * abs(np.polyval(section[3:], passed) / np.polyval(numerator, passed))
    return out


@njit(cache=True, error_model="numpy")
def run(sections: Array, values: Array, settled: bool) -> Array:
    """Columns (k, m) through sections, direct form II transposed, from rest or from the steady state of their first
    rows.
    """
    samples, columns = values.shape
    out = values.copy()
    early, late = np.zeros(columns), np.zeros(columns)
    for section in sections:
        b0, b1, b2, _, a1, a2 = section
        gain = (b0 + b1 + b2) / (1.0 + a1 + a2)
        early[:] = late[:] = 0.0
        for j in range(columns if settled else 0):
            late[j] = (b2 - a2 * gain) * out[0, j]
            early[j] = (b1 - a1 * gain) * out[0, j] + late[j]
        for i in range(samples):
            row = out[i]
            for j in range(columns):
                x = row[j]
                y = b0 * x + early[j]
                early[j] = b1 * x - a1 * y + late[j]
                late[j] = b2 * x - a2 * y
                row[j] = y
    return out


def without_phase(sections: Array, values: Array, padding: int | None = None) -> Array:
    """Values (k, ...) filtered forward and backward along the first axis; the ends are continued by point reflection.

    Args:
        padding: samples of the continuation; None: three times the filter's coefficients.

    Raises:
        ValueError: fewer samples than the continuation needs.
    """
    count = 3 * (2 * len(sections) + 1) if padding is None else padding
    x = np.asarray(values, dtype=float)
    if count >= len(x):
        raise ValueError(f"a signal of {len(x)} samples is too short for a padding of {count}")
    flat = x.reshape(len(x), -1)
    before, after = 2.0 * flat[0] - flat[count:0:-1], 2.0 * flat[-1] - flat[-2 : -2 - count : -1]
    once = run(sections, np.concatenate([before, flat, after]), True)
    twice = run(sections, once[::-1].copy(), True)[::-1]
    return np.ascontiguousarray(twice[count : count + len(x)]).reshape(x.shape)


def correlation(first: Array, second: Array) -> Array:
    """Sum of first[n + lag] second[n] at every lag from 1 - len(second) to len(first) - 1."""
    from scipy.fft import irfft, next_fast_len, rfft

    fast = next_fast_len(len(first) + len(second) - 1, True)
    product = rfft(first, fast) * np.conj(rfft(second, fast))
    found = irfft(product, fast)
    return np.concatenate([found[fast - len(second) + 1 :], found[: len(first)]])
