r"""Coloured disturbance and sensor noise of one channel, and the innovations they leave.

Every flight has a disturbance d(t) of its own (draughts, blade wash), coloured and of unknown size. With the rates as
output, z = omega_measured - integral of the model = integral of d + white noise; with the accelerometer as output, z =
d + white noise. Both are small state models; the Kalman filter turns z, and every column of sensitivities, into
one-step innovations. A prediction error estimate from those is consistent in closed loop (Ljung, System Identification,
2nd ed., section 13.4), which a regression on the wrench is not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from groundstation.identification.newton import Expansion, scored
from groundstation.identification.noise_kernel import NUMBERS, direct_costs, integrated_costs
from groundstation.identification.whitening_kernel import (
    LANES,
    TAPS,
    burg,
    direct_gains,
    integrated_gains,
    white_columns,
)

Array = NDArray[np.float64]
Restarts = NDArray[np.bool_]

DIFFERENCE = 1e-4
"""Step in the logarithm of a noise by which derivatives are taken."""
THINNED = 4
"""Samples of which a first look at a long channel takes one."""
LONG = 2000
"""Samples beyond which there is a first look: it leaves five hundred."""


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Noise of one channel.

    Attributes:
        disturbance: standard deviation of the Ornstein-Uhlenbeck disturbance (rad/s^2 or m/s^2).
        correlation_s: its correlation time.
        process: spectral density root of white acceleration noise, e.g. of noisy rotor speeds (per sqrt(Hz)).
        sensor: standard deviation of the white measurement noise of one sample.
    """

    disturbance: float
    correlation_s: float
    process: float
    sensor: float

    def vector(self) -> Array:
        """The four values, shape (4,)."""
        return np.array([self.disturbance, self.correlation_s, self.process, self.sensor])

    def logarithms(self) -> Array:
        """The vector the likelihood is searched in, shape (4,)."""
        return np.log(self.vector())

    @classmethod
    def from_logarithms(cls, vector: Array) -> NoiseModel:
        """Inverse of :meth:`logarithms`."""
        return cls(*(float(v) for v in np.exp(vector)))


@njit(cache=True)
def driven(sigma: float, tau: float, q: float, h: float, phi: float) -> tuple[float, float, float]:
    """Exact covariance of (integral over h, end value) driven by the Ornstein-Uhlenbeck noise: 00, 01, 11."""
    s2 = sigma * sigma
    q11 = s2 * (1.0 - phi * phi)
    q01 = s2 * tau * (1.0 - phi) * (1.0 - phi)
    q00 = s2 * tau * (2.0 * h - tau * (3.0 - 4.0 * phi + phi * phi)) + q * q * h
    return max(q00, q * q * h), q01, q11


@njit(cache=True, nogil=True)
def _integrated_innovations(
    z: Array, dt: Array, restart: Restarts, noise: Array, state: tuple[Array, Array], fresh: bool
) -> tuple[Array, Array]:
    """Innovations and their variances of z = integral(d + white) + white; state [integral, d]; diffuse at restarts.

    z has shape (k, m): the first column drives nothing special, all columns pass the same filter. dt[i] is the time
    from sample i - 1 to i. Variances at restarts are infinite (the level is unknown there). Columns' states (2, m)
    and their covariance (3,) go in and come out, so that a long series passes in parts, the first of them ``fresh``.
    """
    sigma, tau, q, r = noise
    x, p = state
    k, m = z.shape
    out = np.zeros((k, m))
    variance = np.empty(k)
    p00, p01, p11 = p
    for i in range(k):
        if restart[i] or (fresh and i == 0):
            for j in range(m):
                x[0, j] = z[i, j]
                x[1, j] = 0.0
            p00, p01, p11 = r * r, 0.0, sigma * sigma
            variance[i] = np.inf
            continue
        h = dt[i]
        phi = np.exp(-h / tau)
        g = tau * (1.0 - phi)
        q00, q01, q11 = driven(sigma, tau, q, h, phi)
        n00 = p00 + 2.0 * g * p01 + g * g * p11 + q00
        n01 = phi * (p01 + g * p11) + q01
        n11 = phi * phi * p11 + q11
        s = n00 + r * r
        k0, k1 = n00 / s, n01 / s
        for j in range(m):
            x0 = x[0, j] + g * x[1, j]
            x1 = phi * x[1, j]
            e = z[i, j] - x0
            out[i, j] = e
            x[0, j] = x0 + k0 * e
            x[1, j] = x1 + k1 * e
        p00, p01, p11 = n00 - k0 * n00, n01 - k0 * n01, n11 - k1 * n01
        variance[i] = s
    p[0], p[1], p[2] = p00, p01, p11
    return out, variance


@njit(cache=True, nogil=True)
def _direct_innovations(
    z: Array, dt: Array, restart: Restarts, noise: Array, state: tuple[Array, Array], fresh: bool
) -> tuple[Array, Array]:
    """Innovations and their variances of z = d + white, with stationary start at restarts. Shapes as above."""
    sigma, tau, q, r = noise
    x, p = state
    k, m = z.shape
    out = np.empty((k, m))
    variance = np.empty(k)
    spread = p[0]
    for i in range(k):
        h = dt[i]
        if restart[i] or (fresh and i == 0):
            x[0] = 0.0
            spread = sigma * sigma
            h = 1.0
        else:
            phi = np.exp(-h / tau)
            for j in range(m):
                x[0, j] *= phi
            spread = phi * phi * spread + sigma * sigma * (1.0 - phi * phi)
        s = spread + r * r + q * q / h
        gain = spread / s
        for j in range(m):
            e = z[i, j] - x[0, j]
            out[i, j] = e
            x[0, j] += gain * e
        spread -= gain * spread
        variance[i] = s
    p[0] = spread
    return out, variance


def innovations(z: Array, dt: Array, restart: Restarts, colour: NoiseModel, *, integrated: bool) -> tuple[Array, Array]:
    """One-step innovations of each column of z and their variances.

    Args:
        z: residual and sensitivities, shape (k, m).
        dt: time since the previous sample, shape (k,).
        restart: True where a new segment begins.
        integrated: the channel is a rate (disturbance enters through its integral), not an acceleration.

    Returns:
        Innovations (k, m), variances (k,) with inf where a level was only initialised.
    """
    kernel = _integrated_innovations if integrated else _direct_innovations
    state = np.zeros((2, z.shape[1])), np.zeros(3)
    return kernel(np.ascontiguousarray(z), dt, restart, colour.vector(), state, True)


Gains = tuple[Array, float]
"""Of a channel's filter at each sample (see :mod:`.whitening_kernel`), and half the logarithms of its variances."""
Steps = tuple[Array, Restarts]
"""Time before each sample, and where segments begin, (k,) each."""


class KeptGains:
    """Gains of the filters of one record's channels; those of the last noise models are kept."""

    MOST = 12
    """Six channels, now and before."""

    def __init__(self) -> None:
        self._made: dict[tuple[NoiseModel, bool], Gains] = {}

    def of(self, colour: NoiseModel, steps: Steps, *, integrated: bool) -> Gains:
        """Along the whole record."""
        key = colour, integrated
        if key not in self._made:
            if len(self._made) >= self.MOST:
                self._made.pop(next(iter(self._made)))
            made = integrated_gains if integrated else direct_gains
            self._made[key] = made(*steps, colour.vector(), np.zeros(4))
        return self._made[key]


class Passing:
    """The whitening of one channel, which a long series passes part by part.

    Args:
        colour: its noise. integrated: as in :func:`innovations`.
        polynomial: the autoregression that whitens the rest.
        gains: those of the whole series, where it passes at once.
    """

    def __init__(self, colour: NoiseModel, polynomial: Array, *, integrated: bool, gains: Gains | None = None):
        self._made = integrated_gains if integrated else direct_gains
        self._noise, self._spread, self._gains = colour.vector(), np.zeros(4), gains
        self._polynomial = np.concatenate([polynomial, np.zeros(-(len(polynomial) - 1) % TAPS)])
        self._state: Array | None = None

    def __call__(
        self, rows: Array, steps: Steps, more: Array | None = None, shown: NDArray[np.intp] | None = None
    ) -> Gains:
        """Normalised innovations (k, width) of the next part of columns, each in a row, and half the sum of the
        logarithms of their variances.

        Args:
            rows: the first columns, (n, k). more, shown: as :func:`.whitening_kernel.white_columns` takes them.
        """
        gains, half = self._gains or self._made(*steps, self._noise, self._spread)
        more = np.ascontiguousarray(rows[:0] if more is None else more)
        shown = np.zeros(0, dtype=np.intp) if shown is None else shown
        if self._state is None:
            groups = -(-(len(rows) + len(shown)) // LANES)
            self._state = np.zeros((groups, (1 + len(self._polynomial)) * LANES))
        return white_columns(rows, more, shown, gains, self._polynomial, self._state), half


PART = 4096
"""Samples whose innovations are held at a time where only products of them are asked for."""


def innovation_products(
    z: Array, columns: Array, dt: Array, restart: Restarts, colour: NoiseModel, *, integrated: bool
) -> Array:
    """Sums of products of the normalised innovations of z (k,) and of columns (k, m), z first, shape (1 + m, 1 + m)."""
    kernel = _integrated_innovations if integrated else _direct_innovations
    width = 1 + columns.shape[1]
    state, out = (np.zeros((2, width)), np.zeros(3)), np.zeros((width, width))
    for first in range(0, len(z), PART):
        part = slice(first, first + PART)
        stacked = np.column_stack([z[part], columns[part]])
        e, s = kernel(stacked, dt[part], restart[part], colour.vector(), state, first == 0)
        white = e / np.sqrt(s)[:, None]  # zero where a level was only initialised
        out += white.T @ white
    return out


def minus_log_likelihood(residual: Array, dt: Array, restart: Restarts, colour: NoiseModel, integrated: bool) -> float:
    """Half the Gaussian minus-log-likelihood of a residual, robustified (pseudo-Huber at 4 sigma), constants
    dropped.
    """
    kernel = integrated_costs if integrated else direct_costs
    steps, noises = (dt, restart, float(np.median(dt))), colour.vector()[None, :]
    return float(kernel(np.ascontiguousarray(residual), steps, noises, False)[0])


@dataclass(frozen=True, slots=True)
class _Search:
    """Where the most likely noise is looked for: first guesses, and bounds in logarithms, (4,)."""

    starts: list[NoiseModel]
    floor: Array
    ceiling: Array


def _search(residual: Array, step: float, length: float, *, integrated: bool) -> _Search:
    """By the residual's own spread and that of its differences."""
    difference = np.diff(residual)
    scale = float(1.4826 * np.median(np.abs(difference - np.median(difference)))) + 1e-12
    spread = float(np.std(residual - np.median(residual))) + 1e-12
    rough = scale / step * 0.1 if integrated else spread
    starts = [
        NoiseModel(rough, 0.5, scale / np.sqrt(step) * 0.2, 0.6 * scale),
        NoiseModel(rough, 0.05, scale / np.sqrt(step) * 0.05, 0.6 * scale),
    ]
    unit = scale / step if integrated else spread
    floor = np.log([1e-5 * unit, 2.0 * step, 1e-5 * unit * np.sqrt(step), 1e-4 * scale])
    ceiling = np.log([1e3 * unit, max(length / 4.0, 4.0 * step), 1e2 * unit * np.sqrt(step), 1e2 * scale])
    return _Search(starts, floor, ceiling)


@dataclass(frozen=True, slots=True)
class _Series:
    """A channel's residual (k,), the time before each sample (k,), where segments begin (k,), and the usual time."""

    residual: Array
    dt: Array
    restart: Restarts
    usual_s: float
    integrated: bool

    def expanded(self, point: Array) -> Expansion:
        """Cost, slope and information of a noise by differences in each logarithm."""
        kernel = integrated_costs if self.integrated else direct_costs
        points = np.vstack([point, point + DIFFERENCE * np.eye(NUMBERS)])
        told = kernel(self.residual, (self.dt, self.restart, self.usual_s), np.exp(points), True)
        cost, products = told[: 1 + NUMBERS], told[1 + NUMBERS :].reshape(NUMBERS, LANES)
        information = products[:, 1 : 1 + NUMBERS] / DIFFERENCE**2
        return Expansion(float(cost[0]), (cost[1:] - cost[0]) / DIFFERENCE, information)

    def thinned(self) -> _Series:
        """Every THINNED-th sample of each segment: these have the same noise as all of them."""
        index = np.arange(len(self.dt))
        since = index - np.maximum.accumulate(np.where(self.restart, index, 0))
        kept = index[since % THINNED == 0]
        dt = np.diff(np.cumsum(self.dt)[kept], prepend=0.0)
        return _Series(self.residual[kept], dt, self.restart[kept], THINNED * self.usual_s, self.integrated)


def fit_noise_model(
    residual: Array, dt: Array, restart: Restarts, *, integrated: bool, start: NoiseModel | None = None
) -> NoiseModel:
    """Most likely noise of a channel from its residual, within wide physical bounds.

    The search ends at a minimum, and does not show where it began. Without a previous fit the channel's own spread
    gives two first guesses. Where there is far to go, every fourth sample of a long series says at first whither.

    Args:
        residual: z of the module's docstring, shape (k,).
        start: a previous fit to begin from.
    """
    step = float(np.median(dt[1:]))
    search = _search(residual, step, float(np.sum(dt[1:])), integrated=integrated)
    if not integrated:
        search.ceiling[2] = search.floor[2]  # blocks are equally long: noise of a density and of a size are one there
    series = _Series(np.ascontiguousarray(residual), dt, restart, step, integrated)
    long = len(residual) > LONG

    def look(*starts: Array) -> Array:
        return _likeliest(series.thinned(), search, starts)

    starts = [colour.logarithms() for colour in (search.starts if start is None else [start])]
    if start is None and long:
        starts = [look(*starts)]
    return NoiseModel.from_logarithms(_likeliest(series, search, starts, look if long else None))


EARLY, FIRST = 15, 40
"""Steps of a search that stops early, from a previous fit and without one."""
EARLY_DIFFERENCE = 1e-3
"""Step in the logarithm of a noise by which its slope is taken."""


def early_noise_model(
    residual: Array, dt: Array, restart: Restarts, *, integrated: bool, start: NoiseModel | None = None
) -> NoiseModel:
    """Noise of a channel by a search that stops after a few steps, near where it began; else :func:`fit_noise_model`.

    Of what a diagnosis leaves: generic columns have taken much of it, and effects that nobody has named yet are in it.
    And of attitudes against integrated rates: what these differ by is more than a gyro's white noise (scale, alignment,
    interpolation), too slow for its size to be told. The likeliest noise has none of it; the first guess holds it.
    """
    from scipy.optimize import minimize

    step = float(np.median(dt[1:]))
    search = _search(residual, step, float(np.sum(dt[1:])), integrated=integrated)
    floor, ceiling, series = search.floor, search.ceiling, np.ascontiguousarray(residual)
    kernel = integrated_costs if integrated else direct_costs

    def cost_and_slope(vector: Array) -> tuple[float, Array]:
        """Cost, and its slope by a difference in each logarithm, inwards at the ceiling."""
        step_of = np.where(vector + EARLY_DIFFERENCE > ceiling, -EARLY_DIFFERENCE, EARLY_DIFFERENCE)
        points = np.concatenate([vector[None, :], vector + np.diag(step_of)])
        cost = kernel(series, (dt, restart, step), np.exp(np.clip(points, floor, ceiling)), False)
        return float(cost[0]), (cost[1:] - cost[0]) / step_of

    best, lowest = search.starts[0].logarithms(), np.inf
    for colour in search.starts if start is None else [start]:
        found = minimize(
            cost_and_slope,
            np.clip(colour.logarithms(), floor + 0.1, ceiling - 0.1),
            jac=True,
            method="L-BFGS-B",
            bounds=list(zip(floor, ceiling, strict=True)),
            options={"maxiter": FIRST if start is None else EARLY, "ftol": 1e-7},
        )
        if found.fun < lowest:
            best, lowest = found.x, found.fun
    return NoiseModel.from_logarithms(np.clip(best, floor, ceiling))


def _likeliest(
    series: _Series, search: _Search, starts: Sequence[Array], far: Callable[[Array], Array] | None = None
) -> Array:
    """Logarithms of the likeliest noise that a search from one of several starts finds."""
    found = [scored(series.expanded, each, search.floor, search.ceiling, far) for each in starts]
    return min(found, key=lambda each: each[1])[0]


def whitening_polynomial(innovation: Array, restart: Restarts, highest: int = 24) -> Array:
    """Coefficients [1, -a_1, ...] of the autoregression that takes what colour the state model left, by BIC.

    Burg's recursion on normalised innovations; order 0 (just [1.0]) when nothing is gained. Outliers are clipped at 5
    sigma so that a spike does not shape the filter.
    """
    return burg(np.clip(innovation, -5.0, 5.0), restart, highest)
