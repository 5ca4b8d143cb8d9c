"""A simulated vehicle in its world: runs for a stretch of time and gives back what its devices recorded. No I/O.

One seed gives one flight, however the time is cut into stretches: every source of noise has a generator of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import cos, sin
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from groundstation.vehicle import Vehicle
from sim.autopilot import (
    CONTROL_SIZE,
    EST_ATTITUDE,
    EST_POSITION,
    ESTIMATE_SIZE,
    FORCE,
    SETPOINT_SIZE,
    euler_of,
)
from sim.build import STEP_S, build_world
from sim.loop import (
    CRASH_STEP,
    CRASHED,
    EXTERNAL,
    FLAG_COUNT,
    FLYING,
    HISTORY,
    IDLE,
    PENDING,
    STANDING,
    Memory,
    Stretch,
    World,
    run,
)
from sim.noise import BiasedNoise, Outages, Stamper, Ticker, noisy_speeds, normal
from sim.plant import ATTITUDE, LOAD, ROTOR
from sim.scenario import Scenario, true_vehicle

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Times = tuple[Array, Array, Array]
"""True times, stamps and arrivals, (k,) each."""
Samples = tuple[Array, Array, Array]
"""Stamps on the device's clock (k,), arrivals on the host's clock (k,), values in the columns of a flight bundle (k,
c).
"""

SetpointSource = Callable[[Array], Array]
"""Setpoint rows, shape (k, 11), at true times; see :data:`sim.autopilot.SETPOINT_SIZE`."""


Noises = tuple[list[dict[str, object]], list[Mapping[str, object]]]
"""What noise and clocks of a simulation remember, and the states of their generators."""


class Prepared(NamedTuple):
    """A stretch of time that is ready to run.

    Attributes:
        simulation: whose it is.
        stretch: what the compiled loop needs.
        times: by device; see :data:`Times`.
        lost: which poses are.
        pieces: steps of each piece.
        may_land_s: where it may end at the first piece's end after this time that finds the vehicle standing.
        before: all noise and clocks before it was prepared, where it may.
    """

    simulation: Simulation
    stretch: Stretch
    times: dict[str, Times]
    lost: Mask
    pieces: Sequence[int]
    may_land_s: float = np.inf
    before: Noises | None = None


class Asked(NamedTuple):
    """What a stretch is asked to do; see :class:`sim.loop.Stretch`."""

    steps: int
    mode: int
    setpoints: Array
    motors: Array | None


class Recorded(NamedTuple):
    """What the compiled loop leaves of a stretch; see :func:`sim.loop.run`."""

    imu: Array
    poses: Array
    speeds: Array
    volts: Array
    commands: Array
    estimates: Array


class Simulation:
    """One vehicle, standing on the floor at time zero.

    Args:
        declared: the vehicle as declared.
        scenario: the world.
        seed: of all noise.
        world: what :func:`sim.build.build_world` makes of the two, where somebody has it already.

    Raises:
        BadInput: the scenario does not fit the vehicle.
    """

    def __init__(self, declared: Vehicle, scenario: Scenario, seed: int, world: World | None = None):
        self.declared = declared
        self.scenario = scenario
        self.truth = true_vehicle(declared, scenario)
        self.world: World = build_world(declared, scenario) if world is None else world
        self.step = 0
        self.flight_start_s = np.inf
        keys = ("imu", "imu_noise", "pose", "pose_noise", "lost", "frozen", "speed", "speed_noise", "battery")
        keys += ("battery_noise", "flight", "drift", "gust")
        streams = np.random.SeedSequence(seed).spawn(len(keys))
        self._random = {key: np.random.default_rng(s) for key, s in zip(keys, streams, strict=True)}
        self._tickers = {
            "imu": Ticker(scenario.imu.clock, scenario.imu.rate_hz, self._random["imu"]),
            "pose": Ticker(self._pose_clock(), scenario.mocap.rate_hz, self._random["pose"]),
            "battery": Ticker(scenario.battery.clock, scenario.battery.rate_hz, self._random["battery"]),
            "speed": Ticker(scenario.motors.clock, scenario.motors.rate_hz, self._random["speed"]),
        }
        self._flight = Stamper(scenario.motors.clock, self._random["flight"])
        self._imu_noise = self._make_imu_noise()
        mocap = scenario.mocap
        self._lost = Outages(mocap.dropouts_per_minute, mocap.dropout_s, self._random["lost"])
        self._frozen = Outages(mocap.freezes_per_minute, mocap.freeze_s, self._random["frozen"])
        self.memory = self._make_memory()

    def _pose_clock(self):
        clock, effect = self.scenario.mocap.clock, self.scenario.effects.clock_offset
        if not effect.on:
            return clock
        drift = clock.drift_ppm + effect.drift_ppm
        return clock.model_copy(update={"offset_s": clock.offset_s + effect.offset_s, "drift_ppm": drift})

    def _make_imu_noise(self) -> BiasedNoise:
        imu = self.scenario.imu
        per_sample = np.sqrt(0.5 * imu.rate_hz)
        return BiasedNoise(
            white=np.repeat([imu.gyro_density * per_sample, imu.accel_density * per_sample], 3),
            start=np.repeat([imu.gyro_bias_std, imu.accel_bias_std], 3),
            walk=np.repeat([imu.gyro_walk, imu.accel_walk], 3) / np.sqrt(imu.rate_hz),
            random=self._random["imu_noise"],
        )

    def _make_memory(self) -> Memory:
        count = self.declared.rotors.count
        start = self.scenario.start
        attitude = np.array([cos(0.5 * start.yaw_rad), 0.0, 0.0, sin(0.5 * start.yaw_rad)])
        x = np.zeros(ROTOR + count)
        x[:3] = start.position_m
        x[ATTITUDE : ATTITUDE + 4] = attitude
        x[LOAD : LOAD + 3] = np.array(start.position_m) * [1.0, 1.0, 0.0]
        estimate = np.zeros(ESTIMATE_SIZE)
        estimate[EST_POSITION : EST_POSITION + 3] = start.position_m
        estimate[EST_ATTITUDE : EST_ATTITUDE + 4] = attitude
        history = np.tile(np.concatenate([x[:3], attitude]), (HISTORY, 1))
        flags = np.zeros(FLAG_COUNT, dtype=np.int64)
        flags[STANDING] = 1
        battery = np.array([(1.0 - self.scenario.battery.start_charge) * self.world.supply.capacity, 0.0, 0.0])
        return Memory(
            x=x,
            work=np.zeros((5, len(x))),
            thrust=np.zeros(count),
            target=np.zeros(count),
            delay=np.zeros((HISTORY, count)),
            control=np.zeros(CONTROL_SIZE),
            estimate=estimate,
            led=np.zeros(count),
            history=history,
            pending=np.zeros((PENDING, 9)),
            last_pose=np.concatenate([x[:3], attitude]),
            battery=battery,
            drift=self._random["drift"].standard_normal((2, 6)) * [[1.0], [np.sqrt(0.5)]],
            gust=self._random["gust"].standard_normal((2, 3)) * [[1.0], [np.sqrt(0.5)]],
            low_pass=np.zeros((2, 6)),
            flags=flags,
        )

    @property
    def time_s(self) -> float:
        """True time now."""
        return self.step * STEP_S

    @property
    def standing(self) -> bool:
        """Whether the floor holds the vehicle."""
        return bool(self.memory.flags[STANDING])

    @property
    def crashed(self) -> bool:
        """Whether it hit the floor too hard or tumbled; the rotors stay off until :meth:`set_upright`."""
        return bool(self.memory.flags[CRASHED])

    @property
    def crashed_s(self) -> float:
        """True time of the latest crash."""
        return float(self.memory.flags[CRASH_STEP]) * STEP_S

    @property
    def position_m(self) -> Array:
        """True position of the origin in the world."""
        return self.memory.x[:3].copy()

    @property
    def estimate(self) -> Array:
        """The vehicle's own estimate, in the columns of a ``state`` stream, shape (13,)."""
        return self.memory.estimate[:13].copy()

    @property
    def euler_rad(self) -> tuple[float, float, float]:
        """True roll, pitch and yaw."""
        w, x, y, z = (float(v) for v in self.memory.x[ATTITUDE : ATTITUDE + 4])
        return euler_of((w, x, y, z))

    def take_off_now(self) -> None:
        """Begin the clock of flight, which effects that happen in flight count by; the controller starts afresh."""
        self.flight_start_s = self.time_s
        self.memory.control[:] = 0.0
        self.memory.control[FORCE + 2] = (
            0.2 * self.world.law.mass * self.world.law.gravity
        )  # until the position loop's turn

    def set_upright(self) -> None:
        """After a crash: stand it on its feet where it lies."""
        self.memory.flags[CRASHED] = 0

    def motor_clock_s(self, true_s: float) -> float:
        """Stamp of the flight controller's clock at a true time."""
        clock = self.scenario.motors.clock
        return true_s * (1.0 + 1e-6 * clock.drift_ppm) + clock.offset_s

    def control_ticks(self, steps: int) -> Array:
        """True times of the control ticks in the next stretch."""
        every = self.world.control_every
        first = -(-self.step // every) * every
        return STEP_S * np.arange(first, self.step + steps, every, dtype=float)

    def idle(self, steps: int) -> dict[str, Samples]:
        """Run with the rotors off."""
        return self.run(self.ready_to_idle(steps))

    def ready_to_idle(self, steps: int) -> Prepared:
        """What :meth:`idle` runs."""
        ticks = self.control_ticks(steps)
        held = np.zeros((len(ticks), SETPOINT_SIZE))
        held[:, :3] = self.scenario.start.position_m
        return self._prepare([steps], IDLE, held, None)

    def fly(self, steps: int, setpoints: SetpointSource) -> dict[str, Samples]:
        """Run under the vehicle's own control law.

        Args:
            steps: of 1 ms.
            setpoints: where to be, at the true times of the control ticks.
        """
        return self.run(self.ready_to_fly(steps, setpoints))

    def ready_to_fly(
        self, steps: int, setpoints: SetpointSource, pieces: int = 1, may_land_s: float = np.inf
    ) -> Prepared:
        """What :meth:`fly` runs so many times; its noise is the same to the last bit as if it did.

        Args:
            steps: of 1 ms, of each piece.
            setpoints: where to be, at the true times of the control ticks of all pieces.
            pieces: how many.
            may_land_s: see :class:`Prepared`.
        """
        before = self._remembered() if may_land_s < np.inf else None
        rows = setpoints(self.control_ticks(steps * pieces))
        prepared = self._prepare([steps] * pieces, FLYING, rows, None)
        return prepared._replace(may_land_s=may_land_s, before=before)

    def shortened(self, prepared: Prepared, pieces: int) -> Prepared:
        """The same stretch with its first pieces alone, as if no more had ever been prepared."""
        if prepared.before is None:
            raise ValueError("this stretch was prepared to be run whole")
        numbers, states = prepared.before
        for source, remembered in zip(self._noises(), numbers, strict=True):
            vars(source).update(remembered)
        for random, state in zip(self._random.values(), states, strict=True):
            random.bit_generator.state = state
        steps = prepared.pieces[:pieces]
        setpoints = prepared.stretch.setpoints[: len(self.control_ticks(sum(steps)))]
        return self._prepare(steps, prepared.stretch.mode, setpoints, None)

    def _noises(self) -> list[object]:
        """All noise and clocks; what they remember is in their attributes, and no array of these is ever changed."""
        tickers = self._tickers.values()
        return [*tickers, *(t.stamper for t in tickers), self._flight, self._imu_noise, self._lost, self._frozen]

    def _remembered(self) -> Noises:
        states = [cast(Mapping[str, object], random.bit_generator.state) for random in self._random.values()]
        return [dict(vars(noise)) for noise in self._noises()], states

    def drive(self, steps: int, motors: Array, setpoints: Array | None = None) -> dict[str, Samples]:
        """Run with motor values from outside, as another autopilot gives them.

        Args:
            steps: of 1 ms.
            motors: in the units of the vehicle's ``rotors.input`` (newton per rotor for a wrench vehicle), shape (n,)
                or one row per control tick.
            setpoints: what that autopilot follows, for the record, shape (ticks, 11).
        """
        ticks = len(self.control_ticks(steps))
        rows = np.empty(
            (ticks, self.declared.rotors.count)
        )  # a writable array: compiled code has no second form for others
        rows[:] = motors
        held = np.zeros((ticks, SETPOINT_SIZE)) if setpoints is None else setpoints
        return self.run(self._prepare([steps], EXTERNAL, held, rows))

    def _stretch(self, asked: Asked, times: Mapping[str, Times], lost: Mask, imu: NDArray[np.int64]) -> Stretch:
        """What the compiled loop needs of the next steps: sample times, noise, what is asked for.

        Args:
            asked: of the next steps.
            times: by device.
            lost: which poses are.
            imu: samples of each piece of the stretch.
        """
        pose_s, _, pose_arrival = times["pose"]
        frozen = self._frozen.during(pose_s)
        mocap = self.scenario.mocap
        pose_std = np.repeat([mocap.position_std_m, mocap.attitude_std_rad], 3)
        count = self.declared.rotors.count
        return Stretch(
            first=self.step,
            steps=asked.steps,
            mode=asked.mode,
            start_s=float(self.flight_start_s),
            setpoints=np.ascontiguousarray(asked.setpoints),
            motors=np.zeros((len(asked.setpoints), count)) if asked.motors is None else asked.motors,
            imu_s=times["imu"][0],
            imu_noise=self._imu_noise.draw(imu),
            pose_s=pose_s,
            pose_arrival_s=np.where(lost, np.inf, pose_arrival),
            pose_frozen=frozen,
            pose_noise=pose_std * normal(self._random["pose_noise"], (len(pose_s), 6)),
            speed_s=times["speed"][0],
            battery_s=times["battery"][0],
            drift_noise=normal(self._random["drift"], (asked.steps, 6)),
            gust_noise=normal(self._random["gust"], (asked.steps if self.scenario.effects.wind.on else 0, 3)),
        )

    def _prepare(self, pieces: Sequence[int], mode: int, setpoints: Array, motors: Array | None) -> Prepared:
        steps = sum(pieces)
        ends = (self.step + np.cumsum(pieces)) * STEP_S
        imu = np.diff(self._tickers["imu"].counts_until(ends), prepend=0)
        end = (self.step + steps) * STEP_S
        times = {key: ticker.until(end) for key, ticker in self._tickers.items()}
        ticks = self.control_ticks(steps)
        times["flight"] = (ticks, *self._flight.stamp(ticks))
        lost = self._lost.during(times["pose"][0])
        stretch = self._stretch(Asked(steps, mode, setpoints, motors), times, lost, imu)
        return Prepared(self, stretch, times, lost, pieces)

    def run(self, prepared: Prepared) -> dict[str, Samples]:
        """Run a stretch; returns what the devices recorded, by stream."""
        *arrays, self.path = run(self.world, self.memory, prepared.stretch)
        return self.recorded(prepared, Recorded(*arrays))

    def recorded(self, prepared: Prepared, found: Recorded) -> dict[str, Samples]:
        """The streams of a stretch that has been run.

        Raises:
            FloatingPointError: the state is no longer finite.
        """
        times, lost, setpoints = prepared.times, prepared.lost, prepared.stretch.setpoints
        _, pose_stamp, pose_arrival = times["pose"]
        self.step += prepared.stretch.steps
        if not np.isfinite(self.memory.x).all():
            raise FloatingPointError(f"the simulated state is no longer finite {self.time_s:.3f} s after the start")
        return {
            "imu": (*times["imu"][1:], found.imu),
            "mocap": (pose_stamp[~lost], pose_arrival[~lost], found.poses[~lost]),
            "motors": self._motors(times, found.speeds, found.commands),
            "battery": (*times["battery"][1:], self._battery(found.volts)),
            "setpoint": self._thin(times["flight"], setpoints[:, [0, 1, 2, 9]], self.scenario.setpoint.rate_hz),
            "state": self._thin(times["flight"], found.estimates, self.scenario.state.rate_hz),
        }

    def _motors(self, times: dict[str, Samples], values: Array, commands: Array) -> Samples:
        """Measured rotor speeds with noise, or the commands as they were given; a wrench vehicle's as its wrench."""
        rotors = self.declared.rotors
        if rotors.measured:
            std = self.scenario.motors.noise_share * self.world.plant.rotors.hover_value
            return *times["speed"][1:], noisy_speeds(self._random["speed_noise"], std, values)
        if rotors.input == "wrench":
            commands = commands @ self.declared.allocation().T
        _, stamps, arrival = times["flight"]
        return stamps, arrival, commands

    def _battery(self, volts: Array) -> Array:
        model = self.scenario.battery
        noise = self._random["battery_noise"].standard_normal(volts.shape)
        return volts + noise * [model.voltage_std_v, model.current_std_a]

    def _thin(self, ticks: Samples, rows: Array, rate_hz: float) -> Samples:
        """Every so-many-th control tick, for the streams the flight software makes."""
        true, stamps, arrival = ticks
        if rate_hz <= 0.0:
            return stamps[:0], arrival[:0], rows[:0]
        every = max(round(self.scenario.control.attitude_hz / rate_hz), 1)
        number = np.round(true * self.scenario.control.attitude_hz).astype(int)
        keep = number % every == 0
        return stamps[keep], arrival[keep], rows[keep]
