"""PX4's simulator link (docs.px4.io, "Simulation", MAVLink API): HIL_SENSOR, HIL_GPS and the truth
(HIL_STATE_QUATERNION) out, HIL_ACTUATOR_CONTROLS in.

``time_usec`` of HIL_SENSOR *is* PX4's clock. Until its first answer the sensors flow freely; from then on each step
waits for the answer to the last one (lock-step over TCP). A flight controller on the bench has a clock of its own:
there the sensors are paced by ours, and the newest answer counts.
"""

from __future__ import annotations

import math
import random

from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.dialect import Message, mavlink
from drivers.mavlink.geometry import flip, flip_quaternion
from sim.mavlink.airframe import Airframe, Vector, rotate_inverse
from sim.mavlink.messages import geodetic

STEP_US = 4000
GPS_EVERY = 25
TRUTH_EVERY = 2
ALTITUDE_M = 489.4
FIELD_NED_GAUSS: Vector = (0.2152, 0.0077, 0.4274)
"""Earth's field at the place the positions are reported for."""

FIELD_NOISE_GAUSS, PRESSURE_NOISE_HPA = 5e-4, 5e-3
"""Of the magnetometer and the barometer.

Without any, PX4 takes a vehicle at rest for a sensor that is stuck, after a second.
"""

FIELDS = 0x1BFF
"""Accelerometer, gyro, magnetometer, pressure, pressure altitude and temperature; no differential pressure."""


class HilExchange:
    """The simulator's end of the link.

    Args:
        airframe: the physics.
        rotors: how many of the controls drive it, from the first.

    Attributes:
        time_us: simulated time, which is PX4's in lock-step.
        locked: PX4 has answered once.
        waiting: a step is out and not answered.
        armed: PX4 says it is armed.
    """

    def __init__(self, airframe: Airframe, rotors: int):
        self._airframe, self._rotors = airframe, rotors
        self._noise = random.Random(0)
        self._codec = MavlinkCodec(1, 51)
        self._commands = (0.0,) * rotors
        self._steps = 0
        self.time_us = 0
        self.locked = False
        self.waiting = False
        self.armed = False

    def step(self) -> bytes:
        """Advance the physics by 4 ms under the newest controls; the frames to send."""
        self._airframe.step(STEP_US * 1e-6, self._commands)
        self.time_us += STEP_US
        outgoing = [self._sensor()]
        if self._steps % GPS_EVERY == 0:
            outgoing.append(self._gps())
        if self._steps % TRUTH_EVERY == 0:
            outgoing.append(self._truth())
        self._steps += 1
        self.waiting = True
        return b"".join(self._codec.encode(message) for message in outgoing)

    def receive(self, data: bytes) -> int:
        """Take bytes from PX4; how many sets of controls they brought."""
        count = 0
        for received in self._codec.decode(data):
            if received.name == "HIL_ACTUATOR_CONTROLS":
                self._take(received.message)
                count += 1
        return count

    def _take(self, m: Message) -> None:
        self.locked, self.waiting = True, False
        self.armed = bool(m.mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        wanted = m.controls[: self._rotors] if self.armed else [0.0] * self._rotors
        self._commands = tuple(min(1.0, max(0.0, u)) if math.isfinite(u) else 0.0 for u in wanted)

    def _sensor(self) -> Message:
        state, imu = self._airframe.state, self._airframe.imu()
        mx, my, mz = (
            b + self._noise.gauss(0.0, FIELD_NOISE_GAUSS)
            for b in flip(rotate_inverse(state.quaternion, flip(FIELD_NED_GAUSS)))
        )
        height = ALTITUDE_M + state.position_m[2]
        pressure = pressure_hpa(height) + self._noise.gauss(0.0, PRESSURE_NOISE_HPA)
        return mavlink.MAVLink_hil_sensor_message(
            self.time_us, *flip(imu.accel_m_s2), *flip(imu.gyro_rad_s), mx, my, mz, pressure, 0.0, height, 15.0,
            FIELDS, 0,
        )  # fmt: skip

    def _gps(self) -> Message:
        state = self._airframe.state
        latitude, longitude, altitude = geodetic(state.position_m, ALTITUDE_M)
        north, east, down = (round(100 * v) for v in flip(state.velocity_m_s))
        course = round(100 * math.degrees(math.atan2(east, north) % (2 * math.pi))) % 36000
        return mavlink.MAVLink_hil_gps_message(
            self.time_us, 3, latitude, longitude, round(1000 * altitude), 30, 40, round(math.hypot(north, east)), north,
            east, down, course, 16,
        )  # fmt: skip

    def _truth(self) -> Message:
        """What PX4 writes into its log as groundtruth."""
        state = self._airframe.state
        latitude, longitude, altitude = geodetic(state.position_m, ALTITUDE_M)
        velocity = [round(100 * v) for v in flip(state.velocity_m_s)]
        force = [round(1000 * f / 9.80665) for f in flip(state.specific_force_m_s2)]
        return mavlink.MAVLink_hil_state_quaternion_message(
            self.time_us, list(flip_quaternion(state.quaternion)), *flip(state.rate_rad_s), latitude, longitude,
            round(1000 * altitude), velocity[0], velocity[1], velocity[2], 0, 0, force[0], force[1], force[2],
        )  # fmt: skip


def pressure_hpa(altitude_m: float) -> float:
    """International standard atmosphere below 11 km: p = 1013.25 (1 - 2.25577e-5 h)^5.25588."""
    return 1013.25 * (1.0 - 2.25577e-5 * altitude_m) ** 5.25588
