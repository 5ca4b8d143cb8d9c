"""The only place where north-east-down and forward-right-down exist.

Both the world (NED to x north, y west, z up) and the body (FRD to x forward, y left, z up) turn by pi about their own x
axis, so one flip serves both: v = (x, -y, -z), q = (w, x, -y, -z), and yaw changes its sign. The flip is its own
inverse.
"""

from __future__ import annotations

from math import atan2, cos, sin, sqrt

from drivers.samples import Quaternion, Vector3


def flip(vector: Vector3) -> Vector3:
    """NED to z-up world, FRD to FLU, or back."""
    x, y, z = vector
    return (x, -y, -z)


def flip_quaternion(quaternion: Quaternion) -> Quaternion:
    """FRD-to-NED attitude to FLU-to-world attitude, or back, at unit length."""
    w, x, y, z = quaternion
    norm = sqrt(w * w + x * x + y * y + z * z) or 1.0
    return (w / norm, x / norm, -y / norm, -z / norm)


def quaternion_of(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Quaternion of ZYX Euler angles, rad."""
    cr, sr, cp, sp = cos(roll / 2), sin(roll / 2), cos(pitch / 2), sin(pitch / 2)
    cy, sy = cos(yaw / 2), sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def yaw_of(quaternion: Quaternion) -> float:
    """Heading of a quaternion (ZYX), rad."""
    w, x, y, z = quaternion
    return atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def tilt_cosine(quaternion: Quaternion) -> float:
    """Cosine of the angle between body z and world z."""
    _, x, y, _ = quaternion
    return 1 - 2 * (x * x + y * y)


def rotate(quaternion: Quaternion, vector: Vector3) -> Vector3:
    """Body vector into the world."""
    w, x, y, z = quaternion
    a, b, c = vector
    tx, ty, tz = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return (a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx)


def turned(quaternion: Quaternion, rate_rad_s: Vector3, dt_s: float) -> Quaternion:
    """Attitude after a short time at a constant body rate (first order in the rotation vector's half angle)."""
    w, x, y, z = quaternion
    a, b, c = (0.5 * dt_s * r for r in rate_rad_s)
    q = (w - x * a - y * b - z * c, x + w * a + y * c - z * b, y + w * b + z * a - x * c, z + w * c + x * b - y * a)
    norm = sqrt(sum(v * v for v in q)) or 1.0
    return (q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm)
