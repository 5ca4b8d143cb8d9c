"""The full simulated vehicle as an airframe for a firmware: :class:`sim.simulation.Simulation` driven from outside."""

from __future__ import annotations

import math

import numpy as np

from groundstation.vehicle import Vehicle
from sim.build import STEP_S
from sim.mavlink.airframe import AirframeState, ImuSample
from sim.natnet import NatNetServer
from sim.plant import ATTITUDE, POSITION, RATE, ROTOR, VELOCITY
from sim.scenario import Clock, Scenario
from sim.simulation import Samples, Simulation


class SimulatedAirframe:
    """The plant of a scenario, its effects and its sensors, under a firmware's rotor commands.

    Args:
        declared: the vehicle as declared.
        scenario: the world; its IMU is sampled at 1 kHz, and what the firmware gets is the mean of the samples since it
            last asked, as inertial drivers integrate.
        seed: of all noise.

    Attributes:
        poses: what motion capture has delivered since somebody emptied the list: stamps, arrivals, rows (see
            :data:`sim.simulation.Samples`).
        cameras: a motion-capture server that sends them on; None without.
    """

    def __init__(self, declared: Vehicle, scenario: Scenario, *, seed: int = 0):
        clock = Clock(phase=0.5)  # in the middle of the plant's step: the mean over n steps is that of their middle
        world = scenario.model_copy(
            update={
                "imu": scenario.imu.model_copy(update={"rate_hz": 1.0 / STEP_S, "clock": clock}),
                "control": scenario.control.model_copy(update={"attitude_hz": 1000}),
            }
        )
        self.simulation = Simulation(declared, world, seed)
        self.poses: list[Samples] = []
        self.cameras: NatNetServer | None = None
        rotors = declared.rotors
        self._kind, self._top = rotors.input, rotors.speed_max_rad_s or 1.0
        self._thrust_max = declared.rotor_thrust_max_n()
        self._elapsed_s = 0.0
        self._imu = ImuSample((0.0, 0.0, 0.0), (0.0, 0.0, declared.gravity_m_s2))
        self._rows = np.zeros((0, 6))
        self._keep(self.simulation.idle(1))
        self._elapsed_s = STEP_S

    def step(self, dt_s: float, commands: tuple[float, ...]) -> None:
        """Advance by dt with the commands held; parts of the plant's step are carried over."""
        self._advance(dt_s, commands)
        if self.cameras is not None:
            self.cameras.turn(self.simulation.time_s, self.poses)

    def filmed_from(self, place: str) -> None:
        """Open a motion-capture server at ``HOST:PORT`` that sees this airframe."""
        self.cameras = NatNetServer(place, self.simulation.scenario.mocap.clock)

    def _advance(self, dt_s: float, commands: tuple[float, ...]) -> None:
        self._elapsed_s += dt_s
        steps = round(self._elapsed_s / STEP_S) - self.simulation.step
        if steps <= 0:
            return
        if not any(commands):
            self._keep(self.simulation.idle(steps))
            return
        if self.simulation.standing and not math.isfinite(self.simulation.flight_start_s):
            self.simulation.take_off_now()
        self._keep(self.simulation.drive(steps, self._values(np.asarray(commands))))

    def _values(self, commands: np.ndarray) -> np.ndarray:
        """Commands 0..1 in the units of the vehicle's motor values."""
        if self._kind == "command":
            return commands
        return self._top * commands if self._kind == "rotor_speed" else self._thrust_max * commands**2

    def _keep(self, samples: dict[str, Samples]) -> None:
        rows = samples["imu"][2]
        if len(rows):
            self._rows = rows
            gx, gy, gz, ax, ay, az = rows.mean(axis=0).tolist()
            self._imu = ImuSample((gx, gy, gz), (ax, ay, az))
        if len(samples["mocap"][0]):
            self.poses.append(samples["mocap"])

    def imu(self) -> ImuSample:
        """The mean inertial sample of the last step."""
        return self._imu

    def raw_imu(self) -> list[tuple[float, ImuSample]]:
        """The 1 kHz samples of the last step, with their age, oldest first."""
        count = len(self._rows)
        samples = (ImuSample((gx, gy, gz), (ax, ay, az)) for gx, gy, gz, ax, ay, az in self._rows.tolist())
        return [((count - i - 0.5) * STEP_S, sample) for i, sample in enumerate(samples)]

    @property
    def state(self) -> AirframeState:
        """Truth now."""
        x = self.simulation.memory.x.tolist()
        _, voltage, current = self.simulation.memory.battery.tolist()
        speeds = x[ROTOR:]
        if self._kind != "rotor_speed":
            speeds = self._speeds(np.asarray(speeds)).tolist()
        return AirframeState(
            (x[POSITION], x[POSITION + 1], x[POSITION + 2]),
            (x[VELOCITY], x[VELOCITY + 1], x[VELOCITY + 2]),
            (x[ATTITUDE], x[ATTITUDE + 1], x[ATTITUDE + 2], x[ATTITUDE + 3]),
            (x[RATE], x[RATE + 1], x[RATE + 2]),
            self._imu.accel_m_s2,
            tuple(speeds),
            voltage,
            current,
            self.simulation.standing,
        )

    def _speeds(self, values: np.ndarray) -> np.ndarray:
        """Rotor speeds behind motor values that are not speeds, by T = k Omega^2."""
        rotors = self.simulation.world.plant.rotors
        c0, c1, c2 = rotors.curve
        thrust = np.maximum(c0 + (c1 + c2 * values) * values, 0.0)
        return np.sqrt(thrust / rotors.speed_coefficient)
