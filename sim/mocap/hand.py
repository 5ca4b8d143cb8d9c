"""A vehicle carried and turned by hand: what its IMU and the cameras record.

Random sums of sines, as fast as hands are.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from groundstation.frames import matrix_from_quat, quat_conjugate, quat_exp, quat_log, quat_multiply

Array = NDArray[np.float64]
FINE_HZ = 2000.0
GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True, slots=True)
class Mounting:
    """How the marker body sits, and how the cameras' world and clock differ from the truth.

    Attributes:
        position_m: of the marker body's origin from the IMU, body axes.
        rotation_rad: rotation vector from the marker body's axes to the body's.
        tilt_rad: rotation vector (x, y) of the cameras' world.
        scale: poses are this much too long, as a share.
        clock_s, drift: pose stamp minus IMU stamp at the start, and its growth per second.
    """

    position_m: tuple[float, float, float] = (0.03, -0.02, 0.05)
    rotation_rad: tuple[float, float, float] = (0.05, -0.1, 0.6)
    tilt_rad: tuple[float, float] = (0.01, -0.005)
    scale: float = 0.0
    clock_s: float = 12.345
    drift: float = 2e-6


@dataclass(frozen=True, slots=True)
class Sensors:
    """Rates and noise: a consumer MEMS IMU as an autopilot streams it, and a good capture system."""

    imu_hz: float = 200.0
    pose_hz: float = 120.0
    gyro_rad_s: float = 0.003
    accel_m_s2: float = 0.05
    gyro_bias_rad_s: float = 0.005
    accel_bias_m_s2: float = 0.05
    pose_m: float = 0.0003
    pose_rad: float = 0.001


@dataclass(frozen=True, slots=True)
class Carried:
    """Stamps, gyro and accelerometer; stamps, positions and quaternions of the marker body."""

    imu: tuple[Array, Array, Array]
    poses: tuple[Array, Array, Array]
    mounting: Mounting = field(default_factory=Mounting)


def carry(
    seed: int, mounting: Mounting | None = None, sensors: Sensors | None = None, *, seconds: float = 30.0,
    turning_rad: tuple[float, float, float] = (0.5, 0.5, 0.8),
) -> Carried:  # fmt: skip
    """One carrying of a vehicle.

    Args:
        turning_rad: how far it is turned about each axis, root mean square.
    """
    mounting, sensors = mounting or Mounting(), sensors or Sensors()
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds + 1.0, 1.0 / FINE_HZ)
    place, acceleration = _sines(rng, t, np.array([0.3, 0.3, 0.15]), 0.6)
    turn, _ = _sines(rng, t, np.asarray(turning_rad), 0.7)
    q = quat_exp(turn)
    step = quat_log(quat_multiply(quat_conjugate(q[:-1]), q[1:])) * FINE_HZ
    rate = np.vstack([step[:1], 0.5 * (step[1:] + step[:-1]), step[-1:]])
    r = matrix_from_quat(q)
    force = np.einsum("kji,kj->ki", r, acceleration + np.array([0.0, 0.0, GRAVITY_M_S2]))
    imu = _imu(rng, t, rate, force, sensors)
    return Carried(imu, _poses(rng, t, place, q, (mounting, sensors)), mounting)


def _sines(rng: np.random.Generator, t: Array, size: Array, middle_hz: float) -> tuple[Array, Array]:
    """Six sines per axis about a frequency, and their second derivative, (k, 3) each."""
    hz = middle_hz * np.exp(0.5 * rng.standard_normal((6, 3)))
    weight = rng.standard_normal((6, 3)) / hz
    weight *= size / np.sqrt(0.5 * np.sum(weight**2, axis=0))
    phase = rng.uniform(0.0, 2.0 * np.pi, (6, 3))
    angle = 2.0 * np.pi * hz * t[:, None, None] + phase
    values = np.sum(weight * np.sin(angle), axis=1)
    return values, np.sum(-weight * (2.0 * np.pi * hz) ** 2 * np.sin(angle), axis=1)


def _imu(rng: np.random.Generator, t: Array, rate: Array, force: Array, s: Sensors) -> tuple[Array, Array, Array]:
    every = round(FINE_HZ / s.imu_hz)
    gyro = rate[::every] + s.gyro_bias_rad_s * rng.standard_normal(3)
    accel = force[::every] + s.accel_bias_m_s2 * rng.standard_normal(3)
    noise = rng.standard_normal((2, *gyro.shape))
    return t[::every].copy(), gyro + s.gyro_rad_s * noise[0], accel + s.accel_m_s2 * noise[1]


def _poses(
    rng: np.random.Generator, t: Array, place: Array, q: Array, how: tuple[Mounting, Sensors]
) -> tuple[Array, Array, Array]:
    mounting, s = how
    every = round(FINE_HZ / s.pose_hz)
    t, place, q = t[::every], place[::every], q[::every]
    origin = place + matrix_from_quat(q) @ np.asarray(mounting.position_m)
    world = quat_exp(np.array([*mounting.tilt_rad, 0.0]))
    seen = (1.0 + mounting.scale) * origin @ matrix_from_quat(world).T
    attitude = quat_multiply(quat_multiply(world, q), quat_exp(np.asarray(mounting.rotation_rad)))
    jolt = quat_exp(s.pose_rad * rng.standard_normal((len(t), 3)))
    stamps = t + mounting.clock_s + mounting.drift * t
    return stamps, seen + s.pose_m * rng.standard_normal(seen.shape), quat_multiply(attitude, jolt)
