"""Long logs, and those of several flights: the stretch that tells most of the vehicle, when nobody said which to use.

What a stretch tells of inertias, lags and thrust grows with the square of what the vehicle does in it: turn rates and
specific force that vary. The most informative stretch of a given length is the one where the sum of those variances is
greatest. One stretch is taken, not several, since samples on both sides of a seam do not follow each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.flightdata import Stream

Array = NDArray[np.float64]

LONG_S = 600.0
"""A flight up to here is used whole.

A fit of ten minutes takes about a minute and one gigabyte; batteries rarely last longer.
"""
KEPT_S = 180.0
"""What is kept of a longer one: six times the excitation that a plan flies, at a cost that stays near a planned
flight's.
"""
CHANGED_S = 60.0
"""Motors that stand for as long end a flight: who changes the battery, a propeller or the load walks up to the vehicle
and away again.

Hops with shorter rests are one flight of several stretches.
"""
_FLIGHT_S = 5.0  # motors that ran for less were tried on the ground
_BESIDE_S = 2.0  # of rest that goes with a flight, before and after
_BLOCK_S = 1.0
_STILL = 0.02  # of the most that the motors reach; idling motors are above
_SEEN = 5  # samples of motors that stand, by which a rest is told from a pause of the logger


@dataclass(frozen=True, slots=True)
class Stretch:
    """A part of a log on the motors' clock, and what to say of it."""

    start_s: float
    end_s: float
    notes: tuple[str, ...] = ()


def used_stretch(imu: Stream | None, motors: Stream) -> Stretch | None:
    """What to use of a log when nobody said: of several flights one, of a long one its informative part; None where
    that is all of it.
    """
    flights = _flights(motors)
    if len(flights) < 2:
        return informative_stretch(imu, motors)
    worth = _worth(imu, motors, flights)
    start, end = flights[int(np.argmax(worth))]
    listed = "; ".join(f"{first:.1f} to {last:.1f} s" for first, last in flights)
    note = (
        f"flight: the log holds {len(flights)} flights ({listed}); between them the motors stood for {CHANGED_S:.0f} s "
        f"and more, and the vehicle may have been changed. Number {int(np.argmax(worth)) + 1} is used, which tells "
        "most of it; choose another with --from and --to, or use all with --all."
    )
    used = Stretch(start - _BESIDE_S, end + _BESIDE_S, (note,))
    imu = None if imu is None else imu.select(_within(imu, used))
    motors = motors.select(_within(motors, used))
    found = informative_stretch(imu, motors)
    return used if found is None else Stretch(found.start_s, found.end_s, (note, *found.notes))


def _within(stream: Stream, used: Stretch) -> NDArray[np.bool_]:
    return (stream.t_s >= used.start_s) & (stream.t_s <= used.end_s)


Span = tuple[float, float]


def _flights(motors: Stream) -> list[Span]:
    """When the motors ran, with rests between that are long enough to change something.

    A pause of the logger with the motors running before and after it is a gap in one flight.
    """
    level = np.abs(np.nan_to_num(motors.values)).mean(axis=1)
    there = np.isfinite(motors.t_s)
    on = there & (level > _STILL * np.max(level, initial=0.0))
    if not on.any():
        return []
    t_s, still = np.sort(motors.t_s[on]), np.sort(motors.t_s[there & ~on])  # stamps that stray are not repaired yet
    breaks = np.flatnonzero(np.diff(t_s) >= CHANGED_S)
    seen = np.searchsorted(still, t_s[breaks + 1]) - np.searchsorted(still, t_s[breaks])
    breaks = breaks[seen >= _SEEN]
    spans = zip(t_s[[0, *(breaks + 1)]].tolist(), t_s[[*breaks, -1]].tolist(), strict=True)
    return [(start, end) for start, end in spans if end - start >= _FLIGHT_S]


def _worth(imu: Stream | None, motors: Stream, flights: list[Span]) -> list[float]:
    """What each flight tells of the vehicle; how long it lasts, where nothing says how it moves."""
    edges = np.arange(flights[0][0], flights[-1][1], _BLOCK_S)
    if imu is None or len(edges) > len(motors):
        return [end - start for start, end in flights]
    told = _told_by(imu, motors, edges)
    return [float(np.sum(told[(edges >= start - _BLOCK_S) & (edges <= end)])) for start, end in flights]


def informative_stretch(imu: Stream | None, motors: Stream) -> Stretch | None:
    """What to use of a long flight; None where it is short, or has no IMU, or its stamps stray.

    Blocks of a second in which the motors stand still count nothing, and no block more than the twentieth part of them
    exceeds: a landing, or a vehicle that is carried about, is no flight.
    """
    span_s = float(motors.t_s[-1] - motors.t_s[0]) if len(motors) > 1 else 0.0
    # Less than a sample a second on average: a stamp that strayed makes the flight long, and repair deals with it.
    if imu is None or not LONG_S < span_s <= _BLOCK_S * len(motors):
        return None
    edges = np.arange(motors.t_s[0], motors.t_s[-1], _BLOCK_S)
    told = _told_by(imu, motors, edges)
    if not told.any():
        return None
    width = round(KEPT_S / _BLOCK_S)
    total = np.convolve(told, np.ones(width), mode="valid")
    begin = float(edges[int(np.argmax(total))])
    note = (
        f"flight: of {span_s:.0f} s those from {begin:.1f} to {begin + KEPT_S:.1f} s are used, in which the vehicle "
        "turns and climbs most; choose others with --from and --to, or use all with --all."
    )
    return Stretch(begin, begin + KEPT_S, (note,))


def _told_by(imu: Stream, motors: Stream, edges: Array) -> Array:
    """What each block tells, shape (blocks,): nothing where the motors stand, and no block more than the twentieth
    part of them exceeds.
    """
    told = _variation(imu, edges) * (_means(motors, edges) > 0.1 * np.nanmax(motors.values))
    flying = told[told > 0.0]
    return np.minimum(told, np.quantile(flying, 0.95)) if len(flying) else told


def _variation(imu: Stream, edges: Array) -> Array:
    """Per block the variance of each gyro and accelerometer axis over its own median, summed, shape (blocks,)."""
    block = np.searchsorted(edges, imu.t_s, side="right") - 1
    inside = (block >= 0) & np.isfinite(imu.values).all(axis=1)
    block, out = block[inside], np.zeros(len(edges))
    count = np.maximum(np.bincount(block, minlength=len(edges)), 1)
    for column in range(imu.values.shape[1]):
        values = imu.values[inside, column]
        mean = np.bincount(block, values, len(edges)) / count
        spread = np.bincount(block, (values - mean[block]) ** 2, len(edges)) / count
        typical = float(np.median(spread[spread > 0.0])) if np.any(spread > 0.0) else 1.0
        out += spread / typical
    return out


def _means(motors: Stream, edges: Array) -> Array:
    block = np.clip(np.searchsorted(edges, motors.t_s, side="right") - 1, 0, len(edges) - 1)
    level = np.nan_to_num(motors.values).mean(axis=1)
    return np.bincount(block, level, len(edges)) / np.maximum(np.bincount(block, minlength=len(edges)), 1)
