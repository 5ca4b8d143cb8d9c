"""Flight-path reconstruction: do gyro and attitude, accelerometer and position agree, and what made them differ.

Kinematics alone, no force model (Klein and Morelli, Aircraft System Identification, ch. 10). The gyro is integrated to
an attitude and the specific force to a position; what separates them from motion capture is linear in small errors:
clock offset and drift, gyro and accelerometer bias, gyro scale, misalignment of the marker body, lever arm, tilt of
the capture volume. The rest is integrated sensor noise plus capture noise: a Kalman filter whitens both sides, and
least squares on the innovations gives values with honest standard deviations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from groundstation.frames import quat_normalise, quat_rotate
from groundstation.identification.attitude_fit import ATTITUDE, ATTITUDE_PRIOR, Recording, align_attitude
from groundstation.identification.parts import by_parts
from groundstation.identification.position_fit import POSITION, POSITION_PRIOR, SCALE_PRIOR, SCALES, align_position

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Compatibility:
    """What motion capture and IMU agree on.

    Attributes:
        values, std: kinematic errors by name (``mocap_minus_imu_s``, ``gyro_bias_x_rad_s``, ``mocap_rotation_x_rad``
            ...). Beside those of ``names``: ``stamp_jitter_s`` of the poses.
        covariance: of ``names`` in order.
        revealed: those of ``names`` that the flight tells at least twice as well as was known beforehand.
        kept: poses used, shape (poses,).
        quaternion: smoothed attitude of the body at the IMU's stamps, (k, 4); ``causal_quaternion`` is the filter's.
        position_m, velocity_m_s: of the IMU in the world, smoothed, (k, 3); ``causal_*`` likewise.
        pose_noise: white noise of positions (m) and attitudes (rad), standard deviations.
        accel_walk: by which accelerations walk beside the biases, m/s^2 per root of a second.
    """

    names: tuple[str, ...]
    values: Mapping[str, float]
    std: Mapping[str, float]
    covariance: Annotated[Array, "e e"]
    kept: Annotated[Mask, "poses"]
    quaternion: Annotated[Array, "k 4"]
    position_m: Annotated[Array, "k 3"]
    velocity_m_s: Annotated[Array, "k 3"]
    causal_quaternion: Annotated[Array, "k 4"]
    causal_position_m: Annotated[Array, "k 3"]
    causal_velocity_m_s: Annotated[Array, "k 3"]
    revealed: tuple[str, ...]
    pose_noise: tuple[float, float] = (0.0, 0.0)
    accel_walk: float = 0.0

    def without_path(self) -> Compatibility:
        """The numbers alone, where the path of the declared origin is held beside them: it is as long as the flight."""
        none = self.position_m[:0]
        return replace(
            self,
            quaternion=self.quaternion[:0],
            position_m=none,
            velocity_m_s=none,
            causal_quaternion=self.quaternion[:0],
            causal_position_m=none,
            causal_velocity_m_s=none,
        )


def reconstruct(recording: Recording, *, offset_s: float, gravity_m_s2: float, scale: bool = False) -> Compatibility:
    """Estimate the kinematic errors of a flight and its smoothed motion.

    Args:
        recording: IMU and poses.
        offset_s: coarse pose stamp minus IMU stamp.
        scale: also estimate the scales of poses and accelerometer (``mocap_scale``, ``accel_scale``), as shares.
    """
    attitude = align_attitude(recording, offset_s)
    found = align_position(recording, attitude, gravity_m_s2, scale=scale)
    errors = attitude.errors
    names, theta, covariance = _combine(
        np.array([errors.offset_s, errors.drift, *errors.gyro_bias, *errors.rotation, *errors.gyro_scale]),
        attitude.covariance,
        found.values,
        found.covariance,
    )
    std = np.sqrt(np.diag(covariance))
    prior = np.concatenate([ATTITUDE_PRIOR, POSITION_PRIOR[2:], SCALE_PRIOR])[: len(names)]
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
        accel_walk=float(found.noise[2]),
    )


def _combine(
    attitude: Array, p_attitude: Array, position: Array, p_position: Array
) -> tuple[tuple[str, ...], Array, Array]:
    """Join both fits; the clock is in both (attitude as a value, position as a correction to it).

    The path is integrated along attitudes that follow the poses in the frequencies of a flight. Attitudes that come
    late by d make a path that comes late by d (g theta is integrated twice), so that the correction tells nothing of
    the clock: the attitude's stands.
    """
    # Gyro and accelerometer chains may lag differently: where the correction is more than noise, the interval says so
    # (Birge ratio).
    disagreement = position[:2] @ np.linalg.solve(p_position[:2, :2], position[:2]) / 2.0
    names = (*ATTITUDE, *POSITION[2:], *SCALES[: len(position) - len(POSITION)])
    theta = np.concatenate([attitude, position[2:]])
    covariance = np.zeros((len(names), len(names)))
    na = len(ATTITUDE)
    covariance[2:na, 2:na] = p_attitude[2:, 2:]
    covariance[na:, na:] = p_position[2:, 2:]
    covariance[:2, :2] = p_attitude[:2, :2] * max(1.0, float(disagreement))
    return names, theta, covariance


def body_motion(
    compatibility: Compatibility, rate: Array, imu_position_m: Array, *, causal: bool = False
) -> tuple[Array, Array, Array]:
    """Attitude, position and velocity of the declared origin from those of the IMU: p - R r, v - R (omega x r)."""
    q = compatibility.causal_quaternion if causal else compatibility.quaternion
    p = compatibility.causal_position_m if causal else compatibility.position_m
    v = compatibility.causal_velocity_m_s if causal else compatibility.velocity_m_s
    if not np.any(imu_position_m):
        return q, p, v

    def beside(part: slice) -> Array:
        return p[part] - quat_rotate(q[part], imu_position_m)

    def slower(part: slice) -> Array:
        return v[part] - quat_rotate(q[part], np.cross(rate[part], imu_position_m))

    return q, by_parts(beside, len(q)), by_parts(slower, len(q))
