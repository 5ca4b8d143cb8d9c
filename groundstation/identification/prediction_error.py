r"""Prediction error estimate of mass, tensor, rotor lag and delay with the flight's own coloured disturbance.

Rates and specific force are the outputs, rotor thrusts the inputs, seen through a lag and a delay:

    omega(t) = omega(0) + J^-1 H(t) + integral of d_tau,    H = integral of (tau(T) - c x T e_z - omega x J omega)
    f_z(t) = T / m + b_z + d_F

d are Ornstein-Uhlenbeck disturbances of unknown size and colour, estimated along with the parameters. Innovations from a Kalman
filter per channel (``noise``) make the estimate a maximum-likelihood one and consistent although the controller feeds the
disturbance back into the thrusts (Ljung 1999, ch. 7 and 13.4). omega x J omega uses the measured rates, whose noise
is a part in a thousand there. Sensitivities are analytic, those of lag and delay are differences of the exact lag.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.noise import (
    NoiseModel,
    apply_polynomial,
    fit_noise_model,
    innovations,
    whitening_polynomial,
)
from groundstation.identification.record_model import BodyWrench, DynamicRecord, RecordModel
from groundstation.model.parameters import (
    FitOptions,
    Parameters,
    PriorContext,
    declared_parameters,
    table,
    values_of,
    with_values,
)
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Fitted:
    """A finished fit. ``covariance`` is of ``names``; ``colours`` and ``whiteners`` are per channel.

    ``bound`` is the Cramer-Rao covariance: what an efficient estimate from the same motion and disturbance could reach.
    """

    parameters: Parameters
    names: tuple[str, ...]
    values: Array
    covariance: Array
    bound: Array
    colours: tuple[NoiseModel, ...]
    whiteners: tuple[Array, ...]
    cost: float
    residual_rms: Array
    samples: int
    iterations: int

    def std(self, name: str) -> float:
        """Standard deviation of one parameter."""
        index = self.names.index(name)
        return float(np.sqrt(self.covariance[index, index]))

    def value(self, name: str) -> float:
        """Value of one parameter."""
        return float(self.values[self.names.index(name)])


def priors(
    record: DynamicRecord, p0: Parameters, names: Sequence[str], extra: Sequence[BodyWrench], options: FitOptions
) -> tuple[Array, Array]:
    """Weak prior means and standard deviations that keep an unexcited direction finite; far wider than any claim."""
    context = PriorContext(record.vehicle, p0, record.force_bias_std, options.mass)
    entries, terms = table(), {term.name: (term.prior, term.prior_std) for term in extra}
    pairs = [terms[name] if name in terms else entries[name].prior(context) for name in names]
    mean, std = zip(*pairs, strict=True)
    return np.array(mean, dtype=float), np.array(std, dtype=float)


def whiten(
    model: RecordModel,
    residual: Array,
    sensitivity: Array,
    channels: Sequence[int],
    colours: Sequence[NoiseModel],
    polynomials: Sequence[Array],
) -> tuple[list[Array], list[Array], float]:
    """Normalised innovations and sensitivities per channel, and the log-determinant part of the cost."""
    ys, xs, logs = [], [], 0.0
    for channel, colour, polynomial in zip(channels, colours, polynomials, strict=True):
        stacked = np.concatenate([residual[:, channel : channel + 1], sensitivity[:, channel, :]], axis=1)
        e, s = innovations(stacked, model.dt, model.restart, colour, integrated=channel < 3)
        good = np.isfinite(s)
        e = apply_polynomial(polynomial, np.where(good[:, None], e / np.sqrt(np.where(good, s, 1.0))[:, None], 0.0))
        ys.append(e[:, 0])
        xs.append(e[:, 1:])
        logs += 0.5 * float(np.sum(np.log(s[good])))
    return ys, xs, logs


def huber(y: Array, limit: float = 3.0) -> Array:
    return np.minimum(1.0, limit / np.maximum(np.abs(y), 1e-12))


def inverted(information: Array) -> Array:
    """The inverse of an information matrix, in units in which its diagonal is one: kilograms and kg m^2 of a nano-quadrotor lie 1e10 apart."""
    unit = 1.0 / np.sqrt(np.diag(information))
    scale = np.outer(unit, unit)
    return np.asarray(np.linalg.inv(information * scale) * scale, dtype=float)


def fit(
    models: Sequence[RecordModel],
    start: Parameters,
    options: FitOptions,
    colours: Sequence[Sequence[NoiseModel]] | None = None,
    *,
    fixed: bool = False,
) -> Fitted:
    """Gauss-Newton on the innovations, alternating with the noise model; several flights of one vehicle are pooled.

    Args:
        models: one per flight, with the same extra terms; biases and noise models are each flight's own.
        start: first guess.
        colours: per flight and channel, from an earlier fit, to begin from.
        fixed: take ``colours`` as they are.
    """
    records = [model.record for model in models]
    extra_names = [term.name for term in models[0].extra]
    p = start
    channels = [model.channels(options) for model in models]
    state: list[list[NoiseModel]] = [list(c) for c in colours] if colours is not None else [[] for _ in models]
    polynomials = [[np.array([1.0])] * len(c) for c in channels]
    iterations = 0
    cost = np.inf
    normal = np.eye(1)
    names: tuple[str, ...] = ()
    evaluated = [model.evaluate(p, options) for model in models]
    for round_index in range(options.colour_rounds + 1):
        for index, model in enumerate(models):
            residual = evaluated[index][0]
            previous = state[index]
            if fixed:
                continue
            state[index] = [
                fit_noise_model(
                    residual[:, c],
                    model.dt,
                    model.restart,
                    integrated=c < 3,
                    start=previous[i] if previous else None,
                )
                for i, c in enumerate(channels[index])
            ]
            if options.autoregression and round_index > 0:
                blank = evaluated[index][1][:, :, :0]
                ys, _, _ = whiten(
                    model, residual, blank, channels[index], state[index], [np.array([1.0])] * len(channels[index])
                )
                polynomials[index] = [whitening_polynomial(y, model.restart, options.autoregression) for y in ys]
        for _ in range(8):
            names = evaluated[0][2]
            mean, std = priors(records[0], start, names, models[0].extra, options)
            theta = values_of(p, names, extra_names)
            normal = np.diag(1.0 / std**2)
            gradient = (mean - theta) / std**2
            cost = 0.5 * float(np.sum(((theta - mean) / std) ** 2))
            for index, model in enumerate(models):
                ys, xs, logs = whiten(
                    model, evaluated[index][0], evaluated[index][1], channels[index], state[index], polynomials[index]
                )
                cost += logs
                for y, x in zip(ys, xs, strict=True):
                    w = huber(y)
                    normal = normal + x.T @ (x * w[:, None])
                    gradient = gradient + x.T @ (w * y)
                    cost += float(np.sum(np.where(w < 1.0, 3.0 * np.abs(y) - 4.5, 0.5 * y**2)))
            step = np.asarray(np.linalg.solve(normal, gradient), dtype=float)
            p, taken = _line_search(
                models, p, names, theta, step, extra_names, channels, state, polynomials, cost, mean, std
            )
            iterations += 1
            if taken > 0.0:
                evaluated = [model.evaluate(p, options) for model in models]
            variance = np.maximum(
                np.diag(inverted(normal)), 0.0
            )  # of what a flight does not show, rounding may make it negative
            if taken == 0.0 or np.all(np.abs(taken * step) < 0.02 * np.sqrt(variance)):
                break
    theta = values_of(p, names, extra_names)
    covariance = inverted(normal)
    rms = np.sqrt(np.mean(np.concatenate([e[0] for e in evaluated]) ** 2, axis=0))
    samples = sum(len(m.t_s) for m in models)
    return Fitted(
        p,
        names,
        theta,
        covariance,
        covariance,
        tuple(c for s in state for c in s),
        tuple(q for s in polynomials for q in s),
        cost,
        rms,
        samples,
        iterations,
    )


def _line_search(
    models: Sequence[RecordModel],
    p: Parameters,
    names: Sequence[str],
    theta: Array,
    step: Array,
    extra_names: Sequence[str],
    channels: Sequence[tuple[int, ...]],
    state: Sequence,
    polynomials: Sequence,
    cost: float,
    mean: Array,
    std: Array,
) -> tuple[Parameters, float]:
    """Halve the step until the cost falls; keep the tensor positive definite and the mass positive."""
    fraction = 1.0
    for _ in range(10):
        trial = with_values(p, names, theta + fraction * step, extra_names)
        if trial.mass_kg > 0.0 and np.linalg.eigvalsh(trial.tensor)[0] > 0.02 * np.linalg.eigvalsh(p.tensor)[0]:
            values = values_of(trial, names, extra_names)
            total = 0.5 * float(np.sum(((values - mean) / std) ** 2))
            total += misfit(models, trial, channels, state, polynomials)
            if total <= cost + 1e-9 * abs(cost):
                return trial, fraction
        fraction *= 0.5
    return p, 0.0


def misfit(
    models: Sequence[RecordModel],
    p: Parameters,
    channels: Sequence[tuple[int, ...]],
    state: Sequence[Sequence[NoiseModel]],
    polynomials: Sequence[Sequence[Array]],
) -> float:
    """Half the robust squared innovations and the logarithms of their deviations, at ``p`` under given noise models."""
    return sum(
        innovation_cost(model, model.residual(p), channels[index], state[index], polynomials[index])
        for index, model in enumerate(models)
    )


def innovation_cost(
    model: RecordModel,
    residual: Array,
    channels: Sequence[int],
    colours: Sequence[NoiseModel],
    polynomials: Sequence[Array],
) -> float:
    """The same of one record's residual."""
    ys, _, logs = whiten(model, residual, np.zeros((*residual.shape, 0)), channels, colours, polynomials)
    return logs + sum(float(np.sum(np.where(huber(y) < 1.0, 3.0 * np.abs(y) - 4.5, 0.5 * y**2))) for y in ys)


def fit_from_declared(models: Sequence[RecordModel], vehicle: Vehicle, options: FitOptions) -> Fitted:
    """Prediction error estimate from the declared vehicle: first one lag and no dead time from two starts, then all.

    What divides the total into lag and dead time are the commands' highest frequencies, a narrow band: each of its periods has a
    minimum. So the division is looked for over all of the total before the last fit, and once more after it.
    """
    extra = len(models[0].extra)
    if not options.lag:
        return fit(models, declared_parameters(vehicle, lag_s=0.0, extra=extra), options)
    first = replace(options, symmetric_lag=True, delay=False, colour_rounds=1, autoregression=0)
    tried = [fit(models, declared_parameters(vehicle, lag_s=lag, extra=extra), first) for lag in (0.02, 0.08)]
    best = min(tried, key=lambda found: found.cost)
    channels = [model.channels(options) for model in models]
    best = fit(models, divided_anew(models, best, options), options, per_flight(best.colours, channels))
    start = divided_anew(models, best, options)
    if start is best.parameters:
        return best
    return min(best, fit(models, start, options, per_flight(best.colours, channels)), key=lambda found: found.cost)


DIVISION_S = 0.002
"""Between dead times that are tried."""


def divided_anew(models: Sequence[RecordModel], found: Fitted, options: FitOptions) -> Parameters:
    """The parameters found, or those whose dead time and lags, of the same sum, suit the residual better."""
    p, channels = found.parameters, [model.channels(options) for model in models]
    noise = per_flight(found.colours, channels), per_flight(found.whiteners, channels)
    shifts = DIVISION_S * np.arange(
        -np.floor(max(p.delay_s, 0.0) / DIVISION_S), min(p.lag_up_s, p.lag_down_s) / DIVISION_S
    )
    tried = [p] + [
        replace(p, lag_up_s=p.lag_up_s - s, lag_down_s=p.lag_down_s - s, delay_s=p.delay_s + s) for s in shifts if s
    ]
    costs = np.zeros(len(tried))
    for index, model in enumerate(models):
        own = channels[index], noise[0][index], noise[1][index]
        costs += [innovation_cost(model, residual, *own) for residual in model.residuals(tried)]
    return tried[int(np.argmin(costs))]


SHOOTING_S = 2.0


def output_error(models: Sequence[RecordModel], start: Parameters, options: FitOptions) -> Fitted:
    """Output error by multiple shooting: every SHOOTING_S the state starts anew, and the rest is taken for white noise.

    The classical estimate (Klein and Morelli, ch. 6), for comparison: what it takes for noise is mostly disturbance.
    """
    white = []
    shooting = []
    for model in models:
        every = max(2, round(SHOOTING_S / float(np.median(model.dt))))
        restart = model.restart.copy()
        restart[::every] = True
        shooting.append(model.restarted(restart))
        residual = model.residual(start)
        chosen = model.channels(options)
        spread = [
            max(float(np.std(np.diff(residual[:, c])[~model.restart[1:]] if c < 3 else residual[:, c])), 1e-9)
            for c in chosen
        ]
        white.append([NoiseModel(1e-9 * s, 1.0, 1e-9 * s, s) for s in spread])
    return fit(shooting, start, replace(options, colour_rounds=0, autoregression=0), white, fixed=True)


def noise_model(
    model: RecordModel, residual: Array, channels: Sequence[int], previous: Sequence[NoiseModel], autoregression: int
) -> tuple[list[NoiseModel], list[Array]]:
    """Noise model of each channel of a residual: its colour, and the autoregression for what the colour leaves."""
    colours = [
        fit_noise_model(residual[:, c], model.dt, model.restart, integrated=c < 3, start=colour)
        for c, colour in zip(channels, previous, strict=True)
    ]
    plain = [np.array([1.0])] * len(channels)
    if not autoregression:
        return colours, plain
    ys, _, _ = whiten(model, residual, np.zeros((*residual.shape, 0)), channels, colours, plain)
    return colours, [whitening_polynomial(y, model.restart, autoregression) for y in ys]


def per_flight(items: Sequence, channels: Sequence[Sequence[int]]) -> list[list]:
    """Split what :class:`Fitted` keeps in one row into one list per flight."""
    out, first = [], 0
    for chosen in channels:
        out.append(list(items[first : first + len(chosen)]))
        first += len(chosen)
    return out
