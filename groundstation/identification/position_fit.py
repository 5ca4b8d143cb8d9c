"""The second act of a flight-path reconstruction: the specific force, integrated twice, against the positions of motion
capture.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.flightdata import resampled
from groundstation.frames import matrix_from_quat, slerp
from groundstation.identification.attitude_fit import AttitudeFit, Recording, beside_gaps, whitened_fit
from groundstation.identification.newton import DIFFERENCE, minimum
from groundstation.identification.noise_kernel import LANES
from groundstation.identification.parts import at_times, by_parts, running_integrals
from groundstation.identification.position_kernel import position_costs
from groundstation.identification.smoothing import position_filter, position_smoother

Array = NDArray[np.float64]

POSITION = (
    "mocap_minus_imu_s", "clock_drift",
    "accel_bias_x_m_s2", "accel_bias_y_m_s2", "accel_bias_z_m_s2",
    "mocap_position_x_m", "mocap_position_y_m", "mocap_position_z_m",
    "mocap_tilt_x_rad", "mocap_tilt_y_rad",
)  # fmt: skip
POSITION_PRIOR = np.array([0.2, 3e-3, *[0.5] * 3, *[0.3] * 3, *[0.1] * 2])
SCALES = ("mocap_scale", "accel_scale")
SCALE_PRIOR = np.array([0.2, 0.005])
"""A MEMS accelerometer's scale after its factory trim: the poses' scale can be no surer than that."""
# Columns of the linear fit, by what they stand for.
_CLOCK, _LEVER = slice(0, 2), slice(5, 8)
# No capture system resolves less than a micrometre; a simulated one without noise must not make the filter singular.
_FINEST = np.array([1e-6, 1e-5, 1e-5])
_COARSEST = np.array([1e2, 1e3, 1e3])
"""Metres of pose noise, and a hundred g over a second: nothing that is measured is worse."""
_STEPS = 20
"""Of the search for the noise of positions."""
_STILL = 1e-3
"""Walk of an acceleration in the first round of a fit, m/s^2 per root of a second."""
_INITIAL_M_S2 = 0.3
"""What of an acceleration is unknown at first."""


@dataclass(frozen=True, slots=True)
class PositionFit:
    """The second act: positions against the specific force, integrated twice with the attitude of the first.

    Attributes:
        values, covariance: of the parameters in ``POSITION``. noise: of the poses' filter.
        causal, smoothed: position and velocity at the IMU's stamps, (k, 3) each.
    """

    values: Array
    covariance: Array
    noise: Array
    causal: tuple[Array, Array]
    smoothed: tuple[Array, Array]


def _integrals(made: Callable[[slice], Array], dt: Array) -> tuple[Array, Array]:
    """Running integral (k, m) of what is made of the samples, and its running integral."""
    speed, path = np.zeros((2, 0, 0))
    for samples, speeds, paths in running_integrals(made, dt):
        if not speed.size:
            speed, path = np.empty((2, len(dt), speeds.shape[1]))
        speed[samples], path[samples] = speeds, paths
    return speed, path


def _paths(made: Callable[[slice], Array], recording: Recording, tk: Array) -> Array:
    """What is made of the IMU's samples, integrated twice, at the poses' stamps, (n, m)."""
    integrals = running_integrals(made, recording.dt_imu)
    return at_times(((samples, paths) for samples, _, paths in integrals), recording.t_imu, tk)


def _position_columns(
    recording: Recording, attitude: AttitudeFit, tk: Array, velocity: Array, gravity_m_s2: float
) -> Array:
    """What each parameter in ``POSITION`` changes of the positions, (n, 3, 10)."""
    t_imu = recording.t_imu
    biased = _paths(lambda part: matrix_from_quat(attitude.smoothed[part]).reshape(-1, 9), recording, tk)
    elapsed = tk - tk[0]
    tilt = np.zeros((len(tk), 3, 2))
    tilt[:, 0, 1] = 0.5 * gravity_m_s2 * elapsed**2
    tilt[:, 1, 0] = -0.5 * gravity_m_s2 * elapsed**2
    return np.concatenate(
        [
            -velocity[:, :, None],
            (-velocity * (tk - recording.middle_s)[:, None])[:, :, None],
            -biased.reshape(-1, 3, 3),
            matrix_from_quat(slerp(tk, t_imu, attitude.smoothed)),
            tilt,
        ],
        axis=2,
    )


def _scale_columns(recording: Recording, tk: Array, place: Array, force: Array) -> Array:
    """What the scales of poses and accelerometer change of the positions, (n, 3, 2)."""
    felt = _paths(lambda part: force[part], recording, tk)
    return np.stack([place - place.mean(axis=0), -felt], axis=2)


Filtered = tuple[Array, Array, Array, Array, Array]


def _filtered(series: Array, dt: Array, noise: Array, held: bool, parts: Sequence[slice]) -> Filtered:
    """:func:`~.smoothing.position_filter` of each part from a beginning of its own."""
    if len(parts) == 1:
        return position_filter(series, dt, noise, held)
    found = [position_filter(np.ascontiguousarray(series[part]), dt[part], noise, held) for part in parts]
    e, s, states, pf, pp = (np.concatenate(pieces) for pieces in zip(*found, strict=True))
    return e, s, states, pf, pp


def _smoothed(dt: Array, filtered: Filtered, parts: Sequence[slice]) -> Array:
    _, _, states, pf, pp = filtered
    found = [position_smoother(dt[part], states[part], pf[part], pp[part]) for part in parts]
    return found[0] if len(found) == 1 else np.concatenate(found)


def _slope(values: Array, t_s: Array, parts: Sequence[slice]) -> Array:
    """Derivative of what is known at some stamps, each part for itself, shape (n, 3)."""
    out = np.zeros_like(values)
    for part in parts:
        if part.stop - part.start > 2:
            out[part] = np.gradient(values[part], t_s[part], axis=0)
    return out


def _fitted_position(
    error: Array, columns: Array, dt: Array, noise: Array, parts: Sequence[slice]
) -> tuple[Array, Array, Array, Array]:
    """Values, covariance, residual (n, 3) and noise after three rounds of fit and noise model.

    The first round takes accelerations to walk little: what is not fitted yet looks like one that walks, and a fit by
    that noise would leave it so.
    """
    count = columns.shape[2]
    prior = np.concatenate([POSITION_PRIOR, SCALE_PRIOR])[:count]
    values, covariance, residual = np.zeros(count), np.eye(count), error
    noise = np.array([noise[0], noise[1], min(noise[2], _STILL), noise[3]])
    for number in range(3):
        noise = noise if number == 0 else _position_noise(residual, dt, noise, parts)
        tight = noise.copy()
        tight[3] = 1e-3  # a constant acceleration is named (bias, tilt), not absorbed
        axes = [
            _filtered(np.concatenate([error[:, i : i + 1], columns[:, i, :]], axis=1), dt, tight, False, parts)[:2]
            for i in range(3)
        ]
        e = np.concatenate([axis[0] for axis in axes])
        s = np.concatenate([axis[1] for axis in axes])
        fit = whitened_fit(e[:, 0], e[:, 1:], s, prior)
        values, covariance = fit.values, fit.covariance
        residual = error - columns @ values
    return values, covariance, residual, noise


def _of_the_vehicle(columns: Array) -> Array:
    """The columns of what moves the vehicle itself: not clock, lever arm and the poses' scale, (n, 3, P)."""
    named = columns.copy()
    named[:, :, _CLOCK] = named[:, :, _LEVER] = 0.0
    named[:, :, len(POSITION) : len(POSITION) + 1] = 0.0
    return named


def align_position(
    recording: Recording, attitude: AttitudeFit, gravity_m_s2: float, *, scale: bool = False
) -> PositionFit:
    """Accelerometer bias, lever arm and tilt of the world from positions and specific force; the poses' scale where
    asked.
    """
    t_imu = recording.t_imu
    tk = attitude.errors.stamps(recording, attitude.kept)
    dt = np.concatenate([[0.0], np.diff(tk)])
    force = by_parts(
        lambda part: np.einsum("nij,nj->ni", matrix_from_quat(attitude.smoothed[part]), recording.accel[part]),
        len(t_imu),
    )
    speed, path = _integrals(lambda part: force[part] - np.array([0.0, 0.0, gravity_m_s2]), recording.dt_imu)
    error = recording.position[attitude.kept] - resampled(tk, t_imu, path)
    beside = beside_gaps(recording, tk)
    parts = [poses for _, poses in beside]
    noise = _position_noise(error, dt, None, parts)
    _, _, states, _, _ = _filtered(error, dt, noise, True, parts)
    # from the past alone: a velocity or place that knows this pose's noise would pull clock and scale towards it
    expected = states[:-1, 1, :] + dt[1:, None] * states[:-1, 2, :]
    velocity = resampled(tk, t_imu, speed) + np.concatenate([states[:1, 1, :], expected])
    columns = _position_columns(recording, attitude, tk, velocity, gravity_m_s2)
    if scale:
        ahead = states[:-1, 0, :] + dt[1:, None] * states[:-1, 1, :] + 0.5 * dt[1:, None] ** 2 * states[:-1, 2, :]
        place = resampled(tk, t_imu, path) + np.concatenate([states[:1, 0, :], ahead])
        columns = np.concatenate([columns, _scale_columns(recording, tk, place, force)], axis=2)
    values, covariance, residual, noise = _fitted_position(error, columns, dt, noise, parts)
    filtered = _filtered(residual, dt, noise, True, parts)
    shift = _of_the_vehicle(columns) @ values
    slope = _slope(shift, tk, parts)

    def at_samples(known: Array) -> Array:
        found = [resampled(t_imu[samples], tk[poses], known[poses]) for samples, poses in beside]
        return found[0] if len(found) == 1 else np.concatenate(found)

    def motion(found: Array) -> tuple[Array, Array]:
        return at_samples(found[:, 0, :] + shift) + path, at_samples(found[:, 1, :] + slope) + speed

    smooth = _smoothed(dt, filtered, parts)
    return PositionFit(values, covariance, noise, causal=motion(filtered[2]), smoothed=motion(smooth))


def _position_noise(
    error: Array, dt: Array, start: Array | None = None, parts: Sequence[slice] = (slice(None),)
) -> Array:
    """Most likely (pose noise, white acceleration, acceleration walk, initial acceleration) of position errors."""
    if start is None:
        third = np.diff(error, 3, axis=0)
        rough = float(np.median(np.abs(third)) / 0.6745 / np.sqrt(20.0)) + 1e-7
        start = np.array([rough, 0.01, 0.01, _INITIAL_M_S2])
    series = np.ascontiguousarray(error)

    def costs(points: Array) -> Array:
        noises = np.column_stack([np.exp(points), np.full(len(points), _INITIAL_M_S2)])
        lanes = [noises[i : i + LANES] for i in range(0, len(noises), LANES)]
        return np.concatenate(
            [np.sum([position_costs(series[p], dt[p], some) for p in parts], axis=0) for some in lanes]
        )

    floor, ceiling = np.log(_FINEST), np.log(_COARSEST)
    found, cost = minimum(costs, np.log(start[:3]), floor, ceiling, _STEPS)
    if found[0] < floor[0] + 2.0 * DIFFERENCE:  # no noise of poses: the way to there may end in a lesser minimum
        other, lower = minimum(costs, floor + np.log(10.0), floor, ceiling, _STEPS)
        found = other if lower < cost else found
    return np.array([*np.exp(found), _INITIAL_M_S2])
