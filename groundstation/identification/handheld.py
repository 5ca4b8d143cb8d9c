r"""Calibration by hand: how the marker body sits on the IMU, from half a minute of carrying and turning the vehicle.

Kinematics alone, as for a flight (:mod:`groundstation.identification.reconstruction`), but nothing is known beforehand:

1. *Clock*: the offset at which poses and gyro turn equally fast, whatever their axes.
2. *Axes*: with w the gyro's rates and m those of the marker body's attitudes, the rotation that minimises
   :math:`\sum |w - R m|^2` (Wahba 1965), by the singular values of :math:`\sum w m^T` (Markley 1988). Positions must
   accelerate as the specific force says under it: where the best orthogonal map is no rotation, the poses are mirrored.
3. *Up*: the mean specific force, turned into the poses' world: a hand that goes nowhere for long carries g upwards.
4. From there the whitened least squares of the reconstruction: offset, rotation, clock, tilt, and the scale of the
   poses against the accelerometer, with standard deviations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import NotIdentifiable, Refused
from groundstation.flightdata import resampled
from groundstation.frames import matrix_from_quat, quat_exp, quat_from_matrix, quat_log, quat_multiply, quat_rotate
from groundstation.identification.attitude_fit import Recording
from groundstation.identification.clock import coarse_offset_by_size, rates_from_attitude
from groundstation.identification.reconstruction import Compatibility, reconstruct
from groundstation.linear_filters import both_ways, low_pass

Array = NDArray[np.float64]

LEAST_S = 8.0
LEAST_TURNING_RAD_S = 0.25
"""Root mean square of the rates about the second axis: a slow turn of the wrist; less tells no rotation."""
CLEARLY = 0.05
"""Share of the strongest acceleration that the weakest axis must have before a mirror is named: less is noise."""
_CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])
AXES_SCALE = 0.005
"""Standard deviation of each accelerometer axis's own scale, of which the fit knows their mean alone."""
UPRIGHT_RAD = 0.2
"""A calibration square is laid to within a degree or two; an angle beyond 11 degrees is another axis."""


@dataclass(frozen=True, slots=True)
class HandCalibration:
    """How the marker body sits on the IMU. Lengths in m, angles in rad, body axes.

    Attributes:
        position_m, position_std_m: the marker body's origin from the IMU, in the body.
        rotation_rad, rotation_std_rad: rotation vector that takes the marker body's axes to the body's.
        tilt_rad, tilt_std_rad: of the poses' world against gravity, about x and y.
        scale, scale_std: the poses' metre in true metres, less one; against the accelerometer.
        mocap_minus_imu_s, clock_std_s: pose stamp minus IMU stamp of one instant.
        drift: of that offset, s per s.
        residual_m, residual_rad: white noise of positions and attitudes.
        moved_m, turned_rad: how far it was carried (rms) and turned (largest) while it was measured.
        seconds: how long.
    """

    position_m: Array
    position_std_m: Array
    rotation_rad: Array
    rotation_std_rad: Array
    tilt_rad: Array
    tilt_std_rad: Array
    scale: float
    scale_std: float
    mocap_minus_imu_s: float
    clock_std_s: float
    drift: float
    residual_m: float
    residual_rad: float
    moved_m: float
    turned_rad: float
    seconds: float


def calibrate_by_hand(
    imu: tuple[Array, Array, Array],
    poses: tuple[Array, Array, Array],
    *,
    expected_s: float | None = None,
    gravity_m_s2: float = 9.80665,
) -> HandCalibration:
    """Calibrate from one recording of carrying and turning.

    Args:
        imu: stamps (k,), gyro (k, 3), accelerometer (k, 3).
        poses: stamps (m,), positions (m, 3), quaternions (m, 4) of the marker body.
        expected_s: pose stamp minus IMU stamp of one instant, by arrivals; None takes both records to begin together.

    Raises:
        NotIdentifiable: too short, or turned about one axis at most.
        Refused: mirrored poses, an axis other than z that points up, or streams that share no motion.
    """
    (t_imu, gyro, accel), (t_pose, position, quaternion) = imu, poses
    seconds = min(t_imu[-1] - t_imu[0], t_pose[-1] - t_pose[0]) if min(len(t_imu), len(t_pose)) > 1 else 0.0
    if seconds < LEAST_S:
        raise NotIdentifiable(
            f"only {seconds:.0f} s were recorded, {LEAST_S:.0f} s is the least.", "Carry it for 30 s."
        )
    around = float(t_pose[0] - t_imu[0]) if expected_s is None else expected_s
    coarse, _ = coarse_offset_by_size(t_imu, gyro, t_pose, quaternion, expected_s=around)
    marker = marker_axes(t_imu, gyro, t_pose - coarse, quaternion)
    refuse_mirrored(t_imu, accel, (t_pose - coarse, position, quaternion), marker)
    refuse_other_up(t_imu, accel, t_pose - coarse, quaternion, marker)
    recording = Recording(t_imu, gyro, accel, t_pose, position, quaternion, quat_log(marker))
    found = reconstruct(recording, offset_s=coarse, gravity_m_s2=gravity_m_s2, scale=True)
    return _result(found, marker, position, quaternion, float(seconds))


def marker_axes(t_gyro: Array, gyro: Array, t_pose: Array, quaternion: Array) -> Array:
    """Quaternion that takes the marker body's axes to the gyro's, from rates of one clock, shape (4,).

    Raises:
        NotIdentifiable: turned about one axis at most.
    """
    rates, middle = rates_from_attitude(t_pose, quaternion)
    step = float(np.median(np.diff(t_pose)))
    good = np.diff(t_pose) < 3.0 * step
    w, m = resampled(middle[good], t_gyro, _smoothed(t_gyro, gyro)), _smoothed(middle[good], rates[good])
    w, m = w - w.mean(axis=0), m - m.mean(axis=0)
    u, spread, vt = np.linalg.svd(w.T @ m / len(w))
    if np.sqrt(spread[1]) < LEAST_TURNING_RAD_S:
        raise NotIdentifiable(
            "it was turned about one axis at most, which does not tell how the marker body is mounted.",
            "Turn it about all three axes, by 30 degrees and more.",
        )
    proper = u @ np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ vt)))]) @ vt
    return quat_from_matrix(proper)


def refuse_mirrored(t_imu: Array, accel: Array, poses: tuple[Array, Array, Array], marker: Array) -> None:
    """Check that positions accelerate as the specific force says: a mirror turns attitudes into rotations again, but
    not these.

    Raises:
        Refused: the best orthogonal map between both is no rotation.
    """
    t, position, quaternion = poses
    force = quat_rotate(quat_multiply(quaternion, marker * _CONJUGATE), resampled(t, t_imu, accel))
    speed = np.gradient(_smoothed(t, position), t, axis=0)
    a, f = _smoothed(t, np.gradient(speed, t, axis=0)), _smoothed(t, force)
    ends = slice(len(t) // 20, -len(t) // 20)
    a, f = a[ends] - a[ends].mean(axis=0), f[ends] - f[ends].mean(axis=0)
    u, spread, vt = np.linalg.svd(a.T @ f / len(a))
    if np.linalg.det(u @ vt) < 0.0 and spread[2] > CLEARLY * spread[0]:
        raise Refused(
            "the poses are mirrored: they move as the vehicle does in a mirror.",
            "Make the capture system's world right-handed: swap two axes or negate one in its streaming settings.",
        )


def refuse_other_up(t_imu: Array, accel: Array, t_pose: Array, quaternion: Array, marker: Array) -> None:
    """Check that gravity points down the poses' z.

    Raises:
        Refused: another axis points up, with the line to write where it is y.
    """
    up = up_axis(t_imu, accel, t_pose, quaternion, marker)
    if np.arccos(np.clip(up[2], -1.0, 1.0)) < UPRIGHT_RAD:
        return
    if np.arccos(np.clip(up[1], -1.0, 1.0)) < UPRIGHT_RAD:
        raise Refused("the poses' y axis points up.", 'Write `up = "y"` under [mocap] in the station file.')
    raise Refused(
        f"gravity points along {(-up).round(2).tolist()} of the poses' world, which is none of its axes.",
        "Lay the capture system's ground plane again, with z up.",
    )


def up_axis(t_imu: Array, accel: Array, t_pose: Array, quaternion: Array, marker: Array) -> Array:
    """Unit vector of the mean specific force in the poses' world, shape (3,)."""
    inside = (t_pose > t_imu[0]) & (t_pose < t_imu[-1])
    force = resampled(t_pose[inside], t_imu, accel)
    mean = quat_rotate(quat_multiply(quaternion[inside], marker * _CONJUGATE), force).mean(axis=0)
    return mean / max(float(np.linalg.norm(mean)), 1e-9)


def _smoothed(t: Array, values: Array) -> Array:
    """Below 5 Hz, where hands move and differences of attitudes are not all noise."""
    rate_hz = 1.0 / float(np.median(np.diff(t)))
    return both_ways(low_pass(2, min(5.0, 0.2 * rate_hz), rate_hz), values)


def _result(found: Compatibility, marker: Array, position: Array, quaternion: Array, seconds: float) -> HandCalibration:
    def of(name: str, axes: str, unit: str) -> tuple[Array, Array]:
        keys = [f"mocap_{name}_{axis}_{unit}" for axis in axes]
        return np.array([found.values[k] for k in keys]), np.array([found.std[k] for k in keys])

    lever, lever_std = of("position", "xyz", "m")
    turn, turn_std = of("rotation", "xyz", "rad")
    tilt, tilt_std = of("tilt", "xy", "rad")
    step = matrix_from_quat(quaternion)
    away: Array = np.sum((position - position.mean(axis=0)) ** 2, axis=1)
    angles = np.arccos(np.clip(0.5 * (np.einsum("kij,ij->k", step, step[0]) - 1.0), -1.0, 1.0))
    return HandCalibration(
        position_m=lever, position_std_m=lever_std,
        rotation_rad=quat_log(quat_multiply(marker, quat_exp(turn))), rotation_std_rad=turn_std,
        tilt_rad=-tilt, tilt_std_rad=tilt_std,
        scale=found.values["mocap_scale"],
        scale_std=float(np.hypot(found.std["mocap_scale"], AXES_SCALE)),
        mocap_minus_imu_s=found.values["mocap_minus_imu_s"], clock_std_s=found.std["mocap_minus_imu_s"],
        drift=found.values["clock_drift"],
        residual_m=found.pose_noise[0], residual_rad=found.pose_noise[1],
        moved_m=float(np.sqrt(np.mean(away))),
        turned_rad=float(np.max(angles)), seconds=seconds,
    )  # fmt: skip
