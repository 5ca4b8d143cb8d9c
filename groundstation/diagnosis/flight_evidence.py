"""One flight whitened about a base fit: its residual, the base's columns and instruments, and those of any
candidate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.columns import Batch, Candidate, Solution
from groundstation.diagnosis.course import ByChannel, Course, Part, Wrenches
from groundstation.diagnosis.effect import library
from groundstation.diagnosis.joint import updated_rigid_body
from groundstation.diagnosis.signals import hat_functions, held, planned_signals
from groundstation.diagnosis.sudden import sudden
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.diagnosis.whitening import Whitening
from groundstation.identification.memory import released
from groundstation.identification.prediction_error import Fitted
from groundstation.identification.preparation import Prepared
from groundstation.identification.record_model import RecordModel
from groundstation.identification.sensitivities import planned_parts
from groundstation.identification.sudden import VERTICAL
from groundstation.model.parameters import RIGID_BODY, FitOptions, table, values_of, with_values
from groundstation.model.signals import Signals

Array = NDArray[np.float64]

SAMPLES_AT_ONCE = 2**22
"""Of functions of time that are worked out side by side: 32 MB."""
WRENCH_ROW = {0: 3, 1: 4, 2: 5, 3: 0, 4: 1, 5: 2}
"""Of each channel, where its force or torque stands in a wrench."""


EXCITED_MOST = 262144
"""Samples by whose spread the settings of effects are chosen: four minutes at 1 kHz."""


class FlightEvidence:
    """One flight, whitened about a base fit.

    Args:
        known: effects that are kept out of its noise model.
        generic: keep out of it, too, whatever any effect may look like (:meth:`_generic`), so that none hides in the
            noise; else the noise is all that base and known effects leave.
    """

    def __init__(
        self,
        prepared: Prepared,
        fitted: Fitted,
        options: FitOptions,
        known: Sequence[Candidate] = (),
        *,
        generic: bool = True,
    ):
        self.prepared, self.known = prepared, tuple(known)
        self._moved: list[tuple[Candidate, Array]] = []
        self._fitted, self._given = fitted, options
        p = fitted.parameters
        # Formulas with a mass in them are about the vehicle that flew.
        vehicle = prepared.record.vehicle.model_copy(update={"mass_kg": p.mass_kg})
        record = replace(prepared.record, vehicle=vehicle)
        self.parameters = replace(p, com_m=np.zeros(3), yaw_trim_nm=0.0, force_bias_m_s2=np.zeros(3), extra=np.zeros(0))
        self.channels = _channels_of(prepared)
        self.options = FitOptions(
            lag=options.lag,
            delay=options.delay,
            accel_delay=True,
            com=False,
            yaw_trim=False,
            channels=self.channels,
        )
        self.model = RecordModel(record, (), None if prepared.planned is None else replace(prepared.planned, extra=()))
        self.signals = held(prepared.signals(p.lag_up_s, p.lag_down_s, p.delay_s, p.lag_slope))
        self.excited = self.signals.at(_some(record.keep))
        self.residual, self.sensitivity, self.names = self.model.evaluate(self.parameters, self.options)
        self.model.forget()
        planned = planned_signals(prepared, self.parameters)
        self.planned = None if planned is None else held(planned)
        self.course = Course(self.model, self.signals, self.planned, self.parameters)
        released([prepared])
        self.begun = self._sudden()
        self._whiten(generic)

    def beside(self, known: Sequence[Candidate], *, generic: bool) -> FlightEvidence:
        """The same flight about the same base, with other effects kept out of its noise model."""
        other = copy(self)
        other.known, other._moved = tuple(known), list(self._moved)
        other._whiten(generic)
        return other

    def _whiten(self, generic: bool) -> None:
        """The noise model, and what it whitens."""
        prepared, taken = self.prepared, {candidate.identifier for candidate in self.known}
        self.sudden = [candidate for candidate in self.begun if candidate.identifier not in taken]
        self.whitening = Whitening(
            self.channels, self.model.dt, self.model.restart, self.residual, self._nuisance(generic)
        )
        released([prepared])
        self.y = self.whitened_residual(self.residual)
        self.x = self.whitening.apply(self.sensitivity)
        self.z = self.x if prepared.planned is None else self._base_instruments()

    def _sudden(self) -> list[Candidate]:
        """What begins at an instant of this flight."""
        if VERTICAL not in self.channels:
            return []
        left = (self.residual[:, VERTICAL], _of_channel(self.sensitivity, VERTICAL))
        return sudden(self.model, self.model.record.vehicle, self.signals, self.excited, left)

    def _base_instruments(self) -> Array:
        """The base's columns along the planned motion; what delays the inputs takes what all of those explain of its
        own.
        """
        parts = [columns for _, columns in planned_parts(self.model, self.parameters, self.options)]
        z = self.whitening.apply(parts[0] if len(parts) == 1 else np.concatenate(parts))
        entries = table()
        timing = [index for index, name in enumerate(self.names) if entries[name].timing]
        z[:, timing] = self.whitening.explained(self.x[:, timing], z)
        return z

    @cached_property
    def declared(self) -> RecordModel:
        """The flight by the thrust curve that was declared."""
        return self.model.of_vehicle(self.prepared.flight.vehicle)

    def base_std(self, name: str) -> float:
        """Standard deviation of a parameter of the base fit."""
        return self._fitted.std(name)

    def of(self, other: Prepared) -> FlightEvidence:
        """Another flight about the same base fit."""
        return FlightEvidence(other, self._fitted, self._given, self.known)

    def updated_base(self, fitted: Fitted, solution: Solution) -> Fitted:
        """The base fit at a joint estimate, for the next linearisation; as it was where that is no rigid body
        (:func:`updated_rigid_body`).
        """
        names = list(self.names)
        values = values_of(self.parameters, names) + solution.theta[: len(names)]
        found = updated_rigid_body(*self._rigid_step(solution))
        if found is None:
            return fitted
        values[[names.index(name) for name in RIGID_BODY]] = found[0]
        p = with_values(self.parameters, names, values)
        return replace(fitted, parameters=replace(p, delay_s=max(p.delay_s, 0.0), force_bias_m_s2=np.zeros(3)))

    def rigid_body(self, solution: Solution) -> tuple[Array, Array]:
        """Mass and tensor of a joint estimate, in the order of RIGID_BODY, and their Jacobian by its parameters.

        Those parameters themselves where no rigid body lies there (:func:`updated_rigid_body`).
        """
        about, step = self._rigid_step(solution)
        return updated_rigid_body(about, step) or (about + step, np.eye(len(about)))

    def _rigid_step(self, solution: Solution) -> tuple[Array, Array]:
        index = [self.names.index(name) for name in RIGID_BODY]
        return values_of(self.parameters, RIGID_BODY), solution.theta[index]

    def whitened_residual(self, residual: Array) -> Array:
        """Any residual (blocks, 6) of this flight, whitened as its own, (rows,)."""
        return self.whitening.apply(residual[:, :, None])[:, 0]

    def _nuisance(self, generic: bool) -> Iterator[Array]:
        """Columns (blocks, m) of one known channel after the other that keep an effect's own residual out of the noise
        model.
        """
        known = [self.moved_by(candidate) for candidate in (*self.known, *self.sudden)]
        drift, effects = (self._drift(), self._library()) if generic else (None, ())
        for channel in self.channels:
            parts = [_of_channel(columns, channel) for columns in (self.sensitivity, *known)]
            if drift is not None:
                parts.append(drift(channel))
            yield np.concatenate([*parts, *(columns.of(channel) for columns in effects)], axis=1)

    def _drift(self) -> Callable[[int], Array]:
        """Of a channel, columns (blocks, m): slow drift, its own speed and thrust as torque and as force.

        Without them a step or a trend would pass for a disturbance of long memory, and hide itself.
        """
        signals, mass = self.signals, self.parameters.mass_kg
        length, known = float(signals.t_s[-1] - signals.t_s[0]), np.isfinite(signals.thrust_n).all()
        knots = np.linspace(0.0, length, int(np.clip(length / THRESHOLDS.drift_knot_s, 3, 16)) + 1)

        def beside(own: Callable[[Signals], Array]) -> Callable[[Part], Array]:
            def columns(part: Part) -> Array:
                now = part.signals
                drift, shown = hat_functions(now.t_s - signals.t_s[0], knots), own(now)
                thrust: Array = now.thrust_n.sum(axis=1)[:, None]
                return np.concatenate([drift, shown, thrust] if known else [drift, shown], axis=1)

            return columns

        course = self.course
        turned = [course.sums(beside(lambda now, i=axis: now.rate_rad_s[:, i : i + 1]))[0] for axis in range(3)]

        def of(channel: int) -> Array:
            if channel < 3:
                columns = [course.inverse[channel, axis] * _finite(turned[axis]) for axis in range(3)]
                return _shown(np.concatenate(columns, axis=1))
            pushing = course.sums(beside(lambda now: now.velocity_body_m_s()[:, channel - 3 : channel - 2]))[1]
            return _shown(_finite(pushing) / mass)

        return of

    def _library(self) -> list[ByChannel]:
        """Columns of the library's effects, in a few settings of each."""
        vehicle, many = self.prepared.record.vehicle, list[Wrenches]()
        for effect in library().values():
            settings = effect.variants(self.excited, vehicle) if effect.applies(vehicle) else ()
            some = settings[:: max(1, len(settings) // THRESHOLDS.variants_in_noise)]
            many += self.course.unchanged_of(effect, some)
        return self.course.by_channel(many)

    def moved_by(self, candidate: Candidate) -> Array:
        """Rates and specific forces (blocks, 6, p) that a candidate adds per unit of its parameters; those asked for
        last are kept.
        """
        for known, moved in self._moved:
            if known is candidate:
                return moved
        (found,) = self.course.moved([self.course.seen_wrench_of(candidate)])
        shape = len(self.model.t_s), 6, len(candidate.effect.parameters)
        moved = np.full(shape, np.nan) if found is None else found.columns[0]
        self._moved = [*self._moved[1 - THRESHOLDS.effects_most :], (candidate, moved)]
        return moved

    def batch(self, candidates: Sequence[Candidate]) -> Batch:
        """Whitened sensitivities and instruments of candidates; zero where one's signals are unknown."""
        counts = [len(candidate.effect.parameters) for candidate in candidates]
        total = sum(counts)
        planned = self.planned is not None
        raw = np.zeros((len(self.model.t_s), 6, 2 * total if planned else total))
        rms, known = np.zeros((6, total)), [True] * len(candidates)
        firsts: list[int] = np.cumsum([0, *counts[:-1]]).tolist() if counts else []
        straight = [index for index, candidate in enumerate(candidates) if candidate.effect.straight is not None]
        at_once = max(1, SAMPLES_AT_ONCE // (len(self.signals.t_s) // len(self.model.parts())))
        for start in range(0, len(straight), at_once):
            some = straight[start : start + at_once]
            own = [firsts[index] for index in some]
            columns, sizes, finite = self._straight([candidates[index] for index in some])
            raw[:, :, own], rms[:, own] = columns[:, :, : len(some)], sizes
            if planned:
                raw[:, :, [total + first for first in own]] = columns[:, :, len(some) :]
            for index, is_finite in zip(some, finite, strict=True):
                known[index] = is_finite
        others = [index for index, candidate in enumerate(candidates) if candidate.effect.straight is None]
        moved = self.course.moved([self.course.wrenches_of(candidates[index]) for index in others])
        for index, found in zip(others, moved, strict=True):
            known[index] = found is not None
            if found is not None:
                own = slice(firsts[index], firsts[index] + counts[index])
                rms[:, own] = found.rms
                for start, columns in zip((0, total), found.columns, strict=False):
                    raw[:, :, start + own.start : start + own.stop] = columns
        del moved
        return Batch(*self.whitening.applied(raw), rms, tuple(known))

    def nothing(self, candidates: Sequence[Candidate]) -> Batch:
        """Of candidates that do not act on this flight."""
        total = sum(len(candidate.effect.parameters) for candidate in candidates)
        bands = len(self.whitening.freedom())
        return Batch(
            np.zeros((len(self.y), total)), np.zeros((bands, total)), np.zeros((6, total)), (True,) * len(candidates)
        )

    def _straight(self, candidates: Sequence[Candidate]) -> tuple[Array, Array, list[bool]]:
        """What candidates that push in one direction add, those of the plan behind, (blocks, 6, n); RMS of their
        wrenches, (6, candidates); and whether their signals are known.
        """
        count, squares = len(candidates), np.zeros(len(candidates))
        finite: NDArray[np.bool_] = np.ones(count if self.planned is None else 2 * count, dtype=bool)
        directions = np.zeros((6, len(finite)))

        def series(part: Part) -> Array:
            nonlocal squares, finite, directions
            found, directions = _how_hard(candidates, part)
            here = np.isfinite(found.sum(axis=0))
            found[:, ~here] = 0.0
            finite &= here
            own = found[:, :count]
            squares = squares + part.share @ (own * own)
            return found

        integral, mean = self.course.sums(series)
        turning = self.course.inverse @ directions[3:]
        out = np.empty((len(self.model.t_s), 6, len(finite)))
        out[:, :3] = integral[:, None] * turning
        out[:, 3:] = mean[:, None] * (directions[:3] / self.parameters.mass_kg)
        sizes = np.sqrt(squares) * np.abs(directions[:, :count])
        known = np.asarray(finite.reshape(-1, count).all(axis=0))
        out[:, :, np.tile(~known, len(finite) // count)] = 0.0
        return out, sizes, known.tolist()

    def shares_of(self, channel: int) -> Array:
        """How much of a torque or force of each of the six channels shows in one, (6,); torques by the tensor's
        inverse.
        """
        if channel >= 3:
            return np.eye(6)[channel]
        return np.concatenate([self.course.inverse[channel], np.zeros(3)])


def _how_hard(candidates: Sequence[Candidate], part: Part) -> tuple[Array, Array]:
    """How hard candidates push that do so in one direction, along the motion and then along the plan, (k, n); the
    wrenches of one, (6, n).
    """
    vehicle, both = part.model.record.vehicle, [part.signals, *([] if part.planned is None else [part.planned])]
    made = [
        candidate.effect.straight(signals, vehicle, candidate.settings)
        for signals in both
        for candidate in candidates
        if candidate.effect.straight is not None
    ]
    return _side_by_side([how_hard for how_hard, _ in made]), np.stack([way for _, way in made], axis=1)


ROWS_AT_ONCE = 512
"""Of many columns side by side: as much as a core's own cache holds."""


def _side_by_side(columns: Sequence[Array]) -> Array:
    """Columns (k,) each, (k, n)."""
    out = np.empty((len(columns[0]), len(columns)))
    for first in range(0, len(out), ROWS_AT_ONCE):
        some = slice(first, first + ROWS_AT_ONCE)
        out[some] = np.array([column[some] for column in columns]).T
    return out


def _channels_of(prepared: Prepared) -> tuple[int, ...]:
    """Outputs that a flight's evidence uses: rates, and forces as far as they are measured."""
    if not np.isfinite(prepared.record.force_m_s2).all():
        return (0, 1, 2)
    sideways = prepared.source == "imu" or np.isfinite(prepared.velocity_m_s).all()
    return (0, 1, 2, 3, 4, 5) if sideways else (0, 1, 2, 5)


def _some(keep: NDArray[np.bool_]) -> NDArray[np.bool_] | NDArray[np.intp]:
    """Samples in use; of a long flight EXCITED_MOST of them, evenly."""
    count = int(np.count_nonzero(keep))
    return keep if count <= EXCITED_MOST else np.flatnonzero(keep)[:: -(-count // EXCITED_MOST)]


def _shown(columns: Array) -> Array:
    """Those that are not zero all along."""
    return columns[:, np.any(columns != 0.0, axis=0)]


def _finite(columns: Array) -> Array:
    """Those that are known all along."""
    return columns[:, np.isfinite(columns).all(axis=0)]


def _of_channel(columns: Array, channel: int) -> Array:
    """The columns (blocks, m) of (blocks, 6, m) that show in a channel."""
    return _shown(columns[:, channel])
