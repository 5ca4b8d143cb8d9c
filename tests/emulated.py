"""A small airframe for tests of the emulated autopilot, and a station's end of its link."""

from __future__ import annotations

import math
import random

import numpy as np

from drivers.mavlink.geometry import rotate, turned
from groundstation.vehicle import Vehicle
from sim.mavlink.airframe import AirframeState, ImuSample, Quaternion, Vector, euler


def triple(values) -> Vector:
    """Three floats."""
    x, y, z = (float(v) for v in values)
    return (x, y, z)


class RigidAirframe:
    """A rigid body with four thrusts and first-order rotors over a floor: enough to exercise the protocol.

    The full plant with its effects and sensors is :mod:`sim`'s; this one needs no compiler and keeps the tests fast.
    Semi-implicit Euler at 1 kHz.
    """

    def __init__(self, vehicle: Vehicle, *, seed: int = 0, position_m: Vector = (0.0, 0.0, 0.0)):
        self._vehicle = vehicle
        self._random = random.Random(seed)
        self._inertia = vehicle.inertia_tensor()
        self._inverse = np.linalg.inv(self._inertia)
        self._allocation = vehicle.allocation()
        self._mass = vehicle.mass_kg
        self._gravity = vehicle.gravity_m_s2
        self._lag_s = max(vehicle.rotors.lag.up_s, 0.02)
        self._thrust_max = vehicle.rotor_thrust_max_n()
        self._floor = position_m[2]
        self._position = np.array(position_m, dtype=float)
        self._velocity = np.zeros(3)
        self._q: Quaternion = (1.0, 0.0, 0.0, 0.0)
        self._rate = np.zeros(3)
        self._force = np.array([0.0, 0.0, self._gravity])
        self._commands = np.zeros(vehicle.rotors.count)
        self._on_ground = True

    def step(self, dt_s: float, commands: tuple[float, ...]) -> None:
        """Advance by dt with the commands held."""
        count = max(1, round(dt_s / 0.001))
        for _ in range(count):
            self._substep(dt_s / count, np.asarray(commands))

    def _substep(self, dt: float, commands: np.ndarray) -> None:
        self._commands += (commands - self._commands) * min(1.0, dt / self._lag_s)
        force, *torque = self._allocation @ (self._thrust_max * self._commands**2)
        body = np.array([0.0, 0.0, force / self._mass])
        world = np.array(rotate(self._q, tuple(body)))
        acceleration = world - [0.0, 0.0, self._gravity]
        below = self._position[2] <= self._floor and self._velocity[2] <= 0.0
        grounded = below and acceleration[2] <= 0.0
        if below:
            yaw = euler(self._q)[2]
            self._q = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
            self._velocity[:] = self._rate[:] = 0.0
            self._position[2] = self._floor
        if grounded:
            self._force = np.array([0.0, 0.0, self._gravity])
        else:
            self._velocity += dt * acceleration
            self._position += dt * self._velocity
            gyroscopic = np.cross(self._rate, self._inertia @ self._rate)
            self._rate += dt * (self._inverse @ (np.asarray(torque) - gyroscopic))
            self._q = turned(self._q, (self._rate[0], self._rate[1], self._rate[2]), dt)
            self._force = body
        self._on_ground = bool(below)

    @property
    def state(self) -> AirframeState:
        """Truth now."""
        top = self._vehicle.rotors.speed_max_rad_s or 1.0
        return AirframeState(
            triple(self._position),
            triple(self._velocity),
            self._q,
            triple(self._rate),
            triple(self._force),
            tuple((top * self._commands).tolist()),
            self._vehicle.battery.full_v or 16.2,
            2.0 + 20.0 * float(np.sum(self._commands**3)),
            self._on_ground,
        )

    def imu(self) -> ImuSample:
        """The inertial sample at this instant, with white noise of an ordinary MEMS sensor."""
        noise = self._random.gauss
        gyro = tuple(float(r) + noise(0.0, 0.002) for r in self._rate)
        return ImuSample(gyro, tuple(float(f) + noise(0.0, 0.03) for f in self._force))
