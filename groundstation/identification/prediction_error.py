r"""Prediction error estimate of mass, tensor, rotor lag and delay with the flight's own coloured disturbance.

Rates and specific force are the outputs, rotor thrusts the inputs, seen through a lag and a delay:

    omega(t) = omega(0) + J^-1 H(t) + integral of d_tau,    H = integral of (tau(T) - c x T e_z - omega x J omega)
    f_z(t) = T / m + b_z + d_F

d are Ornstein-Uhlenbeck disturbances of unknown size and colour, estimated along with the parameters. Innovations from
a Kalman filter per channel (``noise``) make the estimate a maximum-likelihood one and consistent although the
controller feeds the disturbance back into the thrusts (Ljung 1999, ch. 7 and 13.4). omega x J omega uses the measured
rates, whose noise is a part in a thousand there. Sensitivities are analytic, those of lag and delay are differences of
the exact lag.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.flight_noise import PLAIN, Columns, FlightNoise, fitted_noise, per_flight
from groundstation.identification.noise import NoiseModel
from groundstation.identification.record_model import RecordModel
from groundstation.identification.together import of_each
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

STEPS = 8
"""Gauss-Newton steps under one noise model, at most."""
SETTLED = 0.05
"""Standard deviations that a step has to move by: less is a thousandth of a nat, and lost in the roundings of lags'
differences.
"""
HUBER = 3.0
"""Standard deviations of an innovation from which its weight falls."""


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


@dataclass(frozen=True, slots=True)
class Point:
    """Parameters, and the flights' outputs there.

    Attributes:
        names: of what is free. residuals: measured less predicted, (blocks, 6) for each flight.
    """

    models: tuple[RecordModel, ...]
    options: FitOptions
    parameters: Parameters
    names: tuple[str, ...]
    residuals: tuple[Array, ...]
    _held: dict[int, Array] = field(default_factory=dict[int, Array])

    def parts(self, flight: int) -> Iterator[tuple[slice, Array, Array]]:
        """Blocks, residuals (n, 6) and sensitivities of the prediction to ``names`` (n, 6, P), part by part.

        Those of a flight that is one part are kept: they are asked for again under the next noise.
        """
        model, residual = self.models[flight], self.residuals[flight]
        parts = model.parts()
        for blocks in parts:
            columns = self._held.get(flight)
            if columns is None:
                columns = model.sensitivities(self.parameters, self.options, blocks)
            if len(parts) == 1:
                self._held[flight] = columns
            yield blocks, residual[blocks], columns

    def rms(self) -> Array:
        """Root mean square of the residuals of all flights, (6,)."""
        return np.asarray(np.sqrt(np.mean(np.concatenate(self.residuals) ** 2, axis=0)), dtype=float)


@dataclass(frozen=True, slots=True)
class Problem:
    """What a fit minimises: models of one vehicle's flights, what is free, and the guess that the weak priors stand
    about.
    """

    models: tuple[RecordModel, ...]
    options: FitOptions
    start: Parameters

    @property
    def extra_names(self) -> list[str]:
        """Names of the wrench terms, the same in every flight."""
        return [term.name for term in self.models[0].extra]

    @property
    def channels(self) -> list[tuple[int, ...]]:
        """Outputs of each flight that the fit uses."""
        return [model.channels(self.options) for model in self.models]

    def at(self, p: Parameters) -> Point:
        """Residuals and sensitivities at ``p``."""
        residuals = of_each(lambda model: model.residual_of(p, model.predicted(p, self.options)), self.models)
        return Point(self.models, self.options, p, self.models[0].names(self.options), tuple(residuals))

    def values(self, point: Point) -> Array:
        """Values of what is free at a point, (P,)."""
        return values_of(point.parameters, point.names, self.extra_names)

    def moved(self, point: Point, values: Array) -> Parameters:
        """The point's parameters with what is free at other values."""
        return with_values(point.parameters, point.names, values, self.extra_names)

    def prior(self, names: Sequence[str]) -> tuple[Array, Array]:
        """Weak means and standard deviations that keep an unexcited direction finite; far wider than any claim."""
        record = self.models[0].record
        context = PriorContext(record.vehicle, self.start, record.force_bias_std, self.options.mass)
        entries, terms = table(), {term.name: (term.prior, term.prior_std) for term in self.models[0].extra}
        pairs = [terms[name] if name in terms else entries[name].prior(context) for name in names]
        mean, std = zip(*pairs, strict=True)
        return np.array(mean, dtype=float), np.array(std, dtype=float)

    def noise(
        self, point: Point, start: Sequence[FlightNoise] | None, *, autoregression: int = 0
    ) -> tuple[FlightNoise, ...]:
        """The noise model of each flight's residual, beginning from an earlier one's colours."""
        before = [None] * len(self.models) if start is None else [noise.colours for noise in start]
        flights = list(zip(self.models, point.residuals, self.channels, before, strict=True))
        return tuple(of_each(lambda flight: fitted_noise(*flight, autoregression), flights))

    def misfits(self, trials: Sequence[Parameters], noise: Sequence[FlightNoise]) -> Array:
        """Half the robust squared innovations and the logarithms of their deviations under given noise models, at
        points that differ in lags and dead time, (trials,).
        """
        costs = np.zeros(len(trials))
        for model, each in zip(self.models, noise, strict=True):
            done = 0
            for residuals in model.residuals(trials):
                whites, logs = each.whitened_residuals(model, residuals)
                part = slice(done, done + len(residuals))
                costs[part] += logs + sum(huber_costs(white) for white in whites)
                done += len(residuals)
        return costs


def huber(y: Array, limit: float = HUBER) -> Array:
    """Weights of a robust fit: one within the limit, falling as 1/|y| beyond."""
    return np.minimum(1.0, limit / np.maximum(np.abs(y), 1e-12))


def huber_costs(y: Array, limit: float = HUBER) -> Array:
    """Half the square within the limit, linear beyond, summed over the rows of (n, trials)."""
    size = np.abs(y)
    within = np.minimum(size, limit)
    return np.sum(within * (size - 0.5 * within), axis=0)


def inverted(information: Array) -> Array:
    """The inverse of an information matrix, in units in which its diagonal is one: kilograms and kg m^2 of a
    nano-quadrotor lie 1e10 apart.
    """
    unit = 1.0 / np.sqrt(np.diag(information))
    scale = np.outer(unit, unit)
    return np.asarray(np.linalg.inv(information * scale) * scale, dtype=float)


@dataclass(frozen=True, slots=True)
class _Local:
    """The cost at a point and its quadratic model: values (P,), normal matrix (P, P), descent direction's right side
    (P,).
    """

    point: Point
    theta: Array
    normal: Array
    gradient: Array
    cost: float

    def far(self, step: Array) -> bool:
        """Whether a step of the values is more than a small share of the deviations: the square is twice the nats."""
        return bool(step @ self.normal @ step > SETTLED**2)


def _linearised(problem: Problem, point: Point, noise: Sequence[FlightNoise]) -> _Local:
    """Normal equations of all flights and the priors, innovations beyond the limit weighted down."""
    mean, std = problem.prior(point.names)
    theta = problem.values(point)
    normal = np.diag(1.0 / std**2)
    gradient = (mean - theta) / std**2
    cost = 0.5 * float(np.sum(((theta - mean) / std) ** 2))
    for shares in of_each(lambda flight: list(_shares(point, flight, noise[flight])), range(len(noise))):
        for log_deviation, channels in shares:
            cost += log_deviation
            for x, square, right, misfit in channels:
                normal[x.pairs] += square
                gradient[x.shown] += right
                cost += misfit
    return _Local(point, theta, normal, gradient, cost)


Share = tuple[Columns, Array, Array, float]
"""Of a channel: which columns show in it, X^T W X and X^T W e of those, and the cost."""


def _shares(point: Point, flight: int, noise: FlightNoise) -> Iterator[tuple[float, list[Share]]]:
    """What each part of a flight adds to the normal equations: the logarithms of its deviations, and its channels."""
    passing = noise.passing(point.models[flight])
    for part in point.parts(flight):
        found, channels = passing(*part), list[Share]()
        for y, x in zip(found.residual, found.sensitivity, strict=True):
            w = huber(y)
            square, right = x.values.T @ (x.values * w[:, None]), x.values.T @ (w * y)
            bare = Columns(x.shown, x.values[:0])
            channels.append((bare, square, right, float(huber_costs(y))))
        yield found.log_deviation, channels


def _step(problem: Problem, local: _Local, noise: Sequence[FlightNoise]) -> _Local | None:
    """One Gauss-Newton step, halved until the cost falls; None where it would be small beside the deviations, or none
    lowers the cost. It keeps the tensor positive definite and the mass positive.
    """
    p = local.point.parameters
    step = np.asarray(np.linalg.solve(local.normal, local.gradient), dtype=float)
    for _ in range(10):
        if not local.far(step):
            return None
        trial = problem.moved(local.point, local.theta + step)
        if trial.mass_kg > 0.0 and np.linalg.eigvalsh(trial.tensor)[0] > 0.02 * np.linalg.eigvalsh(p.tensor)[0]:
            there = _linearised(problem, problem.at(trial), noise)
            if there.cost < local.cost:
                return there
        step = 0.5 * step
    return None


def _descend(problem: Problem, start: _Local, noise: Sequence[FlightNoise]) -> tuple[_Local, int]:
    """Gauss-Newton steps under given noise models, and how many."""
    local, count = start, 0
    while count < STEPS and (there := _step(problem, local, noise)) is not None:
        local, count = there, count + 1
    return local, count


def fit(
    models: Sequence[RecordModel],
    start: Parameters,
    options: FitOptions,
    noise: Sequence[FlightNoise] | None = None,
    *,
    fixed: bool = False,
) -> Fitted:
    """Gauss-Newton on the innovations, alternating with the noise model until neither moves the other; several flights
    of one vehicle are pooled.

    Args:
        models: one per flight, with the same extra terms; biases and noise models are each flight's own.
        start: first guess.
        noise: per flight, from an earlier fit, whose colours to begin from.
        fixed: take ``noise`` as it is.
    """
    problem = Problem(tuple(models), options, start)
    point, order = problem.at(start), 0 if noise is None else options.autoregression
    used = tuple(noise) if fixed and noise is not None else problem.noise(point, noise, autoregression=order)
    local, iterations = _descend(problem, _linearised(problem, point, used), used)
    for _ in range(0 if fixed else options.colour_rounds):
        used = problem.noise(local.point, used, autoregression=options.autoregression)
        before = local.theta
        local, count = _descend(problem, _linearised(problem, local.point, used), used)
        iterations += count
        if not local.far(local.theta - before):
            break
    covariance = inverted(local.normal)
    return Fitted(
        parameters=local.point.parameters,
        names=local.point.names,
        values=local.theta,
        covariance=covariance,
        bound=covariance,
        colours=tuple(colour for each in used for colour in each.colours),
        whiteners=tuple(whitener for each in used for whitener in each.whiteners),
        cost=local.cost,
        residual_rms=local.point.rms(),
        samples=sum(len(model.t_s) for model in models),
        iterations=iterations,
    )


COARSER = 3
"""Blocks in one of a first look."""


def coarser(model: RecordModel) -> RecordModel:
    """The same record for a first look: means over COARSER times as many samples, rotors on every other point of their
    grid.
    """
    record, motors = model.record, model.record.motors
    every = replace(motors, step_s=2.0 * motors.step_s, value=np.ascontiguousarray(motors.value[::2]))
    coarse = replace(record, motors=every, block=COARSER * record.block)
    terms = [replace(term, value=term.value[model.samples]) for term in model.extra]
    found = RecordModel(coarse, terms, model.planned, model.silent)
    return found if 2 * COARSER * len(found.t_s) > len(model.t_s) else model  # short stretches would be lost


FAST_S, SLOW_S = 0.02, 0.08
"""Lags that a fit begins from: a small vehicle's and a large one's."""


def fit_from_declared(models: Sequence[RecordModel], vehicle: Vehicle, options: FitOptions) -> Fitted:
    """Prediction error estimate from the declared vehicle: searched for in the liveliest part of a long flight, then of
    all of it.
    """
    looked_at = [model.liveliest() for model in models]
    found = _searched(looked_at, vehicle, options)
    if all(part is model for part, model in zip(looked_at, models, strict=True)):
        return found
    return fit(models, found.parameters, options, noise_of(found, models, options))


def _searched(models: Sequence[RecordModel], vehicle: Vehicle, options: FitOptions) -> Fitted:
    """Prediction error estimate from the declared vehicle: first one lag and no dead time from two starts, then all.

    What divides the total into lag and dead time are the commands' highest frequencies, a narrow band: each of its
    periods has a minimum. So the division is looked for over all of the total after the fit, until another one is no
    likelier.
    """
    extra = len(models[0].extra)
    if not options.lag:
        return fit(models, declared_parameters(vehicle, lag_s=0.0, extra=extra), options)
    first = replace(options, symmetric_lag=True, delay=False, colour_rounds=1, autoregression=0)
    look = _first_look([coarser(model) for model in models], vehicle, first)
    best = fit(models, look.parameters, options, noise_of(look, models, options))
    for _ in range(DIVISIONS):
        start = divided_anew(models, best, options)
        if start is best.parameters:
            break
        again = fit(models, start, options, noise_of(best, models, options))
        if again.cost >= best.cost:
            break
        best = again
    return best


def noise_of(fitted: Fitted, models: Sequence[RecordModel], options: FitOptions) -> list[FlightNoise]:
    """The noise model of each flight of a fit."""
    return per_flight(fitted.colours, fitted.whiteners, [model.channels(options) for model in models])


def _first_look(models: Sequence[RecordModel], vehicle: Vehicle, options: FitOptions) -> Fitted:
    """From a short lag and from a long one; the second is followed to its end where it leads elsewhere."""
    extra = len(models[0].extra)
    best = fit(models, declared_parameters(vehicle, lag_s=FAST_S, extra=extra), options)
    slow = declared_parameters(vehicle, lag_s=SLOW_S, extra=extra)
    noise = noise_of(best, models, options)
    other = fit(models, slow, options, noise, fixed=True)
    if np.any(np.abs(other.values - best.values) > np.sqrt(np.diag(best.covariance))):
        best = min(best, fit(models, other.parameters, options, noise), key=lambda found: found.cost)
    return best


DIVISIONS = 3
"""Of the total into lag and dead time that are followed to their minimum, at most."""
DIVISION_S = 0.002
"""Between dead times that are tried: minima lie ten milliseconds apart, and are four wide."""


def divided_anew(models: Sequence[RecordModel], found: Fitted, options: FitOptions) -> Parameters:
    """The parameters found, or those whose dead time and lags, of the same sum, suit the residual better."""
    p, noise = found.parameters, noise_of(found, models, options)
    problem = Problem(tuple(models), options, p)
    shifts = DIVISION_S * np.arange(
        -np.floor(max(p.delay_s, 0.0) / DIVISION_S), min(p.lag_up_s, p.lag_down_s) / DIVISION_S
    )
    tried = [p] + [
        replace(p, lag_up_s=p.lag_up_s - s, lag_down_s=p.lag_down_s - s, delay_s=p.delay_s + s) for s in shifts if s
    ]
    return tried[int(np.argmin(problem.misfits(tried, noise)))]


SHOOTING_S = 2.0


def output_error(
    models: Sequence[RecordModel], start: Parameters, options: FitOptions, begin: Parameters | None = None
) -> Fitted:
    """Output error by multiple shooting: every SHOOTING_S the state starts anew, and the rest is taken for white noise.

    The classical estimate (Klein and Morelli, ch. 6), for comparison: what it takes for noise is mostly disturbance.

    Args:
        start: whose residual tells the noise. begin: where the search begins, there where it is not given.
    """
    white: list[FlightNoise] = []
    shooting: list[RecordModel] = []
    for model in models:
        every = max(2, round(SHOOTING_S / float(np.median(model.dt))))
        restart = model.restart.copy()
        restart[::every] = True
        residual = model.residual(start)
        shooting.append(model.restarted(restart))
        chosen = model.channels(options)
        spread = [
            max(float(np.std(np.diff(residual[:, c])[~model.restart[1:]] if c < 3 else residual[:, c])), 1e-9)
            for c in chosen
        ]
        colours = tuple(NoiseModel(1e-9 * s, 1.0, 1e-9 * s, s) for s in spread)
        white.append(FlightNoise(chosen, colours, (PLAIN,) * len(chosen)))
    begin = start if begin is None else begin
    return fit(shooting, begin, replace(options, colour_rounds=0, autoregression=0), white, fixed=True)


def coarse_output_error(models: Sequence[RecordModel], start: Parameters, options: FitOptions) -> Fitted:
    """:func:`output_error` from means of COARSER blocks, with the residual that it leaves of all."""
    found = output_error([coarser(model) for model in models], start, options)
    untimed = replace(options, lag=False, delay=False)  # no residual needs differences by a lag
    point = Problem(tuple(models), untimed, start).at(found.parameters)
    return replace(found, residual_rms=point.rms(), samples=sum(len(model.t_s) for model in models))
