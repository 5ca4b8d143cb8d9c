r"""How one parameter moves from flight to flight: scatter, control limits, steps and drifts with a probability. Numbers
only.

Random-effects model (DerSimonian and Laird 1986) of flights :math:`i = 0 .. n-1` in the order they were flown:

.. math::  y_i = \mu + \delta\,x_i + u_i + e_i, \quad u_i \sim N(0, \tau^2), \quad e_i \sim N(0, s_i^2)

with :math:`s_i` each flight's own standard deviation, :math:`\tau` the scatter between flights that no interval covers,
and :math:`x` one of: nothing, a step at flight k (0 before it, 1 from it on), a drift (:math:`i - (n-1)/2`). Given
:math:`\tau` and the prior :math:`\delta \sim N(0, D^2)`, with :math:`\mu` flat, the marginal likelihood is Gaussian:
with :math:`w_i = 1/(s_i^2 + \tau^2)`, means weighted by w, :math:`A = \sum w (x-\bar x)^2`, :math:`b = \sum w (x-\bar
x)(y-\bar y)`,

.. math::  \ln p_1 - \ln p_0 = \frac{b^2}{2(A + D^{-2})} - \tfrac12 \ln(1 + A D^2)

(Gelman et al., Bayesian Data Analysis, 3rd ed., ch. 5 and 7). :math:`\tau` and D are averaged over grids, in units of
the median :math:`s_i`, so nothing depends on a parameter's unit. A change is named by its posterior probability against
"nothing changed".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import norm

Array = NDArray[np.float64]

CHANGE_IN_A_FLEET = 0.1
"""Prior probability that anything at all changed in a vehicle's flights: one series in ten; spread evenly over its
parameters.
"""
NAMED = 0.95
"""Posterior probability from which a change is named: at most one name in twenty is wrong where the prior is right."""
SHORTEST = 4
"""Flights below which a series says nothing: two before a change and two after it."""
BESIDE = 2
"""Flights on each side of a step: one flight apart from all others is an outlier, which the control limits show."""
LIMIT = 3.0
"""Control limits, in standard deviations of a flight (Shewhart's)."""
_SCATTERS = np.concatenate([[0.0], np.geomspace(0.1, 100.0, 13)])
_SIZES = np.geomspace(0.5, 500.0, 13)


@dataclass(frozen=True, slots=True)
class Change:
    """A step ("from flight ``at`` on, ``size``") or a drift (``size`` a flight), with its probability.

    Attributes:
        kind: "step" or "drift".
        at: index of the first flight after a step; 0 for a drift.
        at_probability: share of the step's probability that lies within one flight of ``at``; 1 for a drift.
        probability: that the parameter moved at all, against "nothing changed".
        size, std: of the change, in the parameter's unit (a flight, for a drift).
    """

    kind: Literal["step", "drift"]
    at: int
    at_probability: float
    probability: float
    size: float
    std: float


@dataclass(frozen=True, slots=True)
class Trend:
    r"""A parameter over a vehicle's flights.

    Attributes:
        mean: at each flight, the change included, shape (n,).
        scatter: :math:`\\tau`, standard deviation between flights beyond their own intervals.
        low, high: control limits of each flight, shape (n,).
        outside: indices of flights beyond their limits.
        change: what moved, where its probability is at least :data:`NAMED`; else None.
        probability: that it moved at all.
    """

    mean: Array
    scatter: float
    low: Array
    high: Array
    outside: tuple[int, ...]
    change: Change | None
    probability: float


def trend(values: Sequence[float] | Array, stds: Sequence[float] | Array, *, parameters: int = 1) -> Trend:
    """Scatter, limits and change of one parameter over flights.

    Args:
        values, stds: estimates and their standard deviations, in the order the flights were flown; shape (n,), finite,
            std > 0.
        parameters: how many of this vehicle's parameters are looked at; the prior of a change is shared among them.

    Raises:
        ValueError: lengths differ, or a value is not finite, or a standard deviation is not positive.
    """
    y, s = np.asarray(values, float), np.asarray(stds, float)
    if y.shape != s.shape or y.ndim != 1 or not (np.isfinite(y).all() and np.isfinite(s).all() and (s > 0.0).all()):
        raise ValueError("a trend needs finite values and positive standard deviations, one for each flight.")
    if not len(y):
        return Trend(y, 0.0, y, y, (), None, 0.0)
    unit = float(np.median(s))
    designs = _designs(len(y))
    table = _log_evidence(y / unit, s / unit, designs)
    prior = CHANGE_IN_A_FLEET / max(parameters, 1)
    log_prior = np.full(len(designs), np.log1p(-prior))
    if len(designs) > 1:
        steps = len(designs) - 2
        log_prior[1] = np.log(prior / 2.0 if steps else prior)
        log_prior[2:] = np.log(prior / 2.0 / max(steps, 1))
    joint = logsumexp(table, axis=(1, 2)) + log_prior
    posterior = np.exp(joint - logsumexp(joint))
    moved = float(1.0 - posterior[0])
    change = _change(y / unit, s / unit, designs, table, posterior, unit) if moved >= NAMED else None
    chosen = 0 if change is None else (1 if change.kind == "drift" else 2 + change.at - BESIDE)
    mean, scatter = _level(y / unit, s / unit, designs[chosen], table[chosen])
    half = LIMIT * np.hypot(s, scatter * unit)
    mean = mean * unit
    outside = tuple(int(i) for i in np.flatnonzero(np.abs(y - mean) > half))
    return Trend(mean, scatter * unit, mean - half, mean + half, outside, change, moved)


def _designs(count: int) -> list[Array]:
    """Nothing; a drift; a step at each flight that leaves :data:`BESIDE` on both sides. Shape (n,) each."""
    flights = np.arange(count, dtype=float)
    nothing = np.zeros(count)
    if count < SHORTEST:
        return [nothing]
    return [nothing, flights - flights.mean(), *(np.where(flights >= k, 1.0, 0.0) for k in range(BESIDE, count - 1))]


def _log_evidence(y: Array, s: Array, designs: Sequence[Array]) -> Array:
    """Ln p(y | design, tau, D) plus the even weights of the grids; shape (designs, scatters, sizes)."""
    out = np.empty((len(designs), len(_SCATTERS), len(_SIZES)))
    for j, tau in enumerate(_SCATTERS):
        w = 1.0 / (s**2 + tau**2)
        total = w.sum()
        centred = y - w @ y / total
        null = 0.5 * np.log(w).sum() - 0.5 * np.log(total) - 0.5 * w @ centred**2
        for i, x in enumerate(designs):
            a, b = _normal_equation(x, centred, w)
            # a drift's size is of the whole series, so that the same prior serves both
            d = _SIZES / max(np.ptp(x), 1.0) if a > 0.0 else _SIZES
            out[i, j] = null + 0.5 * b**2 / (a + d**-2) - 0.5 * np.log1p(a * d**2)
    return out - np.log(out[0].size)


def _normal_equation(x: Array, centred: Array, w: Array) -> tuple[float, float]:
    """A and b of the module's head; ``centred`` is y less its weighted mean."""
    xc = x - w @ x / w.sum()
    return float(w @ xc**2), float((w * xc) @ centred)


def _change(y: Array, s: Array, designs: Sequence[Array], table: Array, posterior: Array, unit: float) -> Change:
    """The likeliest change, its place and size."""
    drift, steps = posterior[1], posterior[2:]
    moved = float(1.0 - posterior[0])
    if not len(steps) or drift > steps.sum():
        size, std = _size(y, s, designs[1], table[1])
        return Change("drift", 0, 1.0, moved, size * unit, std * unit)
    best = int(np.argmax(steps))
    near = float(steps[max(best - 1, 0) : best + 2].sum() / steps.sum())
    size, std = _size(y, s, designs[2 + best], table[2 + best])
    return Change("step", best + BESIDE, near, moved, size * unit, std * unit)


def _size(y: Array, s: Array, x: Array, log_evidence: Array) -> tuple[float, float]:
    """Mean and standard deviation of delta, scatter and prior size averaged over."""
    weight = np.exp(log_evidence - logsumexp(log_evidence))
    mean = np.zeros_like(weight)
    variance = np.zeros_like(weight)
    for j, tau in enumerate(_SCATTERS):
        w = 1.0 / (s**2 + tau**2)
        a, b = _normal_equation(x, y - w @ y / w.sum(), w)
        precision = a + (np.ptp(x) / _SIZES) ** 2
        mean[j], variance[j] = b / precision, 1.0 / precision
    centre = float((weight * mean).sum())
    return centre, float(np.sqrt((weight * (variance + (mean - centre) ** 2)).sum()))


def _level(y: Array, s: Array, x: Array, log_evidence: Array) -> tuple[Array, float]:
    """Mean of each flight and the scatter, averaged over the grids."""
    over = logsumexp(log_evidence, axis=1)
    weight = np.exp(over - logsumexp(over))
    mean = np.zeros_like(y)
    for share, tau in zip(weight, _SCATTERS, strict=True):
        w = 1.0 / (s**2 + tau**2)
        a, b = _normal_equation(x, y - w @ y / w.sum(), w)
        slope = b / a if a > 0.0 else 0.0
        mean += share * (w @ (y - slope * x) / w.sum() + slope * x)
    return mean, float(weight @ _SCATTERS)


@dataclass(frozen=True, slots=True)
class Difference:
    """One parameter in two groups of flights: mean of the second less that of the first, and how surely it is not zero.

    ``p`` is two-sided and not corrected for the number of parameters; :func:`compare_groups` corrects (Holm 1979).
    """

    first: float
    second: float
    std: float
    p: float

    @property
    def size(self) -> float:
        """Second less first."""
        return self.second - self.first


def pooled(values: Sequence[float] | Array, stds: Sequence[float] | Array) -> tuple[float, float]:
    """Random-effects mean of flights and its standard deviation (tau averaged as in :func:`trend`)."""
    y, s = np.asarray(values, float), np.asarray(stds, float)
    unit = float(np.median(s))
    table = _log_evidence(y / unit, s / unit, [np.zeros(len(y))])[0]
    over = logsumexp(table, axis=1)
    weight = np.exp(over - logsumexp(over))
    means: list[float] = []
    variances: list[float] = []
    for tau in _SCATTERS:
        w = 1.0 / ((s / unit) ** 2 + tau**2)
        means.append(w @ (y / unit) / w.sum())
        variances.append(1.0 / w.sum())
    if len(y) == 1:  # one flight does not tell how flights scatter
        return float(y[0]), float(s[0])
    mean = float(weight @ means)
    return mean * unit, float(np.sqrt(weight @ (np.array(variances) + (np.array(means) - mean) ** 2))) * unit


def difference(first: tuple[Array, Array], second: tuple[Array, Array]) -> Difference:
    """Two groups of (values, stds) of one parameter."""
    (a, std_a), (b, std_b) = pooled(*first), pooled(*second)
    std = float(np.hypot(std_a, std_b))
    return Difference(a, b, std, float(2.0 * norm.sf(abs(b - a) / std)))


def holm(p: Sequence[float]) -> list[float]:
    """Holm's step-down adjusted p values, in the order given (Holm, Scand. J. Statist. 6, 1979)."""
    order = np.argsort(p)
    adjusted = np.empty(len(p))
    worst = 0.0
    for rank, index in enumerate(order):
        worst = max(worst, min(1.0, (len(p) - rank) * p[int(index)]))
        adjusted[index] = worst
    return [float(v) for v in adjusted]


Groups = Mapping[str, tuple[Array, Array]]


def compare_groups(first: Groups, second: Groups) -> dict[str, tuple[Difference, float]]:
    """Parameters that both groups have: their difference, and its p value corrected for their number (Holm)."""
    names = [name for name in first if name in second]
    found = [difference(first[name], second[name]) for name in names]
    return {name: (d, p) for name, d, p in zip(names, found, holm([d.p for d in found]), strict=True)}
