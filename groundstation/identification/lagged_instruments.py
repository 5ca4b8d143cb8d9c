r"""Regression of a signal on motion in closed loop, where nothing was planned: past motion as the instrument, parts of
flights as each other's check.

In :math:`y = A \theta + d` the controller answers the disturbance d, so motion and d are correlated and least squares
lies. What the vehicle did a while ago is not: a disturbance that lasts less than the lag cannot have caused it, and a
manoeuvre that lasts longer makes it resemble the motion now. So :math:`Z(t) = A(t - \ell)` for a few lags are the
instruments of two-stage least squares (Soderstrom and Stoica 1983, section 5; Gilson and Van den Hof 2005 for closed
loops). Everything is low-passed: below the band's edge, telemetry that is filtered or late is still right but for terms
that the regressors hold.

Disturbances that last longer, and what the equation leaves out, show as disagreement between parts of the flights. Each
part is an estimate of its own; the pooled one has the scatter between parts in its interval (Birge 1932; the scale
factor of the Particle Data Group's reviews).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from groundstation.identification.uncertainty import coloured_covariance

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LAGS_S = (0.25, 0.4, 0.55)
"""Longer than gusts and sensor noise below the band's edge stay alike, shorter than a manoeuvre."""
WITHIN = 0.95
"""Of an interval."""
WEAK = 1e-6
"""Share of the largest singular value below which a direction of the regressors is taken to be absent."""


@dataclass(frozen=True, slots=True)
class Equation:
    """One channel of one part of a flight, evenly sampled.

    Attributes:
        output: (k,). columns: regressors, (k, p), the first ``effects`` of them those that are asked for.
        known: regressors that owe nothing to the disturbance (constants), (k, c); their own instruments.
        used: which samples count, (k,).
        step_s: of the samples.
    """

    output: Array
    columns: Array
    known: Array
    used: Mask
    step_s: float
    effects: int


@dataclass(frozen=True, slots=True)
class PartEstimate:
    """What one equation says of its effects: values and standard deviations, (effects,), and the residual's variance.

    ``correlation`` is in samples: for an effect so many of the ``samples`` are worth one.
    """

    values: Array
    std: Array
    variance: float
    correlation: Array
    samples: int


@dataclass(frozen=True, slots=True)
class Pooled:
    """One parameter by all parts: value, standard deviation with the scatter between parts in it, and that scatter's
    scale (1 and more).

    ``freedom`` is how many independent samples the parts are worth, ``gain`` the fall of the squared error of each
    part, in units of its noise, with the value that the other parts give, ``count`` that of the parts.
    """

    value: float
    std: float
    scale: float
    freedom: float
    gain: float
    count: int

    def spread(self) -> float:
        """The normal deviation whose 95 % interval is Student's of so many parts, whose scatter they tell
        themselves.
        """
        return self.std * float(stdtrit(self.count - 1, 0.5 * (1.0 + WITHIN)) / ndtri(0.5 * (1.0 + WITHIN)))


def shifted(values: Array, samples: int) -> Array:
    """Values as they were some samples before; the first ones stand in where nothing was."""
    return np.concatenate([np.repeat(values[:1], samples, axis=0), values[: len(values) - samples]])


def _with_past(used: Mask, lags: Sequence[int]) -> Mask:
    """Samples that are used, and were at every lag before."""
    out = used.copy()
    out[: max(lags)] = False
    for lag in lags:
        out[lag:] &= used[: len(used) - lag]
    return out


def two_stage(equation: Equation) -> PartEstimate | None:
    """Two-stage least squares with lagged instruments; None where too few samples are left or an effect's column is
    zero.
    """
    lags = [max(1, round(lag / equation.step_s)) for lag in LAGS_S]
    used = _with_past(equation.used, lags)
    a = np.column_stack([equation.columns, equation.known])
    z = np.column_stack([*(shifted(equation.columns, lag) for lag in lags), equation.known])
    if used.sum() < 4 * z.shape[1]:
        return None
    scale = np.sqrt(np.mean(a[used] ** 2, axis=0))
    count = equation.effects
    if np.any(scale[:count] <= 0.0):
        return None
    a = a / np.where(scale > 0.0, scale, 1.0)
    basis = _basis(z[used])
    first = basis @ (basis.T @ a[used])
    inverse = np.linalg.pinv(first.T @ first, rcond=WEAK, hermitian=True)
    theta = inverse @ (first.T @ equation.output[used])
    left = np.zeros_like(equation.output)
    left[used] = equation.output[used] - a[used] @ theta
    influence = np.zeros((len(left), count, 1))
    influence[used, :, 0] = (first @ inverse)[:, :count]
    covariance = coloured_covariance(influence, left[:, None], equation.step_s)
    variance = float(np.mean(left[used] ** 2))
    std = np.sqrt(np.diag(covariance))
    worth = np.diag(covariance) / np.maximum(np.diag(inverse)[:count] * variance, 1e-300)
    return PartEstimate(
        theta[:count] / scale[:count], std / scale[:count], variance, np.maximum(worth, 1.0), int(used.sum())
    )


def _basis(columns: Array) -> Array:
    """Orthonormal basis of what columns span, (k, r)."""
    left, values, _ = np.linalg.svd(columns / (np.linalg.norm(columns, axis=0) + 1e-300), full_matrices=False)
    return np.asarray(left[:, values > WEAK * values[0]])


Parts = Sequence[tuple[Equation, PartEstimate, int]]
"""Equations with their estimates, and which of its effects' columns the parameter is in each."""


def pooled(parts: Parts) -> Pooled:
    """Weighted mean of the parts; its deviation times the scatter between them where they scatter by more than they
    say.
    """
    values, std = (np.array([getattr(p, name)[i] for _, p, i in parts]) for name in ("values", "std"))
    value, own, scale = _mean(values, std)
    freedom = sum(p.samples / p.correlation[i] for _, p, i in parts)
    return Pooled(value, own * scale, scale, float(freedom), _held_out_gain(parts, values, std), len(parts))


def _mean(values: Array, std: Array) -> tuple[float, float, float]:
    """Weighted mean, its standard deviation by the parts' own, and the scale of their scatter."""
    weight = 1.0 / std**2
    value = float(np.sum(weight * values) / np.sum(weight))
    freedom = len(values) - 1
    scale = max(1.0, float(np.sqrt(np.sum(weight * (values - value) ** 2) / freedom))) if freedom else 1.0
    return value, float(np.sum(weight) ** -0.5), scale


def _held_out_gain(parts: Parts, values: Array, std: Array) -> float:
    if len(parts) < 2:
        return 0.0
    gain = 0.0
    for index, (equation, part, own) in enumerate(parts):
        value, *_ = _mean(np.delete(values, index), np.delete(std, index))
        beside = _basis(np.column_stack([np.delete(equation.columns, own, axis=1), equation.known])[equation.used])
        output = equation.output[equation.used]
        after = output - value * equation.columns[equation.used, own]
        falls = [float(np.sum((y - beside @ (beside.T @ y)) ** 2)) for y in (output, after)]
        gain += (falls[0] - falls[1]) / (part.variance * float(part.correlation[own]))
    return gain
