"""First-order filter pairs f(s) = lambda/(s + lambda) and g(s) = s f(s) for the filtered regression model (seed eq.
14-15).

The filtered model holds exactly only if the discrete g is the discrete f times one and the same derivative. The seed's
pair (35)-(36) is not of that kind: g_D/f_D = lambda (z - 1)/(1 - e^{-lambda T}), a forward difference times
lambda T/(1 - e^{-lambda T}). On perfect data it makes I alpha too large by that gain (1.030 at lambda = 30 rad/s,
T = 2 ms), hence inertias too small by 2.9 %, and leads by T/2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.linear_filters import both_ways, first_order, low_pass

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FilterPair:
    """Coefficients (descending powers of z) of discrete f and g, which share a denominator."""

    low_pass: tuple[float, float]
    derivative: tuple[float, float]
    denominator: tuple[float, float]
    period_s: float

    def f(self, signal: ArrayLike) -> Array:
        """Low-pass along the first axis, started in the steady state of the first sample."""
        return self._run(self.low_pass, signal)

    def g(self, signal: ArrayLike) -> Array:
        """Low-passed derivative along the first axis, started in the steady state (zero) of the first sample."""
        return self._run(self.derivative, signal)

    def at_every(self, steps: int) -> FilterPair:
        """What the pair gives at every so-many-th sample of a signal that is linear between those, in one step."""
        pole = -self.denominator[1] / self.denominator[0]
        after = np.arange(1, steps + 1)
        fade = pole ** (steps - after) / (steps * self.denominator[0])

        def coefficients(numerator: tuple[float, float]) -> tuple[float, float]:
            now, before = numerator
            later = float(np.sum(fade * (now * after + before * (after - 1))))
            earlier = float(np.sum(fade * (now * (steps - after) + before * (steps - after + 1))))
            return later, earlier

        low_pass, derivative = coefficients(self.low_pass), coefficients(self.derivative)
        return FilterPair(low_pass, derivative, (1.0, -(pole**steps)), steps * self.period_s)

    def _run(self, numerator: tuple[float, float], signal: ArrayLike) -> Array:
        x = np.asarray(signal, dtype=float)
        gain = sum(numerator) / sum(self.denominator)
        # Direct form II transposed: y = b0 x + s, s <- b1 x - a1 y; in steady state s = (gain - b0) x.
        state = (gain - numerator[0] / self.denominator[0]) * x[:1]
        return first_order((numerator[0], numerator[1]), self.denominator[1], x, state)

    def gain_ratio(self) -> float:
        """Low-frequency gain of g/(s f): 1 for a matched pair."""
        slope = self.derivative[0] / sum(self.low_pass)  # g is proportional to (z - 1); z - 1 -> s T
        return slope * self.period_s


def seed_pair(cutoff_rad_s: float, period_s: float) -> FilterPair:
    """f_D and g_D as printed (seed eq. 35-36): (1 - e^{-lambda T})/(z - e^{-lambda T}), lambda (z - 1)/(z - e^{-lambda
    T}).
    """
    pole = float(np.exp(-cutoff_rad_s * period_s))
    return FilterPair((0.0, 1.0 - pole), (cutoff_rad_s, -cutoff_rad_s), (1.0, -pole), period_s)


def matched_pair(cutoff_rad_s: float, period_s: float) -> FilterPair:
    """Bilinear pair, s = (2/T)(z - 1)/(z + 1) in both: g/f is the trapezoidal derivative, without lead or gain at low
    frequency.

    Its gain at w is tan(wT/2)/(wT/2): 1 + 3e-6 at 3 rad/s and 2 ms.
    """
    x = cutoff_rad_s * period_s
    return FilterPair(
        (x / (2.0 + x), x / (2.0 + x)),
        (2.0 * cutoff_rad_s / (2.0 + x), -2.0 * cutoff_rad_s / (2.0 + x)),
        (1.0, (x - 2.0) / (x + 2.0)),
        period_s,
    )


def zero_phase_low_pass(signal: ArrayLike, cutoff_hz: float, period_s: float, order: int = 2) -> Array:
    """Butterworth low-pass run forward and backward along the first axis (seed II-C.1, with a cut-off that keeps the
    motion).

    Both passes together have the gain 1/(1 + (f/f_c)^(2 order)); at a tenth of the cut-off that is 1e-4 below one.
    The ends are continued by point reflection, which keeps value and slope. Short signals get the padding they allow.
    """
    x = np.asarray(signal, dtype=float)
    normalised = 2.0 * cutoff_hz * period_s
    if normalised >= 1.0 or len(x) < 8:
        return x.copy()
    padding = min(len(x) - 1, int(np.ceil(3.0 / normalised)) * order)
    return both_ways(low_pass(order, normalised, 2.0), x, padding)


def central_difference(signal: ArrayLike, period_s: float) -> Array:
    """Central difference along the first axis (seed eq. 33); one-sided of second order at the two ends."""
    return np.gradient(np.asarray(signal, dtype=float), period_s, axis=0, edge_order=2)
