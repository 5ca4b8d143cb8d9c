"""One flight whitened about a base fit: its residual, the base's columns and instruments, and those of any
candidate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
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
from groundstation.model.signals import Signals

Array = NDArray[np.float64]

SAMPLES_AT_ONCE = 2**22
"""Of functions of time that are worked out side by side: 32 MB."""
WRENCH_ROW = {0: 3, 1: 4, 2: 5, 3: 0, 4: 1, 5: 2}
"""Of each channel, where its force or torque stands in a wrench."""


NEIGHBOURS = 2
"""Samples before a part that its differences are made of."""
EXCITED_MOST = 262144
"""Samples by whose spread the settings of effects are chosen: four minutes at 1 kHz."""

Wrenches = Callable[[Signals, Signals | None], list[Array]]
"""From signals and planned signals to wrenches, (k, 6, p) each."""


@dataclass(frozen=True, slots=True)
class _Part:
    """A part of a flight: of so many of its first blocks the part before has the numbers."""

    model: RecordModel
    signals: Signals
    planned: Signals | None
    share: Array
    overlap: int


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
        self.excited = self.signals.at(_some(record.keep))
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

    def against_all(self, known: Sequence[Candidate]) -> FlightEvidence:
        """The same with a noise of all that the base and these candidates leave."""
        return FlightEvidence(self.prepared, self._fitted, self._given, known, generic=False)

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
        known = [self.moved_by(candidate) for candidate in (*self.known, *self.sudden)]
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
        signals, mass = self.signals, self.parameters.mass_kg
        length, known = float(signals.t_s[-1] - signals.t_s[0]), np.isfinite(signals.thrust_n).all()
        knots = np.linspace(0.0, length, int(np.clip(length / THRESHOLDS.drift_knot_s, 3, 16)) + 1)

        def beside(own: Callable[[Signals], Array]) -> Callable[[Signals], Array]:
            def columns(now: Signals) -> Array:
                elapsed = now.t_s - signals.t_s[0]
                hats: list[Array] = [np.interp(elapsed, knots, peak) for peak in np.eye(len(knots))]
                drift, shown = np.column_stack(hats), own(now)
                thrust: Array = now.thrust_n.sum(axis=1)[:, None]
                return np.concatenate([drift, shown, thrust] if known else [drift, shown], axis=1)

            return columns

        turned = [self._sums(beside(lambda now, i=axis: now.rate_rad_s[:, i : i + 1]))[0] for axis in range(3)]
        out: list[Array] = []
        for channel in self.channels:
            if channel < 3:
                columns = [self._inverse[channel, axis] * _finite(turned[axis]) for axis in range(3)]
                out.append(_shown(np.concatenate(columns, axis=1)))
            else:
                pushing = self._sums(beside(lambda now, i=channel - 3: now.velocity_body_m_s()[:, i : i + 1]))[1]
                out.append(_shown(_finite(pushing) / mass))
        return out

    @cached_property
    def _parts(self) -> list[_Part]:
        """The flight in parts, each with the last block of the one before."""
        found, done = list[_Part](), 0
        parts = self.model.parts()
        if len(parts) == 1:
            return [self._whole]
        for blocks in parts:
            overlap = 1 if found else 0
            model = self.model.part(slice(blocks.start - overlap, blocks.stop), NEIGHBOURS * self.model.sample_s)
            share = self._share[model.samples].copy()
            share[: max(done - model.samples.start, 0)] = 0.0
            done = model.samples.stop
            planned = None if self.planned is None else self.planned.at(model.samples)
            found.append(_Part(model, self.signals.at(model.samples), planned, share, overlap))
        return found

    @property
    def _whole(self) -> _Part:
        return _Part(self.model, self.signals, self.planned, self._share, 0)

    def _sums(self, made: Callable[[Signals], Array]) -> tuple[Array, Array]:
        """Block means of the running integral of functions of the signals (k, m), and of themselves, (blocks, m)."""
        integrals, means = list[Array](), list[Array]()
        for part in self._parts:
            values = made(part.signals)
            integral, mean = part.model.integrated(values), part.model.average(values)
            if part.overlap:
                integral += integrals[-1][-1] - integral[0]
            integrals.append(integral[part.overlap :])
            means.append(mean[part.overlap :])
        return joined(integrals), joined(means)

    def _moved_along(self, made: Wrenches, *, pointwise: bool) -> tuple[list[Array], Array] | None:
        """Rates and specific forces (blocks, 6, p) that each of some wrenches adds, and the RMS of the first, (6, p);
        None where a signal is unknown.
        """
        pieces, squares = list[list[Array]](), 0.0
        for part in self._parts if pointwise else [self._whole]:
            wrenches = made(part.signals, part.planned)
            if not all(np.isfinite(wrench.sum()) for wrench in wrenches):  # nothing adds up to one without numbers
                return None
            flat = wrenches[0].reshape(len(wrenches[0]), -1)
            squares = squares + np.einsum("k,kj,kj->j", part.share, flat, flat)
            found = [self.predicted(wrench, part.model) for wrench in wrenches]
            if part.overlap:
                for now, before in zip(found, pieces[-1], strict=True):
                    now[:, :3] += before[-1, :3] - now[0, :3]
            pieces.append([each[part.overlap :] for each in found])
        rms = np.sqrt(squares).reshape(6, -1)
        return [joined(list(each)) for each in zip(*pieces, strict=True)], rms

    def predicted(self, wrench: Array, model: RecordModel | None = None) -> Array:
        """Rates and specific forces (blocks, 6, p) that a body wrench (k, 6, p) adds to a flight or a part of it."""
        out = (model or self.model).of_wrench(wrench)
        out[:, :3] = self._inverse @ out[:, :3]
        out[:, 3:] /= self.parameters.mass_kg
        return out

    def _add_library(self, parts: list[list[Array]]) -> None:
        """Columns of the library's effects, in a few settings of each."""
        vehicle = self.prepared.record.vehicle
        for effect in library().values():
            settings = effect.variants(self.excited, vehicle) if effect.applies(vehicle) else ()
            for chosen in settings[:: max(1, len(settings) // THRESHOLDS.variants_in_noise)]:
                found = self._moved_along(
                    lambda now, _, e=effect, c=chosen: [e.unchanged(now, vehicle, c)], pointwise=effect.pointwise
                )
                if found is not None:
                    _add(parts, found[0][0], self.channels)

    def moved_by(self, candidate: Candidate) -> Array:
        """Rates and specific forces (blocks, 6, p) that a candidate adds per unit of its parameters; those asked for
        last are kept.
        """
        for known, moved in self._moved:
            if known is candidate:
                return moved
        vehicle, effect = self.prepared.record.vehicle, candidate.effect
        found = self._moved_along(
            lambda now, _: [effect.wrench(now, vehicle, candidate.settings)], pointwise=effect.pointwise
        )
        moved = np.full((len(self.model.t_s), 6, len(effect.parameters)), np.nan) if found is None else found[0][0]
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
            found = self._moved_along(self._wrenches_of(candidate), pointwise=candidate.effect.pointwise)
            known[index] = found is not None
            if found is not None:
                moved, rms[:, first : first + count] = found
                for start, columns in zip((first, total + first), moved, strict=False):
                    raw[:, :, start : start + count] = columns
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

    def _wrenches_of(self, candidate: Candidate) -> Wrenches:
        """What a candidate adds per unit of its parameters, (k, 6, p); with a plan, its instrument, too."""
        vehicle, effect, settings = self.prepared.record.vehicle, candidate.effect, candidate.settings

        def wrenches(signals: Signals, planned: Signals | None) -> list[Array]:
            seen = effect.wrench(signals, vehicle, settings)
            if planned is None:
                return [seen]
            if effect.instrument is None:
                return [seen, effect.wrench(planned, vehicle, settings)]
            return [seen, effect.instrument(signals, planned, vehicle, settings)]

        return wrenches

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


def _some(keep: NDArray[np.bool_]) -> NDArray[np.bool_] | NDArray[np.intp]:
    """Samples in use; of a long flight EXCITED_MOST of them, evenly."""
    count = int(np.count_nonzero(keep))
    return keep if count <= EXCITED_MOST else np.flatnonzero(keep)[:: -(-count // EXCITED_MOST)]


def joined(parts: Sequence[Array]) -> Array:
    """One after the other."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


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
