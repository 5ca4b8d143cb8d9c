r"""Instrumental variable estimate: consistent whatever the controller saw and however noisy the rotor speeds are.

Solve Z^T W e(theta) = 0, where e are the residuals of ``record_model``, W whitens by the flight's own disturbance and Z
are the sensitivities that the planned motion would have (``instruments``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.flight_noise import Columns, FlightNoise
from groundstation.identification.prediction_error import SETTLED, Fitted, Point, Problem, huber, inverted, noise_of
from groundstation.identification.record_model import RecordModel
from groundstation.identification.sensitivities import planned_parts
from groundstation.model.parameters import FitOptions, Parameters, table

Array = NDArray[np.float64]
Equations = tuple[Array, Array, Array]
"""Z^T W X, Z^T W Z (P, P) and Z^T W e (P,) at a point."""

ROUNDS = 3
"""How often the noise model is refitted to the residual."""
STEPS = 10
"""Steps under one noise model, at most."""
RESIDUAL_GROWTH, HALVINGS = 5.0, 8
"""A step is halved while some channel's residual exceeds that of the prediction error estimate so many times, and not
taken if so many halvings are not enough. The two estimates differ by what feedback does; where the plan hardly tells
lag from dead time, a whole step leaves the flight behind and does not come back (20 to 600 times the residual, where
steps that come back have up to three).
"""
RESIDUAL_LEAST = 0.1
"""rad/s^2 and m/s^2: a residual below it (a flight without noise) is counted as this much."""


@dataclass(frozen=True, slots=True)
class _Instruments:
    """Under one noise model: what the residual is multiplied by, and what else weighs on the estimate.

    Attributes:
        columns: whitened sensitivities of the planned motion, by flight, part and channel, (n, P) each.
        spent: of each of them, by how much its variance exceeds what the residual says.
        precision: of the priors and of the lag's division, (P, P). information: with the instruments' own, (P, P).
        pull: mean and variance of the priors, (P,) each.
        split: precision of what is held near the first estimate, (P, P).
    """

    columns: tuple[tuple[tuple[Columns, ...], ...], ...]
    spent: tuple[tuple[float, ...], ...]
    precision: Array
    information: Array
    pull: tuple[Array, Array]
    split: Array


@dataclass(frozen=True, slots=True)
class _Solution:
    """Where the steps have led, the estimate's covariance (P, P), and Z^T W X (P, P)."""

    point: Point
    covariance: Array
    crossed: Array
    iterations: int


def instrumental(models: Sequence[RecordModel], start: Fitted, options: FitOptions) -> Fitted:
    r"""Refined instrumental variable estimate: solve Z^T W e(theta) = 0 with Z from the planned motion.

    A prediction error estimate is consistent in closed loop only when the controller saw no more than the record holds
    (Van den Hof 1998). The plan is independent of every disturbance, so this holds whatever the controller saw:

        theta <- theta + (Z^T W X)^-1 Z^T W e,    cov = (Z^T W X)^-1 (Z^T W Z) (X^T W Z)^-1

    with X, Z, e whitened by the same noise model, which is refitted to the residual (Young's refined IV). Z is as wide
    as X, one instrument for each parameter over all channels together: every instrument more keeps a share of the bias
    that instruments are there to remove (Bekker 1994), and with gentle flights that share was the larger part of the
    error.
    """
    problem = Problem(tuple(models), options, start.parameters)
    noise = noise_of(start, models, options)
    split, held = _held_near_start(start.names)
    point = problem.at(start.parameters)
    instruments = _instruments(problem, point, noise, split)
    found = _solve(problem, point, noise, instruments, start)
    for _ in range(ROUNDS - 1):
        before = problem.values(found.point)
        noise = problem.noise(found.point, noise, autoregression=options.autoregression)
        del instruments  # a quarter of a gigabyte for an hour of flight
        instruments = _instruments(problem, found.point, noise, split)
        found = _solve(problem, found.point, noise, instruments, start, found.iterations)
        if _settled(problem.values(found.point) - before, found.covariance):
            break
    covariance = found.covariance
    for index in held:
        covariance = _with_uncertain(covariance, found.crossed, index, float(start.covariance[index, index]))
    return replace(
        start,
        parameters=found.point.parameters,
        values=problem.values(found.point),
        covariance=covariance,
        bound=inverted(instruments.information),
        residual_rms=found.point.rms(),
        iterations=found.iterations,
        colours=tuple(colour for each in noise for colour in each.colours),
        whiteners=tuple(whitener for each in noise for whitener in each.whiteners),
    )


def _held_near_start(names: Sequence[str]) -> tuple[Array, list[int]]:
    """Precision (P, P) that keeps some parameters near the first estimate, and those that stay at it."""
    entries = table()
    held = [index for index, name in enumerate(names) if name in entries and entries[name].held is not None]
    split = lag_split_precision(names)
    for index in held:
        split[index, index] += 1.0 / (entries[names[index]].held or np.inf) ** 2
    return split, held


def _instruments(problem: Problem, point: Point, noise: Sequence[FlightNoise], split: Array) -> _Instruments:
    """The planned motion's sensitivities at a point under given noise models."""
    columns: list[tuple[tuple[Columns, ...], ...]] = []
    mean, std = problem.prior(point.names)
    precision = np.diag(1.0 / std**2) + split
    products = np.zeros_like(precision)
    for model, residual, each in zip(problem.models, point.residuals, noise, strict=True):
        passing, parts = each.passing(model), list[tuple[Columns, ...]]()
        for blocks, planned in planned_parts(model, point.parameters, problem.options):
            white = passing(blocks, residual[blocks], planned).sensitivity
            for z in white:
                products[z.pairs] += z.values.T @ z.values
            parts.append(white if len(model.parts()) == 1 else tuple(z.held() for z in white))
        columns.append(tuple(parts))
    information = precision + products
    root = _root_of_inverse(information)
    by_channel = [list(zip(*flight, strict=True)) for flight in columns]
    return _Instruments(
        columns=tuple(columns),
        spent=tuple(tuple(_spent_freedom(parts, root) for parts in flight) for flight in by_channel),
        precision=precision,
        information=information,
        pull=(mean, std**2),
        split=split,
    )


def _equations(
    problem: Problem, point: Point, noise: Sequence[FlightNoise], instruments: _Instruments, start: Fitted
) -> Equations:
    """Over all flights and channels, with priors."""
    theta = problem.values(point)
    mean, variance = instruments.pull
    zx, zz = instruments.precision.copy(), instruments.precision.copy()
    ze = (mean - theta) / variance + instruments.split @ (start.values - theta)
    for index, (model, each) in enumerate(zip(problem.models, noise, strict=True)):
        passing, spent = each.passing(model), instruments.spent[index]
        for part, columns in zip(point.parts(index), instruments.columns[index], strict=True):
            found = passing(*part)
            for y, x, z, factor in zip(found.residual, found.sensitivity, columns, spent, strict=True):
                w = huber(y)
                weighted = z.values * w[:, None]
                zx[np.ix_(z.shown, x.shown)] += weighted.T @ x.values
                zz[z.pairs] += factor * weighted.T @ z.values
                ze[z.shown] += weighted.T @ y
    return zx, zz, ze


def _merit(equations: Equations) -> float:
    """How far Z^T W e is from zero, in units of its own deviations, squared."""
    _, zz, ze = equations
    return float(ze @ np.linalg.solve(zz, ze))


def _step(
    problem: Problem,
    point: Point,
    equations: Equations,
    noise: Sequence[FlightNoise],
    instruments: _Instruments,
    start: Fitted,
) -> tuple[_Solution, Equations, bool]:
    """One of Newton's steps towards Z^T W e = 0, the equations where it led, and whether it was small beside the
    standard deviations.

    A step that leads away from zero is halved until it does not: the direction is right where the step is small
    (globalised Newton's method: Nocedal and Wright 2006, Numerical Optimization, 11.2).
    """
    zx, zz, ze = equations
    step = np.asarray(np.linalg.solve(zx, ze), dtype=float)
    inverse = np.linalg.inv(zx)
    found = _Solution(point, inverse @ zz @ inverse.T, zx, 1)
    most, before = RESIDUAL_GROWTH * np.maximum(start.residual_rms, RESIDUAL_LEAST), _merit(equations)
    for _ in range(HALVINGS):
        found = replace(found, point=_beside_the_flight(problem, point, step, most))
        if _settled(problem.values(found.point) - problem.values(point), found.covariance):
            return found, equations, True
        equations = _equations(problem, found.point, noise, instruments, start)
        if _merit(equations) < before:
            break
        step = 0.5 * step
    return found, equations, False


def _settled(change: Array, covariance: Array) -> bool:
    return bool(np.all(np.abs(change) < SETTLED * np.sqrt(np.diag(covariance))))


def _solve(
    problem: Problem,
    point: Point,
    noise: Sequence[FlightNoise],
    instruments: _Instruments,
    start: Fitted,
    taken_before: int = 0,
) -> _Solution:
    """Steps under one noise model until they are small."""
    equations = _equations(problem, point, noise, instruments, start)
    found, equations, small = _step(problem, point, equations, noise, instruments, start)
    iterations = 1
    while not small and iterations < STEPS:
        found, equations, small = _step(problem, found.point, equations, noise, instruments, start)
        iterations += 1
    return replace(found, iterations=taken_before + iterations)


def _with_uncertain(covariance: Array, zx: Array, held: int, variance: float) -> Array:
    """The covariance with that of a parameter which was held, and what its uncertainty does to the others.

    Args:
        zx: Z^T W X with the precision of the held one in its place; the others answer a change of it by -zx_oo^-1
            zx_oh.
    """
    others = np.arange(len(zx)) != held
    answer = np.ones(len(zx))
    answer[others] = -np.linalg.solve(zx[np.ix_(others, others)], zx[others, held])
    out = covariance.copy()
    out[held, :] = out[:, held] = 0.0
    return out + variance * np.outer(answer, answer)


def _root_of_inverse(information: Array) -> Array:
    """A square root R of the inverse, R R^T = information^-1, by eigenvalues in units in which the diagonal is one.

    What the flight tells nothing of in double precision (a flight without noise tells the rest to ten digits) counts
    for nothing.
    """
    unit = 1.0 / np.sqrt(np.diag(information))
    eigenvalues, vectors = np.linalg.eigh(information * np.outer(unit, unit))
    told = eigenvalues > 1e-14 * eigenvalues[-1]
    return unit[:, None] * vectors[:, told] / np.sqrt(eigenvalues[told])


def _spent_freedom(parts: Sequence[Columns], root: Array) -> float:
    """By how much the variance of an estimate exceeds what its residual says: n / (n - p - 2).

    A flight has few independent values n in the band an estimate uses (two at each frequency, up to the 95 % point of
    the whitened instruments' power), and a fit of p parameters takes its share out of the residual that the disturbance
    is read from: n / (n - p). What is left is a Student variable of n - p degrees of freedom, of variance (n - p) / (n
    - p - 2). p is this channel's leverage, trace(I^-1 Z^T Z).

    Args:
        parts: whitened instruments of one channel, the same of them shown in each.
        root: what brings them to units of the whole fit's standard deviations, (P, r).
    """
    shown = np.unique(np.concatenate([part.shown for part in parts]))
    whole, own = np.concatenate([part.of(shown) for part in parts]), root[shown]
    parameters = float(np.sum((whole.T @ whole) * (own @ own.T)))
    spectra = np.fft.rfft(whole, axis=0)
    power = np.asarray(sum(np.abs(spectra @ direction) ** 2 for direction in own.T))
    count = 2.0 * (1.0 + int(np.searchsorted(np.cumsum(power), 0.95 * float(np.sum(power)))))
    return count / max(count - parameters - 2.0, 0.3 * count)


def lag_split_precision(names: Sequence[str]) -> Array:
    """Prior precision that keeps how the total delay divides into lag up, lag down and dead time near the first
    estimate.

    The plan excites low frequencies, where only the sum shows; its division comes from the prediction error estimate,
    to 2 ms for the dead time (in 28 drawn flights it was never wrong by more than 1 ms, however wrong the lag) and 5 ms
    for up against down. The sum stays free.
    """
    precision = np.zeros((len(names), len(names)))
    row = np.zeros(len(names))
    if "input_delay_s" in names:
        row[names.index("input_delay_s")] = 1.0
        precision += np.outer(row, row) / 0.002**2
    if "rotor_lag_up_s" in names:
        row = np.zeros(len(names))
        row[names.index("rotor_lag_up_s")], row[names.index("rotor_lag_down_s")] = 1.0, -1.0
        precision += np.outer(row, row) / 0.005**2
    return precision


def _beside_the_flight(problem: Problem, point: Point, step: Array, most: Array) -> Point:
    """The point after the step, its half, its quarter ..., the first whose residual is at most so large in each
    channel; where it began if none is.
    """
    for _ in range(HALVINGS):
        after = problem.at(_bounded_move(problem, point, step))
        if not np.any(after.rms() > most):
            return after
        step = 0.5 * step
    return point


def _bounded_move(problem: Problem, point: Point, step: Array) -> Parameters:
    """The step, shortened until the tensor stays positive definite and the mass positive."""
    p, theta, fraction = point.parameters, problem.values(point), 1.0
    for _ in range(12):
        trial = problem.moved(point, theta + fraction * step)
        if (
            trial.mass_kg > 0.2 * p.mass_kg
            and np.linalg.eigvalsh(trial.tensor)[0] > 0.05 * np.linalg.eigvalsh(p.tensor)[0]
        ):
            return trial
        fraction *= 0.5
    return p
