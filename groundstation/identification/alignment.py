"""Time between streams: motors against the IMU, positions against attitudes of one pose stream.

A shift is taken only where the data demand it: a correlation that stands out of those at all other lags, found in the
parts of a flight alike, and not contradicted by the specific force. Everything else is left to the fit's own delay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from groundstation.flightdata import FlightData, Stream, resampled
from groundstation.frames import quat_rotate, slerp
from groundstation.identification.instruments import FlownMotion
from groundstation.identification.parts import by_parts
from groundstation.linear_filters import band_pass, both_ways, correlation
from groundstation.model.rotors import MotorInput, declared_thrust, interpolate_columns, wrench_matrix
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

STEP_S = 0.005
REACH_S = 10.0
BAND_HZ = (0.2, 8.0)
TYPICAL_LAG_S = 0.05
"""Of rotors that are commanded; what is left of it is the fit's to find."""
OWN_S = (-0.2, 0.06)
"""Lags of the rotors and their drivers make the torque lead by up to 0.2 s: no clock's fault."""
STANDS_OUT = 1.25
"""Correlation at the best lag over the next best one elsewhere: a manoeuvre that repeats itself comes within this."""
WEAKEST = 0.3
"""Correlation below which nine tenths of the motion are something else, and a lag is chance or the disturbance's."""
PARTS = 6
SIGNIFICANT = 2.5
"""Student's t over the parts of a flight (five degrees of freedom): by chance one time in forty, beside all of the
above.
"""
ONE_DEVICE = ("crazyflie usd log", "PX4 ULog", "ArduPilot DataFlash")
"""Logs that the vehicle itself wrote: one clock stamped everything in them."""


def arrival_difference(first: Stream, second: Stream) -> float | None:
    """First clock minus second clock by arrival times, where both have them."""
    if first.received_s is None or second.received_s is None:
        return None
    return float(np.min(second.received_s - second.t_s) - np.min(first.received_s - first.t_s))


def one_clock(flight: FlightData) -> bool:
    """Whether one device stamped IMU and motors: its own log, or samples that share nearly all of their stamps."""
    if flight.metadata.get("format") in ONE_DEVICE:
        return True
    if flight.imu is None or len(flight.motors) < 2:
        return False
    return float(np.mean(np.isin(flight.motors.t_s, flight.imu.t_s))) > 0.9


@dataclass(frozen=True, slots=True)
class Lag:
    """A lag between two signals.

    Attributes:
        lag_s: by which the second is later, and its standard deviation by the parts of the flight.
        correlation: there. rival: the best one over half a second away.
        gain: Student's t over the parts of the correlation there less the best one that needs no shift.
    """

    lag_s: float
    std_s: float
    correlation: float
    rival: float
    gain: float

    @property
    def tells(self) -> bool:
        """Whether it beats every other lag."""
        return self.correlation > max(WEAKEST, STANDS_OUT * self.rival)

    @property
    def stands_out(self) -> bool:
        """Whether it also beats those that need no shift, in all parts alike."""
        return self.tells and self.gain > SIGNIFICANT


def lag_between(
    first: Array, second: Array, step_s: float, *, reach_s: float = REACH_S, own_s: tuple[float, float] = OWN_S
) -> Lag:
    """By how much the columns of ``second`` come after those of ``first``, shapes (k, d), mean of the columns'
    correlations.
    """
    first, second = (x / (np.std(x, axis=0) + 1e-12) for x in (first, second))
    parts = [correlation(second[:, i], first[:, i]) for i in range(first.shape[1])]
    score = np.mean(np.asarray(parts), axis=0) / len(first)
    lags = (np.arange(2 * len(first) - 1) - (len(first) - 1)) * step_s
    reach = np.abs(lags) < min(reach_s, 0.5 * len(first) * step_s)
    score, lags = score[reach], lags[reach]
    best = int(np.argmax(score))
    away = np.abs(lags - lags[best]) > 0.5
    home = np.where((lags >= own_s[0]) & (lags <= own_s[1]), score, -np.inf)
    shifts = round(float(lags[best]) / step_s), round(float(lags[int(np.argmax(home))]) / step_s)
    std_s, gain = _by_parts(first, second, *shifts, step_s)
    rival = float(np.max(score[away])) if away.any() else 0.0
    return Lag(float(lags[best]), std_s, float(score[best]), rival, gain)


def _by_parts(first: Array, second: Array, shift: int, home: int, step_s: float) -> tuple[float, float]:
    """Standard deviation of a lag, and Student's t of its gain over the one at home, by parts of equal motion."""
    near, moved = round(0.25 / step_s), np.cumsum(np.sum(first**2, axis=1))
    bounds = np.searchsorted(moved, float(moved[-1]) * np.arange(PARTS + 1) / PARTS)
    size = moved[-1] / PARTS
    lags: list[float] = []
    gains: list[float] = []
    for begin, end in pairwise(bounds):
        if begin + shift - near < 0 or end + shift + near > len(second):
            continue
        scores = _products(second[begin + shift - near : end + shift + near], first[begin:end]) / size
        lags.append((int(np.argmax(scores)) - near) * step_s)
        inside = begin + home >= 0 and end + home <= len(second)
        own = float(_products(second[begin + home : end + home], first[begin:end])[0]) / size if inside else -np.inf
        gains.append(float(scores[near]) - own)
    if len(lags) < 3 or not np.isfinite(gains).all():
        return 0.1, 0.0
    root = np.sqrt(len(lags))
    std_s = float(np.hypot(np.std(lags, ddof=1) / root, step_s / np.sqrt(12.0)))
    return std_s, float(np.mean(gains) / (np.std(gains, ddof=1) / root + 1e-9))


def _products(longer: Array, shorter: Array) -> Array:
    """Sums of products of all columns, the shorter (n, d) along the longer (n + m, d) a row further each, (m + 1,)."""
    return np.sum([np.correlate(a, b, "valid") for a, b in zip(longer.T, shorter.T, strict=True)], axis=0)


def motor_offset(flight: FlightData, motion: FlownMotion, inputs: MotorInput) -> tuple[float, list[str]]:
    """Motors' stamp minus IMU stamp, coarsely, where they plainly disagree, and what to say of it; else 0.

    Angular acceleration against the torque of the declared vehicle, and specific force against its thrust, over shifts.
    """
    if one_clock(flight):
        return 0.0, []
    expected = arrival_difference(flight.motors, flight.imu) if flight.imu is not None else None
    centre = expected if expected is not None and abs(expected) > 0.5 else 0.0
    turning, force = _turning_and_force(flight, motion, inputs, centre)
    by_turning, by_force = (lag_between(*each, STEP_S) for each in (turning, force))
    # A force that stands out elsewhere contradicts; one that says little is outvoted by what turns.
    agree = abs(by_turning.lag_s - by_force.lag_s) < 0.1 + 3.0 * float(np.hypot(by_turning.std_s, by_force.std_s))
    found = by_turning if by_turning.stands_out and (agree or not by_force.stands_out) else None
    moved = found is not None and not OWN_S[0] <= found.lag_s <= OWN_S[1]
    if moved and found is not None:
        offset = centre + found.lag_s
        how = "angular acceleration and specific force" if agree else "angular acceleration"
        text = (
            f"The motors' stamps run {offset * 1e3:+.0f} +- {found.std_s * 1e3:.0f} ms against the IMU's, by {how} "
            f"(correlation {found.correlation:.2f}, {max(found.rival, 0.0):.2f} at the next best shift); they were "
            "shifted by that."
        )
        return offset, [text]
    if centre != 0.0:
        text = (
            f"The motors' stamps run {centre * 1e3:+.0f} ms against the IMU's by their arrival; they were shifted by "
            "that."
        )
        return centre, [text]
    return 0.0, []


def _turning_and_force(
    flight: FlightData, motion: FlownMotion, inputs: MotorInput, centre: float
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Measured and predicted angular acceleration (roll, pitch) and specific force z in one band, (k, 2) and (k, 1)
    each.
    """
    vehicle = flight.vehicle
    grid = np.arange(motion.t_s[0], motion.t_s[-1], STEP_S)
    lag_s = 0.0 if inputs.measured or vehicle.rotors.input == "wrench" else TYPICAL_LAG_S
    lagged, at_s = inputs.lagged(lag_s, lag_s), grid + centre
    band = band_pass(2, BAND_HZ, 1.0 / STEP_S)

    def passed(values: Array) -> Array:
        return both_ways(band, values)

    rate = resampled(grid, motion.t_s, motion.rate)
    made = by_parts(lambda part: _wrench_at(at_s, part, (inputs, lagged), vehicle), len(grid))
    torque = passed(made[:, 3:] @ np.linalg.inv(vehicle.inertia_tensor()))[:, :2]
    turning = passed(np.gradient(rate, STEP_S, axis=0))[:, :2]
    up = np.nan_to_num(np.interp(grid, motion.t_s, motion.force[:, 2]))[:, None]
    return (turning, torque), (passed(up), passed(made[:, 2:3]))


def _wrench_at(at_s: Array, part: slice, motors: tuple[MotorInput, Array], vehicle: Vehicle) -> Array:
    """Body wrench (n, 6) at some of the times, from motor values behind their lag on the motors' grid."""
    inputs, lagged = motors
    first = 0 if part.start == 0 else max(0, int((at_s[part.start] - inputs.start_s) / inputs.step_s) - 1)
    beyond = int((at_s[part.stop - 1] - inputs.start_s) / inputs.step_s) + 3
    rows = slice(first, len(lagged) if part.stop == len(at_s) else max(beyond, first + 2))
    wrench = declared_thrust(vehicle, lagged[rows]) @ wrench_matrix(vehicle).T
    return interpolate_columns(at_s[part], inputs.start_s + first * inputs.step_s, inputs.step_s, wrench)


LATE_S = 0.01
"""Positions and attitudes that differ by less are left to the flight-path reconstruction."""
LATE_BAND_HZ = (0.3, 4.0)


def with_one_stamp(
    pose: Stream, attitude_offset_s: float, t_imu: Array, accel: Array, gravity_m_s2: float
) -> tuple[Stream, list[str]]:
    """Poses whose positions are taken at the attitudes' time, where both of a pose are late by different amounts.

    The world's acceleration by second differences of the positions, against the specific force turned into the world by
    the attitudes and less gravity, over lags.

    Args:
        pose: positions and attitudes, (m, 7).
        attitude_offset_s: attitude stamp minus IMU stamp.
    """
    late, std, correlation = _lateness(pose, attitude_offset_s, t_imu, accel, gravity_m_s2)
    if abs(late) < max(LATE_S, 4.0 * std):
        return pose, []
    at = np.clip(pose.t_s + late, pose.t_s[0], pose.t_s[-1])
    moved = resampled(at, pose.t_s, pose.values[:, :3])
    inside = (pose.t_s + late >= pose.t_s[0]) & (pose.t_s + late <= pose.t_s[-1])
    text = (
        f"Positions are {late * 1e3:+.0f} +- {std * 1e3:.0f} ms late against the attitudes of the same poses "
        f"(by the accelerometer, correlation {correlation:.2f}); each was taken at its own time."
    )
    return replace(pose, values=np.column_stack([moved, pose.values[:, 3:]])).select(inside), [text]


def _lateness(
    pose: Stream, attitude_offset_s: float, t_imu: Array, accel: Array, gravity_m_s2: float
) -> tuple[float, float, float]:
    """By how much positions are later than attitudes, its standard deviation and the correlation; 0 if too short."""
    when = pose.t_s - attitude_offset_s
    grid = np.arange(max(when[0], t_imu[0]), min(when[-1], t_imu[-1]), STEP_S)
    if len(grid) * STEP_S < 5.0:
        return 0.0, 0.0, 0.0
    step = float(np.median(np.diff(pose.t_s)))
    top = min(LATE_BAND_HZ[1], 0.2 / step)
    band = band_pass(2, (LATE_BAND_HZ[0], top), 1.0 / STEP_S)

    def passed(values: Array) -> Array:
        return both_ways(band, values)

    position = resampled(grid, when, pose.values[:, :3])
    seen = np.gradient(np.gradient(passed(position), STEP_S, axis=0), STEP_S, axis=0)
    felt = quat_rotate(slerp(t_imu, when, pose.values[:, 3:7]), accel) - np.array([0.0, 0.0, gravity_m_s2])
    felt = passed(resampled(grid, t_imu, felt))
    axes = [
        lag_between(felt[:, i : i + 1], seen[:, i : i + 1], STEP_S, reach_s=0.5, own_s=(-LATE_S, LATE_S))
        for i in range(3)
    ]
    return _joined([lag for lag in axes if lag.correlation > 0.5])


def _joined(axes: list[Lag]) -> tuple[float, float, float]:
    """Weighted mean lag, its standard deviation, and the mean correlation; no lag where no axis shows one.

    A tilt that is a little wrong turns gravity into the plane and moves the lags of x and y: where the axes disagree,
    the standard deviation says so (Birge ratio).
    """
    if not axes:
        return 0.0, np.inf, 0.0
    lags = np.array([lag.lag_s for lag in axes])
    weight = np.array([1.0 / (lag.std_s**2 + STEP_S**2) for lag in axes])
    mean = float(weight @ lags / weight.sum())
    birge = float(weight @ (lags - mean) ** 2) / max(len(axes) - 1, 1)
    return mean, float(np.sqrt(max(1.0, birge) / weight.sum())), float(np.mean([lag.correlation for lag in axes]))
