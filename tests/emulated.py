"""A small airframe for tests of the emulated autopilot, and a station's end of its link."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

import numpy as np

from drivers.mavlink.codec import MavlinkCodec, Received
from drivers.mavlink.dialect import Message, mavlink
from drivers.mavlink.geometry import rotate, turned
from groundstation.vehicle import Vehicle, vehicle_from_dict
from sim.mavlink.airframe import AirframeState, ImuSample, Quaternion, Vector, cross, euler
from sim.mavlink.autopilot import Autopilot


def triple(values) -> Vector:
    """Three floats."""
    x, y, z = (float(v) for v in values)
    return (x, y, z)


class RigidAirframe:
    """A rigid body with four thrusts and first-order rotors over a floor: enough to exercise the protocol.

    The full plant with its effects and sensors is :mod:`sim`'s; this one needs no compiler and keeps the tests fast.
    Semi-implicit Euler at 500 Hz.
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
        count = max(1, round(dt_s / 0.002))
        for _ in range(count):
            self._substep(dt_s / count, np.asarray(commands))

    def _substep(self, dt: float, commands: np.ndarray) -> None:
        self._commands += (commands - self._commands) * min(1.0, dt / self._lag_s)
        force, *torque = self._allocation @ self._thrust(self._commands)
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
            gyroscopic = cross(self._rate.tolist(), (self._inertia @ self._rate).tolist())
            self._rate += dt * (self._inverse @ (np.asarray(torque) - gyroscopic))
            self._q = turned(self._q, (self._rate[0], self._rate[1], self._rate[2]), dt)
            self._force = body
        self._on_ground = bool(below)

    def _thrust(self, commands: np.ndarray) -> np.ndarray:
        if self._vehicle.rotors.thrust_curve is not None:
            return self._vehicle.thrust(commands)
        return self._thrust_max * commands**2

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

    def raw_imu(self) -> list[tuple[float, ImuSample]]:
        """One sample a step."""
        return [(0.0, self.imu())]


class Station:
    """Drives an emulated autopilot on virtual time over one link and keeps what it says.

    Args:
        autopilot: with no links yet.
        kind: of link.
        step_s: how often the autopilot is stepped.
    """

    LINK = "station"

    def __init__(self, autopilot: Autopilot, *, kind: str = "companion", step_s: float = 0.004, **link):
        self.autopilot = autopilot
        self.codec = MavlinkCodec()
        self.heard: list[tuple[float, Received]] = []
        self.now_s = 0.0
        self.heartbeats = True
        self._step_s, self._beat_s = step_s, 0.0
        self._outgoing: list[bytes] = []
        self.repeating: Callable[[float], Message | None] | None = None
        self._repeat_s = 0.0
        autopilot.add_link(self.LINK, kind, **link)

    def send(self, *messages: Message) -> None:
        """Messages that reach the autopilot at the next step."""
        self._outgoing += [self.codec.encode(m) for m in messages]

    def command(self, number: int, *p: float) -> int | None:
        """COMMAND_LONG; the result of its acknowledgement within 100 ms."""
        seen = len(self.heard)
        self.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *(list(p) + [0.0] * 7)[:7]))
        self.run(0.1)
        return next((r.message.result for _, r in self.heard[seen:] if is_ack(r, number)), None)

    def request(self, message: Message, reply: str, within_s: float = 0.5):
        """The first message of that name after sending another."""
        seen = len(self.heard)
        self.send(message)
        self.run(within_s)
        return next((r.message for _, r in self.heard[seen:] if r.name == reply), None)

    def run(self, duration_s: float, until: Callable[[], bool] | None = None) -> bool:
        """Let time pass; whether ``until`` came true."""
        end = self.now_s + duration_s
        while self.now_s < end - 1e-9:
            self.now_s += self._step_s
            if self.heartbeats and self.now_s >= self._beat_s:
                self._beat_s = self.now_s + 1.0
                self.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
            if self.repeating is not None and self.now_s >= self._repeat_s:
                self._repeat_s = self.now_s + 0.02
                message = self.repeating(self.now_s)
                if message is not None:
                    self.send(message)
            incoming = [(self.LINK, data) for data in self._outgoing]
            self._outgoing = []
            for _, frame in self.autopilot.step(self.now_s, incoming):
                self.heard += [(self.now_s, r) for r in self.codec.decode(frame, datagram=True)]
            if until is not None and until():
                return True
        return False

    def named(self, name: str, since_s: float = -1.0) -> list:
        """All messages of a name since a time."""
        return [r.message for t, r in self.heard if r.name == name and t > since_s]

    def texts(self, since_s: float = -1.0) -> list[str]:
        """Status texts since a time, long ones put together."""
        whole: list[str] = []
        for m in self.named("STATUSTEXT", since_s):
            if m.chunk_seq:
                whole[-1] += m.text
            else:
                whole.append(m.text)
        return [text.strip() for text in whole]

    def rate_hz(self, name: str, since_s: float) -> float:
        """How often a message came since a time."""
        return len(self.named(name, since_s)) / (self.now_s - since_s)


def is_ack(received: Received, command: int) -> bool:
    """Whether it acknowledges this command."""
    return received.name == "COMMAND_ACK" and received.message.command == command


def position_setpoint(x: float, y: float, z: float, *, yaw: float = 0.0) -> Message:
    """SET_POSITION_TARGET_LOCAL_NED at rest at a point of the house's world (z up)."""
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, 2048, x, -y, -z, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -yaw, 0.0
    )


def quadrotor(**rotors) -> Vehicle:
    """The 1 kg quadrotor of PX4's built-in simulation: 5 N per rotor at full command, linear in it, 50 ms lag."""
    return vehicle_from_dict(
        {
            "vehicle": {"name": "sih", "mass_kg": 1.0, "inertia_kg_m2": {"xx": 0.025, "yy": 0.025, "zz": 0.03}},
            "rotors": {
                "position_m": [[0.2, -0.2, 0.0], [-0.2, 0.2, 0.0], [0.2, 0.2, 0.0], [-0.2, -0.2, 0.0]],
                "spin": [1, 1, -1, -1],
                "torque_to_thrust_m": 0.02,
                "input": "command",
                "thrust_curve": [0.0, 5.0, 0.0],
                "lag": {"up_s": 0.05, "down_s": 0.05},
                **rotors,
            },
            "battery": {"full_v": 16.2},
        }
    )
