"""From a calibrated marker body's pose to that of the vehicle's declared tracked point. Pure."""

from __future__ import annotations

import numpy as np

from drivers.mavlink.geometry import rotate
from drivers.samples import Pose, Quaternion, Vector3
from groundstation.flight.station import MarkerCalibration
from groundstation.frames import quat_conjugate, quat_exp, quat_multiply
from groundstation.vehicle import Vehicle


class Mounting:
    r"""Undoes what the calibration found, so that everything after sees the vehicle as its file declares it.

    With W the tilt of the poses' world, s their scale, M the rotation from the marker body's axes to the body's and r
    its origin from the IMU: :math:`q = W^* q_m M^*`, :math:`p_{imu} = W^T p_m / (1 + s) - R(q) r`; then the declared
    tracked point and marker axes of the vehicle file are put in their place.
    """

    def __init__(self, calibration: MarkerCalibration, vehicle: Vehicle):
        declared = quat_exp(np.asarray(vehicle.mocap.rotation_rad))
        marker = quat_multiply(quat_conjugate(quat_exp(np.asarray(calibration.rotation_rad))), declared)
        self._upright = _quaternion(quat_conjugate(quat_exp(np.array([*calibration.tilt_rad, 0.0]))))
        self._marker = _quaternion(marker)
        self._back = _quaternion(quat_conjugate(declared))
        self._shorter = 1.0 / (1.0 + calibration.scale)
        x, y, z = (
            tracked - imu - offset
            for tracked, imu, offset in zip(
                vehicle.mocap.position_m, vehicle.imu.position_m, calibration.position_m, strict=True
            )
        )
        self._shift: Vector3 = (x, y, z)

    def corrected(self, pose: Pose) -> Pose:
        """The pose as the declared marker body would have given it."""
        x, y, z = rotate(self._upright, pose.position_m)
        attitude = product(product(self._upright, pose.quaternion), self._marker)
        a, b, c = rotate(product(attitude, self._back), self._shift)
        k = self._shorter
        return Pose(pose.device_s, (k * x + a, k * y + b, k * z + c), attitude)


def product(left: Quaternion, right: Quaternion) -> Quaternion:
    """Hamilton product; in plain floats, since it is formed for every pose."""
    a, b, c, d = left
    e, f, g, h = right
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )


def _quaternion(values: np.ndarray) -> Quaternion:
    w, x, y, z = (float(v) for v in values)
    return (w, x, y, z)
