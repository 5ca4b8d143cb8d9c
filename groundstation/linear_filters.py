"""Butterworth filters that run forward and backward, first-order recursions, moving averages and correlations.

SciPy's signal package has all of them, and takes longer to import than an identification takes; these give the same
numbers (``tests/test_linear_filters.py``).
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Poles = NDArray[np.complex128]


def low_pass(order: int, cutoff_hz: float, rate_hz: float) -> Annotated[Array, "sections 6"]:
    """Second-order sections of a digital Butterworth low-pass of even order, -3 dB at ``cutoff_hz``.

    Analogue poles on a circle, brought over by the bilinear transform with prewarping (Oppenheim and Schafer,
    Discrete-Time Signal Processing, 3rd ed., section 7.3). Each row is b0, b1, b2, 1, a1, a2.
    """
    warped = _prewarped(cutoff_hz, rate_hz)
    poles: Poles = warped * _prototype(order)
    digital: Poles = (4.0 + poles) / (4.0 - poles)
    gain = warped**order * np.real(1.0 / np.prod(4.0 - poles))
    return _sections(digital, -np.ones(order), float(gain))


def band_pass(order: int, band_hz: tuple[float, float], rate_hz: float) -> Annotated[Array, "sections 6"]:
    """The same of a band-pass that falls off by ``order`` at both ends, -3 dB at both of ``band_hz``."""
    low, high = (_prewarped(edge, rate_hz) for edge in band_hz)
    width, centre = high - low, np.sqrt(low * high)
    half = _prototype(order) * width / 2.0
    apart = np.sqrt(half**2 - centre**2)
    poles: Poles = np.concatenate([half + apart, half - apart])
    digital: Poles = (4.0 + poles) / (4.0 - poles)
    gain = width**order * np.real(np.prod(np.full(order, 4.0)) / np.prod(4.0 - poles))
    return _sections(digital, np.concatenate([np.ones(order), -np.ones(order)]), float(gain))


def _prototype(order: int) -> Poles:
    """Poles of the analogue low-pass of one rad/s, (order,)."""
    m = np.arange(-order + 1, order, 2, dtype=float)
    return -np.exp(1j * np.pi * m / (2 * order))


def _prewarped(frequency_hz: float, rate_hz: float) -> float:
    """The analogue frequency that the bilinear transform takes there, at two samples a second."""
    share = np.float64(frequency_hz) / (rate_hz / 2)
    if not 0.0 < share < 1.0:
        raise ValueError(f"{frequency_hz:g} Hz is not between zero and half of {rate_hz:g} Hz")
    return float(4.0 * np.tan(np.pi * share / 2.0))


def _sections(poles: Poles, zeros: Array, gain: float) -> Array:
    """Sections of conjugate poles, each with the two zeros nearest to it, those nearest to the unit circle last."""
    upper = poles[poles.imag > 0.0]
    out, left = np.zeros((len(upper), 6)), zeros
    for row, at in enumerate(np.argsort(np.abs(1.0 - np.abs(upper)), kind="stable")[: len(upper)], start=1):
        pole, near = upper[at], np.argsort(np.abs(left - upper[at]), kind="stable")
        z1, z2 = left[near[0]], left[near[1]]
        left = np.delete(left, near[:2])
        out[-row] = 1.0, -(z1 + z2), z1 * z2, 1.0, -2.0 * pole.real, (pole * pole.conj()).real
    out[0, :3] *= gain
    return out


@njit(cache=True, nogil=True)
def _through(sections: Array, x: Array, state: Array) -> None:
    """Columns (k, d) through the sections, in place; ``state`` is (sections, 2, d), of direct form II transposed."""
    for i in range(len(x)):
        for s in range(len(sections)):
            b0, b1, b2, a1, a2 = sections[s, 0], sections[s, 1], sections[s, 2], sections[s, 4], sections[s, 5]
            for j in range(x.shape[1]):
                now = x[i, j]
                y = b0 * now + state[s, 0, j]
                state[s, 0, j] = b1 * now - a1 * y + state[s, 1, j]
                state[s, 1, j] = b2 * now - a2 * y
                x[i, j] = y


def _settled(sections: Array) -> Array:
    """States of the sections that have seen ones for ever, (sections, 2)."""
    out, scale = np.empty((len(sections), 2)), 1.0
    for row, (b0, b1, b2, _, a1, a2) in zip(out, sections, strict=True):
        row[:] = scale * np.linalg.solve(
            np.array([[1.0 + a1, -1.0], [a2, 1.0]]), np.array([b1 - a1 * b0, b2 - a2 * b0])
        )
        scale *= (b0 + b1 + b2) / (1.0 + a1 + a2)
    return out


def both_ways(sections: Array, signal: Array, padding: int | None = None) -> Array:
    """Columns (k,) or (k, d) through the sections forward and backward: without phase.

    The ends are continued by point reflection, which keeps value and slope (Gustafsson 1996 says what else could be
    done).

    Args:
        padding: samples by which the ends are continued; three times the filter's length where it is not given.

    Raises:
        ValueError: the signal is not longer than its padding.
    """
    values = np.asarray(signal, dtype=float)
    x = values if values.ndim == 2 else values[:, None]
    taps = 2 * len(sections) + 1 - min(int(np.sum(sections[:, 2] == 0.0)), int(np.sum(sections[:, 5] == 0.0)))
    pad = 3 * taps if padding is None else padding
    if len(x) <= pad:
        raise ValueError(f"a signal of {len(x)} samples is not longer than its padding of {pad}")
    y, start = x.copy(), _settled(sections)[:, :, None]
    if pad > 0:
        y = np.concatenate([2.0 * x[:1] - x[pad:0:-1], x, 2.0 * x[-1:] - x[-2 : -2 - pad : -1]])
    for _ in range(2):
        _through(sections, y, start * y[:1])
        y = np.ascontiguousarray(y[::-1])
    y = y[pad : len(y) - pad]
    return y if values.ndim == 2 else y[:, 0]


@njit(cache=True, nogil=True)
def _recursion(b0: float, b1: float, a1: float, x: Array, state: Array) -> Array:
    out = np.empty_like(x)
    for i in range(len(x)):
        for j in range(x.shape[1]):
            y = b0 * x[i, j] + state[j]
            state[j] = b1 * x[i, j] - a1 * y
            out[i, j] = y
    return out


def first_order(numerator: tuple[float, float], a1: float, signal: Array, state: Array | None = None) -> Array:
    """y_k = b0 x_k + b1 x_(k-1) - a1 y_(k-1) along the first axis of a signal (k, ...).

    Args:
        state: b1 x - a1 y of the sample before, shape of a sample; zero where it is not given.
    """
    x = np.ascontiguousarray(signal, dtype=float)
    before = np.zeros(x[:1].size) if state is None else np.array(state, dtype=float).reshape(-1)
    b0, b1 = numerator
    return _recursion(b0, b1, a1, x.reshape(len(x), -1), before).reshape(x.shape)


def correlation(later: Array, earlier: Array) -> Array:
    """sum_k later[k + n] earlier[k] at each lag n from 1 - len(earlier) to len(later) - 1, by fast transforms."""
    count = len(later) + len(earlier) - 1
    length = fast_length(count)
    product = np.fft.rfft(later, length) * np.fft.rfft(earlier[::-1], length)
    return np.fft.irfft(product, length)[:count]


def power_spectrum(signal: Array, rate_hz: float, length: int) -> tuple[Array, Array]:
    """Frequencies (n,) and the power spectral density there of columns (k, d), (n, d), by Welch's method (1967).

    Means of the periodograms of stretches of ``length`` samples that overlap by half, each less its mean and under
    Hann's window.
    """
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)
    starts = range(0, len(signal) - length + 1, length - length // 2)
    power = np.zeros((length // 2 + 1, signal.shape[1]))
    for start in starts:
        stretch = signal[start : start + length]
        power += np.abs(np.fft.rfft((stretch - stretch.mean(axis=0)) * window[:, None], axis=0)) ** 2
    power *= 2.0 / (len(starts) * rate_hz * float(np.sum(window**2)))
    power[0] *= 0.5
    if length % 2 == 0:
        power[-1] *= 0.5
    return np.asarray(np.fft.rfftfreq(length, 1.0 / rate_hz), dtype=np.float64), power


def fast_length(least: int) -> int:
    """The smallest number from ``least`` on without prime factors above five, whose transform is fast."""
    best = 1 << max(least - 1, 0).bit_length()
    five = 1
    while five < best:
        three = five
        while three < best:
            doubled = three << max(-(-least // three) - 1, 0).bit_length()
            best = min(best, doubled)
            three *= 3
        five *= 5
    return best


@njit(cache=True)
def _reflected(n: int, k: int) -> int:
    """Where a series of k that goes on in its mirror image has what stands at n."""
    n %= 2 * k
    return n if n < k else 2 * k - 1 - n


@njit(cache=True, nogil=True)
def moving_mean(values: Array, width: int) -> Array:
    """Mean of ``width`` values, an odd number, about each of a series, which is reflected at its ends."""
    k, half = len(values), width // 2
    out, total = np.empty(k), 0.0
    for n in range(-half, half + 1):
        total += values[_reflected(n, k)]
    out[0] = total / width
    for i in range(1, k):
        inside = i > half and i + half < k  # a remainder takes longer than the rest
        later, earlier = i + half, i - half - 1
        total += (
            values[later if inside else _reflected(later, k)] - values[earlier if inside else _reflected(earlier, k)]
        )
        out[i] = total / width
    return out
