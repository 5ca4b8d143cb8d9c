"""The noise of one flight's outputs: a colour for each channel that a fit uses, and the whitening of what the colour
leaves.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.innovation_kernel import filtered, filtered_one
from groundstation.identification.noise import (
    NoiseModel,
    apply_polynomial,
    fit_noise_model,
    gains_of,
    whitening_polynomial,
)
from groundstation.identification.record_model import RecordModel

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_Filter = tuple[Array, Array, float]
"""Gains (blocks, 5), deviations of innovations (blocks,), half the sum of their variances' logarithms."""

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
class FlightNoise:
    """Noise model of one flight, an entry for each channel.

    Attributes:
        channels: outputs in use. colours: their disturbance and sensor noise.
        whiteners: coefficients of the autoregression that whitens the rest.
    """

    channels: tuple[int, ...]
    colours: tuple[NoiseModel, ...]
    whiteners: tuple[Array, ...]
    _filters: list[tuple[Array, Mask, list[_Filter]]] = field(
        default_factory=list[tuple[Array, Mask, list[_Filter]]], init=False, repr=False, compare=False
    )

    def whitened(self, model: RecordModel, residual: Array, sensitivity: Array) -> Whitened:
        """Residuals (blocks, 6) and sensitivities (blocks, 6, P) as innovations of unit variance."""
        parts = list(self.by_channel(model, residual, sensitivity))
        return Whitened(tuple(y for y, _ in parts), tuple(x for _, x in parts), self.log_deviation(model))

    def by_channel(self, model: RecordModel, residual: Array, sensitivity: Array) -> Iterator[tuple[Array, Array]]:
        """The same, one channel after the other: residual (blocks,) and sensitivities (blocks, P)."""
        filters, ys = self._filters_of(model), self.residuals(model, residual)
        for channel, polynomial, (gains, unit, _), y in zip(self.channels, self.whiteners, filters, ys, strict=True):
            x = filtered(sensitivity[:, channel, :], gains, unit, np.zeros((2, sensitivity.shape[2])))
            yield y, apply_polynomial(polynomial, x)

    def residuals(self, model: RecordModel, residual: Array) -> Iterator[Array]:
        """Of the residual (blocks, 6) alone, channel by channel, (blocks,)."""
        for channel, polynomial, (gains, unit, _) in zip(
            self.channels, self.whiteners, self._filters_of(model), strict=True
        ):
            y = filtered_one(residual[:, channel], gains, unit)
            yield apply_polynomial(polynomial, y[:, None])[:, 0]

    def log_deviation(self, model: RecordModel) -> float:
        """Half the sum of the logarithms of the innovations' variances."""
        return sum(log for _, _, log in self._filters_of(model))

    def _filters_of(self, model: RecordModel) -> list[_Filter]:
        """The filter of each channel; those of the last record are kept."""
        if not self._filters or self._filters[0][0] is not model.dt or self._filters[0][1] is not model.restart:
            found: list[_Filter] = []
            for channel, colour in zip(self.channels, self.colours, strict=True):
                gains, variance = gains_of(model.dt, model.restart, colour, integrated=channel < 3)
                known = variance[np.isfinite(variance)]
                found.append((gains, np.sqrt(variance), 0.5 * float(np.sum(np.log(known)))))
            self._filters[:] = [(model.dt, model.restart, found)]
        return self._filters[0][2]


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
    left = coloured.residuals(model, residual)
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
