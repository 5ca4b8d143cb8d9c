"""Long logs: the stretch of a flight that tells most of the vehicle, when nobody said which part to use.

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
_BLOCK_S = 1.0


@dataclass(frozen=True, slots=True)
class Stretch:
    """A part of a flight on the motors' clock, and how long the flight is."""

    start_s: float
    end_s: float
    of_s: float = np.inf


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
    told = _variation(imu, edges) * (_means(motors, edges) > 0.1 * np.nanmax(motors.values))
    flying = told[told > 0.0]
    if not len(flying):
        return None
    told = np.minimum(told, np.quantile(flying, 0.95))
    width = round(KEPT_S / _BLOCK_S)
    total = np.convolve(told, np.ones(width), mode="valid")
    begin = float(edges[int(np.argmax(total))])
    return Stretch(begin, begin + KEPT_S, span_s)


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
