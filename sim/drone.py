"""The simulated drone's flight manager: what may be asked of it when, and where it is to be. No I/O, no clock of its
own.

Phases are :data:`drivers.bus.DronePhase`. Time advances only in :meth:`Drone.advance`; requests are answered between.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator

import numpy as np
import tomli_w
from numpy.typing import NDArray

from drivers import samples as wire
from drivers.bus import (
    Answer,
    Command,
    Description,
    DronePhase,
    DroneStatus,
    Upload,
    checksum_holds,
)
from groundstation.errors import BadInput
from groundstation.outside import parse_json, parse_toml
from groundstation.trajectory import Plan, Sequence, changed_length, flight_path, plan_from_dict, with_periods
from groundstation.vehicle import Vehicle, vehicle_to_dict
from sim.feasibility import why_not
from sim.flight import excitation_window, path_setpoints
from sim.scenario import Scenario
from sim.simulation import Samples, SetpointSource, Simulation

Array = NDArray[np.float64]

_IN_AIR: tuple[DronePhase, ...] = ("takeoff", "exciting", "landing")
_AT_REST: tuple[DronePhase, ...] = ("idle", "uploaded", "landed", "crashed")
_BRAKE_S = 0.5  # time constant with which an aborted path comes to rest
_DESCENT_M_S = 0.4


def braking_setpoints(row: Array, start_s: float) -> SetpointSource:
    """Come to rest from a setpoint row and go down: v = v_0 exp(-t/T), and the descent sets in as smoothly.

    Args:
        row: the setpoint at the moment of the abort, shape (11,).
        start_s: that moment, true time.
    """

    def rows(times_s: Array) -> Array:
        t = np.maximum(times_s - start_s, 0.0)
        fading = np.exp(-t / _BRAKE_S)
        out = np.zeros((len(t), len(row)))
        out[:, :3] = row[:3] + row[3:6] * _BRAKE_S * (1.0 - fading)[:, None]
        out[:, 3:6] = row[3:6] * fading[:, None]
        out[:, 6:9] = -row[3:6] * fading[:, None] / _BRAKE_S
        out[:, 2] -= _DESCENT_M_S * (t - _BRAKE_S * (1.0 - fading))
        out[:, 5] -= _DESCENT_M_S * (1.0 - fading)
        out[:, 8] -= _DESCENT_M_S * fading / _BRAKE_S
        out[:, 9] = row[9] + row[10] * _BRAKE_S * (1.0 - fading)
        out[:, 10] = row[10] * fading
        return out

    return rows


class Drone:
    """A simulated drone on the floor.

    Args:
        name: on the bus.
        declared: the vehicle as declared.
        scenario: its world.
        seed: of all noise.
        real_time: what the description says; pacing is the caller's.

    Raises:
        BadInput: the scenario does not fit the vehicle.
    """

    def __init__(self, name: str, declared: Vehicle, scenario: Scenario, seed: int, *, real_time: bool = False):
        self.simulation = Simulation(declared, scenario, seed)
        self.description = Description(
            drone=name,
            vehicle=declared.name,
            motor_kind=declared.rotors.input,
            real_time=real_time,
            batch_s=0.02 if real_time else 0.05,
            scenario=scenario.name,
            truth_toml=tomli_w.dumps(vehicle_to_dict(self.simulation.truth)),
        )
        self.phase: DronePhase = "idle"
        self.text = ""
        self._plan: Plan | None = None
        self._crc: int | None = None
        self._path: Sequence | None = None
        self._source: SetpointSource | None = None
        self._started_s = 0.0
        self._ends_s = 0.0
        self._window: tuple[float, float] | None = None
        self._rested_s = 0.0
        self._order = 0
        self._waiting: list[tuple[float, int, wire.Sample]] = []

    @property
    def armed(self) -> bool:
        """Whether the rotors may turn."""
        return self.phase == "armed" or self.phase in _IN_AIR

    @property
    def airborne(self) -> bool:
        """Whether a flight is under way."""
        return self.phase in _IN_AIR

    def upload(self, request: Upload) -> Answer:
        """Take a plan, or say why not."""
        if self.phase not in _AT_REST:
            return Answer(
                False, f"a plan can be uploaded on the ground and disarmed; the drone is in phase {self.phase}."
            )
        if not checksum_holds(request):
            return Answer(False, "the checksum does not match: the plan was damaged on the way; upload it again.")
        try:
            parse = parse_toml if request.format == "toml" else parse_json
            plan = plan_from_dict(parse(request.plan, "the uploaded plan"), "the uploaded plan")
        except BadInput as error:
            return Answer(False, str(error))
        path = self._path_from_here(plan)
        reason = why_not(self.simulation.declared, path, self.simulation.position_m[2])
        if reason:
            return Answer(False, reason)
        if self.phase == "crashed":
            self.simulation.set_upright()
        self._plan, self._crc = plan, request.crc32
        self._enter("uploaded", f"plan of {path.duration_s:.0f} s accepted")
        return Answer(True)

    def command(self, request: Command) -> Answer:
        """Do as told, or say why not."""
        order = {
            "arm": self._arm,
            "start": self._start,
            "finish": lambda: self._change_length("finish"),
            "extend": lambda: self._change_length("extend"),
            "kill": self._kill,
            "disarm": self._disarm,
            "shutdown": self._may_end,
        }
        return order.get(request.name, lambda: self.land(f"{request.name} on command"))()

    def _arm(self) -> Answer:
        if self.phase != "uploaded":
            need = "upload a plan first" if self.phase in _AT_REST else f"the drone is in phase {self.phase}"
            return Answer(False, f"cannot arm: {need}.")
        self._enter("armed", "armed")
        return Answer(True)

    def _start(self) -> Answer:
        if self.phase != "armed" or self._plan is None:
            return Answer(False, f"cannot start in phase {self.phase}: upload a plan and arm first.")
        path = with_periods(self._path_from_here(self._plan), self._plan.first_periods)
        self.simulation.take_off_now()
        self._started_s = self.simulation.time_s
        self._follow(path)
        self._enter("takeoff", "taking off")
        return Answer(True)

    def _follow(self, path: Sequence) -> None:
        self._path, self._ends_s = path, self._started_s + path.duration_s
        self._source = path_setpoints(path, self._started_s)
        begin, end = excitation_window(path, self._started_s)
        clock = self.simulation.motor_clock_s
        self._window = (clock(begin), clock(end))

    def _change_length(self, order: str) -> Answer:
        """End the excitation at its next rest point, or let it go on."""
        if self.phase != "exciting" or self._path is None or self._plan is None:
            return Answer(False, f"'{order}' is for an excitation; the drone is in phase {self.phase}.")
        changed = changed_length(self._path, self.simulation.time_s - self._started_s, order, self._plan.periods)
        if isinstance(changed, str):
            return Answer(False, changed)
        self._follow(changed)
        return Answer(True)

    def _kill(self) -> Answer:
        """Rotors off: it falls, and what becomes of it nature decides."""
        if not self.airborne:
            return self._disarm()
        self._source, self._ends_s = None, self.simulation.time_s
        self._enter("landing", "rotors stopped on command")
        return Answer(True)

    def _disarm(self) -> Answer:
        if self.airborne:
            return Answer(False, "cannot disarm in the air: land first.")
        if self.phase == "armed":
            self._enter("uploaded", "disarmed")
        return Answer(True)

    def _may_end(self) -> Answer:
        return Answer(not self.airborne, "cannot shut down in the air: land first." if self.airborne else "")

    def land(self, why: str) -> Answer:
        """Stop where it is and go down; on the ground, disarm."""
        if self.phase == "armed":
            return self._disarm()
        if self.phase in ("takeoff", "exciting") and self._source is not None:
            now = self.simulation.time_s
            self._source = braking_setpoints(self._source(np.array([now]))[0], now)
            self._ends_s = now
            self._enter("landing", why)
        elif self.phase != "landing":
            return Answer(False, f"there is nothing to land: the drone is in phase {self.phase}.")
        return Answer(True)

    def advance(self, steps: int) -> list[tuple[float, wire.Sample]]:
        """Run for some steps of 1 ms and return what has arrived at the host by then, in order: (true time, sample)."""
        simulation = self.simulation
        if self.airborne and self._source is not None:
            chunk = simulation.fly(steps, self._source)
        else:
            chunk = simulation.idle(steps)
        for name, stream in chunk.items():
            for arrival, sample in _samples(name, stream, self.description.motor_kind):
                self._queue(arrival, sample)
        self._watch()
        arrived = []
        while self._waiting and self._waiting[0][0] <= simulation.time_s:
            at, _, sample = heapq.heappop(self._waiting)
            arrived.append((at, sample))
        return arrived

    def status(self, host_offset_s: float = 0.0) -> DroneStatus:
        """What it is doing; ``host_offset_s`` is the host's clock minus true time."""
        simulation = self.simulation
        now = simulation.time_s
        row = np.zeros(3)
        if self.airborne and self._source is not None:
            row = self._source(np.array([now]))[0, :3]
        x, y, z = (float(v) for v in simulation.position_m)
        duration = self._path.duration_s if self._path is not None else 0.0
        return DroneStatus(
            phase=self.phase,
            armed=self.armed,
            device_s=simulation.motor_clock_s(now),
            host_s=now + host_offset_s,
            text=self.text,
            flight_s=now - self._started_s if self.airborne else 0.0,
            flight_end_s=duration,
            window_s=self._window,
            position_m=(x, y, z),
            setpoint_m=(float(row[0]), float(row[1]), float(row[2])),
            euler_rad=simulation.euler_rad,
            plan_crc32=self._crc,
        )

    def _path_from_here(self, plan: Plan) -> Sequence:
        x, y, z = self.simulation.position_m
        return flight_path(plan, np.array([x, y, z, self.simulation.euler_rad[2]]))

    def _watch(self) -> None:
        """Change phase as time and nature have it."""
        simulation, now = self.simulation, self.simulation.time_s
        if simulation.crashed:
            if self.phase != "crashed":
                self._enter("crashed", "hit the floor or tumbled; motors off")
            return
        if self.phase == "takeoff" and self._path is not None:
            begin, _ = excitation_window(self._path, self._started_s)
            if now >= begin and simulation.standing:
                self.land("could not lift off: not enough thrust")
            elif now >= begin:
                self._enter("exciting", "flying the excitation")
        if self.phase == "exciting" and self._path is not None:
            _, end = excitation_window(self._path, self._started_s)
            if now >= end:
                self._enter("landing", "excitation flown; landing")
        if self.phase == "landing":
            self._rested_s = self._rested_s if simulation.standing and self._rested_s else now
            if not simulation.standing:
                self._rested_s = now
            if simulation.standing and now - self._rested_s >= 0.3 and now >= self._ends_s - 0.5:
                self._enter("landed", "landed and disarmed")

    def _enter(self, phase: DronePhase, text: str) -> None:
        self.phase, self.text = phase, text
        now = self.simulation.time_s
        self._rested_s = now
        self._queue(now, wire.Event(self.simulation.motor_clock_s(now), "phase", f"{phase}: {text}"))

    def _queue(self, arrival_s: float, sample: wire.Sample) -> None:
        self._order += 1
        heapq.heappush(self._waiting, (arrival_s, self._order, sample))


def _samples(name: str, stream: Samples, motor_kind: str) -> Iterator[tuple[float, wire.Sample]]:
    """Wire samples of one stream with their arrivals."""
    stamps, arrivals, values = (part.tolist() for part in stream)
    for stamp, arrival, row in zip(stamps, arrivals, values, strict=True):
        match name:
            case "imu":
                sample: wire.Sample = wire.Imu(stamp, tuple(row[:3]), tuple(row[3:]))
            case "mocap":
                sample = wire.Pose(stamp, tuple(row[:3]), tuple(row[3:]))
            case "motors":
                sample = wire.Motors(stamp, tuple(row), motor_kind)  # type: ignore[arg-type]
            case "battery":
                sample = wire.Battery(stamp, row[0], row[1])
            case "setpoint":
                sample = wire.Setpoint(stamp, tuple(row[:3]), row[3])
            case _:
                sample = wire.State(stamp, tuple(row[:3]), tuple(row[3:6]), tuple(row[6:10]), tuple(row[10:]))
        yield arrival, sample
