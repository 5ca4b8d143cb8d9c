"""The emulated autopilot's cascade: position, velocity, attitude, rate, rotors, as both firmwares arrange it.

Position (P) -> velocity (PI) -> acceleration -> thrust vector -> attitude (P on the quaternion error) -> body rate (PID
in angular acceleration) -> torque -> rotor thrusts -> commands. Set-points may be partial: NaN marks what is not
commanded. Everything is in the house's frames; NED lives in the codec.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drivers.mavlink.geometry import rotate
from groundstation.vehicle import Vehicle
from sim.mavlink.airframe import Quaternion, Vector, cross, euler, rotate_inverse

NAN3: Vector = (math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What to follow, world z up; NaN: not commanded. ``vertical_limit`` bounds the climb (m/s)."""

    position_m: Vector = NAN3
    velocity_m_s: Vector = NAN3
    acceleration_m_s2: Vector = NAN3
    yaw_rad: float = math.nan
    yaw_rate_rad_s: float = math.nan


@dataclass(frozen=True, slots=True)
class Gains:
    """Gains in SI; the two firmwares' defaults where they are of this form (MPC_XY_P, MPC_XY_VEL_P_ACC,
    MC_ROLL_P...).
    """

    position_p: Vector = (0.95, 0.95, 1.0)
    velocity_p: Vector = (1.8, 1.8, 4.0)
    velocity_i: Vector = (0.4, 0.4, 2.0)
    attitude_p: Vector = (6.0, 6.0, 2.8)
    rate_p: Vector = (14.0, 14.0, 6.0)
    rate_i: Vector = (6.0, 6.0, 2.0)
    rate_d: Vector = (0.5, 0.5, 0.0)
    speed_max_m_s: Vector = (12.0, 12.0, 3.0)
    tilt_max_rad: float = math.radians(45.0)
    rate_filter_hz: float = 30.0


class Cascade:
    """Holds the integrators and filters of the loops.

    Args:
        vehicle: the declared vehicle: what the firmware was tuned for.
        gains: loop gains.
    """

    def __init__(self, vehicle: Vehicle, gains: Gains | None = None):
        self._vehicle = vehicle
        self._gains = gains or Gains()
        self._inertia = vehicle.inertia_tensor()
        self._gravity = vehicle.gravity_m_s2
        self._mixer = vehicle.mixing()
        thrust_max = vehicle.rotor_thrust_max_n()
        hover = vehicle.mass_kg * self._gravity / vehicle.rotors.count
        self._thrust_max = thrust_max if math.isfinite(thrust_max) else 2.2 * hover
        self.reset()

    def reset(self) -> None:
        """Forget the integrators: the vehicle is on the ground."""
        self._velocity_integral = [0.0, 0.0, 0.0]
        self._rate_integral = np.zeros(3)
        self._rate_filtered = np.zeros(3)
        self._rate_setpoint = np.zeros(3)
        self.attitude_setpoint: Quaternion = (1.0, 0.0, 0.0, 0.0)
        self.rate_setpoint: Vector = (0.0, 0.0, 0.0)
        self.acceleration_setpoint: Vector = (0.0, 0.0, 0.0)

    def command_of_thrust(self, thrust_n: np.ndarray) -> tuple[float, ...]:
        """Rotor commands 0..1 for thrusts: the share of the top speed, or what the declared thrust curve asks."""
        ratio = np.clip(thrust_n / self._thrust_max, 0.0, 1.0)
        if self._vehicle.rotors.thrust_curve is not None:
            return tuple(np.clip(self._vehicle.motor_for_thrust(ratio * self._thrust_max), 0.0, 1.0).tolist())
        return tuple(np.sqrt(ratio).tolist())

    def update(
        self, dt: float, setpoint: Setpoint, position: Vector, velocity: Vector, attitude: Quaternion, rate: Vector
    ) -> tuple[float, ...]:
        """One cycle: rotor commands (0..1) from the set-point and the estimated state."""
        yaw_now = euler(attitude)[2]
        acceleration = self._acceleration(dt, setpoint, position, velocity)
        specific = (acceleration[0], acceleration[1], acceleration[2] + self._gravity)
        tilted = _limit_tilt(specific, self._gains.tilt_max_rad)
        yaw = setpoint.yaw_rad if math.isfinite(setpoint.yaw_rad) else yaw_now
        wanted = _attitude_of_thrust(tilted, yaw)
        axis = rotate(attitude, (0.0, 0.0, 1.0))
        thrust = self._vehicle.mass_kg * max(0.0, sum(a * b for a, b in zip(tilted, axis, strict=True)))
        torque = self._torque(dt, wanted, setpoint.yaw_rate_rad_s, attitude, rate)
        self.attitude_setpoint, self.acceleration_setpoint = wanted, acceleration
        return self.command_of_thrust(_desaturated(self._mixer, thrust, torque, self._thrust_max))

    def _acceleration(self, dt: float, setpoint: Setpoint, position: Vector, velocity: Vector) -> Vector:
        gains, out = self._gains, []
        for axis in range(3):
            target, feed = setpoint.position_m[axis], setpoint.velocity_m_s[axis]
            ahead = setpoint.acceleration_m_s2[axis]
            result = ahead if math.isfinite(ahead) else 0.0
            if math.isfinite(target) or math.isfinite(feed):
                wanted = feed if math.isfinite(feed) else 0.0
                if math.isfinite(target):
                    wanted += gains.position_p[axis] * (target - position[axis])
                limit = gains.speed_max_m_s[axis]
                error = max(-limit, min(limit, wanted)) - velocity[axis]
                integral = self._velocity_integral[axis] + gains.velocity_i[axis] * error * dt
                self._velocity_integral[axis] = max(-4.0, min(4.0, integral))
                result += gains.velocity_p[axis] * error + self._velocity_integral[axis]
            out.append(result)
        out[2] = max(-0.8 * self._gravity, min(1.2 * self._gravity, out[2]))
        return (out[0], out[1], out[2])

    def _torque(self, dt: float, wanted: Quaternion, yaw_rate: float, attitude: Quaternion, rate: Vector) -> np.ndarray:
        gains = self._gains
        error = _rotation_between(attitude, wanted)
        target = np.asarray(gains.attitude_p) * error
        if math.isfinite(yaw_rate):
            target += rotate_inverse(attitude, (0.0, 0.0, yaw_rate))
        target = np.clip(target, -3.8, 3.8)
        measured = np.asarray(rate)
        weight = dt / (dt + 1.0 / (2.0 * math.pi * gains.rate_filter_hz))
        before = self._rate_filtered.copy()
        self._rate_filtered += weight * (measured - self._rate_filtered)
        slope = (self._rate_filtered - before) / dt
        deviation = target - measured
        self._rate_integral = np.clip(self._rate_integral + np.asarray(gains.rate_i) * deviation * dt, -6.0, 6.0)
        angular = np.asarray(gains.rate_p) * deviation + self._rate_integral - np.asarray(gains.rate_d) * slope
        self.rate_setpoint = (float(target[0]), float(target[1]), float(target[2]))
        return self._inertia @ angular + cross(rate, (self._inertia @ measured).tolist())


def _limit_tilt(specific: Vector, tilt_max: float) -> Vector:
    """The same vertical pull with the horizontal part shortened to the largest tilt."""
    x, y, z = specific
    z = max(z, 0.5)
    horizontal, limit = math.hypot(x, y), z * math.tan(tilt_max)
    scale = limit / horizontal if horizontal > limit else 1.0
    return (x * scale, y * scale, z)


def _attitude_of_thrust(thrust: Vector, yaw: float) -> Quaternion:
    """Attitude whose body z lies along the thrust and whose x points along yaw: tilt after heading."""
    norm = math.sqrt(sum(c * c for c in thrust))
    x, y, z = (c / norm for c in thrust)
    # Shortest rotation from the vertical to the thrust axis, after a rotation by yaw.
    w = math.sqrt(max(0.0, (1.0 + z) / 2.0))
    tilt = (w, -y / (2 * w), x / (2 * w), 0.0)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        tilt[0] * cy - tilt[3] * sy,
        tilt[1] * cy + tilt[2] * sy,
        tilt[2] * cy - tilt[1] * sy,
        tilt[0] * sy + tilt[3] * cy,
    )


def _rotation_between(attitude: Quaternion, wanted: Quaternion) -> np.ndarray:
    """Rotation vector in the body that turns ``attitude`` into ``wanted``, to first order 2 sign(w) vec."""
    w, x, y, z = attitude
    a, b, c, d = wanted
    ew = w * a + x * b + y * c + z * d
    ex = w * b - x * a - y * d + z * c
    ey = w * c + x * d - y * a - z * b
    ez = w * d - x * c + y * b - z * a
    sign = 2.0 if ew >= 0.0 else -2.0
    return sign * np.array([ex, ey, ez])


def _desaturated(mixer: np.ndarray, thrust: float, torque: np.ndarray, limit: float) -> np.ndarray:
    """Rotor thrusts of a wrench; yaw gives way first, then the collective, before the tilt torques do."""
    tilt = mixer[:, 1] * torque[0] + mixer[:, 2] * torque[1]
    yaw = mixer[:, 3] * torque[2]
    lift = mixer[:, 0] * thrust
    room = min(float(np.min(limit - (lift + tilt))), float(np.min(lift + tilt)))
    size = float(np.max(np.abs(yaw)))
    if size > 1e-12:
        yaw *= min(1.0, max(room, 0.15 * limit) / size)
    total = lift + tilt + yaw
    excess = max(0.0, float(np.max(total)) - limit) - max(0.0, -float(np.min(total)))
    return np.clip(total - excess, 0.0, limit)
