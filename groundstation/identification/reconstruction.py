"""Flight-path reconstruction: do gyro and attitude, accelerometer and position agree, and what made them differ.

Kinematics alone, no force model (Klein and Morelli, Aircraft System Identification, ch. 10). The gyro is integrated to
an attitude and the specific force to a position; what separates them from motion capture is linear in small errors: clock
offset and drift, gyro and accelerometer bias, gyro scale, misalignment of the marker body, lever arm, tilt of
the capture volume. The rest is integrated sensor noise plus capture noise: a Kalman filter whitens both sides, and least
squares on the innovations gives values with honest standard deviations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.frames import (
    matrix_from_quat,
    quat_conjugate,
    quat_exp,
    quat_log,
    quat_multiply,
    quat_normalise,
    quat_rotate,
)
from groundstation.identification.newton import minimum
from groundstation.identification.noise import NoiseModel, fit_noise_model, innovations
from groundstation.identification.noise_kernel import LANES
from groundstation.identification.position_kernel import position_costs
from groundstation.identification.smoothing import integrate_rates, local_level, position_filter, position_smoother

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Compatibility:
    """What motion capture and IMU agree on.

    Attributes:
        values, std: kinematic errors by name (``mocap_minus_imu_s``, ``gyro_bias_x_rad_s``, ``mocap_rotation_x_rad`` ...). Beside those
            of ``names``: ``stamp_jitter_s`` of the poses.
        covariance: of ``names`` in order.
        revealed: those of ``names`` that the flight tells at least twice as well as was known beforehand.
        kept: poses used, shape (poses,).
        quaternion: smoothed attitude of the body at the IMU's stamps, (k, 4); ``causal_quaternion`` is the filter's.
        position_m, velocity_m_s: of the IMU in the world, smoothed, (k, 3); ``causal_*`` likewise.
        pose_noise: white noise of positions (m) and attitudes (rad), standard deviations.
    """

    names: tuple[str, ...]
    values: Mapping[str, float]
    std: Mapping[str, float]
    covariance: Array
    kept: Mask
    quaternion: Array
    position_m: Array
    velocity_m_s: Array
    causal_quaternion: Array
    causal_position_m: Array
    causal_velocity_m_s: Array
    revealed: tuple[str, ...]
    pose_noise: tuple[float, float] = (0.0, 0.0)


def _interpolate(query: Array, t: Array, values: Array) -> Array:
    return np.stack([np.interp(query, t, column) for column in values.T], axis=-1)


def slerp(query: Array, t: Array, quaternion: Array) -> Array:
    """Spherical interpolation of attitudes at query times within t, held at the ends."""
    index = np.clip(np.searchsorted(t, query, side="right") - 1, 0, len(t) - 2)
    fraction = np.clip((query - t[index]) / (t[index + 1] - t[index]), 0.0, 1.0)
    step = quat_log(quat_multiply(quat_conjugate(quaternion[index]), quaternion[index + 1]))
    return quat_multiply(quaternion[index], quat_exp(step * fraction[:, None]))


@dataclass(frozen=True, slots=True)
class _Fit:
    values: Array
    covariance: Array
    outlier: Mask


def _whitened_fit(e: Array, columns: Array, variance: Array, prior_std: Array) -> _Fit:
    """Huber-weighted least squares of innovations on innovations of regressors, with zero-mean priors."""
    keep = np.isfinite(variance)
    scale = np.sqrt(np.where(keep, variance, 1.0))
    y, x = np.where(keep, e / scale, 0.0), np.where(keep[:, None], columns / scale[:, None], 0.0)
    weight = np.ones(len(y))
    theta = np.zeros(x.shape[1])
    information = np.diag(1.0 / prior_std**2)
    for _ in range(6):
        normal = x.T @ (x * weight[:, None]) + information
        theta = np.linalg.solve(normal, x.T @ (weight * y))
        size = np.abs(y - x @ theta)
        weight = np.minimum(1.0, 2.5 / np.maximum(size, 1e-12))
    residual = y - x @ theta
    inverse = np.asarray(np.linalg.inv(normal), dtype=float)
    # Stamps jitter, so a pose is noisier the faster it moves: the spread of each row is its own (White 1980).
    rows = x * (weight * residual)[:, None]
    return _Fit(
        np.asarray(theta, dtype=float),
        inverse @ (rows.T @ rows + information) @ inverse,
        keep & (np.abs(residual) > 6.0),
    )


_ATTITUDE = (
    "mocap_minus_imu_s", "clock_drift",
    "gyro_bias_x_rad_s", "gyro_bias_y_rad_s", "gyro_bias_z_rad_s",
    "mocap_rotation_x_rad", "mocap_rotation_y_rad", "mocap_rotation_z_rad",
    "gyro_scale_x", "gyro_scale_y", "gyro_scale_z",
)  # fmt: skip
_ATTITUDE_PRIOR = np.array([0.2, 3e-3, *[0.3] * 3, *[0.3] * 3, *[0.05] * 3])
_POSITION = (
    "mocap_minus_imu_s", "clock_drift",
    "accel_bias_x_m_s2", "accel_bias_y_m_s2", "accel_bias_z_m_s2",
    "mocap_position_x_m", "mocap_position_y_m", "mocap_position_z_m",
    "mocap_tilt_x_rad", "mocap_tilt_y_rad",
)  # fmt: skip
_POSITION_PRIOR = np.array([0.2, 3e-3, *[0.5] * 3, *[0.3] * 3, *[0.1] * 2])
_SCALES = ("mocap_scale", "accel_scale")
_SCALE_PRIOR = np.array([0.2, 0.005])
"""A MEMS accelerometer's scale after its factory trim: the poses' scale can be no surer than that."""


def reconstruct(
    t_imu: Array,
    gyro: Array,
    accel: Array,
    t_pose: Array,
    position: Array,
    quaternion: Array,
    *,
    offset_s: float,
    gravity_m_s2: float,
    mocap_rotation_rad: Array,
    scale: bool = False,
) -> Compatibility:
    """Estimate the kinematic errors of a flight and its smoothed motion.

    Args:
        t_imu: stamps, shape (k,); gyro and accel, shape (k, 3).
        t_pose: stamps, shape (m,); position (m, 3) and quaternion (m, 4) of the marker body.
        offset_s: coarse pose stamp minus IMU stamp.
        mocap_rotation_rad: declared rotation vector from the body to the marker frame.
        scale: also estimate the scales of poses and accelerometer (``mocap_scale``, ``accel_scale``), as shares.
    """
    recording = _Recording(
        t_imu, gyro, accel, t_pose, position, quaternion, quat_exp(mocap_rotation_rad), 0.5 * (t_imu[0] + t_imu[-1])
    )
    attitude = align_attitude(recording, offset_s)
    found = align_position(recording, attitude, gravity_m_s2, scale=scale)
    errors = attitude.errors
    names, theta, covariance = _combine(
        np.array([errors.offset_s, errors.drift, *errors.gyro_bias, *errors.rotation, *errors.gyro_scale]),
        attitude.covariance,
        found.values,
        found.covariance,
        errors.offset_s,
    )
    std = np.sqrt(np.diag(covariance))
    prior = np.concatenate([_ATTITUDE_PRIOR, _POSITION_PRIOR[2:], _SCALE_PRIOR])[: len(names)]
    jitter_s, jitter_std_s = attitude.stamp_jitter_s
    return Compatibility(
        names=names,
        values=dict(zip(names, map(float, theta), strict=True)) | {"stamp_jitter_s": jitter_s},
        std=dict(zip(names, map(float, std), strict=True)) | {"stamp_jitter_s": jitter_std_s},
        covariance=covariance,
        revealed=tuple(n for n, s, p in zip(names, std, prior, strict=True) if s < 0.5 * p),
        kept=attitude.kept,
        quaternion=quat_normalise(attitude.smoothed),
        position_m=found.smoothed[0],
        velocity_m_s=found.smoothed[1],
        causal_quaternion=quat_normalise(attitude.filtered),
        causal_position_m=found.causal[0],
        causal_velocity_m_s=found.causal[1],
        pose_noise=(float(found.noise[0]), float(attitude.colour.sensor)),
    )


# Columns of the two linear fits, by what they stand for.
_CLOCK = slice(0, 2)
_GYRO_BIAS, _ROTATION, _GYRO_SCALE = slice(2, 5), slice(5, 8), slice(8, 11)
_LEVER = slice(5, 8)


@dataclass(frozen=True, slots=True)
class _Recording:
    """What is compared: IMU (k,) and (k, 3), poses (m,), (m, 3) and (m, 4), the marker body's declared rotation, the middle stamp."""

    t_imu: Array
    gyro: Array
    accel: Array
    t_pose: Array
    position: Array
    quaternion: Array
    alignment: Array
    middle_s: float

    @property
    def dt_imu(self) -> Array:
        """Before each IMU sample, (k,)."""
        return np.concatenate([[0.0], np.diff(self.t_imu)])


@dataclass(frozen=True, slots=True)
class _AttitudeErrors:
    """Errors that the attitudes show: pose clock, gyro bias and scale (3,), rotation of the tracked frame (3,)."""

    offset_s: float
    drift: float
    gyro_bias: Array
    rotation: Array
    gyro_scale: Array

    def stamps(self, recording: _Recording, kept: Mask) -> Array:
        """Of the poses that are kept, on the IMU's clock."""
        t = recording.t_pose[kept]
        return t - self.offset_s - self.drift * (t - self.offset_s - recording.middle_s)

    def changed(self, step: Array) -> _AttitudeErrors:
        """After a step of the fit, (11,)."""
        return _AttitudeErrors(
            offset_s=self.offset_s + step[0],
            drift=self.drift + step[1],
            gyro_bias=self.gyro_bias + step[_GYRO_BIAS],
            rotation=quat_log(quat_multiply(quat_exp(step[_ROTATION]), quat_exp(self.rotation))),
            gyro_scale=self.gyro_scale + step[_GYRO_SCALE],
        )


@dataclass(frozen=True, slots=True)
class AttitudeFit:
    """The first act: attitudes against the integrated rates.

    Attributes:
        covariance: of the errors, (11, 11). kept: poses that are no outliers, (m,). colour: noise of the attitudes.
        filtered, smoothed: attitude at the IMU's stamps, from the past alone and from all, (k, 4).
        stamp_jitter_s: of the poses, and its standard deviation.
    """

    errors: _AttitudeErrors
    covariance: Array
    kept: Mask
    colour: NoiseModel
    filtered: Array
    smoothed: Array
    stamp_jitter_s: tuple[float, float]


@dataclass(frozen=True, slots=True)
class PositionFit:
    """The second act: positions against the specific force, integrated twice with the attitude of the first.

    Attributes:
        values, covariance: of the parameters in ``_POSITION``. noise: of the poses' filter.
        causal, smoothed: position and velocity at the IMU's stamps, (k, 3) each.
    """

    values: Array
    covariance: Array
    noise: Array
    causal: tuple[Array, Array]
    smoothed: tuple[Array, Array]


def _attitude_columns(
    recording: _Recording, errors: _AttitudeErrors, tk: Array, attitude: Array, rates: Array
) -> Array:
    """What each error changes of the attitude at the poses' stamps, (n, 3, 11)."""
    t_imu, dt_imu = recording.t_imu, recording.dt_imu
    world_from_body = matrix_from_quat(attitude)
    r_poses = matrix_from_quat(slerp(tk, t_imu, attitude))
    rate_world = np.einsum("nij,nj->ni", r_poses, _interpolate(tk, t_imu, rates))
    drifted = np.cumsum(world_from_body * dt_imu[:, None, None], axis=0).reshape(-1, 9)
    scaled = np.cumsum(world_from_body * rates[:, None, :] * dt_imu[:, None, None], axis=0).reshape(-1, 9)
    return np.concatenate(
        [
            -rate_world[:, :, None],
            (-rate_world * (tk - recording.middle_s)[:, None])[:, :, None],
            -_interpolate(tk, t_imu, drifted).reshape(-1, 3, 3),
            r_poses @ matrix_from_quat(recording.alignment),  # the rotation is about the marker frame's declared axes
            -_interpolate(tk, t_imu, scaled).reshape(-1, 3, 3),
        ],
        axis=2,
    )


def _compared_attitudes(
    recording: _Recording, errors: _AttitudeErrors, kept: Mask, tk: Array
) -> tuple[Array, Array, Array]:
    """Attitude by the rates (k, 4), its error against the poses (n, 3), and the columns of the errors (n, 3, 11)."""
    t_imu = recording.t_imu
    marker = quat_multiply(recording.alignment, quat_exp(errors.rotation))
    body = quat_multiply(recording.quaternion[kept], quat_conjugate(marker))
    rates = (recording.gyro - errors.gyro_bias) / (1.0 + errors.gyro_scale)
    rough = integrate_rates(np.array([1.0, 0.0, 0.0, 0.0]), recording.dt_imu, rates)
    at_first = slerp(tk[:1], t_imu, rough)[0]
    attitude = quat_multiply(quat_multiply(body[0], quat_conjugate(at_first)), rough)
    error = quat_log(quat_multiply(body, quat_conjugate(slerp(tk, t_imu, attitude))))
    return attitude, error, _attitude_columns(recording, errors, tk, attitude, rates)


def _attitude_step(
    recording: _Recording, errors: _AttitudeErrors, kept: Mask, colour: NoiseModel | None
) -> tuple[AttitudeFit, bool]:
    """One Gauss-Newton step, and whether it was within a twentieth of the standard deviations."""
    tk = errors.stamps(recording, kept)
    attitude, error, columns = _compared_attitudes(recording, errors, kept, tk)
    dt = np.concatenate([[0.0], np.diff(tk)])
    count = len(tk)
    stacked = np.concatenate([error.T.reshape(-1, 1), columns.transpose(1, 0, 2).reshape(3 * count, -1)], axis=1)
    restart = np.zeros(3 * count, dtype=bool)
    restart[::count] = True
    dts = np.tile(dt, 3)
    if colour is None:
        colour = _local_noise(stacked[:, 0], dts, restart)
    e, s = innovations(stacked, dts, restart, colour, integrated=True)
    fit = _whitened_fit(e[:, 0], e[:, 1:], s, _ATTITUDE_PRIOR)
    bad = fit.outlier.reshape(3, count).any(axis=0)
    remainder = stacked[:, 0] - stacked[:, 1:] @ fit.values
    kept = kept.copy()
    kept[np.flatnonzero(kept)[bad]] = False
    good = ~bad
    dt_good = np.concatenate([[0.0], np.diff(tk[good])])
    filtered, smoothed = local_level(remainder.reshape(3, count).T[good], dt_good, colour.process, colour.sensor)
    found = AttitudeFit(
        errors=errors.changed(fit.values),
        covariance=fit.covariance,
        kept=kept,
        colour=_local_noise(remainder, dts, restart, colour),
        filtered=quat_multiply(quat_exp(_interpolate(recording.t_imu, tk[good], filtered)), attitude),
        smoothed=quat_multiply(quat_exp(_interpolate(recording.t_imu, tk[good], smoothed)), attitude),
        stamp_jitter_s=_stamp_jitter(e[:, 0] - e[:, 1:] @ fit.values, e[:, 1], s, fit.outlier),
    )
    return found, bool(np.all(np.abs(fit.values) < 0.05 * np.sqrt(np.diag(fit.covariance))))


def align_attitude(recording: _Recording, offset_s: float) -> AttitudeFit:
    """Clock, gyro and rotation of the tracked frame from attitudes and rates; up to five Gauss-Newton steps."""
    shifted, t_imu = recording.t_pose - offset_s, recording.t_imu
    kept = (shifted > t_imu[0] + 0.05) & (shifted < t_imu[-1] - 0.05)
    errors = _AttitudeErrors(offset_s, 0.0, np.zeros(3), np.zeros(3), np.zeros(3))
    found, done = _attitude_step(recording, errors, kept, None)
    for _ in range(4):
        if done:
            break
        found, done = _attitude_step(recording, found.errors, found.kept, found.colour)
    return found


def _twice(values: Array, dt: Array) -> tuple[Array, Array]:
    """Running integral and its running integral by the trapezoidal rule, shapes of ``values``."""
    mean = 0.5 * (values[1:] + values[:-1]) * dt[1:, None]
    speed = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(mean, axis=0)])
    path = 0.5 * (speed[1:] + speed[:-1]) * dt[1:, None]
    return speed, np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(path, axis=0)])


def _position_columns(
    recording: _Recording, attitude: AttitudeFit, tk: Array, velocity: Array, gravity_m_s2: float
) -> Array:
    """What each parameter in ``_POSITION`` changes of the positions, (n, 3, 10)."""
    t_imu = recording.t_imu
    _, biased = _twice(matrix_from_quat(attitude.smoothed).reshape(-1, 9), recording.dt_imu)
    elapsed = tk - tk[0]
    tilt = np.zeros((len(tk), 3, 2))
    tilt[:, 0, 1] = 0.5 * gravity_m_s2 * elapsed**2
    tilt[:, 1, 0] = -0.5 * gravity_m_s2 * elapsed**2
    return np.concatenate(
        [
            -velocity[:, :, None],
            (-velocity * (tk - recording.middle_s)[:, None])[:, :, None],
            -_interpolate(tk, t_imu, biased).reshape(-1, 3, 3),
            matrix_from_quat(slerp(tk, t_imu, attitude.smoothed)),
            tilt,
        ],
        axis=2,
    )


def _fitted_position(error: Array, columns: Array, dt: Array, noise: Array) -> tuple[Array, Array, Array, Array]:
    """Values, covariance, residual (n, 3) and noise after three rounds of fit and noise model."""
    count = columns.shape[2]
    prior = np.concatenate([_POSITION_PRIOR, _SCALE_PRIOR])[:count]
    values, covariance, residual = np.zeros(count), np.eye(count), error
    for _ in range(3):
        noise = _position_noise(residual, dt, noise)
        tight = noise.copy()
        tight[3] = 1e-3  # a constant acceleration is named (bias, tilt), not absorbed
        parts = [
            position_filter(np.concatenate([error[:, i : i + 1], columns[:, i, :]], axis=1), dt, tight)[:2]
            for i in range(3)
        ]
        e = np.concatenate([p[0] for p in parts])
        s = np.concatenate([p[1] for p in parts])
        fit = _whitened_fit(e[:, 0], e[:, 1:], s, prior)
        values, covariance = fit.values, fit.covariance
        residual = error - columns @ values
    return values, covariance, residual, noise


def align_position(
    recording: _Recording, attitude: AttitudeFit, gravity_m_s2: float, *, scale: bool = False
) -> PositionFit:
    """Accelerometer bias, lever arm and tilt of the world from positions and specific force; the poses' scale where asked."""
    t_imu = recording.t_imu
    tk = attitude.errors.stamps(recording, attitude.kept)
    dt = np.concatenate([[0.0], np.diff(tk)])
    force = np.einsum("nij,nj->ni", matrix_from_quat(attitude.smoothed), recording.accel)
    speed, path = _twice(force - np.array([0.0, 0.0, gravity_m_s2]), recording.dt_imu)
    error = recording.position[attitude.kept] - _interpolate(tk, t_imu, path)
    noise = _position_noise(error, dt)
    _, _, states, _, _ = position_filter(error, dt, noise)
    # from the past alone: a velocity or place that knows this pose's noise would pull clock and scale towards it
    expected = states[:-1, 1, :] + dt[1:, None] * states[:-1, 2, :]
    velocity = _interpolate(tk, t_imu, speed) + np.concatenate([states[:1, 1, :], expected])
    columns = _position_columns(recording, attitude, tk, velocity, gravity_m_s2)
    if scale:
        ahead = states[:-1, 0, :] + dt[1:, None] * states[:-1, 1, :] + 0.5 * dt[1:, None] ** 2 * states[:-1, 2, :]
        place = _interpolate(tk, t_imu, path) + np.concatenate([states[:1, 0, :], ahead])
        _, felt = _twice(force, recording.dt_imu)
        both = np.stack([place - place.mean(axis=0), -_interpolate(tk, t_imu, felt)], axis=2)
        columns = np.concatenate([columns, both], axis=2)
    values, covariance, residual, noise = _fitted_position(error, columns, dt, noise)
    _, _, states, pf, pp = position_filter(residual, dt, noise)
    smooth = position_smoother(dt, states, pf, pp)
    named = columns.copy()
    named[:, :, _CLOCK] = 0.0  # clock terms move stamps, not the vehicle
    named[:, :, _LEVER] = 0.0  # neither does the lever arm
    named[:, :, len(_POSITION) : len(_POSITION) + 1] = 0.0  # nor the poses' scale
    shift = named @ values
    slope = np.gradient(shift, tk, axis=0) if len(tk) > 2 else np.zeros_like(shift)

    def motion(found: Array) -> tuple[Array, Array]:
        return (
            _interpolate(t_imu, tk, found[:, 0, :] + shift) + path,
            _interpolate(t_imu, tk, found[:, 1, :] + slope) + speed,
        )

    return PositionFit(values, covariance, noise, causal=motion(states), smoothed=motion(smooth))


def _stamp_jitter(residual: Array, turning: Array, variance: Array, outlier: Mask) -> tuple[float, float]:
    """Jitter of the pose stamps and its standard deviation: by how much attitudes are noisier the faster they turn.

    A stamp that is d late moves an attitude by its rate times d. So squared innovations, in units of their variance, are regressed on the
    squared rate (Breusch and Pagan 1979).

    Args:
        residual, turning, variance: innovations of the attitude and of its derivative by the clock, and their variance, (rows,).
    """
    good = np.isfinite(variance) & ~outlier
    y, x = residual[good] ** 2 / variance[good], turning[good] ** 2 / variance[good]
    x = x - np.mean(x)
    square = float(x @ y / (x @ x))
    spread = float(np.sqrt(np.mean((y - np.mean(y) - square * x) ** 2) / (x @ x)))
    jitter = np.sqrt(max(square, 0.0))
    return float(jitter), float(np.sqrt(jitter**2 + spread) - jitter)


# No capture system resolves less than a micrometre; a simulated one without noise must not make the filter singular.
_FINEST = np.array([1e-6, 1e-5, 1e-5])
_COARSEST = np.array([1e2, 1e3, 1e3])
"""Metres of pose noise, and g of acceleration over a second: nothing that is measured is worse."""
_STEPS = 20
"""Of the search for the noise of positions."""
INITIAL_M_S2 = 0.3
"""What of an acceleration is unknown at first."""


def _local_noise(residual: Array, dt: Array, restart: Mask, start: NoiseModel | None = None) -> NoiseModel:
    """Random walk and capture noise of the attitude error (no slower disturbance)."""
    fitted = fit_noise_model(residual, dt, restart, integrated=True, start=start)
    return fitted


def _position_noise(error: Array, dt: Array, start: Array | None = None) -> Array:
    """Most likely (pose noise, white acceleration, acceleration walk, initial acceleration) of position errors."""
    if start is None:
        third = np.diff(error, 3, axis=0)
        rough = float(np.median(np.abs(third)) / 0.6745 / np.sqrt(20.0)) + 1e-7
        start = np.array([rough, 0.01, 0.01, 0.3])
    series = np.ascontiguousarray(error)

    def costs(points: Array) -> Array:
        noises = np.column_stack([np.exp(points), np.full(len(points), INITIAL_M_S2)])
        parts = [position_costs(series, dt, noises[i : i + LANES]) for i in range(0, len(noises), LANES)]
        return np.concatenate(parts)

    found, _ = minimum(costs, np.log(start[:3]), np.log(_FINEST), np.log(_COARSEST), _STEPS)
    return np.array([*np.exp(found), INITIAL_M_S2])


SHARED = 0.5
"""Correlation of the clock read from attitudes and from positions: between none and all, as the gyro drifts little or much."""


def _combine(
    attitude: Array, p_attitude: Array, position: Array, p_position: Array, offset: float
) -> tuple[tuple[str, ...], Array, Array]:
    """Join both fits; the clock is in both (attitude as a value, position as a correction to it) and is weighted."""
    w_a, w_p = np.linalg.inv(p_attitude[:2, :2]), np.linalg.inv(p_position[:2, :2])
    covariance_clock = np.linalg.inv(w_a + w_p)
    clock = attitude[:2] + covariance_clock @ (w_p @ position[:2])
    # The path is integrated along attitudes that were smoothed on the attitude's own clock: the two share part of their error.
    half_a, half_p = np.linalg.cholesky(p_attitude[:2, :2]), np.linalg.cholesky(p_position[:2, :2])
    cross = covariance_clock @ w_a @ (SHARED * half_a @ half_p.T) @ w_p @ covariance_clock
    # Gyro and accelerometer chains may lag differently: where the two disagree, the interval says so (Birge ratio).
    disagreement = position[:2] @ np.linalg.solve(p_attitude[:2, :2] + p_position[:2, :2], position[:2]) / 2.0
    covariance_clock = covariance_clock * max(1.0, float(disagreement)) + cross + cross.T
    names = (*_ATTITUDE, *_POSITION[2:], *_SCALES[: len(position) - len(_POSITION)])
    theta = np.concatenate([clock, attitude[2:], position[2:]])
    covariance = np.zeros((len(names), len(names)))
    na = len(_ATTITUDE)
    covariance[2:na, 2:na] = p_attitude[2:, 2:]
    covariance[na:, na:] = p_position[2:, 2:]
    covariance[:2, :2] = covariance_clock
    return names, theta, covariance


def body_motion(
    compatibility: Compatibility, rate: Array, imu_position_m: Array, *, causal: bool = False
) -> tuple[Array, Array, Array]:
    """Attitude, position and velocity of the declared origin from those of the IMU: p - R r, v - R (omega x r)."""
    q = compatibility.causal_quaternion if causal else compatibility.quaternion
    p = compatibility.causal_position_m if causal else compatibility.position_m
    v = compatibility.causal_velocity_m_s if causal else compatibility.velocity_m_s
    return q, p - quat_rotate(q, imu_position_m), v - quat_rotate(q, np.cross(rate, imu_position_m))
