"""The predicted rates and specific forces of one recorded flight, and their sensitivities to the parameters.

    omega(t) = omega(0) + J^-1 H(t),    H = integral of (tau(T) - c x F(T) - omega x J omega)
    f(t) = (F(T) + extra forces) / m + b

T are rotor thrusts behind a lag and a delay, F and tau what they make along their axes. omega x J omega uses the
measured rates, whose noise is a part in a thousand there. Sensitivities are analytic; those of lag and delay are
differences of the exact lag. Everything is linear in running integrals, so those are averaged to the fit's rate once.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.block_kernel import integral_means, outputs, residual, wrench_means
from groundstation.identification.noise import KeptGains
from groundstation.identification.parts import double, kept
from groundstation.identification.record import LATEST_S, DynamicRecord, PlannedMotion
from groundstation.identification.sensitivities import (
    Measured,
    lag_of,
    measured_sensitivities,
    sensitivity_of,
    stacked,
    timing_steps,
)
from groundstation.model.parameters import PAIRS, FitOptions, Parameters, free_entries
from groundstation.model.rotor_kernel import LANES
from groundstation.model.rotors import Lag, mean_thrusts, wrench_matrix
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PART = 16384
"""Blocks whose sensitivities are held at a time: nearly two minutes of flight at the fit's rate."""
LIVELIEST = 45000
"""Blocks in which lags, dead time and noise are searched for: five minutes, which tell them to a few parts of a
thousand, so that a fit of all from there takes few steps.
"""

UNTIMED = FitOptions(lag=False, delay=False)
"""Asks for no differences by lags and dead time."""

CHANNELS = ("torque_x_nm", "torque_y_nm", "torque_z_nm", "force_x_n", "force_y_n", "force_z_n")


@dataclass(frozen=True, slots=True)
class BodyWrench:
    """An extra force and torque about the declared origin per unit of one parameter, body axes, at the IMU's stamps.

    Attributes:
        value: force (N) then torque (N m), (k, 6); of a wrench along one axis, what is taken away there, (k,).
        against: the row of ``value`` (k,), that the wrench acts against; None for all six rows.
        prior_std: regularises the coefficient about ``prior``.
    """

    name: str
    value: Array
    prior_std: float = np.inf
    prior: float = 0.0
    against: int | None = None


@dataclass(frozen=True, slots=True)
class TermMeans:
    """Of a term its running integral and its force, averaged over the blocks: (blocks, 6) and (blocks, 3), or along one
    axis (blocks,) each.
    """

    integral: Array
    push: Array
    against: int | None = None

    def part(self, blocks: slice) -> TermMeans:
        """Of some of the blocks."""
        return replace(self, integral=self.integral[blocks], push=self.push[blocks])

    def dense(self) -> tuple[Array, Array]:
        """Running integral (blocks, 6) and force (blocks, 3)."""
        integral, push = np.zeros((len(self.integral), 6)), np.zeros((len(self.integral), 3))
        self.turn(1.0, integral)
        self.push_on(1.0, push)
        return integral, push

    def turn(self, coefficient: float, impulse: Array) -> None:
        """Add so much of the running integral to one (blocks, 6)."""
        if self.against is None:
            impulse += coefficient * self.integral
        else:
            impulse[:, self.against] += coefficient * self.integral

    def push_on(self, coefficient: float, force: Array) -> None:
        """Add so much of the force to one (blocks, 3)."""
        if self.against is None:
            force += coefficient * self.push
        elif self.against < 3:
            force[:, self.against] += coefficient * self.push


@dataclass(frozen=True, slots=True)
class Predicted:
    """A record's outputs at given parameters: wrench and impulse (blocks, 6), rates, forces; differences of force
    (blocks, 3) and impulse (blocks, 6) by lags and dead time.
    """

    moved: Mapping[str, tuple[Array, Array]]
    wrench: Array
    impulse: Array
    rate: Array
    force: Array

    def part(self, blocks: slice) -> Predicted:
        """Of some of the blocks."""
        moved = {
            name: (double(wrench[blocks]), double(impulse[blocks])) for name, (wrench, impulse) in self.moved.items()
        }
        return Predicted(moved, *(each[blocks] for each in (self.wrench, self.impulse, self.rate, self.force)))


class RecordModel:
    """Predicted outputs of one record and their sensitivities, at the fit's rate. Built once per flight; pure in the
    parameters.

    Attributes:
        matrix: from rotors' thrusts to body force and torque, (6, n).
        t_s, dt, restart: blocks of averaged samples, shape (blocks,); ``restart`` marks the first of a segment.
        rate, force: measured, averaged, (blocks, 3).
        elapsed_s: time since the record's start, (blocks,). turned: see :meth:`integrated_products`.
        extra_means: of each wrench term its running integral (blocks, 6) and mean force (blocks, 3).
        silent: channels in which this record only answers its disturbance, while another one tells more.
    """

    def __init__(
        self,
        record: DynamicRecord,
        extra: Sequence[BodyWrench] = (),
        planned: PlannedMotion | None = None,
        silent: frozenset[int] = frozenset(),
    ):
        self.record = record
        self.silent = silent
        self.planned = planned
        self.extra = tuple(extra)
        self.matrix = wrench_matrix(record.vehicle)
        self._members, self.restart = _blocks(record)
        self._step = np.concatenate([[0.0], np.diff(record.t_s)])
        self.sample_s, self.samples = float(np.median(np.diff(record.t_s))), slice(0, len(record.t_s))
        self.t_s = self.average(record.t_s[:, None])[:, 0]
        nominal = self.sample_s * record.block
        self.dt = np.concatenate([[nominal], np.maximum(np.diff(self.t_s), 1e-4)])[: len(self.t_s)]
        self.rate = self.average(record.rate_rad_s)
        self.force = self.average(record.force_m_s2)
        self._known = [True] * 3 + [bool(np.isfinite(self.force[:, axis]).all()) for axis in range(3)]
        self.elapsed_s = self.t_s - record.t_s[0]
        self.turned = self.integrated_products(record.rate_rad_s)
        self.extra_means = tuple(self.means_of(term, term.value) for term in self.extra)
        self._last: tuple[Parameters, Predicted] | None = None
        self._made: tuple[list[tuple[Lag, float]], tuple[Array, Array]] | None = None
        self._asked = UNTIMED
        self.gains = KeptGains()

    def channels(self, options: FitOptions) -> tuple[int, ...]:
        """Outputs of this record that a fit uses: those asked for, measured, and not silent."""
        return tuple(c for c in options.channels if self._known[c] and c not in self.silent)

    def restarted(self, restart: Mask) -> RecordModel:
        """The same record with other segment starts."""
        other = copy(self)
        other.restart, other.gains = restart, KeptGains()
        return other

    def parts(self) -> list[slice]:
        """The blocks in parts of at most PART; one for a flight of a minute."""
        count = len(self.t_s)
        return [slice(first, min(first + PART, count)) for first in range(0, max(count, 1), PART)]

    def part(self, blocks: slice, before_s: float = 0.0) -> RecordModel:
        """Some of the blocks, and of the samples those of these blocks and some before: views.

        Running integrals begin at the first sample of the part.
        """
        if blocks.start <= 0 and blocks.stop >= len(self.t_s):
            return self
        other, members = copy(self), self._members[blocks]
        margin = round(before_s / self.sample_s) + 1
        before = 0 if blocks.start <= 0 else max(0, int(members[0, 0]) - margin)
        samples = other.samples = slice(before, int(members[-1, -1]) + 2)
        other.record = self.record.part(samples)
        other.planned = None if self.planned is None else self.planned.part(samples)
        other._members, other._step, other.gains = members - before, self._step[samples], KeptGains()
        for name in ("restart", "t_s", "dt", "rate", "force", "elapsed_s", "turned"):
            setattr(other, name, getattr(self, name)[blocks])
        other.extra_means = tuple(means.part(blocks) for means in self.extra_means)
        other._last = other._made = None
        return other

    def liveliest(self) -> RecordModel:
        """The LIVELIEST blocks in a row in which the vehicle turns most; itself where there are no more."""
        count = len(self.t_s)
        if count <= LIVELIEST:
            return self
        turned = np.cumsum(np.sum(np.diff(self.rate, axis=0, prepend=self.rate[:1]) ** 2, axis=1))
        first = int(np.argmax(turned[LIVELIEST:] - turned[:-LIVELIEST]))
        found = self.part(slice(first, first + LIVELIEST), LATEST_S)
        found.restart = found.restart.copy()
        found.restart[0] = True
        return found

    def of_vehicle(self, vehicle: Vehicle) -> RecordModel:
        """The same record by another vehicle's thrust, with neither terms nor plan."""
        other = copy(self)
        other.record, other.matrix = replace(self.record, vehicle=vehicle), wrench_matrix(vehicle)
        other.planned, other.extra, other.extra_means = None, (), ()
        other._last = other._made = None
        other._asked = UNTIMED
        return other

    def integrated(self, values: Array) -> Array:
        """Block means of the running integral of values (k, ...) at the IMU's stamps, (blocks, ...)."""
        means = integral_means(values.reshape(len(values), -1), self._step, self._members)
        return means.reshape(len(means), *values.shape[1:])

    def means_of(self, term: BodyWrench, value: Array) -> TermMeans:
        """Of a term with these values at the IMU's stamps."""
        if term.against is None:
            return TermMeans(self.integrated(value), self.average(value[:, :3]))
        return TermMeans(-self.integrated(value), -self.average(value), term.against)

    def integrated_products(self, rate: Array) -> Array:
        """Block means of the integrals of products of two rates, (blocks, 6): TURNING makes omega x J omega of them."""
        return self.integrated(np.stack([rate[:, i] * rate[:, j] for i, j in PAIRS], axis=-1))

    def of_wrench(self, wrench: Array) -> Array:
        """Block means of the running integrals of torques and of forces, torques first, of a wrench (k, 6, p)."""
        flat = np.ascontiguousarray(wrench, dtype=float).reshape(len(wrench), -1)
        return wrench_means(flat, self._step, self._members).reshape(-1, 6, wrench.shape[2])

    def average(self, values: Array) -> Array:
        """Block means of samples (k, ...) at the IMU's stamps, (blocks, ...)."""
        if not len(self._members):
            return np.zeros((0, *values.shape[1:]))
        total = values[self._members[:, 0]].copy()
        for column in self._members.T[1:]:
            total += values[column]
        return total / self._members.shape[1]

    def thrusts(self, wanted: Sequence[tuple[Lag, float]]) -> Iterator[tuple[Array, Array]]:
        """Force and torque of the rotors by the declared constants behind each lag and dead time, averaged over the
        blocks, and their running integrals, (blocks, 6) each.

        A single one is kept: a fit whose rotors have neither lag nor dead time to find asks for the same again.
        """
        if self._made is not None and self._made[0] == list(wanted):
            yield self._made[1]
            return
        record = self.record
        for each in mean_thrusts(record.vehicle, record.motors, wanted, (record.t_s, self._members)):
            made = each[:, 0] @ self.matrix.T, each[:, 1] @ self.matrix.T
            if len(wanted) == 1:
                self._made = list(wanted), made
            yield made

    def wrench(self, p: Parameters) -> Array:
        """Force and torque of the rotors at ``p``, (blocks, 6)."""
        return self.predicted(p).wrench

    def predicted(self, p: Parameters, options: FitOptions | None = None) -> Predicted:
        """At ``p``, with the differences that the sensitivities of these options need (None: those asked for last).

        Differences cost little beside the prediction, and a search that ends at ``p`` goes on from there.
        """
        if self._last is not None and self._last[0] is p and options in (None, self._asked):
            return self._last[1]
        self._asked = self._asked if options is None else options
        steps = timing_steps(p, self._asked, self.record.motors.held_s)
        self._last = None
        made = self.thrusts([(lag_of(p), p.delay_s), *((step.lag, step.delay_s) for step in steps.values())])
        here = next(made)
        moved = {
            name: (kept((wrench[:, :3] - here[0][:, :3]) / step.size), kept((impulse - here[1]) / step.size))
            for (name, step), (wrench, impulse) in zip(steps.items(), made, strict=True)
        }
        prediction = self._outputs(p, moved, *here)
        self._last = p, prediction
        return prediction

    def _outputs(
        self, p: Parameters, moved: Mapping[str, tuple[Array, Array]], wrench: Array, impulse: Array
    ) -> Predicted:
        """Rates and forces that a wrench and its integral make."""
        entries = np.array([p.tensor[i, j] for i, j in PAIRS])
        body = entries, np.asarray(np.linalg.inv(p.tensor), dtype=float), np.array(p.com_m, dtype=float)
        whole = impulse.copy()
        for coefficient, means in zip(p.extra, self.extra_means, strict=True):
            means.turn(coefficient, whole)
        rate, force = outputs(wrench, whole, self.turned, body, p.yaw_trim_nm * self.elapsed_s)
        for coefficient, means in zip(p.extra, self.extra_means, strict=True):
            means.push_on(coefficient, force)
        return self._with_linear(p, Predicted(moved, wrench, impulse, rate, force))

    def forget(self) -> None:
        """Let go of the last prediction."""
        self._last = self._made = None

    def residuals(self, trials: Sequence[Parameters]) -> Iterator[Array]:
        """:meth:`residual` at many points that differ in lags and dead time, for less: a few at a time, (few, blocks,
        6).
        """
        together = max(1, LANES // self.record.motors.value.shape[1])
        for first in range(0, len(trials), together):
            some = trials[first : first + together]
            found = self.thrusts([(lag_of(p), p.delay_s) for p in some])
            yield np.stack(
                [self.residual_of(p, self._outputs(p, {}, *each)) for p, each in zip(some, found, strict=True)]
            )

    def _with_linear(self, p: Parameters, prediction: Predicted) -> Predicted:
        """With what parameters without physics of their own add: value times sensitivity."""
        if not p.others:
            return prediction
        at = Measured(self, p, prediction)
        for name, value in p.others.items():
            rate, force = sensitivity_of(name)(at)
            prediction = replace(
                prediction, rate=prediction.rate + value * rate, force=prediction.force + value * p.mass_kg * force
            )
        return prediction

    def residual(self, p: Parameters) -> Array:
        """Measured less predicted rates and specific forces at ``p``, (blocks, 6)."""
        return self.residual_of(p, self.predicted(p))

    def residual_of(self, p: Parameters, prediction: Predicted) -> Array:
        """Measured less a prediction at ``p``, (blocks, 6)."""
        return residual((self.rate, self.force), prediction.rate, prediction.force, p.mass_kg, p.force_bias_m_s2)

    def sensitivities(self, p: Parameters, options: FitOptions, blocks: slice) -> Array:
        """d(prediction)/d(parameter) of some of the blocks, (n, 6, P)."""
        prediction = self.predicted(p, options)
        at = Measured(self.part(blocks), p, prediction.part(blocks))
        return stacked(measured_sensitivities(at, options))

    def names(self, options: FitOptions) -> tuple[str, ...]:
        """Of what is free, in the order of the sensitivities."""
        return (*(entry.name for entry in free_entries(options)), *(term.name for term in self.extra))

    def evaluate(self, p: Parameters, options: FitOptions) -> tuple[Array, Array, tuple[str, ...]]:
        """Residuals (blocks, 6) and sensitivities d(prediction)/d(parameter) (blocks, 6, P) at ``p``, with names."""
        sensitivity = self.sensitivities(p, options, slice(0, len(self.t_s)))
        return self.residual_of(p, self.predicted(p, options)), sensitivity, self.names(options)


def _blocks(record: DynamicRecord) -> tuple[NDArray[np.int64], Mask]:
    """Indices of the samples of each block, (blocks, block), and which blocks begin a segment."""
    index = np.flatnonzero(record.keep)
    nominal = float(np.median(np.diff(record.t_s)))
    broken = (np.diff(index) > 1) | (np.diff(record.t_s[index]) > 3.5 * nominal)
    members: list[NDArray[np.int64]] = []
    restarts: list[bool] = []
    for part in np.split(index, np.flatnonzero(broken) + 1):
        count = len(part) // record.block
        if count >= 8:
            members.append(part[: count * record.block].reshape(count, record.block))
            restarts += [True] + [False] * (count - 1)
    empty = np.zeros((0, record.block), dtype=np.int64)
    return (np.concatenate(members) if members else empty), np.array(restarts, dtype=bool)
