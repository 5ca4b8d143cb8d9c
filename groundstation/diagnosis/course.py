"""A flight from its beginning to its end, part by part: what forces along it add to its rates and specific forces.

Of a long flight nothing is held of every sample but the signals: wrenches are made of one part after another, and
running integrals go on from part to part. A flight of a minute is one part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.columns import Candidate
from groundstation.diagnosis.effect import Effect, Followed, Settings
from groundstation.identification.record_model import RecordModel
from groundstation.model.parameters import Parameters
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

NEIGHBOURS = 2
"""Samples before a part that its differences are made of."""


@dataclass(frozen=True, slots=True)
class Wrenches:
    """What makes wrenches (k, 6, p) from signals and planned signals; ``pointwise`` of any part of a flight."""

    made: Followed
    pointwise: bool


@dataclass(frozen=True, slots=True)
class Moved:
    """Rates and specific forces (blocks, 6, p) that each of some wrenches adds, and the RMS of the first, (6, p)."""

    columns: list[Array]
    rms: Array


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a flight: of so many of its first blocks the part before has the numbers.

    Attributes:
        samples: of the flight. share: weight of each sample in a mean over the flight, zero where another part has it.
    """

    model: RecordModel
    samples: slice
    signals: Signals
    planned: Signals | None
    share: Array
    overlap: int


class Course:
    """Of one flight.

    Args:
        model: its record. signals: along it, and as the plan made them where there is one.
        parameters: mass and tensor that wrenches act on.
    """

    def __init__(self, model: RecordModel, signals: Signals, planned: Signals | None, parameters: Parameters):
        self.model, self.signals, self.planned = copy(model), signals, planned
        self.model.planned = None  # a part of it would be made with each part of the flight
        self.vehicle: Vehicle = model.record.vehicle
        self.inverse = np.linalg.inv(parameters.tensor)
        self.mass_kg = parameters.mass_kg
        self._share = model.record.keep / np.sum(model.record.keep)

    @property
    def whole(self) -> Part:
        """The flight as one part."""
        return Part(self.model, slice(0, len(self.signals.t_s)), self.signals, self.planned, self._share, 0)

    @cached_property
    def divided(self) -> bool:
        """Whether it is more than one part."""
        return len(self.model.parts()) > 1

    def parts(self) -> Iterator[Part]:
        """One after the other, each with the last block of the one before."""
        if not self.divided:
            yield self.whole
            return
        done = 0
        for blocks in self.model.parts():
            overlap = 1 if blocks.start else 0
            model = self.model.part(slice(blocks.start - overlap, blocks.stop), NEIGHBOURS * self.model.sample_s)
            share = self._share[model.samples].copy()
            share[: max(done - model.samples.start, 0)] = 0.0
            done = model.samples.stop
            planned = None if self.planned is None else self.planned.at(model.samples)
            yield Part(model, model.samples, self.signals.at(model.samples), planned, share, overlap)

    def sums(self, made: Callable[[Part], Array], parts: Iterable[Part] | None = None) -> tuple[Array, Array]:
        """Block means of the running integral of functions of a part's signals (k, m), and of themselves,
        (blocks, m); parts are :meth:`parts` where none are given.
        """
        integrals, means = list[Array](), list[Array]()
        for part in self.parts() if parts is None else parts:
            values = made(part)
            integral, mean = part.model.integrated(values), part.model.average(values)
            if part.overlap:
                integral += integrals[-1][-1] - integral[0]
            integrals.append(integral[part.overlap :])
            means.append(mean[part.overlap :])
        return joined(integrals), joined(means)

    def moved(self, many: Sequence[Wrenches]) -> list[Moved | None]:
        """What each of many adds, all of them a part at a time; None where one's signals are unknown."""
        return [None if growing is None else growing.moved() for growing in self._grown(many, steps=False)]

    def by_channel(self, many: Sequence[Wrenches]) -> list[ByChannel]:
        """What each of many adds whose signals are known, for as little memory as may be."""
        grown = self._grown(many, steps=self.divided)
        return [columns for growing in grown if growing is not None for columns in growing.by_channel()]

    def _grown(self, many: Sequence[Wrenches], *, steps: bool) -> list[_Growing | None]:
        found: list[_Growing | None] = [_Growing(steps=steps) for _ in many]
        for pointwise, parts in ((True, self.parts), (False, lambda: iter([self.whole]))):
            if not any(each.pointwise == pointwise for each in many):
                continue
            for part in parts():
                for number, (wrenches, growing) in enumerate(zip(many, found, strict=True)):
                    if growing is None or wrenches.pointwise != pointwise:
                        continue
                    if not growing.grow(self, part, wrenches.made(part.signals, part.planned)):
                        found[number] = None
        return found

    def predicted(self, wrench: Array, model: RecordModel | None = None) -> Array:
        """Rates and specific forces (blocks, 6, p) that a body wrench (k, 6, p) adds to a flight or a part of it."""
        out = (model or self.model).of_wrench(wrench)
        out[:, :3] = self.inverse @ out[:, :3]
        out[:, 3:] /= self.mass_kg
        return out

    def wrenches_of(self, candidate: Candidate) -> Wrenches:
        """What a candidate adds per unit of its parameters; with a plan, its instrument, too."""
        vehicle, effect, settings = self.vehicle, candidate.effect, candidate.settings
        if self.divided and effect.followed is not None:
            return Wrenches(effect.followed(self.signals, self.planned, vehicle, [settings], False), True)

        def wrenches(signals: Signals, planned: Signals | None) -> list[Array]:
            seen = effect.wrench(signals, vehicle, settings)
            if planned is None:
                return [seen]
            if effect.instrument is None:
                return [seen, effect.wrench(planned, vehicle, settings)]
            return [seen, effect.instrument(signals, planned, vehicle, settings)]

        return Wrenches(wrenches, effect.pointwise)

    def seen_wrench_of(self, candidate: Candidate) -> Wrenches:
        """What a candidate adds per unit of its parameters."""
        vehicle, effect, settings = self.vehicle, candidate.effect, candidate.settings
        if self.divided and effect.followed is not None:
            return Wrenches(effect.followed(self.signals, None, vehicle, [settings], False), True)
        return Wrenches(lambda now, _: [effect.wrench(now, vehicle, settings)], effect.pointwise)

    def unchanged_of(self, effect: Effect, several: Sequence[Settings]) -> list[Wrenches]:
        """What an effect adds in several settings, without the columns that change a setting."""
        if effect.followed is not None and several and (self.divided or effect.alone is not None):
            return [Wrenches(effect.followed(self.signals, None, self.vehicle, several, True), True)]

        def one(settings: Settings) -> Wrenches:
            return Wrenches(
                lambda now, _: [effect.of(settings).unchanged(now, self.vehicle, settings)], effect.pointwise
            )

        return [one(settings) for settings in several]


@dataclass(frozen=True, slots=True)
class ByChannel:
    """What some wrenches add, (blocks, 6, p), to be asked for channel by channel.

    Of a flight in several parts in single precision: of rates what each block adds to the one before, since a running
    integral of an hour leaves too few digits for its steps.
    """

    pieces: Sequence[NDArray[np.floating[Any]]]
    steps: bool

    def of(self, channel: int) -> Array:
        """Those columns (blocks, m) that show in a channel."""
        columns = joined([np.asarray(piece[:, channel], dtype=float) for piece in self.pieces])
        columns = columns[:, np.any(columns != 0.0, axis=0)]
        return np.cumsum(columns, axis=0) if self.steps and channel < 3 else columns


class _Growing:
    """What some wrenches add, as far as the flight has been gone through; ``steps`` as in :class:`ByChannel`."""

    def __init__(self, *, steps: bool = False) -> None:
        self._pieces, self._squares, self._steps = list[list[NDArray[np.floating[Any]]]](), np.zeros(0), steps
        self._last: list[Array] = []

    def grow(self, course: Course, part: Part, wrenches: Sequence[Array]) -> bool:
        """By the next part; False where a signal is unknown."""
        if not all(np.isfinite(wrench.sum()) for wrench in wrenches):  # nothing adds up to one without numbers
            return False
        flat = wrenches[0].reshape(len(wrenches[0]), -1)
        squares = np.einsum("k,kj,kj->j", part.share, flat, flat)
        self._squares = self._squares + squares if len(self._squares) else squares
        found = [course.predicted(wrench, part.model) for wrench in wrenches]
        if part.overlap:
            for now, before in zip(found, self._last, strict=True):
                now[:, :3] += before - now[0, :3]
        last = [each[-1, :3].copy() for each in found]
        if self._steps:
            before = self._last or [np.zeros_like(each) for each in last]
            self._pieces.append([_steps_of(n, b)[part.overlap :] for n, b in zip(found, before, strict=True)])
        else:
            self._pieces.append([each[part.overlap :] for each in found])
        self._last = last
        return True

    def moved(self) -> Moved:
        """Of the whole flight."""
        columns = [joined(list(each)) for each in zip(*self._pieces, strict=True)]
        return Moved(columns, np.sqrt(self._squares).reshape(6, -1))

    def by_channel(self) -> list[ByChannel]:
        """Of the whole flight."""
        return [ByChannel(each, self._steps) for each in zip(*self._pieces, strict=True)]


def _steps_of(columns: Array, before: Array) -> NDArray[np.float32]:
    """Columns (blocks, 6, p) with what rates grow by in their place, from (3, p) before the first block."""
    out = columns.astype(np.float32)
    out[1:, :3] = np.diff(columns[:, :3], axis=0)
    out[0, :3] = columns[0, :3] - before
    return out


def joined(parts: Sequence[Array]) -> Array:
    """One after the other."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
