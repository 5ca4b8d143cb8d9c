"""The motion that a plan made the vehicle do: the instruments of identification and diagnosis.

An instrument must owe nothing to the flight's disturbances, and be as strong as it resembles the regressor (Soderstrom
and Stoica 1983). The plan meets the first demand; but the vehicle follows it late, with other amplitudes, and not at
all where the plan's jerk steps. So each axis's planned motion is passed through its own short linear filter, fitted to
what was flown: a few weights over a whole flight take next to nothing of its disturbance along (Janot, Vandanjon and
Gautier 2014 simulate the closed loop for the same purpose; here its law is unknown).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from groundstation.flightdata import FlightData, Stream, resampled
from groundstation.frames import (
    euler_from_quat,
    quat_continuous,
    quat_from_euler,
    quat_normalise,
    quat_rotate_inverse,
)
from groundstation.identification.block_kernel import cubic
from groundstation.identification.parts import double, kept, parts_of
from groundstation.identification.record import PlannedMotion
from groundstation.identification.streams import clean
from groundstation.linear_filters import both_ways, low_pass
from groundstation.trajectory import FlatState, RigidMotion, rigid_motion

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Reference = Callable[[Array], FlatState]

PATH_KNOTS_S = 0.5
"""Knots of the path that stands in for a plan."""
COHERENT = 0.2
"""Correlation of planned and flown body rates below which the plan was not flown."""
BAND_HZ = 5.0
"""Manoeuvres are slower than this; the filters are fitted below it."""
PART = 16384
"""Samples for which the shifted motions are held at a time."""
GRID_S = 0.005
"""Grid on which the plan is worked out: a hundredth of a manoeuvre's period."""
FILTER_GRID_S = 0.02
"""The same where filters are fitted, to samples at 50 Hz below BAND_HZ."""
GAP_S = 1.0
"""Between two samples: beyond it a new grid begins."""
TURNED_RAD = 0.1
"""Heading between a plan and its flight from which the plan is taken to be flown in a frame of its own; below it an
instrument loses half a percent of its strength, and a steady yaw torque leaves about as much.
"""
STEADY = 0.95
"""Mean length of the unit vectors of that heading from which there is one: a vehicle that follows another yaw than the
plan's, or none, has none.
"""
SHORT_S: Array = np.linspace(-0.2, 0.2, 3)
LONG_S: Array = np.linspace(-0.4, 0.4, 9)
"""Taps of the tracking filters, about the vehicle's mean delay."""


@dataclass(frozen=True, slots=True)
class FlownMotion:
    """What a flight's sensors say of its motion, on one clock.

    Attributes:
        t_s: (k,). rate: body rates, (k, 3). force: specific force, (k, 3).
        smooth: attitude (k, 4), position and velocity in the world (k, 3); NaN where unknown.
        source: "imu", "poses" or "state".
        rate_hz: of the stamps.
    """

    t_s: Array
    rate: Array
    force: Array
    smooth: tuple[Array, Array, Array]
    source: str
    rate_hz: float


def planned_motion(
    flight: FlightData, motion: FlownMotion, keep: Mask, start_s: float, *, stand_in: bool
) -> PlannedMotion | None:
    """The motion the plan (or the setpoints) asked for, as the vehicle follows it; None where there is none.

    Args:
        keep: samples of the excitation, shape (k,).
        start_s: when the plan began.
        stand_in: where neither plan nor setpoints are recorded, the smoothed path of the vehicle may stand in: torque
            disturbances reach position only through four integrations, and the noise of rotor speeds not at all.
    """
    reference = _reference(flight, motion, keep, start_s, stand_in)
    if reference is None:
        return None
    gravity = flight.vehicle.gravity_m_s2
    delay_s, coherence = _delay(reference, motion, keep, gravity)
    if coherence < COHERENT:
        return None
    used = np.flatnonzero(keep)[:: max(1, round(motion.rate_hz / 50.0))]
    reference = _as_placed(reference, motion, used, delay_s)
    asked = _Asked(reference, delay_s, gravity)
    tracking = _Tracking(_path_filters(asked, motion, used), _body_filters(asked, motion, used))
    found = asked.at(motion.t_s, GRID_S, tracking.on)
    rate, acceleration, thrust, velocity, position, attitude = np.split(found, [3, 6, 7, 10, 13], axis=1)
    quaternion = kept(quat_continuous(quat_normalise(double(attitude))))
    return PlannedMotion(rate, acceleration, thrust[:, 0], velocity, position, quaternion)


def _reference(flight: FlightData, motion: FlownMotion, keep: Mask, start_s: float, stand_in: bool) -> Reference | None:
    """What the vehicle was to follow, over time on the motion's clock."""
    if flight.plan is not None:
        series = flight.plan.series()

        def reference(query: Array) -> FlatState:
            # periodic beyond its ends: the jerk steps where the series starts, and no vehicle follows that
            d = series.derivatives(query - start_s, 4)
            return FlatState(d[:, :, :3], d[:3, :, 3])

        return reference
    if flight.setpoint is not None and len(flight.setpoint) > 50:
        return _setpoint_spline(flight.setpoint)
    if stand_in and motion.source == "imu" and np.isfinite(motion.smooth[1]).all():
        return _path_spline(motion, keep)
    return None


def _delay(reference: Reference, motion: FlownMotion, keep: Mask, gravity: float) -> tuple[float, float]:
    """The shift at which planned and flown body rates correlate best, and that correlation; 0 where nothing was
    planned.

    It is the vehicle's own tracking delay and whatever separates the clocks.
    """
    t = motion.t_s
    step, reach = 0.02, 1.5
    grid = np.arange(t[keep][0], t[keep][-1], step)
    actual = resampled(grid, t, motion.rate)
    pad = round(reach / step)
    wide = grid[0] + step * np.arange(-pad, len(grid) + pad)
    planned = rigid_motion(reference(wide), gravity).angular_velocity_body_rad_s
    if float(np.std(planned)) < 1e-4:
        return 0.0, 0.0
    scores = [float(np.sum(planned[first : first + len(grid)] * actual)) for first in range(2 * pad + 1)]
    best = int(np.argmax(scores))
    size = np.sqrt(np.sum(planned[best : best + len(grid)] ** 2) * np.sum(actual**2)) + 1e-12
    return step * (pad - best), scores[best] / size


def _as_placed(reference: Reference, motion: FlownMotion, used: NDArray[np.int64], delay_s: float) -> Reference:
    """The reference turned about the vertical as the flight's world is: a link flies a plan along the heading that the
    vehicle had on the ground, and from flight to flight that is another one.

    Its path is compared with the flown one axis by axis; turned by a right angle, x is compared with y.
    """
    yaw = euler_from_quat(motion.smooth[0][used])[:, 2]
    if not np.isfinite(yaw).all():
        return reference
    apart: Array = yaw - reference(motion.t_s[used] - delay_s).yaw[0]
    x, y = float(np.mean(np.cos(apart))), float(np.mean(np.sin(apart)))
    turn = float(np.arctan2(y, x))
    if np.hypot(x, y) < STEADY or abs(turn) < TURNED_RAD:
        return reference
    cos, sin = np.cos(turn), np.sin(turn)
    rotation = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])

    def turned(query: Array) -> FlatState:
        flat = reference(query)
        return FlatState(flat.position @ rotation, flat.yaw + np.array([turn, 0.0, 0.0])[:, None])

    return turned


@dataclass(frozen=True, slots=True)
class _BodyFilter:
    """Of an axis of the body: taps, whose axes' rates pass them, and the weights of all, axis by axis."""

    shifts: Array
    axes: Sequence[int]
    weights: Array


class _Shifted:
    """The reference on a uniform grid, and later or earlier by the shifts of the tracking filters, each a whole number
    of the grid's steps: worked out once for all of them.
    """

    def __init__(self, reference: Reference, gravity: float, first_s: float, step_s: float, count: int):
        self._step_s, self._count, self._margin = step_s, count, round(float(LONG_S[-1]) / step_s)
        self.gravity = gravity
        self._wide = reference(
            np.asarray(first_s + step_s * np.arange(-self._margin, count + self._margin), dtype=float)
        )
        self._rigid: RigidMotion | None = None

    def _part(self, shift: float) -> slice:
        first = self._margin - round(shift / self._step_s)
        return slice(first, first + self._count)

    def flat(self, shift: float) -> FlatState:
        """Later by a shift."""
        part = self._part(shift)
        return FlatState(self._wide.position[:, part], self._wide.yaw[:, part])

    def columns(self, chosen: _BodyFilter, name: str) -> Array:
        """What a filter of the body weighs, of one quantity of rigid motion, (k, taps)."""
        if self._rigid is None:
            self._rigid = rigid_motion(self._wide, self.gravity)
        values: Array = getattr(self._rigid, name)
        return np.column_stack([values[self._part(float(s)), axis] for axis in chosen.axes for s in chosen.shifts])


@dataclass(frozen=True, slots=True)
class _Asked:
    """The reference as it reaches the vehicle, late by the delay."""

    reference: Reference
    delay_s: float
    gravity: float

    def at(self, t_s: Array, step_s: float, columns: Callable[[_Shifted], Array]) -> Array:
        """Columns that are worked out on a grid, at other times, (k, n): cubic between the grid's points.

        References are slow beside the grid. A part of the flight at a time is held, none across a gap.
        """
        out: Array | None = None
        for part in self._parts(t_s):
            begin, end = float(t_s[part.start]), float(t_s[part.stop - 1])
            first = float(t_s[0] + step_s * (np.floor((begin - t_s[0]) / step_s) - 2.0))  # one grid in all parts
            count = int((end - first) / step_s) + 4
            shifted = _Shifted(self.reference, self.gravity, first - self.delay_s, step_s, count)
            found = cubic(columns(shifted), first, step_s, t_s[part])
            out = kept(np.empty((len(t_s), found.shape[1]))) if out is None else out
            out[part] = found
        return np.zeros((0, 0)) if out is None else out

    def _parts(self, t_s: Array) -> Iterator[slice]:
        """Times without a gap, at most PART of them each."""
        bounds = [0, *(np.flatnonzero(np.diff(t_s) > GAP_S) + 1).tolist(), len(t_s)]
        for start, stop in pairwise(bounds):
            for part in parts_of(stop - start, PART):
                if part.stop > part.start:
                    yield slice(start + part.start, start + part.stop)


@dataclass(frozen=True, slots=True)
class _Tracking:
    """How the vehicle follows: p(t) = sum_j w_j r(t - delay - s_j) for x, y, z and yaw (None: without a filter), and
    the filters of the body's rates (None: those of that path).
    """

    path: Sequence[Array | None]
    body: Sequence[_BodyFilter | None]

    def on(self, shifts: _Shifted) -> Array:
        """Rates, their derivatives, specific thrust, velocity in the body, position, attitude, (k, 17)."""
        middle = shifts.flat(float(SHORT_S[len(SHORT_S) // 2]))
        position, yaw = middle.position.copy(), middle.yaw.copy()
        moved = [shifts.flat(float(shift)) for shift in SHORT_S]
        for axis, weights in enumerate(self.path):
            if weights is None:
                continue
            parts = [m.position[:, :, axis] if axis < 3 else m.yaw for m in moved]
            target = position[:, :, axis] if axis < 3 else yaw
            target[:] = sum(w * part for w, part in zip(weights, parts, strict=True))
        path = rigid_motion(FlatState(position, yaw), shifts.gravity)
        rate, acceleration = path.angular_velocity_body_rad_s.copy(), path.angular_acceleration_body_rad_s2.copy()
        for axis, chosen in enumerate(self.body):
            if chosen is not None:
                rate[:, axis] = shifts.columns(chosen, "angular_velocity_body_rad_s") @ chosen.weights
                acceleration[:, axis] = shifts.columns(chosen, "angular_acceleration_body_rad_s2") @ chosen.weights
        attitude = quat_continuous(quat_from_euler(*path.euler_rad.T))
        velocity = quat_rotate_inverse(attitude, path.velocity_world_m_s)
        return np.column_stack([rate, acceleration, path.specific_thrust_m_s2, velocity, path.position_m, attitude])


def _path_filters(asked: _Asked, motion: FlownMotion, used: NDArray[np.int64]) -> list[Array | None]:
    """Weights of x, y, z and yaw, fitted to acceleration and yaw rate."""
    if not np.isfinite(motion.smooth[2]).all():
        return [None] * 4
    yaw = np.unwrap(euler_from_quat(motion.smooth[0][used])[:, 2])
    flown = np.gradient(np.column_stack([motion.smooth[2][used], yaw]), motion.t_s[used], axis=0)

    def accelerations(shifts: _Shifted) -> Array:
        moved = [shifts.flat(float(shift)) for shift in SHORT_S]
        return np.concatenate([np.column_stack([m.position[2], m.yaw[1]]) for m in moved], axis=1)

    asked_for, found = asked.at(motion.t_s[used], FILTER_GRID_S, accelerations), list[Array | None]()
    for axis in range(4):
        columns = asked_for[:, axis::4]
        still = np.std(columns) < 1e-4
        weights = None if still else np.linalg.lstsq(columns, flown[:, axis], rcond=1e-3)[0]
        found.append(None if weights is None else np.asarray(weights, dtype=float))
    return found


def _body_filters(asked: _Asked, motion: FlownMotion, used: NDArray[np.int64]) -> list[_BodyFilter | None]:
    """Rates as flown: each is a filtered plan of its own, of all three axes' rates where that pays (BIC).

    A fast manoeuvre couples the axes and saturates loops, which a filter of position and yaw does not tell.
    """
    sections = low_pass(2, min(BAND_HZ, 0.4 * motion.rate_hz), motion.rate_hz)
    flown = np.gradient(both_ways(sections, motion.rate)[used], motion.t_s[used], axis=0)
    independent = 2.0 * BAND_HZ * float(motion.t_s[used[-1]] - motion.t_s[used[0]])
    every = _BodyFilter(LONG_S, (0, 1, 2), np.zeros(0))
    all_axes = asked.at(
        motion.t_s[used], FILTER_GRID_S, lambda shifts: shifts.columns(every, "angular_acceleration_body_rad_s2")
    )
    found: list[_BodyFilter | None] = []
    for axis in range(3):
        sets: list[tuple[Array, Sequence[int]]] = [(SHORT_S, (axis,)), (LONG_S, (axis,)), (LONG_S, (0, 1, 2))]
        choices = [_BodyFilter(taps, axes, np.zeros(len(taps) * len(axes))) for taps, axes in sets]
        own = all_axes[:, axis * len(LONG_S) : (axis + 1) * len(LONG_S)]
        columns = [own[:, np.searchsorted(LONG_S, SHORT_S - 1e-9)], own, all_axes]
        index, weights = _most_probable(columns, flown[:, axis], independent)
        found.append(None if index is None else _BodyFilter(choices[index].shifts, choices[index].axes, weights))
    return found


def _most_probable(candidates: Sequence[Array], target: Array, independent: float) -> tuple[int | None, Array]:
    """The regression with the lowest Bayesian information criterion, and its weights; None where none explains
    anything.

    Args:
        candidates: regressors, each of shape (n, p).
        target: shape (n,).
        independent: how many independent samples the n are worth.
    """
    chosen, best, lowest = None, np.zeros(0), 0.0
    power = float(np.sum(target**2))
    for index, columns in enumerate(candidates):
        weights = np.asarray(np.linalg.lstsq(columns, target, rcond=1e-3)[0], dtype=float)
        left = float(np.sum((target - columns @ weights) ** 2))
        score = independent * np.log(max(left, 1e-12 * power) / power) + columns.shape[1] * np.log(independent)
        if score < lowest:
            chosen, best, lowest = index, weights, score
    return chosen, best


def _path_spline(motion: FlownMotion, keep: Mask) -> Reference | None:
    """The flown path as a spline with knots every PATH_KNOTS_S, which follows the manoeuvre and not the disturbance."""
    used = np.flatnonzero(keep)
    index = np.arange(int(used[0]), int(used[-1]), max(1, round(motion.rate_hz / 50.0)))
    yaw = np.unwrap(euler_from_quat(motion.smooth[0][index])[:, 2])
    path = np.column_stack([motion.smooth[1][index], yaw])
    return _setpoint_spline(Stream(motion.t_s[index], path, ("x_m", "y_m", "z_m", "yaw_rad")), PATH_KNOTS_S)


def _setpoint_spline(setpoint: Stream, knots_s: float = 0.2) -> Reference | None:
    """Quintic least-squares spline through position and yaw setpoints, knots every ``knots_s``; None if they do not
    move.
    """
    from scipy.interpolate import make_lsq_spline

    stream = clean(setpoint)
    t = stream.t_s
    values = stream.values[:, :4].copy()
    values[:, 3] = np.unwrap(values[:, 3])
    if len(t) < 50 or np.ptp(values[:, :3], axis=0).max() < 0.02:
        return None
    spacing = max(knots_s, 3.0 * float(np.max(np.diff(t))))
    inner = np.arange(t[0] + spacing, t[-1] - spacing, spacing)
    knots = np.concatenate([np.full(6, t[0]), inner, np.full(6, t[-1])])
    spline = make_lsq_spline(t, values, knots, k=5)

    def sample(query: Array) -> FlatState:
        inside = np.clip(query, t[0], t[-1])
        d = np.stack([spline.derivative(n)(inside) if n else spline(inside) for n in range(5)])
        d[1:, (query < t[0]) | (query > t[-1])] = 0.0
        return FlatState(d[:, :, :3], d[:3, :, 3])

    return sample
