"""What the declaration checks compare: a flight's own signals on one grid and in one band, nothing fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise, permutations, product

import numpy as np
from numpy.typing import NDArray

from groundstation.flightdata import FlightData, Stream, resampled
from groundstation.identification.streams import clean, flown_stretches
from groundstation.identification.stretches import within
from groundstation.identification.wrench import voltage_ratio
from groundstation.linear_filters import band_pass, both_ways

Array = NDArray[np.float64]

STEP_S = 0.01
SHORTEST_S = 3.0
"""Of a stream that a check can go by: the slowest manoeuvre in its band, once."""
LONGEST_S = 300.0
"""Of a flight that the checks look at: five lively minutes show beyond doubt what they tell, axes, units and orders."""
BAND_HZ = (0.3, 8.0)
PARTS = 12


def signed_permutations() -> list[Array]:
    """The 48 ways to name and point three axes, the declared one first."""
    found: list[Array] = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            for row, (column, sign) in enumerate(zip(order, signs, strict=True)):
                matrix[row, column] = sign
            found.append(matrix)
    return found


def in_words(matrix: Array) -> str:
    """A signed permutation as (x, -y, -z)."""
    parts = [("-" if row[np.argmax(np.abs(row))] < 0 else "") + "xyz"[int(np.argmax(np.abs(row)))] for row in matrix]
    return f"({', '.join(parts)})"


def passed(values: Array, band_hz: tuple[float, float] = BAND_HZ) -> Array:
    """Columns in the band of manoeuvres, shape kept."""
    return both_ways(band_pass(2, band_hz, 1.0 / STEP_S), values)


def long_enough(stream: Stream | None) -> Stream | None:
    """A stream's good samples; None where they are too few or too short."""
    kept = None if stream is None or len(stream) < 100 else clean(stream)
    return kept if kept is not None and len(kept) >= 100 and kept.t_s[-1] - kept.t_s[0] >= SHORTEST_S else None


def similarity(first: Array, second: Array) -> float:
    """Correlation of all columns together, in [-1, 1]."""
    size = float(np.sqrt(np.sum(first**2) * np.sum(second**2)))
    return float(np.sum(first * second)) / size if size > 0.0 else 0.0


def similarities(inputs: Array, columns: Array, measured: Array) -> list[float]:
    """:func:`similarity` to what is measured of many linear functions of the same inputs, each column in units of its
    own size; the samples are gone through once for all of them.

    Args:
        inputs: (k, n). columns: of each function the outputs by the inputs, (m, n, d). measured: (k, d).
    """
    square = np.maximum(np.einsum("mnd,np,mpd->md", columns, inputs.T @ inputs, columns), 0.0)  # but for rounding
    mean = inputs.mean(axis=0) @ columns
    spread = np.sqrt(np.maximum(square / len(inputs) - mean**2, 0.0)) + 1e-12
    alike = np.sum(np.einsum("mnd,nd->md", columns, inputs.T @ measured) / spread, axis=1)
    size = np.sqrt(np.sum(square / spread**2, axis=1) * np.sum(measured**2))
    return np.divide(alike, size, out=np.zeros_like(alike), where=size > 0.0).tolist()


def correlations(first: Array, second: Array) -> Array:
    """Correlation of each column of the first with each of the second, (d, d)."""
    size = np.outer(np.std(first, axis=0), np.std(second, axis=0)) + 1e-12
    return (first - first.mean(axis=0)).T @ (second - second.mean(axis=0)) / len(first) / size


def alike(found: Array, matrix: Array) -> float:
    """Mean correlation of the columns under a naming of the first one's axes, so that an axis that moves little has a
    say.

    Args:
        found: of :func:`correlations`.
    """
    return float(np.sum(matrix * found.T)) / len(found)


def apart(better: Array, declared: Array, measured: Array) -> float:
    """Student's t over parts of equal motion of how much more alike ``better`` is to ``measured`` than ``declared``
    is.
    """
    moved = np.cumsum(np.sum(measured**2, axis=1))
    bounds = np.searchsorted(moved, float(moved[-1]) * np.arange(PARTS + 1) / PARTS)
    gain = [
        similarity(better[a:b], measured[a:b]) - similarity(declared[a:b], measured[a:b])
        for a, b in pairwise(bounds)
        if b - a > 10
    ]
    if len(gain) < 3:
        return 0.0
    return float(np.mean(gain) / (np.std(gain, ddof=1) / np.sqrt(len(gain)) + 1e-6))


@dataclass(frozen=True, slots=True)
class Flown:
    """The flying part of a flight on a grid of the motors' clock, which IMU and motors share.

    Attributes:
        t_s: (k,). used: in the air, (k,). rate, force: of the IMU, (k, 3); None without one.
        thrust: of each rotor by the declared constants, (k, n); None for a wrench.
        speed_m_s: half of the poses are faster; None without poses.
    """

    t_s: Array
    used: NDArray[np.bool_]
    rate: Array | None
    force: Array | None
    thrust: Array | None
    speed_m_s: float | None = None


def liveliest(flight: FlightData) -> FlightData:
    """The LONGEST_S of a flight in which it turns most; a shorter flight as it is."""
    source = flight.imu if flight.imu is not None and len(flight.imu) else flight.motors
    if len(source) < 2 or source.t_s[-1] - source.t_s[0] <= LONGEST_S:
        return flight
    second = np.clip(source.t_s - source.t_s[0], 0.0, None).astype(np.int64)
    turning = source.values[:, :3] - np.nanmedian(source.values[:, :3], axis=0)
    size = np.nan_to_num(np.sum(turning**2, axis=1))
    energy = np.concatenate([[0.0], np.cumsum(np.bincount(second, np.minimum(size, np.quantile(size, 0.99))))])
    whole = int(LONGEST_S)
    first = float(source.t_s[0]) + int(np.argmax(energy[whole:] - energy[:-whole]))
    cut = {name: _cut(stream, source, first) for name, stream in flight.streams().items()}
    window = flight.window_s
    if window is not None:
        late = _later(flight.motors, source)
        window = max(window[0], first + late), min(window[1], first + late + LONGEST_S)
        if window[1] - window[0] < SHORTEST_S:
            return flight
    return replace(flight, window_s=window, **cut)


def _later(stream: Stream, source: Stream) -> float:
    """A stream's clock less another's, by arrivals, or where stamps are of two times by where they begin."""
    from groundstation.identification.alignment import arrival_difference

    difference = arrival_difference(stream, source)
    if difference is not None:
        return difference
    apart = float(stream.t_s[0] - source.t_s[0])
    return 0.0 if abs(apart) < float(source.t_s[-1] - source.t_s[0]) else apart


def _cut(stream: Stream, source: Stream, first_s: float) -> Stream:
    """A stream's LONGEST_S from a time of the other's clock on."""
    if not len(stream):
        return stream
    begin = first_s + _later(stream, source)
    return stream.select(slice(*np.searchsorted(stream.t_s, (begin, begin + LONGEST_S)).tolist()))


def flown(flight: FlightData) -> Flown:
    """Signals of a flight; the clocks of IMU and motors are taken to agree but for their arrival times.

    Raises:
        NotIdentifiable: it did not fly.
    """
    from groundstation.identification.alignment import arrival_difference, one_clock

    motors = clean(flight.motors)
    stretches = flown_stretches(flight, 0.0)
    imu = long_enough(flight.imu)
    offset = 0.0
    if imu is not None and not one_clock(flight):
        offset = arrival_difference(flight.motors, imu) or 0.0
        offset = offset if abs(offset) > 0.5 else 0.0
    grid = np.arange(motors.t_s[0], motors.t_s[-1], STEP_S)
    source = imu if imu is not None else _rates_of(flight)
    rate = force = None
    if source is not None:
        rate = resampled(grid - offset, source.t_s, source.values[:, :3])
        force = resampled(grid - offset, source.t_s, source.values[:, 3:6]) if imu is not None else None
    thrust = None
    if flight.vehicle.rotors.input != "wrench":
        values = motors.values
        if flight.vehicle.rotors.input == "command":
            values = values * voltage_ratio(flight.vehicle, flight.battery, motors.t_s)[:, None]
        thrust = resampled(grid, motors.t_s, flight.vehicle.thrust(values))
    return Flown(grid, within(grid, stretches), rate, force, thrust, _speed(flight))


def _speed(flight: FlightData) -> float | None:
    """Median speed over tenths of a second of a flight's poses, or of its own positions."""
    poses = long_enough(flight.mocap) or long_enough(flight.state)
    if poses is None:
        return None
    at = np.arange(poses.t_s[0], poses.t_s[-1], 0.1)
    return (
        float(np.median(np.linalg.norm(np.diff(resampled(at, poses.t_s, poses.values[:, :3]), axis=0), axis=1))) / 0.1
    )


def _rates_of(flight: FlightData) -> Stream | None:
    """Rates of the vehicle's own state, where there is no IMU."""
    state = long_enough(flight.state)
    if state is None:
        return None
    return Stream(state.t_s, state.values[:, 10:13], ("x", "y", "z"))
