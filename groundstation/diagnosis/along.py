"""Joint estimates of functions of the signals as a torque or a force of each channel, beside what was chosen.

A function of time is whitened once for each channel that it may show in. What it would be as the torque or force of any
channel, and the products of that, are sums of these parts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.columns import Candidate, Columns
from groundstation.diagnosis.course import Part
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.flight_evidence import FlightEvidence
from groundstation.diagnosis.joint import Products, estimated
from groundstation.diagnosis.whitening import of_size_one
from groundstation.model.signals import Signals

Array = NDArray[np.float64]
Function = Callable[[Signals], Array]


@dataclass(frozen=True, slots=True)
class Along:
    """Functions of the signals as a torque or force of one channel.

    Attributes:
        values, covariance: of their p coefficients in the joint estimate.
        energy: how that of each one's instrument lies over channels and bands, (bands, p).
    """

    values: Array
    covariance: Array
    energy: Array

    def wald(self) -> float:
        """theta^T cov^-1 theta."""
        try:
            return float(self.values @ np.linalg.solve(self.covariance, self.values))
        except np.linalg.LinAlgError:  # columns of which the flight holds nothing: their directions say nothing
            return float(self.values @ np.linalg.pinv(self.covariance, hermitian=True) @ self.values)


class Beside:
    """What functions of the signals are estimated together with."""

    def __init__(self, evidence: Evidence, chosen: Sequence[tuple[Candidate, Columns]]):
        self._evidence, self._before = evidence, evidence.products(chosen)
        members = [evidence.base, *(columns for _, columns in chosen)]
        self._beside = [columns.instrument for columns in members] + [columns.sensitivity for columns in members]

    def _left(self, rows: slice) -> Array:
        """Weighted instruments, sensitivities and output of some rows, (beside, rows)."""
        y = self._evidence.y[rows, None]
        left = np.concatenate([*(columns[rows] for columns in self._beside), y], axis=1)
        return np.ascontiguousarray((left * self._evidence.weight[rows, None]).T)

    def along(
        self,
        function: Function,
        channels: Sequence[int],
        prior: Callable[[int], float],
        *,
        pointwise: bool = True,
    ) -> dict[int, Along]:
        """Functions (k, p) of the signals in each of some channels; empty where one is unknown.

        Args:
            prior: precision of each coefficient in a channel.
            pointwise: they follow from the signals at an instant and its neighbours, so that a long flight may be gone
                through in parts.
        """
        found = self._parts(function, pointwise)
        if found is None or not channels:
            return {}
        shares, crossed, squares, energy = found
        taken: Array = shares[:, list(channels)].T
        count, place = squares.shape[-1] // 2, len(self._before.zy)
        together = self._with(np.tensordot(taken, crossed, 1), np.tensordot(taken * taken, squares, 1))
        precision = np.zeros((len(channels), place + count, place + count))
        for number, channel in enumerate(channels):
            precision[number, range(place, place + count), range(place, place + count)] = prior(channel)
        theta, covariance = estimated(together.with_prior(precision))
        return {
            channel: Along(theta[n, place:], covariance[n, place:, place:], self._spread(taken[n], energy))
            for n, channel in enumerate(channels)
        }

    def _parts(self, function: Function, pointwise: bool) -> tuple[Array, Array, Array, list[Array]] | None:
        """Of each channel of each flight: its share in a torque or force of any channel, (parts, 6); products with what
        is beside, (parts, beside, 2 p), and with itself, (parts, 2 p, 2 p); energy of instruments by band.
        """
        shares: list[Array] = []
        crossed: list[Array] = []
        squares: list[Array] = []
        energy: list[Array] = []
        first = 0
        for number, flight in enumerate(self._evidence.flights):
            size = len(flight.y) // len(flight.channels)
            if number >= self._evidence.suspects:
                energy += [np.zeros((len(flight.whitening.bands), 1)) for _ in flight.channels]
                continue
            whitened = _whitened(flight, function, pointwise)
            if whitened is None:
                return None
            for channel, (white, spread) in zip(flight.channels, whitened, strict=True):
                rows = slice(first, first + size)
                first += size
                shares.append(flight.shares_of(channel))
                crossed.append(self._left(rows) @ white)
                squares.append((white * self._evidence.weight[rows, None]).T @ white)
                energy.append(spread[:, white.shape[1] // 2 :])
        return np.array(shares), np.array(crossed), np.array(squares), energy

    def _with(self, crossed: Array, squares: Array) -> Products:
        """The products of what is beside and of functions in many channels; ``crossed`` (many, rows beside, 2 p) and
        ``squares`` (many, 2 p, 2 p) of sensitivities, then instruments.
        """
        before, place, count = self._before, len(self._before.zy), squares.shape[1] // 2
        x, z = slice(0, count), slice(count, 2 * count)
        instruments, sensitivities, output = crossed[:, :place], crossed[:, place : 2 * place], crossed[:, -1]
        zx, zz, xx = np.empty((3, len(crossed), place + count, place + count))
        zx[:, :place, :place], zz[:, :place, :place], xx[:, :place, :place] = before.zx, before.zz, before.xx
        zx[:, :place, place:], zx[:, place:, :place] = instruments[:, :, x], sensitivities[:, :, z].transpose(0, 2, 1)
        zz[:, :place, place:], zz[:, place:, :place] = instruments[:, :, z], instruments[:, :, z].transpose(0, 2, 1)
        xx[:, :place, place:], xx[:, place:, :place] = sensitivities[:, :, x], sensitivities[:, :, x].transpose(0, 2, 1)
        zx[:, place:, place:], zz[:, place:, place:], xx[:, place:, place:] = (
            squares[:, z, x],
            squares[:, z, z],
            squares[:, x, x],
        )
        zy, xy = np.empty((2, len(crossed), place + count))
        zy[:, :place], xy[:, :place], zy[:, place:], xy[:, place:] = before.zy, before.xy, output[:, z], output[:, x]
        return Products(zx, zz, xx, zy, xy, before.rows)

    def _spread(self, share: Array, energy: Sequence[Array]) -> Array:
        """Energies of the parts put together by their shares in one channel, (bands, p), of size one on each flight."""
        first, part, out = 0, 0, list[Array]()
        count = energy[0].shape[1]
        for number, flight in enumerate(self._evidence.flights):
            own = energy[first : first + len(flight.channels)]
            first += len(flight.channels)
            if number >= self._evidence.suspects:
                out += [np.zeros((len(each), count)) for each in own]
                continue
            scaled = [share[part + n] ** 2 * each for n, each in enumerate(own)]
            part += len(own)
            out.append(of_size_one(np.concatenate(scaled)))
        return np.concatenate(out)


def _whitened(flight: FlightEvidence, function: Function, pointwise: bool) -> list[tuple[Array, Array]] | None:
    """Functions along the measured, then the planned motion, whitened as each channel of a flight would show them, and
    their energies by band; None where one is unknown.
    """
    finite = True

    def both(part: Part) -> Array:
        nonlocal finite
        basis = function(part.signals)
        found = np.concatenate([basis, basis if part.planned is None else function(part.planned)], axis=1)
        finite = finite and bool(np.isfinite(found).all())
        return found

    turning, pushing = flight.course.sums(both, None if pointwise else [flight.course.whole])
    if not finite:
        return None
    pushing /= flight.parameters.mass_kg
    return [flight.whitening.channel(n, turning if c < 3 else pushing) for n, c in enumerate(flight.channels)]
