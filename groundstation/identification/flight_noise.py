"""The noise of one flight's outputs: a colour for each channel that a fit uses, and the whitening of what the colour
leaves.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.noise import (
    NoiseModel,
    Passing,
    fit_noise_model,
    whitening_polynomial,
)
from groundstation.identification.record_model import RecordModel

Array = NDArray[np.float64]

PLAIN: Array = np.array([1.0])
"""The autoregression that changes nothing."""


@dataclass(frozen=True, slots=True)
class Columns:
    """Columns of which those that are zero all along are not held.

    Attributes:
        shown: the numbers of those that are. values: those, (n, shown).
    """

    shown: NDArray[np.intp]
    values: Array

    @property
    def pairs(self) -> tuple[NDArray[np.intp], ...]:
        """Where products of the columns stand among those of all."""
        return np.ix_(self.shown, self.shown)

    def held(self) -> Columns:
        """Without those that turned out to be zero."""
        some = np.any(self.values != 0.0, axis=0)
        return Columns(self.shown[some], self.values[:, some])

    def of(self, shown: NDArray[np.intp]) -> Array:
        """The columns of these numbers, zeros where one is not held, (n, len(shown))."""
        if np.array_equal(shown, self.shown):
            return self.values
        out = np.zeros((len(self.values), len(shown)))
        out[:, np.searchsorted(shown, self.shown)] = self.values
        return out


@dataclass(frozen=True, slots=True)
class Whitened:
    """Normalised innovations by channel: of the residual (n,) and of the sensitivities.

    Attributes:
        log_deviation: half the sum of the logarithms of the innovations' variances, a part of the cost.
    """

    residual: tuple[Array, ...]
    sensitivity: tuple[Columns, ...]
    log_deviation: float


@dataclass(frozen=True, slots=True)
class WhitenedParts:
    """Whitens a flight part by part, from its beginning to its end."""

    model: RecordModel
    channels: tuple[int, ...]
    filters: tuple[Passing, ...]

    def __call__(self, blocks: slice, residual: Array, sensitivity: Array) -> Whitened:
        """The next part's residuals (n, 6) and sensitivities (n, 6, P) as innovations of unit variance."""
        steps = self.model.dt[blocks], self.model.restart[blocks]
        whole = len(residual) == len(self.model.dt)
        ys: list[Array] = []
        xs: list[Columns] = []
        logs = 0.0
        for channel, passed in zip(self.channels, self.filters, strict=True):
            rows = sensitivity[:, channel, :].T
            ends = np.any(rows[:, -1:], axis=1).tolist()  # few rows that are not zero all along end in a zero
            shown = np.array([n for n, row in enumerate(rows) if not whole or ends[n] or row.any()], dtype=np.intp)
            white, deviation = passed(residual[:, channel].copy()[None, :], steps, rows, shown)
            ys.append(white[:, 0].copy())
            xs.append(Columns(shown, white[:, 1:]))
            logs += deviation
        return Whitened(tuple(ys), tuple(xs), logs)


@dataclass(frozen=True, slots=True)
class FlightNoise:
    """Noise model of one flight, an entry for each channel.

    Attributes:
        channels: outputs in use. colours: their disturbance and sensor noise.
        whiteners: coefficients of the autoregression that whitens the rest.
    """

    channels: tuple[int, ...]
    colours: tuple[NoiseModel, ...]
    whiteners: tuple[Array, ...]

    def passing(self, model: RecordModel) -> WhitenedParts:
        """The filters of all channels, for a residual and columns of sensitivities."""
        return WhitenedParts(model, self.channels, tuple(self._filters(model)))

    def _filters(self, model: RecordModel) -> Iterator[Passing]:
        steps, whole = (model.dt, model.restart), len(model.parts()) == 1
        for channel, colour, rest in zip(self.channels, self.colours, self.whiteners, strict=True):
            gains = model.gains.of(colour, steps, integrated=channel < 3) if whole else None
            yield Passing(colour, rest, integrated=channel < 3, gains=gains)

    def whitened_residual(self, model: RecordModel, residual: Array) -> Whitened:
        """Residuals (blocks, 6) as innovations of unit variance."""
        return self.passing(model)(slice(0, len(residual)), residual, np.zeros((*residual.shape, 0)))

    def whitened_residuals(self, model: RecordModel, residuals: Array) -> tuple[tuple[Array, ...], float]:
        """Several residuals (trials, blocks, 6) at once: by channel (blocks, trials), and the logarithms."""
        whites, logs = list[Array](), 0.0
        for channel, passed in zip(self.channels, self._filters(model), strict=True):
            white, half = passed(residuals[:, :, channel].copy(), (model.dt, model.restart))
            whites.append(white)
            logs += half
        return tuple(whites), logs


def fitted_noise(
    model: RecordModel,
    residual: Array,
    channels: Sequence[int],
    start: Sequence[NoiseModel] | None = None,
    autoregression: int = 0,
) -> FlightNoise:
    """Noise model of a residual: each channel's colour, and the autoregression for what the colour leaves.

    Args:
        residual: (blocks, 6).
        start: colour of each channel to begin from.
        autoregression: its order; 0 leaves it out.
    """
    colours = tuple(
        fit_noise_model(residual[:, c], model.dt, model.restart, integrated=c < 3, start=colour)
        for c, colour in zip(channels, start or [None] * len(channels), strict=True)
    )
    coloured = FlightNoise(tuple(channels), colours, (PLAIN,) * len(colours))
    if not autoregression:
        return coloured
    left = coloured.whitened_residual(model, residual).residual
    whiteners = tuple(whitening_polynomial(y, model.restart, autoregression) for y in left)
    return FlightNoise(coloured.channels, colours, whiteners)


def per_flight(
    colours: Sequence[NoiseModel], whiteners: Sequence[Array], channels: Sequence[Sequence[int]]
) -> list[FlightNoise]:
    """Noise models of several flights, whose channels stand in one row."""
    out: list[FlightNoise] = []
    first = 0
    for chosen in channels:
        part = slice(first, first + len(chosen))
        out.append(FlightNoise(tuple(chosen), tuple(colours[part]), tuple(whiteners[part])))
        first += len(chosen)
    return out
