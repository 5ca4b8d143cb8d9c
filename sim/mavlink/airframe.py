"""What the emulated autopilot flies: the boundary between its firmware and the simulated physics.

World z up, body x forward, y left, z up, quaternions scalar first, SI. Vectors are tuples: at 250 Hz and a handful of
numbers per call, arrays cost more than they give.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from drivers.mavlink.geometry import rotate

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class AirframeState:
    """Truth at one instant.

    Attributes:
        specific_force_m_s2: what an ideal accelerometer at the IMU reads (+g on z at rest).
        rotor_speed_rad_s: actual rotor speeds.
        on_ground: the landing gear carries weight.
    """

    position_m: Vector
    velocity_m_s: Vector
    quaternion: Quaternion
    rate_rad_s: Vector
    specific_force_m_s2: Vector
    rotor_speed_rad_s: tuple[float, ...]
    voltage_v: float
    current_a: float
    on_ground: bool


@dataclass(frozen=True, slots=True)
class ImuSample:
    """Gyro and accelerometer as the driver gives them, body FLU."""

    gyro_rad_s: Vector
    accel_m_s2: Vector


class Airframe(Protocol):
    """Anything that turns rotor commands (0..1 of the top speed) into motion."""

    @property
    def state(self) -> AirframeState:
        """Truth now."""
        ...

    def step(self, dt_s: float, commands: tuple[float, ...]) -> None:
        """Advance by dt with the commands held."""
        ...

    def imu(self) -> ImuSample:
        """The inertial sample the firmware integrated over the last step."""
        ...

    def raw_imu(self) -> list[tuple[float, ImuSample]]:
        """The sensor's own samples of the last step, with their age in seconds, oldest first."""
        ...


def rotate_inverse(q: Quaternion, v: Vector) -> Vector:
    """Rotate a world vector into the body."""
    return rotate((q[0], -q[1], -q[2], -q[3]), v)


def cross(a: Sequence[float], b: Sequence[float]) -> Vector:
    """Vector product; for three floats far faster than numpy's."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def euler(q: Quaternion) -> Vector:
    """ZYX Euler angles (roll, pitch, yaw)."""
    w, x, y, z = q
    return (
        math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x)))),
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )
