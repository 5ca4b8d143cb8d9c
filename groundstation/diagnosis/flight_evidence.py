"""One flight whitened about a base fit: its residual, the base's columns and instruments, and those of any
candidate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.columns import Batch, Candidate, Solution
from groundstation.diagnosis.effect import library
from groundstation.diagnosis.joint import updated_rigid_body
from groundstation.diagnosis.signals import planned_signals
from groundstation.diagnosis.sudden import sudden
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.diagnosis.whitening import Whitening
from groundstation.identification.prediction_error import Fitted
from groundstation.identification.preparation import Prepared
from groundstation.identification.record_model import RecordModel
from groundstation.identification.sensitivities import planned_parts
from groundstation.identification.sudden import VERTICAL
from groundstation.model.parameters import RIGID_BODY, FitOptions, table, values_of, with_values

Array = NDArray[np.float64]

SAMPLES_AT_ONCE = 2**22
"""Of functions of time that are worked out side by side: 32 MB."""
WRENCH_ROW = {0: 3, 1: 4, 2: 5, 3: 0, 4: 1, 5: 2}
"""Of each channel, where its force or torque stands in a wrench."""


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
        record, p = prepared.record, fitted.parameters
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
        self.signals = prepared.signals(p.lag_up_s, p.lag_down_s, p.delay_s, p.lag_slope)
        self.excited = self.signals.at(record.keep)
        self._share = record.keep / np.sum(record.keep)
        self._inverse = np.linalg.inv(self.parameters.tensor)
        self.residual, self.sensitivity, self.names = self.model.evaluate(self.parameters, self.options)
        self.planned = planned_signals(prepared, self.parameters)
        self.sudden = self._sudden()
        self.whitening = Whitening(
            self.channels, self.model.dt, self.model.restart, self.residual, self._nuisance(generic)
        )
        self.y = self.whitened_residual(self.residual)
        self.x = self.whitening.apply(self.sensitivity)
        self.z = self.x if prepared.planned is None else self._base_instruments()

    def _sudden(self) -> list[Candidate]:
        """What begins at an instant of this flight, and nobody knows of yet."""
        if VERTICAL not in self.channels:
            return []
        left = (self.residual[:, VERTICAL], _of_channel(self.sensitivity, VERTICAL))
        taken = {candidate.identifier for candidate in self.known}
        found = sudden(self.model, self.prepared.record.vehicle, self.signals, self.excited, left)
        return [candidate for candidate in found if candidate.identifier not in taken]

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

    def _nuisance(self, generic: bool) -> list[Array]:
        """Columns (blocks, m) of each known channel that keep an effect's own residual out of the noise model."""
        vehicle = self.prepared.record.vehicle
        kept_out = (*self.known, *self.sudden)
        known = [self.predicted(c.effect.wrench(self.signals, vehicle, c.settings)) for c in kept_out]
        parts: list[list[Array]] = [[_of_channel(self.sensitivity, c)] for c in self.channels]
        for columns in known:
            _add(parts, columns, self.channels)
        if generic:
            for own, drift in zip(parts, self._drift(), strict=True):
                own.append(drift)
            self._add_library(parts)
        return [np.concatenate(parts.pop(0), axis=1) for _ in self.channels]  # the parts of one channel at a time

    def _drift(self) -> list[Array]:
        """Columns (blocks, m) of each known channel: slow drift, its own speed and thrust as torque and as force.

        Without them a step or a trend would pass for a disturbance of long memory, and hide itself.
        """
        signals = self.signals
        elapsed = signals.t_s - signals.t_s[0]
        knots = np.linspace(0.0, float(elapsed[-1]), int(np.clip(elapsed[-1] / THRESHOLDS.drift_knot_s, 3, 16)) + 1)
        hats: list[Array] = [np.interp(elapsed, knots, peak) for peak in np.eye(len(knots))]
        drift, mass = np.column_stack(hats), self.parameters.mass_kg
        thrust: Array = signals.thrust_n.sum(axis=1)[:, None]
        velocity = signals.velocity_body_m_s()
        turning = [np.concatenate([drift, signals.rate_rad_s[:, i : i + 1], thrust], axis=1) for i in range(3)]
        turned = [self.model.integrated(known) for known in map(_finite, turning)]
        out: list[Array] = []
        for channel in self.channels:
            if channel < 3:
                columns = [self._inverse[channel, axis] * turned[axis] for axis in range(3)]
                out.append(_shown(np.concatenate(columns, axis=1)))
            else:
                own = velocity[:, channel - 3 : channel - 2]
                pushing = _finite(np.concatenate([drift, own, thrust], axis=1))
                out.append(_shown(self.model.average(pushing) / mass))
        return out

    def _add_library(self, parts: list[list[Array]]) -> None:
        """Columns of the library's effects, in a few settings of each."""
        vehicle = self.prepared.record.vehicle
        for effect in library().values():
            settings = effect.variants(self.excited, vehicle) if effect.applies(vehicle) else ()
            for chosen in settings[:: max(1, len(settings) // THRESHOLDS.variants_in_noise)]:
                wrench = effect.unchanged(self.signals, vehicle, chosen)
                if np.isfinite(wrench).all():
                    _add(parts, self.predicted(wrench), self.channels)

    def predicted(self, wrench: Array) -> Array:
        """Rates and specific forces (blocks, 6, p) that a body wrench (k, 6, p) adds."""
        out = self.model.of_wrench(wrench)
        out[:, :3] = self._inverse @ out[:, :3]
        out[:, 3:] /= self.parameters.mass_kg
        return out

    def moved_by(self, candidate: Candidate) -> Array:
        """Rates and specific forces (blocks, 6, p) that a candidate adds per unit of its parameters; those asked for
        last are kept.
        """
        for known, moved in self._moved:
            if known is candidate:
                return moved
        moved = self.predicted(candidate.effect.wrench(self.signals, self.prepared.record.vehicle, candidate.settings))
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
        at_once = max(1, SAMPLES_AT_ONCE // len(self.signals.t_s))
        for start in range(0, len(straight), at_once):
            some = straight[start : start + at_once]
            own = [firsts[index] for index in some]
            columns, sizes, finite = self._straight([candidates[index] for index in some])
            raw[:, :, own], rms[:, own] = columns[:, :, : len(some)], sizes
            if planned:
                raw[:, :, [total + first for first in own]] = columns[:, :, len(some) :]
            for index, is_finite in zip(some, finite, strict=True):
                known[index] = is_finite
        for index, (candidate, first, count) in enumerate(zip(candidates, firsts, counts, strict=True)):
            if candidate.effect.straight is not None:
                continue
            wrenches = self._wrenches(candidate)
            known[index] = all(np.isfinite(wrench.sum()) for wrench in wrenches)  # nothing adds up to one without it
            if known[index]:
                flat = wrenches[0].reshape(len(wrenches[0]), -1)
                squares = np.einsum("k,kj,kj->j", self._share, flat, flat)
                rms[:, first : first + count] = np.sqrt(squares).reshape(6, count)
                for start, wrench in zip((first, total + first), wrenches, strict=False):
                    raw[:, :, start : start + count] = self.predicted(wrench)
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
        vehicle, both = self.prepared.record.vehicle, [self.signals]
        if self.planned is not None:
            both.append(self.planned)
        made = [
            candidate.effect.straight(signals, vehicle, candidate.settings)
            for signals in both
            for candidate in candidates
            if candidate.effect.straight is not None
        ]
        series = np.stack([how_hard for how_hard, _ in made], axis=1)
        finite = np.isfinite(series.sum(axis=0))
        series[:, ~finite] = 0.0
        directions = np.stack([direction for _, direction in made], axis=1)
        turning = self._inverse @ directions[3:]
        out = np.empty((len(self.model.t_s), 6, len(made)))
        out[:, :3] = self.model.integrated(series)[:, None] * turning
        out[:, 3:] = self.model.average(series)[:, None] * (directions[:3] / self.parameters.mass_kg)
        own = series[:, : len(candidates)]
        sizes = np.sqrt(self._share @ (own * own)) * np.abs(directions[:, : len(candidates)])
        known = finite.reshape(len(both), -1).all(axis=0)
        out[:, :, np.tile(~known, len(both))] = 0.0
        return out, sizes, known.tolist()

    def _wrenches(self, candidate: Candidate) -> list[Array]:
        """What a candidate adds per unit of its parameters, (k, 6, p); with a plan, its instrument, too."""
        vehicle, effect, planned = self.prepared.record.vehicle, candidate.effect, self.planned
        seen = effect.wrench(self.signals, vehicle, candidate.settings)
        if planned is None:
            return [seen]
        if effect.instrument is None:
            return [seen, effect.wrench(planned, vehicle, candidate.settings)]
        return [seen, effect.instrument(self.signals, planned, vehicle, candidate.settings)]

    def shares_of(self, channel: int) -> Array:
        """How much of a torque or force of each of the six channels shows in one, (6,); torques by the tensor's
        inverse.
        """
        if channel >= 3:
            return np.eye(6)[channel]
        return np.concatenate([self._inverse[channel], np.zeros(3)])


def _channels_of(prepared: Prepared) -> tuple[int, ...]:
    """Outputs that a flight's evidence uses: rates, and forces as far as they are measured."""
    if not np.isfinite(prepared.record.force_m_s2).all():
        return (0, 1, 2)
    sideways = prepared.source == "imu" or np.isfinite(prepared.velocity_m_s).all()
    return (0, 1, 2, 3, 4, 5) if sideways else (0, 1, 2, 5)


def _shown(columns: Array) -> Array:
    """Those that are not zero all along."""
    return columns[:, np.any(columns != 0.0, axis=0)]


def _finite(columns: Array) -> Array:
    """Those that are known all along."""
    return columns[:, np.isfinite(columns).all(axis=0)]


def _of_channel(columns: Array, channel: int) -> Array:
    """The columns (blocks, m) of (blocks, 6, m) that show in a channel."""
    return _shown(columns[:, channel])


def _add(parts: list[list[Array]], columns: Array, channels: Sequence[int]) -> None:
    """Columns (blocks, 6, p) to those of each channel."""
    for own, channel in zip(parts, channels, strict=True):
        own.append(_of_channel(columns, channel))
