"""The noise of one flight's outputs: a colour for each channel that a fit uses, and the whitening of what the colour
leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
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
class Whitened:
    """Normalised innovations by channel: of the residual (n,) and of the sensitivities (n, P).

    Attributes:
        log_deviation: half the sum of the logarithms of the innovations' variances, a part of the cost.
    """

    residual: tuple[Array, ...]
    sensitivity: tuple[Array, ...]
    log_deviation: float


@dataclass(frozen=True, slots=True)
class WhitenedParts:
    """Whitens a flight part by part, from its beginning to its end."""

    model: RecordModel
    channels: tuple[int, ...]
    filters: tuple[Passing, ...]

    def __call__(self, blocks: slice, residual: Array, sensitivity: Array) -> Whitened:
        """The next part's residuals (n, 6) and sensitivities (n, 6, P) as innovations of unit variance."""
        dt, restart = self.model.dt[blocks], self.model.restart[blocks]
        ys: list[Array] = []
        xs: list[Array] = []
        logs = 0.0
        for channel, passed in zip(self.channels, self.filters, strict=True):
            both = np.concatenate([residual[:, channel : channel + 1], sensitivity[:, channel, :]], axis=1)
            e, deviation = passed(both, dt, restart)
            ys.append(e[:, 0])
            xs.append(e[:, 1:])
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

    def passing(self, model: RecordModel, columns: int) -> WhitenedParts:
        """The filters of all channels, for a residual and as many columns of sensitivities."""
        kinds = zip(self.channels, self.colours, self.whiteners, strict=True)
        filters = tuple(Passing(colour, rest, 1 + columns, integrated=c < 3) for c, colour, rest in kinds)
        return WhitenedParts(model, self.channels, filters)

    def whitened_residual(self, model: RecordModel, residual: Array) -> Whitened:
        """Residuals (blocks, 6) as innovations of unit variance."""
        return self.passing(model, 0)(slice(0, len(residual)), residual, np.zeros((*residual.shape, 0)))


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
