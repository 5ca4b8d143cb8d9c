"""Clocks and frames that are not what they are taken for: no force is missing, the data disagree among themselves."""

from __future__ import annotations

from typing import NamedTuple


class ClockOffset(NamedTuple):
    """Motion capture's clock against the flight controller's, beyond what the scenario's clocks already have.

    Attributes:
        offset_s: added to the stamps of poses.
        drift_ppm: rate at which they run away.
    """

    offset_s: float = 0.02
    drift_ppm: float = 0.0
    on: bool = True


class ImuMisalignment(NamedTuple):
    """The IMU's axes are the body's turned by a rotation vector; bias and scale are its own.

    Attributes:
        rotation_rad: v_body = exp(rotation) v_imu.
        gyro_bias_rad_s: added to the gyro.
        accel_bias_m_s2: added to the accelerometer.
        gyro_scale: factors of the three axes.
        accel_scale: factors of the three axes.
    """

    rotation_rad: tuple[float, float, float] = (0.01, -0.015, 0.02)
    gyro_bias_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    accel_bias_m_s2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gyro_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    accel_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    on: bool = True


class MocapMisalignment(NamedTuple):
    """The marker body is turned and shifted in the body beyond what the vehicle file declares.

    Attributes:
        rotation_rad: rotation vector from the (declared) marker frame to the true one.
        offset_m: of the tracked point, in the body.
    """

    rotation_rad: tuple[float, float, float] = (0.01, 0.0, 0.02)
    offset_m: tuple[float, float, float] = (0.01, 0.0, 0.02)
    on: bool = True


class MocapTilt(NamedTuple):
    """Motion capture's world is tilted against gravity (a carelessly laid calibration square).

    Attributes:
        tilt_rad: rotation vector about world x and y; poses are given in the tilted frame:
            v_capture = exp(-tilt) v_world.
    """

    tilt_rad: tuple[float, float] = (0.01, 0.0)
    on: bool = True
