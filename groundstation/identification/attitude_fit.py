"""The first act of a flight-path reconstruction: the integrated gyro against the attitudes of motion capture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from groundstation.flightdata import resampled
from groundstation.frames import matrix_from_quat, quat_conjugate, quat_exp, quat_log, quat_multiply, slerp
from groundstation.identification.noise import NoiseModel, early_noise_model, innovations
from groundstation.identification.parts import at_times, by_parts, running_sums, weighted_products
from groundstation.identification.smoothing import integrate_rates, integrated_level
from groundstation.identification.stretches import gaps, parts_of, within

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ATTITUDE = (
    "mocap_minus_imu_s", "clock_drift",
    "gyro_bias_x_rad_s", "gyro_bias_y_rad_s", "gyro_bias_z_rad_s",
    "mocap_rotation_x_rad", "mocap_rotation_y_rad", "mocap_rotation_z_rad",
    "gyro_scale_x", "gyro_scale_y", "gyro_scale_z",
)  # fmt: skip
ATTITUDE_PRIOR = np.array([0.2, 3e-3, *[0.3] * 3, *[0.3] * 3, *[0.05] * 3])
# Columns of the linear fit, by what they stand for.
_GYRO_BIAS, _ROTATION, _GYRO_SCALE = slice(2, 5), slice(5, 8), slice(8, 11)


@dataclass(frozen=True, slots=True)
class Recording:
    """What is compared: IMU and poses of one flight, each on its own clock.

    Attributes:
        t_imu: stamps, (k,); gyro and accel, (k, 3).
        t_pose: stamps, (m,); position (m, 3) and quaternion (m, 4) of the marker body.
        mocap_rotation_rad: declared rotation vector from the body to the marker frame.
    """

    t_imu: Array
    gyro: Array
    accel: Array
    t_pose: Array
    position: Array
    quaternion: Array
    mocap_rotation_rad: Array

    @property
    def alignment(self) -> Array:
        """Quaternion of the marker body's declared rotation, (4,)."""
        return quat_exp(self.mocap_rotation_rad)

    @property
    def middle_s(self) -> float:
        """Middle of the IMU's stamps, about which the clock drifts."""
        return 0.5 * (self.t_imu[0] + self.t_imu[-1])

    @property
    def dt_imu(self) -> Array:
        """Before each IMU sample, (k,)."""
        return np.concatenate([[0.0], np.diff(self.t_imu)])


_UNKNOWN_S = 1e12
"""Between poses on both sides of a gap of the IMU: how far the vehicle turned there is not known."""


def beside_gaps(recording: Recording, tk: Array) -> list[tuple[slice, slice]]:
    """The IMU's samples between one gap and the next, and the poses at these stamps that lie among them.

    What the IMU did not see is no part of its integrals: each part has a beginning of its own.
    """
    parts = parts_of(recording.t_imu)
    edges = [0, *np.searchsorted(tk, recording.t_imu[[part.start for part in parts[1:]]]).tolist(), len(tk)]
    found = [(part, slice(first, last)) for part, (first, last) in zip(parts, pairwise(edges), strict=True)]
    return found if len(found) == 1 else _with_poses(found)


def _with_poses(parts: Sequence[tuple[slice, slice]]) -> list[tuple[slice, slice]]:
    """Parts without poses joined to the one before, or to the one after the first."""
    joined: list[tuple[slice, slice]] = []
    for samples, poses in parts:
        if joined and (poses.start == poses.stop or joined[-1][1].start == joined[-1][1].stop):
            before = joined.pop()
            samples, poses = slice(before[0].start, samples.stop), slice(before[1].start, poses.stop)
        joined.append((samples, poses))
    return joined


@dataclass(frozen=True, slots=True)
class WhitenedFit:
    """Values (P,), their covariance (P, P), and which innovations are outliers, (n,)."""

    values: Array
    covariance: Array
    outlier: Mask


def whitened_fit(e: Array, columns: Array, variance: Array, prior_std: Array) -> WhitenedFit:
    """Huber-weighted least squares of innovations on innovations of regressors, with zero-mean priors."""
    keep = np.isfinite(variance)
    scale = np.sqrt(np.where(keep, variance, 1.0))
    y = np.where(keep, e / scale, 0.0)
    x = by_parts(lambda part: np.where(keep[part, None], columns[part] / scale[part, None], 0.0), len(columns))
    weight = np.ones(len(y))
    theta = np.zeros(x.shape[1])
    information = normal = np.diag(1.0 / prior_std**2)
    for _ in range(6):
        normal = weighted_products(x, weight) + information
        theta = np.linalg.solve(normal, x.T @ (weight * y))
        size = np.abs(y - x @ theta)
        weight = np.minimum(1.0, 2.5 / np.maximum(size, 1e-12))
    residual = y - x @ theta
    inverse = np.asarray(np.linalg.inv(normal), dtype=float)
    # Stamps jitter, so a pose is noisier the faster it moves: the spread of each row is its own (White 1980).
    x *= (weight * residual)[:, None]
    return WhitenedFit(
        np.asarray(theta, dtype=float),
        inverse @ (weighted_products(x) + information) @ inverse,
        keep & (np.abs(residual) > 6.0),
    )


@dataclass(frozen=True, slots=True)
class AttitudeErrors:
    """Errors that the attitudes show: pose clock, gyro bias and scale (3,), rotation of the tracked frame (3,)."""

    offset_s: float
    drift: float
    gyro_bias: Array
    rotation: Array
    gyro_scale: Array

    def stamps(self, recording: Recording, kept: Mask) -> Array:
        """Of the poses that are kept, on the IMU's clock."""
        t = recording.t_pose[kept]
        return t - self.offset_s - self.drift * (t - self.offset_s - recording.middle_s)

    def changed(self, step: Array) -> AttitudeErrors:
        """After a step of the fit, (11,)."""
        return AttitudeErrors(
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

    errors: AttitudeErrors
    covariance: Array
    kept: Mask
    colour: NoiseModel
    filtered: Array
    smoothed: Array
    stamp_jitter_s: tuple[float, float]


def _attitude_columns(recording: Recording, errors: AttitudeErrors, tk: Array, attitude: Array, rates: Array) -> Array:
    """What each error changes of the attitude at the poses' stamps, (n, 3, 11)."""
    t_imu, dt_imu, count = recording.t_imu, recording.dt_imu[:, None, None], len(attitude)

    def grown(part: slice) -> Array:
        """By drift and by scale, (n, 18)."""
        matrix = matrix_from_quat(attitude[part])
        both = matrix * dt_imu[part], matrix * rates[part, None, :] * dt_imu[part]
        return np.concatenate([each.reshape(-1, 9) for each in both], axis=1)

    drifted, scaled = np.hsplit(at_times(running_sums(grown, count), t_imu, tk), 2)
    r_poses = matrix_from_quat(slerp(tk, t_imu, attitude))
    rate_world = np.einsum("nij,nj->ni", r_poses, resampled(tk, t_imu, rates))
    return np.concatenate(
        [
            -rate_world[:, :, None],
            (-rate_world * (tk - recording.middle_s)[:, None])[:, :, None],
            -drifted.reshape(-1, 3, 3),
            r_poses @ matrix_from_quat(recording.alignment),  # the rotation is about the marker frame's declared axes
            -scaled.reshape(-1, 3, 3),
        ],
        axis=2,
    )


def _compared_attitudes(
    recording: Recording, errors: AttitudeErrors, kept: Mask, tk: Array
) -> tuple[Array, Array, Array]:
    """Attitude by the rates (k, 4), its error against the poses (n, 3), and the columns of the errors (n, 3, 11)."""
    t_imu = recording.t_imu
    marker = quat_multiply(recording.alignment, quat_exp(errors.rotation))
    body = quat_multiply(recording.quaternion[kept], quat_conjugate(marker))
    rates = (recording.gyro - errors.gyro_bias) / (1.0 + errors.gyro_scale)
    rough = integrate_rates(np.array([1.0, 0.0, 0.0, 0.0]), recording.dt_imu, rates)
    turned: list[Array] = []
    for samples, poses in beside_gaps(recording, tk):
        at_first = slerp(tk[poses][:1], t_imu, rough)[0]
        turn = quat_multiply(body[poses.start], quat_conjugate(at_first))
        own = rough[samples]
        turned.append(by_parts(lambda part, turn=turn, own=own: quat_multiply(turn, own[part]), len(own)))
    attitude = turned[0] if len(turned) == 1 else np.concatenate(turned)
    error = quat_log(quat_multiply(body, quat_conjugate(slerp(tk, t_imu, attitude))))
    return attitude, error, _attitude_columns(recording, errors, tk, attitude, rates)


@dataclass(frozen=True, slots=True)
class _Step:
    """A step of the fit: as :class:`AttitudeFit`, whose paths are worked out where they are asked for."""

    errors: AttitudeErrors
    covariance: Array
    kept: Mask
    colour: NoiseModel
    stamp_jitter_s: tuple[float, float]
    paths: Callable[[], tuple[Array, Array]]

    def fit(self) -> AttitudeFit:
        """With its paths."""
        filtered, smoothed = self.paths()
        return AttitudeFit(
            self.errors, self.covariance, self.kept, self.colour, filtered, smoothed, self.stamp_jitter_s
        )


def _attitude_step(
    recording: Recording, errors: AttitudeErrors, kept: Mask, colour: NoiseModel | None
) -> tuple[_Step, bool]:
    """One Gauss-Newton step, and whether it was within a twentieth of the standard deviations."""
    tk = errors.stamps(recording, kept)
    attitude, error, columns = _compared_attitudes(recording, errors, kept, tk)
    dt = np.concatenate([[0.0], np.diff(tk)])
    count = len(tk)
    stacked = np.concatenate([error.T.reshape(-1, 1), columns.transpose(1, 0, 2).reshape(3 * count, -1)], axis=1)
    fresh = np.zeros(count, dtype=bool)
    fresh[[poses.start for _, poses in beside_gaps(recording, tk)]] = True
    restart = np.tile(fresh, 3)
    dts = np.tile(dt, 3)
    if colour is None:
        colour = early_noise_model(stacked[:, 0], dts, restart, integrated=True)
    e, s = innovations(stacked, dts, restart, colour, integrated=True)
    fit = whitened_fit(e[:, 0], e[:, 1:], s, ATTITUDE_PRIOR)
    bad = fit.outlier.reshape(3, count).any(axis=0)
    remainder = stacked[:, 0] - stacked[:, 1:] @ fit.values
    kept = kept.copy()
    kept[np.flatnonzero(kept)[bad]] = False

    def paths() -> tuple[Array, Array]:
        good = ~bad
        dt_good, beside = np.concatenate([[0.0], np.diff(tk[good])]), beside_gaps(recording, tk[good])
        dt_good[[poses.start for _, poses in beside[1:]]] = _UNKNOWN_S
        levels = integrated_level(remainder.reshape(3, count).T[good], dt_good, colour.vector())
        filtered, smoothed = (_turned(recording.t_imu, tk[good], level, attitude, beside) for level in levels)
        return filtered, smoothed

    found = _Step(
        errors=errors.changed(fit.values),
        covariance=fit.covariance,
        kept=kept,
        colour=early_noise_model(remainder, dts, restart, integrated=True, start=colour),
        stamp_jitter_s=_stamp_jitter(e[:, 0] - e[:, 1:] @ fit.values, e[:, 1], s, fit.outlier),
        paths=paths,
    )
    return found, bool(np.all(np.abs(fit.values) < 0.05 * np.sqrt(np.diag(fit.covariance))))


def _turned(t_imu: Array, tk: Array, by: Array, attitude: Array, beside: Sequence[tuple[slice, slice]]) -> Array:
    """Attitudes (k, 4) turned by rotation vectors (n, 3) that are known at the poses' stamps."""

    def of(samples: slice, poses: slice) -> Array:
        t, own, at, turn = t_imu[samples], attitude[samples], tk[poses], by[poses]
        return by_parts(lambda part: quat_multiply(quat_exp(resampled(t[part], at, turn)), own[part]), len(own))

    found = [of(samples, poses) for samples, poses in beside]
    return found[0] if len(found) == 1 else np.concatenate(found)


def align_attitude(recording: Recording, offset_s: float) -> AttitudeFit:
    """Clock, gyro and rotation of the tracked frame from attitudes and rates; up to five Gauss-Newton steps."""
    shifted, t_imu = recording.t_pose - offset_s, recording.t_imu
    kept = (shifted > t_imu[0] + 0.05) & (shifted < t_imu[-1] - 0.05) & ~within(shifted, gaps(t_imu), (0.05, 0.05))
    errors = AttitudeErrors(offset_s, 0.0, np.zeros(3), np.zeros(3), np.zeros(3))
    found, done = _attitude_step(recording, errors, kept, None)
    for _ in range(4):
        if done:
            break
        found, done = _attitude_step(recording, found.errors, found.kept, found.colour)
    return found.fit()


def _stamp_jitter(residual: Array, turning: Array, variance: Array, outlier: Mask) -> tuple[float, float]:
    """Jitter of the pose stamps and its standard deviation: by how much attitudes are noisier the faster they turn.

    A stamp that is d late moves an attitude by its rate times d. So squared innovations, in units of their variance,
    are regressed on the squared rate (Breusch and Pagan 1979).

    Args:
        residual, turning, variance: innovations of the attitude and of its derivative by the clock, and their variance,
            (rows,).
    """
    good = np.isfinite(variance) & ~outlier
    y, x = residual[good] ** 2 / variance[good], turning[good] ** 2 / variance[good]
    x = x - np.mean(x)
    square = float(x @ y / (x @ x))
    spread = float(np.sqrt(np.mean((y - np.mean(y) - square * x) ** 2) / (x @ x)))
    jitter = np.sqrt(max(square, 0.0))
    return float(jitter), float(np.sqrt(jitter**2 + spread) - jitter)
