"""The task of an optimised plan, and how its unknowns become a trajectory that starts and ends at rest."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from groundstation.planning.information import DEFAULT_NOISE, Noise
from groundstation.planning.limits import Envelope
from groundstation.trajectory import FourierSeries
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

FLAT_INPUTS = 18
"""Position, velocity, acceleration, jerk, snap (three each), yaw and its first two derivatives."""


@lru_cache(maxsize=32)
def rest_basis(harmonics: int, without_jerk: bool) -> Array:
    """Coefficients [a, b] of one channel from its free unknowns, orthonormal columns, shape (2 N, free)."""
    harmonic, none = np.arange(1, harmonics + 1), np.zeros(harmonics)
    conditions = [np.concatenate([harmonic**0, none]), np.concatenate([none, harmonic])]
    if without_jerk:
        conditions.append(np.concatenate([harmonic**2, none]))
    basis = np.linalg.svd(np.array(conditions, dtype=float))[2][len(conditions) :].T
    basis.setflags(write=False)
    return basis


@dataclass(frozen=True, slots=True)
class Problem:
    """What to optimise.

    Attributes:
        vehicles: candidates for the vehicle; the worst case counts.
        envelopes: limits of each.
        criterion: one of ``criteria.CRITERIA``.
        harmonics: N of eq. (18), at least 2 (one harmonic cannot start and end at rest).
        base_frequency_rad_s: w_f.
        duration_s: of the whole flight, for the information.
        start: x, y, z, yaw at both ends, or None where the optimiser may choose.
        noise: what disturbs the flight.
        effects: whose parameters are estimated with mass and inertia (not for "condition").
    """

    vehicles: tuple[Vehicle, ...]
    envelopes: tuple[Envelope, ...]
    criterion: str
    harmonics: int
    base_frequency_rad_s: float
    duration_s: float
    start: tuple[float, float, float, float] | None = None
    noise: Noise = DEFAULT_NOISE
    effects: tuple[str, ...] = ()

    @property
    def room(self) -> tuple[tuple[float, float], ...]:
        """Range of x, y, z and yaw that every vehicle may use."""
        ranges: list[tuple[float, float]] = []
        for channel, name in enumerate(("x_max_m", "y_max_m", "z_max_m", "yaw_max_rad")):
            low, high = -np.inf, np.inf
            for envelope in self.envelopes:
                upper = getattr(envelope.limits, name)
                lower = envelope.limits.z_min_m if channel == 2 else (None if upper is None else -upper)
                high = high if upper is None else min(high, upper)
                low = low if lower is None else max(low, lower)
            ranges.append((low, high))
        return tuple(ranges)

    @property
    def bases(self) -> tuple[Array, ...]:
        """For each channel, coefficients [a, b] from its free unknowns, shape (2 N, free), orthonormal columns.

        A channel that starts on the edge of the room cannot have jerk there either: to third order the motion would
        leave the room just before or just after.
        """
        edges = zip(self.start or (), self.room, strict=False)
        touching = [not low < at < high for at, (low, high) in edges] or [False] * 4
        bases = [rest_basis(self.harmonics, on_edge) for on_edge in touching]
        if any(vehicle.turns_freely() for vehicle in self.vehicles):
            bases[3] = bases[3][:, :0]  # nobody steers yaw: it stays where it is
        return tuple(bases)

    @property
    def unknowns(self) -> int:
        """Number of unknowns: coefficients, and the start where it is free."""
        return sum(basis.shape[1] for basis in self.bases) + (4 if self.start is None else 0)

    def series(self, unknowns: Array) -> FourierSeries:
        """One period of the trajectory that the unknowns stand for."""
        bases, count = self.bases, self.harmonics
        edges = np.cumsum([basis.shape[1] for basis in bases])
        pieces = np.split(unknowns[: edges[-1]], edges[:-1])
        coefficients = np.stack([basis @ piece for basis, piece in zip(bases, pieces, strict=True)])
        a, b = coefficients[:, :count], coefficients[:, count:]
        below = (b / (self.base_frequency_rad_s * np.arange(1, count + 1))).sum(axis=1)
        start = unknowns[edges[-1] :] if self.start is None else np.array(self.start)
        return FourierSeries(a, b, start + below, self.base_frequency_rad_s)

    def unknowns_of(self, series: FourierSeries) -> Array:
        """Unknowns of the trajectory nearest to a given one with the same harmonics and base frequency."""
        coefficients = np.hstack([series.a, series.b])
        parts = [basis.T @ row for basis, row in zip(self.bases, coefficients, strict=True)]
        if self.start is None:
            parts.append(series.derivatives(0.0, 0)[0, 0])
        return np.concatenate(parts)

    def flat_basis(self, phase: Array) -> tuple[Array, Array]:
        """Flat samples at phases of the base frequency: (B, c) with u = B x + c, shapes (18, k, unknowns) and (18,
        1).
        """
        count, frequency, bases = self.harmonics, self.base_frequency_rad_s, self.bases
        edges = np.concatenate([[0], np.cumsum([basis.shape[1] for basis in bases])])
        matrix, constant = np.zeros((FLAT_INPUTS, len(phase), self.unknowns)), np.zeros((FLAT_INPUTS, 1))
        harmonic = frequency * np.arange(1, count + 1)
        wave = np.exp(1j * np.outer(phase, np.arange(1, count + 1)))
        for channel, basis in enumerate(bases):
            rows = range(channel, 15, 3) if channel < 3 else range(15, 18)
            for order, row in enumerate(rows):
                turn = (1j * harmonic) ** order / harmonic * wave
                if order == 0:
                    turn = turn - 1.0 / harmonic
                coefficients = np.hstack([np.real(-1j * turn), np.real(-turn)])
                matrix[row, :, edges[channel] : edges[channel + 1]] = coefficients @ basis
            if self.start is None:
                matrix[rows[0], :, edges[4] + channel] = 1.0
            else:
                constant[rows[0]] = self.start[channel]
        return matrix, constant
