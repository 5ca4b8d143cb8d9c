"""The noise of a flight, channel by channel, and the filter that makes it white: what findings are judged against.

A first-order disturbance with sensor noise is fitted to each channel, then the rest of its colour is taken out band by
band. Both are estimated from what generic columns (drift, speeds, the library's effects) leave of the residual, with
what these take of the noise put back.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.identification.noise import (
    NoiseModel,
    early_noise_model,
    innovation_products,
    innovations,
    minus_log_likelihood,
)

Array = NDArray[np.float64]

COLUMNS_AT_ONCE = 16
"""Columns of a channel that are whitened at a time: what they need stays in the processor's cache."""
SEED = 0
"""Of the draws that put back the noise that generic columns take."""


class Whitening:
    """Whitens the channels of one flight.

    Args:
        channels: which of the six (torques as rates, forces as specific forces) are known.
        dt: time since the previous block, (blocks,). restart: True where a new segment begins, (blocks,).
        residual: (blocks, 6). nuisance: generic columns of one known channel after the other, (blocks, m) each.
    """

    def __init__(
        self,
        channels: Sequence[int],
        dt: Array,
        restart: NDArray[np.bool_],
        residual: Array,
        nuisance: Iterable[Array],
    ):
        self.channels = tuple(channels)
        self._dt, self._restart = dt, restart
        self.bands = bands_of(len(dt) // 2 + 1)
        self.colours, self._gains = list[NoiseModel](), np.ones((len(self.channels), len(dt) // 2 + 1))
        draws = [np.random.default_rng(SEED) for _ in range(2)]  # of colours and of gains, from channel to channel
        for number, (channel, columns) in enumerate(zip(self.channels, nuisance, strict=True)):
            self.colours.append(self._fitted_colour(residual[:, channel], columns, channel, draws[0]))
            self._gains[number] = self._fitted_gain(residual[:, channel], columns, number, draws[1])

    def apply(self, columns: Array) -> Array:
        """Stack the whitened channels of (blocks, 6, m) below each other, (channels * blocks, m)."""
        return self.applied(columns)[0]

    def applied(self, columns: Array) -> tuple[Array, Array]:
        """The same, and how the energy of each whitened column, taken to be of size one, lies over channels and bands,
        (channels * bands, m).
        """
        blocks, _, count = columns.shape
        white = np.zeros((len(self.channels) * blocks, count))
        energy = np.zeros((len(self.channels), len(self.bands), count))
        for number, channel in enumerate(self.channels):
            shown = np.flatnonzero(columns[:, channel].any(axis=0))
            for first in range(0, len(shown), COLUMNS_AT_ONCE):
                some = shown[first : first + COLUMNS_AT_ONCE]
                found = self.channel(number, columns[:, channel, some])
                white[number * blocks : (number + 1) * blocks, some], energy[number][:, some] = found
        return white, of_size_one(energy.reshape(len(self.channels) * len(self.bands), count))

    def channel(self, number: int, columns: Array) -> tuple[Array, Array]:
        """Whitened columns (blocks, m) of one channel, by its place among the known ones, and their energy by band,
        (bands, m).
        """
        colour, gain = self.colours[number], self._gains[number]
        e, s = innovations(columns, self._dt, self._restart, colour, integrated=self.channels[number] < 3)
        e /= np.sqrt(s)[:, None]  # zero where a level was only initialised
        spectrum = np.fft.rfft(e, axis=0) * gain[:, None]
        power = spectrum.real**2 + spectrum.imag**2
        return np.fft.irfft(spectrum, len(e), axis=0), np.add.reduceat(power, [b.start for b in self.bands], axis=0)

    def energy(self, columns: Array) -> Array:
        """That of whitened columns (rows, m), (channels * bands, m)."""
        power = np.abs(np.fft.rfft(columns.reshape(len(self.channels), -1, columns.shape[1]), axis=1)) ** 2
        by_band = np.add.reduceat(power, [band.start for band in self.bands], axis=1)
        return of_size_one(by_band.reshape(-1, columns.shape[1]))

    def freedom(self) -> Array:
        """Degrees of freedom by channel and band, (channels * bands,)."""
        return np.tile([2.0 * (band.stop - band.start) for band in self.bands], len(self.channels))

    def explained(self, columns: Array, basis: Array) -> Array:
        """What a basis tells of whitened columns, channel by channel, by least squares."""
        rows = len(self.channels)
        out = np.zeros_like(columns)
        for part, c, b in zip(*(a.reshape(rows, -1, a.shape[1]) for a in (out, columns, basis)), strict=True):
            q = orthonormal(b)
            part[:] = q @ (q.T @ c)
        return out

    def _fitted_colour(self, z: Array, columns: Array, channel: int, random: np.random.Generator) -> NoiseModel:
        """Noise of a channel from what generic columns leave of the residual.

        Whitened at first by a disturbance of 0.3 s, so that slow effects go into the columns and not into the noise, or
        by none to speak of, as where sensors are noisier than the air; the likelier goes on.
        """
        step = float(np.median(self._dt)) if channel < 3 else 1.0
        size = float(np.std(np.diff(z))) + 1e-9
        rough = size / step
        starts = (
            NoiseModel(rough, 0.3, 1e-3 * rough, 0.1 * size),
            NoiseModel(1e-2 * rough, 0.3, 1e-3 * rough, size / np.sqrt(2.0)),
        )
        tried = [self._recoloured(z, columns, start, channel) for start in starts]
        colour = min(tried, key=lambda item: item[1])[0]
        for _ in range(THRESHOLDS.noise_refills):
            colour = self._recoloured(z, columns, colour, channel, random)[0]
        return colour

    def _recoloured(
        self, z: Array, columns: Array, colour: NoiseModel, channel: int, random: np.random.Generator | None = None
    ) -> tuple[NoiseModel, float]:
        """Noise of what columns leave when they are fitted under a given noise, and half its minus-log-likelihood.

        With ``random`` what they take of the noise is put back (:func:`coefficients`), and the search starts from the
        given noise.
        """
        integrated = channel < 3
        products = innovation_products(z, columns, self._dt, self._restart, colour, integrated=integrated)
        left = z - columns @ coefficients(products[1:, 1:], products[1:, 0], random)
        start = None if random is None else colour
        found = early_noise_model(left, self._dt, self._restart, integrated=integrated, start=start)
        return found, minus_log_likelihood(left, self._dt, self._restart, found, integrated)

    def _fitted_gain(self, z: Array, columns: Array, number: int, random: np.random.Generator) -> Array:
        """What is left of a channel's colour behind its noise model: a filter (frequencies,) that whitens the rest.

        A disturbance need not be of first order. The periodogram of what generic columns leave, with what they took put
        back, is averaged over bands.
        """
        colour, integrated = self.colours[number], self.channels[number] < 3
        products = innovation_products(z, columns, self._dt, self._restart, colour, integrated=integrated)
        left = z - columns @ coefficients(products[1:, 1:], products[1:, 0], random)
        power = self.channel(number, left[:, None])[1][:, 0] / len(z)
        out = np.ones(self._gains.shape[1])
        for band, total in zip(self.bands, power, strict=True):
            out[band] = 1.0 / np.sqrt(total / (band.stop - band.start) + 1e-12)
        return out


def of_size_one(energy: Array) -> Array:
    """Energy by channel and band (rows, m) of columns of size one."""
    total = energy.sum(axis=0)
    return energy / np.where(total > 0.0, total, 1.0)


def bands_of(count: int) -> list[slice]:
    """Frequencies of a periodogram in bands, each an eighth of its own frequency wide, or ``band_bins``."""
    out, first = list[slice](), 0
    while first < count:
        last = first + max(THRESHOLDS.band_bins, first // 8)
        if count - last < THRESHOLDS.band_bins:
            last = count
        out.append(slice(first, last))
        first = last
    return out


def coefficients(gram: Array, cross: Array, random: np.random.Generator | None) -> Array:
    """Least-squares coefficients of whitened columns; with ``random`` a draw from their posterior instead of its mean.

    A fit of p columns takes p degrees of freedom out of the noise, nearly all of them at the low frequencies where they
    live. The draw puts as much back, so that a noise model fitted to what is left is right on average (data
    augmentation: Tanner and Wong 1987; its limit is restricted maximum likelihood, Patterson and Thompson 1971).

    Args:
        gram: products of the columns, (p, p); a column without innovations may be zero. cross: of the columns and y,
            which is of unit variance if the noise is right, (p,).
    """
    scale = np.sqrt(np.diag(gram))
    shown = scale > 1e-9 * scale.max(initial=1e-300)
    unit = scale[shown]
    values, vectors = np.linalg.eigh(gram[np.ix_(shown, shown)] / np.outer(unit, unit))
    kept = values > 1e-8 * values[-1]
    root = vectors[:, kept] / np.sqrt(values[kept])  # of the inverse information
    inside = root.T @ (cross[shown] / unit)
    if random is not None:
        inside = inside + random.standard_normal(len(inside))
    theta = np.zeros(len(gram))
    theta[shown] = root @ inside / unit
    return theta


def orthonormal(basis: Array) -> Array:
    """An orthonormal basis of what columns span."""
    return basis @ spanning(basis.T @ basis)


def spanning(gram: Array) -> Array:
    """What columns of these products (n, n) are to be multiplied by to become orthonormal, (n, r)."""
    size = np.sqrt(np.diag(gram))
    largest = float(size.max(initial=0.0))
    used = size > 1e-7 * max(largest, 1e-30)
    if not used.any() or largest < 1e-12:
        return np.zeros((len(gram), 0))
    values, vectors = np.linalg.eigh(gram[np.ix_(used, used)] / np.outer(size[used], size[used]))
    keep = values > 1e-6 * values[-1]
    out = np.zeros((len(gram), int(keep.sum())))
    out[used] = vectors[:, keep] / np.sqrt(values[keep]) / size[used, None]
    return out
