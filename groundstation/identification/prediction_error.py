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
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.noise import (
    Colour,
    apply_polynomial,
    fit_colour,
    innovations,
    whitening_polynomial,
)
from groundstation.model.rotors import MotorInput, cumulative, declared_thrust, interpolate_columns, wrench_matrix
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

TENSOR = ("ixx_kg_m2", "ixy_kg_m2", "ixz_kg_m2", "iyy_kg_m2", "iyz_kg_m2", "izz_kg_m2")
_BASIS = np.zeros((6, 3, 3))
for _index, (_i, _j) in enumerate([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]):
    _BASIS[_index, _i, _j] = _BASIS[_index, _j, _i] = 1.0
FORCE_CHANNELS = (3, 4, 5)
INSTRUMENT_SHIFTS_S = (-0.25, -0.1, 0.0, 0.1, 0.25)
CHANNELS = ("torque_x_nm", "torque_y_nm", "torque_z_nm", "force_x_n", "force_y_n", "force_z_n")


@dataclass(frozen=True, slots=True)
class DynamicRecord:
    """One flight's data for the dynamic fit, at the IMU's stamps (the IMU's clock).

    Attributes:
        t_s: stamps, (k,). keep: samples inside the window and outside exclusions, (k,).
        rate_rad_s: rates less their bias, (k, 3).
        force_m_s2: specific force of the declared origin less bias and lever arm, (k, 3); NaN when there is no accelerometer.
        force_bias_std: what is left unknown of the bias, (3,).
        motors: on the motors' clock.
        block: samples averaged into one for the fit, the same on both sides of the equation.
    """

    vehicle: Vehicle
    t_s: Array
    keep: Mask
    rate_rad_s: Array
    force_m_s2: Array
    force_bias_std: Array
    motors: MotorInput
    block: int = 1


@dataclass(frozen=True, slots=True)
class PlannedMotion:
    """The motion that was asked for, at the IMU's stamps: it owes nothing to this flight's disturbances.

    Attributes:
        rate_rad_s: body rates, (k, 3).
        angular_acceleration_rad_s2: (k, 3).
        specific_thrust_m_s2: thrust over mass, (k,).
        extra: planned wrench of each BodyWrench term, (k, 6) each.
    """

    rate_rad_s: Array
    angular_acceleration_rad_s2: Array
    specific_thrust_m_s2: Array
    extra: tuple[Array, ...] = ()

    def shifted(self, seconds: float, t_s: Array) -> PlannedMotion:
        """The same motion, later by ``seconds``; the ends are held."""
        if seconds == 0.0:
            return self
        query = t_s - seconds

        def move(values: Array) -> Array:
            columns = values.reshape(len(t_s), -1)
            return np.stack([np.interp(query, t_s, c) for c in columns.T], axis=-1).reshape(values.shape)

        return PlannedMotion(
            move(self.rate_rad_s),
            move(self.angular_acceleration_rad_s2),
            move(self.specific_thrust_m_s2),
            tuple(move(value) for value in self.extra),
        )


@dataclass(frozen=True, slots=True)
class BodyWrench:
    """An extra force and torque about the declared origin per unit of one parameter, body axes, at the IMU's stamps.

    ``value`` has shape (k, 6): force (N) then torque (N m). ``prior_std`` regularises the coefficient about ``prior``.
    """

    name: str
    value: Array
    prior_std: float = np.inf
    prior: float = 0.0


@dataclass(frozen=True, slots=True)
class Parameters:
    """The state of the fit in physical units; ``extra`` holds the coefficients of the BodyWrench terms."""

    mass_kg: float
    tensor: Array
    lag_up_s: float
    lag_down_s: float
    delay_s: float
    com_m: Array
    yaw_trim_nm: float
    force_bias_m_s2: Array
    extra: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, slots=True)
class Fitted:
    """A finished fit. ``covariance`` is of ``names``; ``colours`` and ``whiteners`` are per channel."""

    parameters: Parameters
    names: tuple[str, ...]
    values: Array
    covariance: Array
    colours: tuple[Colour, ...]
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
class Options:
    """What the fit is free to change.

    ``torque_axes`` and ``use_force`` select output channels; ``lag`` and ``delay`` free those parameters.
    """

    lag: bool = True
    symmetric_lag: bool = False
    delay: bool = True
    com: bool = True
    yaw_trim: bool = True
    channels: tuple[int, ...] = (0, 1, 2, 5)
    colour_rounds: int = 3
    autoregression: int = 24


@dataclass(frozen=True, slots=True)
class _Prediction:
    wrench: Array
    impulse: Array
    rate: Array
    force: Array


class RecordModel:
    """Predicted outputs of one record and their sensitivities. Built once per flight; pure in the parameters."""

    def __init__(self, record: DynamicRecord, extra: Sequence[BodyWrench] = (), planned: PlannedMotion | None = None):
        self.record = record
        self.planned = planned
        self.extra = tuple(extra)
        self._matrix = wrench_matrix(record.vehicle)
        block = record.block
        index = np.flatnonzero(record.keep)
        runs = np.split(index, np.flatnonzero(np.diff(index) > 1) + 1)
        nominal = float(np.median(np.diff(record.t_s)))
        blocks: list[Array] = []
        restarts: list[bool] = []
        for run in runs:
            gaps = np.flatnonzero(np.diff(record.t_s[run]) > 3.5 * nominal) + 1
            for part in np.split(run, gaps):
                count = len(part) // block
                if count < 8:
                    continue
                blocks.append(part[: count * block].reshape(count, block))
                restarts += [True] + [False] * (count - 1)
        self.members = np.concatenate(blocks) if blocks else np.zeros((0, block), dtype=int)
        self.restart = np.array(restarts, dtype=bool)
        self.t_s = record.t_s[self.members].mean(axis=1) if len(self.members) else np.zeros(0)
        self.dt = np.concatenate([[nominal * block], np.maximum(np.diff(self.t_s), 1e-4)]) if len(self.t_s) else self.t_s
        dt = np.concatenate([[0.0], np.diff(record.t_s)])
        self._dt = dt
        rate = record.rate_rad_s
        products = np.stack([np.cross(rate, rate @ basis) for basis in _BASIS], axis=-1)  # (k, 3, 6)
        self._gyroscopic = self._integrate(products.reshape(len(rate), -1)).reshape(len(rate), 3, 6)
        self._elapsed = (record.t_s - record.t_s[0])[:, None]
        self._extra_torque = [self._integrate(term.value[:, 3:]) for term in self.extra]
        self._extra_impulse = [self._integrate(term.value[:, :3]) for term in self.extra]
        self.rate = self.average(rate)
        self.force = self.average(record.force_m_s2)

    def restarted(self, restart: Mask) -> RecordModel:
        """The same record with other segment starts."""
        other = RecordModel(self.record, self.extra, self.planned)
        other.restart = restart
        return other

    def _integrate(self, values: Array) -> Array:
        mean = 0.5 * (values[1:] + values[:-1]) * self._dt[1:, None]
        return np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(mean, axis=0)])

    def average(self, values: Array) -> Array:
        """Block means of samples at the IMU's stamps, shape (blocks, ...)."""
        total = values[self.members[:, 0]].copy()
        for column in self.members.T[1:]:
            total += values[column]
        return total / self.members.shape[1]

    def thrusts(self, up_s: float, down_s: float, delay_s: float) -> tuple[Array, Array]:
        """[F_z, tau] at the IMU's stamps and their running integrals, shapes (k, 4), by the declared constants."""
        motors = self.record.motors
        lagged = motors.lagged(up_s, down_s)
        wrench = declared_thrust(self.record.vehicle, lagged) @ self._matrix.T
        held = not motors.measured and up_s <= 1e-6 and down_s <= 1e-6
        query = self.record.t_s - delay_s
        integral = cumulative(wrench, motors.step_s, held=held)
        return (
            interpolate_columns(query, motors.start_s, motors.step_s, wrench),
            interpolate_columns(query, motors.start_s, motors.step_s, integral),
        )

    def _predict(self, p: Parameters) -> _Prediction:
        wrench, impulse = self.thrusts(p.lag_up_s, p.lag_down_s, p.delay_s)
        thrust, thrust_integral = wrench[:, :1], impulse[:, :1]
        lever = np.stack([-p.com_m[1], p.com_m[0]])
        torque = impulse[:, 1:] - self._gyroscopic @ np.array([p.tensor[i, j] for i, j in _PAIRS])
        torque[:, :2] += lever * thrust_integral
        torque[:, 2:] += p.yaw_trim_nm * self._elapsed
        force = np.zeros((len(thrust), 3))
        force[:, 2:] = thrust
        for coefficient, term, integral, push in zip(
            p.extra, self.extra, self._extra_torque, self._extra_impulse, strict=True
        ):
            torque += coefficient * (integral - np.cross(p.com_m, push))
            force += coefficient * term.value[:, :3]
        rate = torque @ np.linalg.inv(p.tensor).T
        return _Prediction(wrench, impulse, rate, force)

    def residual(self, p: Parameters) -> Array:
        """Measured less predicted rates and specific forces at ``p``, (blocks, 6)."""
        return self._residual(p, self._predict(p))

    def _residual(self, p: Parameters, prediction: _Prediction) -> Array:
        predicted = np.concatenate([prediction.rate, prediction.force / p.mass_kg + p.force_bias_m_s2], axis=1)
        return np.concatenate([self.rate, self.force], axis=1) - self.average(predicted)

    def evaluate(self, p: Parameters, options: Options) -> tuple[Array, Array, tuple[str, ...]]:
        """Residuals (blocks, 6) and sensitivities d(prediction)/d(parameter) (blocks, 6, P) at ``p``, with names."""
        inverse = np.linalg.inv(p.tensor)
        prediction = self._predict(p)
        wrench, impulse, rate, force = prediction.wrench, prediction.impulse, prediction.rate, prediction.force
        thrust, thrust_integral = wrench[:, :1], impulse[:, :1]
        lever = np.stack([-p.com_m[1], p.com_m[0]])
        residual = self._residual(p, prediction)

        names: list[str] = []
        columns: list[Array] = []
        blank = np.zeros((len(thrust), 3))

        def add(name: str, d_rate: Array, d_force: Array) -> None:
            names.append(name)
            columns.append(self.average(np.concatenate([d_rate, d_force], axis=1)))

        add("mass_kg", blank, -force / p.mass_kg**2)
        for name, basis, column in zip(TENSOR, _BASIS, np.moveaxis(self._gyroscopic, -1, 0), strict=True):
            add(name, -(rate @ basis.T + column) @ inverse.T, blank)

        def thrust_sensitivity(d_wrench: Array, d_impulse: Array) -> tuple[Array, Array]:
            d_torque = d_impulse[:, 1:].copy()
            d_torque[:, :2] += lever * d_impulse[:, :1]
            d_force = blank.copy()
            d_force[:, 2] = d_wrench[:, 0] / p.mass_kg
            return d_torque @ inverse.T, d_force

        if options.delay:
            step = 1e-3
            later = self.thrusts(p.lag_up_s, p.lag_down_s, p.delay_s + step)
            add("input_delay_s", *thrust_sensitivity((later[0] - wrench) / step, (later[1] - impulse) / step))
        if options.lag:
            up, down = p.lag_up_s, p.lag_down_s
            step = max(1e-3, 0.02 * max(up, down))
            if options.symmetric_lag:
                more = self.thrusts(up + step, down + step, p.delay_s)
                add("rotor_lag_s", *thrust_sensitivity((more[0] - wrench) / step, (more[1] - impulse) / step))
            else:
                more = self.thrusts(up + step, down, p.delay_s)
                add("rotor_lag_up_s", *thrust_sensitivity((more[0] - wrench) / step, (more[1] - impulse) / step))
                more = self.thrusts(up, down + step, p.delay_s)
                add("rotor_lag_down_s", *thrust_sensitivity((more[0] - wrench) / step, (more[1] - impulse) / step))
        if options.com:
            d = blank.copy()
            d[:, 1] = thrust_integral[:, 0]
            add("com_offset_x_m", d @ inverse.T, blank)
            d = blank.copy()
            d[:, 0] = -thrust_integral[:, 0]
            add("com_offset_y_m", d @ inverse.T, blank)
        if options.yaw_trim:
            d = blank.copy()
            d[:, 2] = self._elapsed[:, 0]
            add("yaw_trim_nm", d @ inverse.T, blank)
        for axis, letter in enumerate("xyz"):
            if axis + 3 in options.channels:
                d = blank.copy()
                d[:, axis] = 1.0
                add(f"accel_bias_{letter}_m_s2", blank, d)
        for term, integral, push in zip(self.extra, self._extra_torque, self._extra_impulse, strict=True):
            add(term.name, (integral - np.cross(p.com_m, push)) @ inverse.T, term.value[:, :3] / p.mass_kg)
        return residual, np.stack(columns, axis=-1), tuple(names)


    def instruments(self, p: Parameters, options: Options) -> Array:
        """Sensitivities the planned motion would have at ``p``, shifted by INSTRUMENT_SHIFTS_S, (blocks, 6, P * shifts).

        Any function of the plan is a valid instrument (Soderstrom and Stoica 1983); what the vehicle really did is a filtered
        plan, which a few shifted copies span. The lag is approximated by its first order: d(impulse)/d(tau) = -wrench.
        """
        if self.planned is None:
            raise ValueError("no planned motion was given for this record")
        shifted = [self._planned_sensitivities(self.planned.shifted(s, self.record.t_s), p, options) for s in INSTRUMENT_SHIFTS_S]
        return np.concatenate(shifted, axis=2)

    def _planned_sensitivities(self, plan: PlannedMotion, p: Parameters, options: Options) -> Array:
        inverse = np.linalg.inv(p.tensor)
        rate = plan.rate_rad_s
        torque = plan.angular_acceleration_rad_s2 @ p.tensor + np.cross(rate, rate @ p.tensor)
        thrust = p.mass_kg * plan.specific_thrust_m_s2[:, None]
        wrench = np.concatenate([thrust, torque], axis=1)
        slope = np.gradient(wrench, self.record.t_s, axis=0)
        per_rotor = slope @ np.linalg.pinv(self._matrix).T
        rising = np.maximum(per_rotor, 0.0) @ self._matrix.T
        gyroscopic = self._integrate(
            np.stack([np.cross(rate, rate @ basis) for basis in _BASIS], axis=-1).reshape(len(rate), -1)
        ).reshape(len(rate), 3, 6)
        blank = np.zeros((len(rate), 3))
        columns: list[Array] = []

        def add(d_rate: Array, d_force: Array) -> None:
            columns.append(self.average(np.concatenate([d_rate, d_force], axis=1)))

        up = blank.copy()
        up[:, 2:] = thrust
        add(blank, -up / p.mass_kg**2)
        for basis, column in zip(_BASIS, np.moveaxis(gyroscopic, -1, 0), strict=True):
            add(-(rate @ basis.T + column) @ inverse.T, blank)

        def later(part: Array) -> None:
            force = blank.copy()
            force[:, 2] = -part[:, 0] / p.mass_kg
            add(-self._integrate(part)[:, 1:] @ inverse.T, force)

        if options.delay:
            later(slope)
        if options.lag and options.symmetric_lag:
            later(slope)
        elif options.lag:
            later(rising)
            later(slope - rising)
        impulse = self._integrate(thrust)[:, 0]
        if options.com:
            for axis, sign in ((1, 1.0), (0, -1.0)):
                d = blank.copy()
                d[:, axis] = sign * impulse
                add(d @ inverse.T, blank)
        if options.yaw_trim:
            d = blank.copy()
            d[:, 2] = self._elapsed[:, 0]
            add(d @ inverse.T, blank)
        for axis in range(3):
            if axis + 3 in options.channels:
                d = blank.copy()
                d[:, axis] = 1.0
                add(blank, d)
        for value in plan.extra:
            add(self._integrate(value[:, 3:]) @ inverse.T, value[:, :3] / p.mass_kg)
        return np.stack(columns, axis=-1)


_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def initial_parameters(vehicle: Vehicle, *, lag_s: float, extra: int = 0) -> Parameters:
    """The declared vehicle with a starting lag (where none is declared)."""
    lag = vehicle.rotors.lag
    return Parameters(
        mass_kg=vehicle.mass_kg,
        tensor=vehicle.inertia_tensor(),
        lag_up_s=lag.up_s or lag_s,
        lag_down_s=lag.down_s or lag_s,
        delay_s=0.0,
        com_m=np.zeros(3),
        yaw_trim_nm=0.0,
        force_bias_m_s2=np.zeros(3),
        extra=np.zeros(extra),
    )


def _current(p: Parameters, names: Sequence[str], extra_names: Sequence[str]) -> Array:
    table = {
        "mass_kg": p.mass_kg,
        **{name: p.tensor[i, j] for name, (i, j) in zip(TENSOR, _PAIRS, strict=True)},
        "input_delay_s": p.delay_s,
        "rotor_lag_s": p.lag_up_s,
        "rotor_lag_up_s": p.lag_up_s,
        "rotor_lag_down_s": p.lag_down_s,
        "com_offset_x_m": p.com_m[0],
        "com_offset_y_m": p.com_m[1],
        "yaw_trim_nm": p.yaw_trim_nm,
        **{f"accel_bias_{a}_m_s2": b for a, b in zip("xyz", p.force_bias_m_s2, strict=True)},
        **dict(zip(extra_names, p.extra, strict=True)),
    }
    return np.array([table[name] for name in names], dtype=float)


def _moved(p: Parameters, names: Sequence[str], values: Array, extra_names: Sequence[str]) -> Parameters:
    v = dict(zip(names, values, strict=True))
    tensor = sum(v[name] * basis for name, basis in zip(TENSOR, _BASIS, strict=True))
    up = v.get("rotor_lag_s", v.get("rotor_lag_up_s", p.lag_up_s))
    down = v.get("rotor_lag_s", v.get("rotor_lag_down_s", p.lag_down_s))
    return replace(
        p,
        mass_kg=v["mass_kg"],
        tensor=np.asarray(tensor),
        lag_up_s=float(np.clip(up, 0.0, 0.5)),
        lag_down_s=float(np.clip(down, 0.0, 0.5)),
        delay_s=v.get("input_delay_s", p.delay_s),
        com_m=np.array([v.get("com_offset_x_m", p.com_m[0]), v.get("com_offset_y_m", p.com_m[1]), p.com_m[2]]),
        yaw_trim_nm=v.get("yaw_trim_nm", p.yaw_trim_nm),
        force_bias_m_s2=np.array([v.get(f"accel_bias_{a}_m_s2", b) for a, b in zip("xyz", p.force_bias_m_s2, strict=True)]),
        extra=np.array([v[name] for name in extra_names]),
    )


def _priors(record: DynamicRecord, p0: Parameters, names: Sequence[str], extra: Sequence[BodyWrench]) -> tuple[Array, Array]:
    """Weak prior means and standard deviations that keep an unexcited direction finite; far wider than any claim."""
    trace = float(np.trace(p0.tensor))
    arm = record.vehicle.arm_m()
    table = {
        "mass_kg": (p0.mass_kg, p0.mass_kg),
        **{
            name: (p0.tensor[i, j], p0.tensor[i, j] * 2.0 if i == j else 0.3 * trace)
            for name, (i, j) in zip(TENSOR, _PAIRS, strict=True)
        },
        "input_delay_s": (0.0, 0.05),
        "rotor_lag_s": (0.05, 0.15),
        "rotor_lag_up_s": (0.05, 0.15),
        "rotor_lag_down_s": (0.05, 0.15),
        "com_offset_x_m": (0.0, arm),
        "com_offset_y_m": (0.0, arm),
        "yaw_trim_nm": (0.0, p0.mass_kg * 10.0 * arm),
        **{f"accel_bias_{a}_m_s2": (0.0, s) for a, s in zip("xyz", record.force_bias_std, strict=True)},
        **{term.name: (term.prior, term.prior_std) for term in extra},
    }
    mean, std = zip(*(table[name] for name in names), strict=True)
    return np.array(mean, dtype=float), np.array(std, dtype=float)


def _whiten(
    model: RecordModel, residual: Array, sensitivity: Array, channels: Sequence[int], colours: Sequence[Colour], polynomials: Sequence[Array]
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


def _huber(y: Array, limit: float = 3.0) -> Array:
    return np.minimum(1.0, limit / np.maximum(np.abs(y), 1e-12))


def fit(
    models: Sequence[RecordModel],
    start: Parameters,
    options: Options,
    colours: Sequence[Sequence[Colour]] | None = None,
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
    channels = [
        tuple(c for c in options.channels if c < 3 or np.isfinite(model.force[:, c - 3]).all()) for model in models
    ]
    state = [list(c) for c in colours] if colours is not None else [None] * len(models)
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
                fit_colour(
                    residual[:, c],
                    model.dt,
                    model.restart,
                    integrated=c < 3,
                    start=None if previous is None else previous[i],
                )
                for i, c in enumerate(channels[index])
            ]
            if options.autoregression and round_index > 0:
                blank = evaluated[index][1][:, :, :0]
                ys, _, _ = _whiten(
                    model, residual, blank, channels[index], state[index], [np.array([1.0])] * len(channels[index])
                )
                polynomials[index] = [
                    whitening_polynomial(y, model.restart, options.autoregression) for y in ys
                ]
        for _ in range(8):
            names = evaluated[0][2]
            mean, std = _priors(records[0], start, names, models[0].extra)
            theta = _current(p, names, extra_names)
            normal = np.diag(1.0 / std**2)
            gradient = (mean - theta) / std**2
            cost = 0.5 * float(np.sum(((theta - mean) / std) ** 2))
            for index, model in enumerate(models):
                ys, xs, logs = _whiten(
                    model, evaluated[index][0], evaluated[index][1], channels[index], state[index], polynomials[index]
                )
                cost += logs
                for y, x in zip(ys, xs, strict=True):
                    w = _huber(y)
                    normal = normal + x.T @ (x * w[:, None])
                    gradient = gradient + x.T @ (w * y)
                    cost += float(np.sum(np.where(w < 1.0, 3.0 * np.abs(y) - 4.5, 0.5 * y**2)))
            step = np.linalg.solve(normal, gradient)
            p, taken = _line_search(models, p, names, theta, step, extra_names, channels, state, polynomials, cost, mean, std)
            iterations += 1
            if taken > 0.0:
                evaluated = [model.evaluate(p, options) for model in models]
            if taken == 0.0 or np.all(np.abs(taken * step) < 0.02 * np.sqrt(np.diag(np.linalg.inv(normal)))):
                break
    theta = _current(p, names, extra_names)
    covariance = np.linalg.inv(normal)
    rms = np.sqrt(np.mean(np.concatenate([e[0] for e in evaluated]) ** 2, axis=0))
    samples = sum(len(m.t_s) for m in models)
    return Fitted(
        p, names, theta, covariance, tuple(c for s in state for c in (s or [])), tuple(q for s in polynomials for q in s),
        cost, rms, samples, iterations,
    )


def _line_search(
    models: Sequence[RecordModel], p: Parameters, names: Sequence[str], theta: Array, step: Array,
    extra_names: Sequence[str], channels: Sequence[tuple[int, ...]], state: Sequence, polynomials: Sequence, cost: float,
    mean: Array, std: Array,
) -> tuple[Parameters, float]:
    """Halve the step until the cost falls; keep the tensor positive definite and the mass positive."""
    fraction = 1.0
    for _ in range(10):
        trial = _moved(p, names, theta + fraction * step, extra_names)
        if trial.mass_kg > 0.0 and np.linalg.eigvalsh(trial.tensor)[0] > 0.02 * np.linalg.eigvalsh(p.tensor)[0]:
            residuals = [model.residual(trial) for model in models]
            values = _current(trial, names, extra_names)
            total = 0.5 * float(np.sum(((values - mean) / std) ** 2))
            for index, model in enumerate(models):
                blank = np.zeros((*residuals[index].shape, 0))
                ys, _, logs = _whiten(model, residuals[index], blank, channels[index], state[index], polynomials[index])
                total += logs
                for y in ys:
                    w = _huber(y)
                    total += float(np.sum(np.where(w < 1.0, 3.0 * np.abs(y) - 4.5, 0.5 * y**2)))
            if total <= cost + 1e-9 * abs(cost):
                return trial, fraction
        fraction *= 0.5
    return p, 0.0


def fit_from_declared(models: Sequence[RecordModel], vehicle: Vehicle, options: Options) -> Fitted:
    """Prediction error estimate from the declared vehicle: first one lag and no dead time from two starts, then all."""
    extra = len(models[0].extra)
    if not options.lag:
        return fit(models, initial_parameters(vehicle, lag_s=0.0, extra=extra), options)
    first = replace(options, symmetric_lag=True, delay=False, colour_rounds=1, autoregression=0)
    tried = [fit(models, initial_parameters(vehicle, lag_s=lag, extra=extra), first) for lag in (0.02, 0.08)]
    best = min(tried, key=lambda found: found.cost)
    channels = [
        tuple(c for c in options.channels if c < 3 or np.isfinite(model.force[:, c - 3]).all()) for model in models
    ]
    return fit(models, best.parameters, options, per_flight(best.colours, channels))


SHOOTING_S = 2.0


def output_error(models: Sequence[RecordModel], start: Fitted, options: Options) -> Fitted:
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
        residual = model.residual(start.parameters)
        chosen = [c for c in options.channels if c < 3 or np.isfinite(model.force[:, c - 3]).all()]
        spread = [
            max(float(np.std(np.diff(residual[:, c]))) if c < 3 else float(np.std(residual[:, c])), 1e-9) for c in chosen
        ]
        white.append([Colour(1e-9 * s, 1.0, 1e-9 * s, s) for s in spread])
    return fit(shooting, start.parameters, replace(options, colour_rounds=0, autoregression=0), white, fixed=True)


def instrumental(models: Sequence[RecordModel], start: Fitted, options: Options) -> Fitted:
    r"""Refined instrumental variable estimate: solve Z^T W e(theta) = 0 with Z from the planned motion.

    A prediction error estimate is consistent in closed loop only when the controller saw no more than the record holds
    (Van den Hof 1998). The plan is independent of every disturbance, so this holds whatever the controller saw:

        theta <- theta + (Z^T W X)^-1 Z^T W e,    cov = (Z^T W X)^-1 (Z^T W Z) (X^T W Z)^-1

    with X, Z, e whitened by the same noise model, which is refitted to the residual (Young's refined IV).
    """
    extra_names = [term.name for term in models[0].extra]
    channels = [
        tuple(c for c in options.channels if c < 3 or np.isfinite(model.force[:, c - 3]).all()) for model in models
    ]
    colours, polynomials = per_flight(start.colours, channels), per_flight(start.whiteners, channels)
    p, names = start.parameters, start.names
    covariance = start.covariance
    split = _lag_split_precision(names)
    evaluated = [model.evaluate(p, options) for model in models]
    iterations = 0
    for round_index in range(2):
        if round_index > 0:
            colours = [
                [
                    fit_colour(e[0][:, c], model.dt, model.restart, integrated=c < 3, start=colour)
                    for c, colour in zip(chosen, previous, strict=True)
                ]
                for model, e, chosen, previous in zip(models, evaluated, channels, colours, strict=True)
            ]
        instruments = [model.instruments(p, options) for model in models]
        for _ in range(10):
            theta = _current(p, names, extra_names)
            mean, std = _priors(models[0].record, start.parameters, names, models[0].extra)
            precision = np.diag(1.0 / std**2) + split
            zx, zz = precision.copy(), precision.copy()
            ze = (mean - theta) / std**2 + split @ (start.values - theta)
            for index, model in enumerate(models):
                joined = np.concatenate([evaluated[index][1], instruments[index]], axis=2)
                ys, both, _ = _whiten(
                    model, evaluated[index][0], joined, channels[index], colours[index], polynomials[index]
                )
                for y, columns in zip(ys, both, strict=True):
                    x = columns[:, : len(names)]
                    z = _projected(x, columns[:, len(names) :])
                    w = _huber(y)[:, None]
                    zx += z.T @ (x * w)
                    zz += z.T @ (z * w)
                    ze += z.T @ (w[:, 0] * y)
            step = np.linalg.solve(zx, ze)
            inverse = np.linalg.inv(zx)
            covariance = inverse @ zz @ inverse.T
            p = _bounded_move(p, names, theta, step, extra_names)
            evaluated = [model.evaluate(p, options) for model in models]
            iterations += 1
            moved = _current(p, names, extra_names) - theta
            if np.all(np.abs(moved) < 0.02 * np.sqrt(np.diag(covariance))):
                break
    theta = _current(p, names, extra_names)
    rms = np.sqrt(np.mean(np.concatenate([e[0] for e in evaluated]) ** 2, axis=0))
    return replace(
        start, parameters=p, values=theta, covariance=covariance, residual_rms=rms, iterations=iterations,
        colours=tuple(c for s in colours for c in s),
    )


def _projected(x: Array, basis: Array) -> Array:
    """The part of the columns of x that lies in the span of a basis (first stage of two-stage least squares)."""
    size = np.linalg.norm(basis, axis=0)
    used = basis[:, size > 1e-9 * max(float(size.max()), 1e-30)] / size[size > 1e-9 * max(float(size.max()), 1e-30)]
    left, singular, _ = np.linalg.svd(used, full_matrices=False)
    left = left[:, singular > 1e-3 * singular[0]] if len(singular) else left
    return left @ (left.T @ x)


def _lag_split_precision(names: Sequence[str]) -> Array:
    """Prior precision that keeps how the total delay divides into lag up, lag down and dead time near the first estimate.

    The plan excites low frequencies, where only the sum shows; its division comes from the prediction error estimate, to
    10 ms for the dead time and 5 ms for up against down. The sum stays free.
    """
    precision = np.zeros((len(names), len(names)))
    row = np.zeros(len(names))
    if "input_delay_s" in names:
        row[names.index("input_delay_s")] = 1.0
        precision += np.outer(row, row) / 0.010**2
    if "rotor_lag_up_s" in names:
        row = np.zeros(len(names))
        row[names.index("rotor_lag_up_s")], row[names.index("rotor_lag_down_s")] = 1.0, -1.0
        precision += np.outer(row, row) / 0.005**2
    return precision


def per_flight(items: Sequence, channels: Sequence[Sequence[int]]) -> list[list]:
    """Split what :class:`Fitted` keeps in one row into one list per flight."""
    out, first = [], 0
    for chosen in channels:
        out.append(list(items[first : first + len(chosen)]))
        first += len(chosen)
    return out


def _bounded_move(p: Parameters, names: Sequence[str], theta: Array, step: Array, extra_names: Sequence[str]) -> Parameters:
    """The step, shortened until the tensor stays positive definite and the mass positive."""
    fraction = 1.0
    for _ in range(12):
        trial = _moved(p, names, theta + fraction * step, extra_names)
        if trial.mass_kg > 0.2 * p.mass_kg and np.linalg.eigvalsh(trial.tensor)[0] > 0.05 * np.linalg.eigvalsh(p.tensor)[0]:
            return trial
        fraction *= 0.5
    return p
