"""The seed's two estimators, least squares (40) and gradient descent (42), with their evolution over time.

Both are linear in the output, so both get their intervals from :mod:`uncertainty` through their influence H_k.

The printed update of gradient descent, Theta <- Theta - sigma T Gamma^T e, is unstable: at sigma = 30 and T = 2 ms the
mass row alone makes sigma T g^2 = 5.8 > 2, and on a vehicle of 30 g the tensor's rows would too. Here every parameter
has a gain of its own, d_j = T rate / mean(|Gamma_j|^2), so that all forget at one rate in 1/s whatever their unit, and
the step is the backward Euler form of (41), taken row by row with the row G and output y:

    Theta <- Theta - d G^T (G Theta - y) / (1 + G d G^T),

a contraction for every gain and every sample. The price is noise: it remembers about 1/rate seconds, where least
squares remembers all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import NotIdentifiable
from groundstation.identification.parts import evenly, parts_of
from groundstation.identification.regressors import Assembled
from groundstation.identification.uncertainty import coloured_covariance

Array = NDArray[np.float64]

ADAPTATION_RATE_PER_S = 1.0
"""Rate at which gradient descent forgets along an average direction: memory of about one second."""
STRETCH = 131072
"""Samples over which a spectrum is taken at most: two minutes at 1 kHz, of which a residual remembers a thirtieth."""
FORGOTTEN = 1e-15
"""Share of an earlier error from which a covariance, where its square is added, is the same to the last bit."""
SINGULAR = 1e-10
"""Eigenvalues of the correlation matrix of the regressor's columns below this are zero in double precision."""


@dataclass(frozen=True, slots=True)
class LinearEstimate:
    """An estimate of Theta in Gamma Theta = Upsilon.

    Attributes:
        values: at the end, shape (p,); NaN where the data do not determine a parameter.
        covariance: allowing for coloured residuals, shape (p, p).
        condition_number: ratio of the largest to the smallest singular value of the stacked regressor, as in cond(W).
        rms_residual: root mean square of Gamma Theta - Upsilon per output (eq. 43), shape (n_outputs,).
        evolution_t_s: shape (n,).
        evolution: estimate at those times, shape (n, p); NaN while undetermined.
    """

    values: Annotated[Array, "p"]
    covariance: Annotated[Array, "p p"]
    condition_number: float
    rms_residual: Annotated[Array, "outputs"]
    evolution_t_s: Annotated[Array, "n"]
    evolution: Annotated[Array, "n p"]


def least_squares(
    regressor: Annotated[Array, "k outputs p"] | Assembled,
    output: Annotated[Array, "k outputs"],
    t_s: Annotated[Array, "k"],
    used: Annotated[NDArray[np.bool_], "k"],
    points: int = 400,
) -> LinearEstimate:
    r"""Least squares (seed eq. 40), with its evolution from cumulated normal equations.

    Sums of Gamma^T Gamma and Gamma^T Upsilon are formed per block of samples and cumulated, so the evolution costs one
    small solve per point. Columns are scaled to unit length first: conditioning then is of directions, not of units.

    Args:
        regressor: Gamma, shape (k, n_outputs, p).
        output: Upsilon, shape (k, n_outputs), N and N m.
        t_s: times on a uniform grid, shape (k,).
        used: which samples count, shape (k,).
        points: how many points of the evolution to keep.

    Raises:
        NotIdentifiable: no sample is used.
    """
    rows = _used_rows(used)
    stops = _stops(len(rows), points)
    normals, moments = _cumulated(regressor, output, rows, stops)
    length = np.sqrt(np.diag(normals[-1]))
    unit = np.where(length > 0.0, length, 1.0)
    scaled = normals / np.outer(unit, unit)
    known = _determined(scaled[-1])
    evolution = _solve_scaled(scaled, moments / unit) / unit
    values = evolution[-1].copy()
    final: Array = scaled[-1]
    inverse = np.linalg.pinv(final, rcond=SINGULAR, hermitian=True) / np.outer(unit, unit)
    residual, covariance = _residual(regressor, output, values, rows), np.zeros_like(inverse)
    for part in evenly(len(used), STRETCH):
        inside = rows[slice(*np.searchsorted(rows, (part.start, part.stop)))]
        influence = np.zeros((part.stop - part.start, *regressor.shape[:0:-1]))
        influence[run_of(inside - part.start)] = np.matmul(inverse, regressor[run_of(inside)].transpose(0, 2, 1))
        covariance += coloured_covariance(influence, residual[part], float(t_s[1] - t_s[0]))
    covariance[~known, :] = covariance[:, ~known] = np.inf
    evolution[:, ~known] = values[~known] = np.nan
    rms = np.sqrt(np.sum(residual**2, axis=0) / len(rows))
    return LinearEstimate(values, covariance, _condition(normals[-1]), rms, t_s[rows[stops - 1]], evolution)


def _cumulated(
    regressor: Array | Assembled, output: Array, rows: NDArray[np.intp], stops: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Gamma^T Gamma (n, p, p) and Gamma^T Upsilon (n, p) of the rows up to each stop."""
    from groundstation.identification.kernels import add_products

    count = regressor.shape[2]
    total, noted = np.zeros((count + 1, count)), list[Array]()
    for part in parts_of(len(rows), STRETCH):
        run = run_of(rows[part])
        gamma, upsilon = np.ascontiguousarray(regressor[run]), np.ascontiguousarray(output[run])
        inside = stops[(stops > part.start) & (stops <= part.stop)] - part.start
        noted.append(add_products(gamma, upsilon, inside, total))
    both = np.concatenate(noted)
    return both[:, :count], both[:, count]


def _determined(correlation: Array) -> NDArray[np.bool_]:
    """Which parameters take no part in a direction that the regressor leaves at zero; columns are of unit length."""
    eigenvalues, vectors = np.linalg.eigh(correlation)
    return ~(np.abs(vectors[:, eigenvalues < SINGULAR]) > 1e-3).any(axis=1) & (np.diag(correlation) > 0.0)


def _solve_scaled(normals: Array, moments: Array) -> Array:
    """Solutions of a stack of scaled normal equations, shape (n, p); NaN while one is singular."""
    eigenvalues, vectors = np.linalg.eigh(normals)
    singular = eigenvalues < SINGULAR
    inverse = np.where(singular, 0.0, 1.0 / np.where(singular, 1.0, eigenvalues))
    solution = np.einsum("npi,ni,nqi,nq->np", vectors, inverse, vectors, moments, optimize=True)
    touched = np.einsum("npi,ni->np", np.abs(vectors) > 1e-3, singular) > 0.0
    last = solution[-1].copy()
    solution[touched] = np.nan
    solution[-1] = last
    return solution


def gradient_descent(
    regressor: Annotated[Array, "k outputs p"] | Assembled,
    output: Annotated[Array, "k outputs"],
    t_s: Annotated[Array, "k"],
    used: Annotated[NDArray[np.bool_], "k"],
    *,
    rate_per_s: float = ADAPTATION_RATE_PER_S,
    points: int = 400,
) -> LinearEstimate:
    r"""Gradient descent (seed eq. 42) from zero, scaled so that it is stable on every vehicle (see the module's head).

    Args are those of :func:`least_squares`, and the adaptation rate.

    Raises:
        NotIdentifiable: no sample is used.
    """
    period_s = float(t_s[1] - t_s[0])
    rows = _used_rows(used)
    normal, moment = _sums(regressor, output, rows)
    mean_square = np.diag(normal) / len(rows)
    known = mean_square > 0.0
    gain = np.where(known, rate_per_s * period_s / np.where(known, mean_square, 1.0), 0.0)
    stops = _stops(len(rows), points)
    evolution = _descended(regressor, output, rows, gain, stops)
    values = evolution[-1].copy()
    # What least squares leaves is the disturbance: a descent's own error would add lines where it listens.
    fitted = np.asarray(np.linalg.lstsq(normal, moment, rcond=SINGULAR)[0], dtype=float)
    residual = _residual(regressor, output, fitted, rows)
    covariance, initial = _descent_covariance(regressor, residual, rows, gain, period_s)
    left = initial @ values  # what is left of the start at zero is an error of its own, -M Theta
    covariance += np.outer(left, left)
    covariance[~known, :] = covariance[:, ~known] = np.inf
    evolution[:, ~known] = np.nan
    rms = np.sqrt(np.sum(_residual(regressor, output, values, rows) ** 2, axis=0) / len(rows))
    values[~known] = np.nan
    return LinearEstimate(values, covariance, _condition(normal), rms, t_s[rows[stops - 1]], evolution)


def _sums(regressor: Array | Assembled, output: Array, rows: NDArray[np.intp]) -> tuple[Array, Array]:
    """Gamma^T Gamma (p, p) and Gamma^T Upsilon (p,) of all rows."""
    count = regressor.shape[2]
    normal, moment = np.zeros((count, count)), np.zeros(count)
    for part in parts_of(len(rows), STRETCH):
        run = run_of(rows[part])
        gamma = regressor[run]
        normal += np.tensordot(gamma, gamma, axes=((0, 1), (0, 1)))
        moment += np.tensordot(gamma, output[run], axes=((0, 1), (0, 1)))
    return normal, moment


def _descended(
    regressor: Array | Assembled, output: Array, rows: NDArray[np.intp], gain: Array, stops: NDArray[np.int64]
) -> Array:
    """The descent's estimate at each stop, (n, p)."""
    from groundstation.identification.kernels import descend

    theta, noted = np.zeros(regressor.shape[2]), list[Array]()
    for part in parts_of(len(rows), STRETCH):
        run = run_of(rows[part])
        gamma, upsilon = np.ascontiguousarray(regressor[run]), np.ascontiguousarray(output[run])
        inside = stops[(stops > part.start) & (stops <= part.stop)] - part.start
        noted.append(descend(gamma, upsilon, gain, inside, theta))
    return np.concatenate(noted)


def _descent_covariance(
    regressor: Array | Assembled, residual: Array, rows: NDArray[np.intp], gain: Array, period_s: float
) -> tuple[Array, Array]:
    """Covariance of the final estimate (p, p), and what is left of the initial error, (p, p)."""
    from groundstation.identification.kernels import descent_influence

    later = np.eye(regressor.shape[2])
    covariance = np.zeros_like(later)
    for part in reversed(evenly(len(residual), STRETCH)):
        inside = rows[slice(*np.searchsorted(rows, (part.start, part.stop)))]
        influence = np.zeros((part.stop - part.start, *regressor.shape[:0:-1]))
        gamma = np.ascontiguousarray(regressor[run_of(inside)])
        influence[run_of(inside - part.start)] = descent_influence(gamma, gain, later)
        if np.any(influence):
            covariance += coloured_covariance(influence, residual[part], period_s)
        if _forgotten(later, gain):
            break
    return covariance, later


def _forgotten(later: Array, gain: Array) -> bool:
    """Whether steps whose product is ``later`` leave nothing of what was before them, in the units in which each step
    is a contraction: 1 - D^(1/2) G^T G D^(1/2) / size.
    """
    known = gain > 0.0
    unit = np.sqrt(gain[known])
    return bool(np.all(np.abs(later[np.ix_(known, known)]) * unit < FORGOTTEN * unit[:, None]))


def _used_rows(used: NDArray[np.bool_]) -> NDArray[np.intp]:
    rows = np.flatnonzero(used)
    if len(rows) == 0:
        raise NotIdentifiable("No sample is left to estimate from.", "Exclude less.")
    return rows


def run_of(rows: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    """Ascending rows as a slice, which copies nothing, where none is left out between them."""
    if not len(rows) or rows[-1] - rows[0] + 1 != len(rows):
        return rows
    return slice(int(rows[0]), int(rows[-1]) + 1)


def _stops(samples: int, points: int) -> NDArray[np.int64]:
    """At most ``points`` numbers of samples, ascending, the last of which is all of them."""
    return np.unique(np.linspace(1, samples, min(points, samples)).astype(np.int64))


def _condition(normal: Array) -> float:
    """Ratio of singular values of the stacked regressor, from its normal matrix; inf beyond what doubles resolve."""
    eigenvalues = np.linalg.eigvalsh(normal)
    return (
        float(np.sqrt(eigenvalues[-1] / eigenvalues[0])) if eigenvalues[0] > 1e-15 * eigenvalues[-1] else float("inf")
    )


def _residual(regressor: Array | Assembled, output: Array, values: Array, rows: NDArray[np.intp]) -> Array:
    """Gamma Theta - Upsilon (eq. 43) on the full grid, zero where a sample was not used."""
    out = np.zeros(output.shape)
    for part in parts_of(len(rows), STRETCH):
        run = run_of(rows[part])
        out[run] = regressor[run] @ values - output[run]
    return out
