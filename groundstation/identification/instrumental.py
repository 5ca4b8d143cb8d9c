r"""Instrumental variable estimate: consistent whatever the controller saw and however noisy the rotor speeds are.

Solve Z^T W e(theta) = 0, where e are the residuals of ``record_model``, W whitens by the flight's own disturbance and Z are
the sensitivities that the planned motion would have (``instruments``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.prediction_error import (
    Fitted,
    huber,
    inverted,
    noise_model,
    per_flight,
    priors,
    whiten,
)
from groundstation.identification.record_model import RecordModel
from groundstation.identification.sensitivities import planned_sensitivities
from groundstation.model.parameters import FitOptions, Parameters, table, values_of, with_values

Array = NDArray[np.float64]

ROUNDS = 3
"""How often the noise model is refitted to the residual."""


def instrumental(models: Sequence[RecordModel], start: Fitted, options: FitOptions) -> Fitted:
    r"""Refined instrumental variable estimate: solve Z^T W e(theta) = 0 with Z from the planned motion.

    A prediction error estimate is consistent in closed loop only when the controller saw no more than the record holds
    (Van den Hof 1998). The plan is independent of every disturbance, so this holds whatever the controller saw:

        theta <- theta + (Z^T W X)^-1 Z^T W e,    cov = (Z^T W X)^-1 (Z^T W Z) (X^T W Z)^-1

    with X, Z, e whitened by the same noise model, which is refitted to the residual (Young's refined IV). Z is as wide as X, one
    instrument for each parameter over all channels together: every instrument more keeps a share of the bias that
    instruments are there to remove (Bekker 1994), and with gentle flights that share was the larger part of the error.
    """
    extra_names = [term.name for term in models[0].extra]
    channels = [model.channels(options) for model in models]
    colours, polynomials = per_flight(start.colours, channels), per_flight(start.whiteners, channels)
    p, names = start.parameters, start.names
    covariance, information = start.covariance, inverted(start.covariance)
    entries = table()
    held = [index for index, name in enumerate(names) if name in entries and entries[name].held is not None]
    split = lag_split_precision(names)
    for index in held:
        split[index, index] += 1.0 / (entries[names[index]].held or np.inf) ** 2
    evaluated = [model.evaluate(p, options) for model in models]
    iterations = 0
    for round_index in range(ROUNDS):
        if round_index > 0:
            for index, (model, found) in enumerate(zip(models, evaluated, strict=True)):
                colours[index], polynomials[index] = noise_model(
                    model, found[0], channels[index], colours[index], options.autoregression
                )
        planned = [
            whiten(
                model, model.residual(p), planned_sensitivities(model, p, options),
                channels[index], colours[index], polynomials[index],
            )[1]
            for index, model in enumerate(models)
        ]  # fmt: skip
        mean, std = priors(models[0].record, start.parameters, names, models[0].extra, options)
        precision = np.diag(1.0 / std**2) + split
        information = precision + sum(z.T @ z for columns in planned for z in columns)
        root = _root_of_inverse(information)
        freedom = [[_spent_freedom(z @ root) for z in columns] for columns in planned]
        for _ in range(10):
            theta = values_of(p, names, extra_names)
            zx, zz = precision.copy(), precision.copy()
            ze = (mean - theta) / std**2 + split @ (start.values - theta)
            for index, model in enumerate(models):
                ys, xs, _ = whiten(model, *evaluated[index][:2], channels[index], colours[index], polynomials[index])
                for y, x, z, spent in zip(ys, xs, planned[index], freedom[index], strict=True):
                    w = huber(y)[:, None]
                    zx += z.T @ (x * w)
                    zz += spent * z.T @ (z * w)
                    ze += z.T @ (w[:, 0] * y)
            step = np.asarray(np.linalg.solve(zx, ze), dtype=float)
            inverse = np.linalg.inv(zx)
            covariance = inverse @ zz @ inverse.T
            p = _bounded_move(p, names, theta, step, extra_names)
            evaluated = [model.evaluate(p, options) for model in models]
            iterations += 1
            change = values_of(p, names, extra_names) - theta
            if np.all(np.abs(change) < 0.02 * np.sqrt(np.diag(covariance))):
                break
    theta = values_of(p, names, extra_names)
    rms = np.sqrt(np.mean(np.concatenate([e[0] for e in evaluated]) ** 2, axis=0))
    for index in held:
        covariance = _with_uncertain(covariance, zx, index, float(start.covariance[index, index]))
    return replace(
        start,
        parameters=p,
        values=theta,
        covariance=covariance,
        bound=inverted(information),
        residual_rms=rms,
        iterations=iterations,
        colours=tuple(c for s in colours for c in s),
        whiteners=tuple(q for s in polynomials for q in s),
    )


def _with_uncertain(covariance: Array, zx: Array, held: int, variance: float) -> Array:
    """The covariance with that of a parameter which was held, and what its uncertainty does to the others.

    Args:
        zx: Z^T W X with the precision of the held one in its place; the others answer a change of it by -zx_oo^-1 zx_oh.
    """
    others = np.arange(len(zx)) != held
    answer = np.ones(len(zx))
    answer[others] = -np.linalg.solve(zx[np.ix_(others, others)], zx[others, held])
    out = covariance.copy()
    out[held, :] = out[:, held] = 0.0
    return out + variance * np.outer(answer, answer)


def _root_of_inverse(information: Array) -> Array:
    """A square root R of the inverse, R R^T = information^-1, by eigenvalues in units in which the diagonal is one.

    What the flight tells nothing of in double precision (a flight without noise tells the rest to ten digits) counts for nothing.
    """
    unit = 1.0 / np.sqrt(np.diag(information))
    eigenvalues, vectors = np.linalg.eigh(information * np.outer(unit, unit))
    told = eigenvalues > 1e-14 * eigenvalues[-1]
    return unit[:, None] * vectors[:, told] / np.sqrt(eigenvalues[told])


def _spent_freedom(z: Array) -> float:
    """By how much the variance of an estimate exceeds what its residual says: n / (n - p - 2).

    A flight has few independent values n in the band an estimate uses (two at each frequency, up to the 95 % point of the
    whitened instruments' power), and a fit of p parameters takes its share out of the residual that the disturbance is read
    from: n / (n - p). What is left is a Student variable of n - p degrees of freedom, of variance (n - p) / (n - p - 2).
    p is this channel's leverage, trace(I^-1 Z^T Z).

    Args:
        z: whitened instruments of one channel in units of the whole fit's standard deviations, (rows, P).
    """
    parameters = float(np.sum(z**2))
    power = np.sum(np.abs(np.fft.rfft(z, axis=0)) ** 2, axis=1)
    count = 2.0 * (1.0 + int(np.searchsorted(np.cumsum(power), 0.95 * float(np.sum(power)))))
    return count / max(count - parameters - 2.0, 0.3 * count)


def lag_split_precision(names: Sequence[str]) -> Array:
    """Prior precision that keeps how the total delay divides into lag up, lag down and dead time near the first estimate.

    The plan excites low frequencies, where only the sum shows; its division comes from the prediction error estimate, to
    2 ms for the dead time (in 28 drawn flights it was never wrong by more than 1 ms, however wrong the lag) and 5 ms for up against
    down. The sum stays free.
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


def _bounded_move(
    p: Parameters, names: Sequence[str], theta: Array, step: Array, extra_names: Sequence[str]
) -> Parameters:
    """The step, shortened until the tensor stays positive definite and the mass positive."""
    fraction = 1.0
    for _ in range(12):
        trial = with_values(p, names, theta + fraction * step, extra_names)
        if (
            trial.mass_kg > 0.2 * p.mass_kg
            and np.linalg.eigvalsh(trial.tensor)[0] > 0.05 * np.linalg.eigvalsh(p.tensor)[0]
        ):
            return trial
        fraction *= 0.5
    return p
