"""Many simulated flights at once: eight in lockstep, each to the bit what :func:`sim.flight.simulate` gives.

Flights whose worlds differ in numbers only (masses, gains, strengths of effects) share a vector register. Others do
not: rotor counts, control rates, or which effects are on. So a study of one laboratory gains most.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Hashable, Iterator, Sequence
from functools import lru_cache
from typing import NamedTuple, cast

import numpy as np
from numba import typeof
from numba.core.dispatcher import Dispatcher
from numpy.typing import NDArray

from groundstation.errors import GroundStationError
from groundstation.trajectory import Plan
from groundstation.vehicle import Vehicle
from sim.autopilot import CONTROL_SIZE, ESTIMATE_SIZE
from sim.build import STEP_S, build_world
from sim.flight import SimulatedFlight, flown, simulate
from sim.lanes import WIDTH, Lanes
from sim.lockstep import Inputs, Outputs, Scratch, run_lanes
from sim.loop import FLYING, Memory, Stretch, World
from sim.rows import Rows
from sim.scenario import Scenario
from sim.simulation import Prepared, Recorded, Samples, SetpointSource, Simulation

Array = NDArray[np.float64]
Outcome = SimulatedFlight | GroundStationError | FloatingPointError

LEAST = 3
"""Flights of one kind from which lockstep pays: eight lanes cost about as much as two flights alone."""


class Job(NamedTuple):
    """A flight to be simulated: the arguments of :func:`sim.flight.simulate`."""

    vehicle: Vehicle
    plan: Plan
    scenario: Scenario
    seed: int
    rest_s: float = 1.0


def simulate_many(jobs: Sequence[Job]) -> Iterator[tuple[int, Outcome]]:
    """Fly them all; yields each one's number and flight (or why there is none), as groups are done.

    Raises:
        BadInput: a scenario does not fit its vehicle.
    """
    kinds: dict[tuple[Hashable, float], list[int]] = {}
    worlds: dict[tuple[int, int], tuple[World, Hashable]] = {}
    for number, job in enumerate(jobs):
        pair = (id(job.vehicle), id(job.scenario))
        if pair not in worlds:
            world = build_world(job.vehicle, job.scenario)
            worlds[pair] = world, kind(world)
        kinds.setdefault((worlds[pair][1], job.rest_s), []).append(number)
    sources: dict[Hashable, SetpointSource] = {}
    for (shape, _), numbers in kinds.items():
        kernel = _kernel_of(shape)
        for first in range(0, len(numbers), WIDTH):
            group = numbers[first : first + WIDTH]
            if len(group) < LEAST:
                yield from ((n, _alone(jobs[n])) for n in group)
                continue
            members = [(jobs[n], worlds[id(jobs[n].vehicle), id(jobs[n].scenario)][0]) for n in group]
            yield from zip(group, _in_lockstep(members, sources, kernel), strict=True)
            for other in list(sources)[:-WIDTH]:  # a study flies one plan, or each flight its own
                del sources[other]


def kind(world: object) -> Hashable:
    """What flights in lockstep share: shapes, switches and counts, but not the numbers."""
    if isinstance(world, World):
        return (world.dt, world.outer_every, *(kind(part) for part in world[4:]), world.control_every)
    if isinstance(world, tuple):
        return tuple(kind(part) for part in world)
    if isinstance(world, np.ndarray):
        return world.shape
    return None if isinstance(world, float) else cast(Hashable, world)


def _alone(job: Job) -> Outcome:
    try:
        return simulate(job.vehicle, job.plan, job.scenario, job.seed, rest_s=job.rest_s)
    except (GroundStationError, FloatingPointError) as error:
        return error


def _stacked(parts: Sequence[object]) -> object:
    """Constants of eight worlds as lanes, in the same tuples."""
    first = parts[0]
    if isinstance(first, tuple):
        fields = [_stacked(column) for column in zip(*cast(Sequence[tuple[object, ...]], parts), strict=True)]
        return cast(Callable[..., object], type(first))(*fields) if hasattr(first, "_fields") else tuple(fields)
    if isinstance(first, np.ndarray):
        return Rows(np.ascontiguousarray(np.stack(cast(Sequence[Array], parts), axis=-1)))
    return Lanes(np.array(parts)) if isinstance(first, float) else first


class Lane:
    """One flight of a group: its stretch, and how much of it has been run."""

    def __init__(self, simulation: Simulation, flight: Generator[Prepared, dict[str, Samples], SimulatedFlight]):
        self.simulation = simulation
        self.outcome: Outcome | None = None
        self._flight = flight
        self._take(next(flight))

    def _take(self, prepared: Prepared) -> None:
        self.prepared, self.steps, self.ticks, self.taken = prepared, 0, 0, np.zeros(4, dtype=int)
        self._found: list[Recorded] = []

    @property
    def left(self) -> int:
        """Steps of its stretch that are still to be run."""
        return self.prepared.stretch.steps - self.steps

    @property
    def until_look(self) -> int:
        """Steps until somebody has to look at it: at its stretch's end, or a piece's where it may land."""
        piece = self.prepared.pieces[0]
        return self.left if np.isinf(self.prepared.may_land_s) else piece - self.steps % piece

    @property
    def _landed(self) -> bool:
        time_s = (self.simulation.step + self.steps) * STEP_S
        at_end = self.steps % self.prepared.pieces[0] == 0
        return at_end and time_s > self.prepared.may_land_s and self.simulation.standing

    def advance(self, steps: int, found: Recorded, taken: NDArray[np.int_]) -> None:
        """Take what a run of so many steps left; at the end of its stretch the flight says what comes next."""
        self._found.append(found)
        self.steps += steps
        self.ticks += len(found.commands)
        self.taken = self.taken + taken
        if self.left and not self._landed:
            return
        parts = self._found
        whole = parts[0] if len(parts) == 1 else Recorded(*map(np.concatenate, zip(*parts, strict=True)))
        if self.left:
            whole = self._shortened(whole)
        try:
            self._take(self._flight.send(self.simulation.recorded(self.prepared, whole)))
        except StopIteration as end:
            self.outcome = end.value
        except (GroundStationError, FloatingPointError) as error:
            self.outcome = error

    def _shortened(self, found: Recorded) -> Recorded:
        """It landed: its stretch ends here. A sample within a nanosecond of the end belongs to the next one."""
        self.prepared = self.simulation.shortened(self.prepared, self.steps // self.prepared.pieces[0])
        stretch = self.prepared.stretch
        return found._replace(
            imu=found.imu[: len(stretch.imu_s)],
            poses=found.poses[: len(stretch.pose_s)],
            speeds=found.speeds[: len(stretch.speed_s)],
            volts=found.volts[: len(stretch.battery_s)],
        )


class Kernel:
    """The loop compiled for one kind of flights; a plain call would look at the types of all constants each time."""

    def __init__(self) -> None:
        self._code: Callable[..., None] | None = None

    def __call__(self, *arguments: object) -> None:
        if self._code is None:
            self._code = cast(Dispatcher, run_lanes).compile(tuple(map(typeof, arguments)))
        cast(Callable[..., None], self._code)(*arguments)


@lru_cache(maxsize=64)
def _kernel_of(shape: Hashable) -> Kernel:
    """The same for all flights of a :func:`kind` in this process."""
    return Kernel()


def _in_lockstep(
    members: Sequence[tuple[Job, World]], sources: dict[Hashable, SetpointSource], kernel: Kernel
) -> list[Outcome]:
    """Fly up to eight flights of one kind; empty lanes repeat the first one's world."""
    simulations = [Simulation(job.vehicle, job.scenario, job.seed, world) for job, world in members]
    spare = [simulations[0]] * (WIDTH - len(simulations))
    shared = simulations[0].world
    constants = cast(World, _stacked([s.world for s in (*simulations, *spare)]))
    world = constants._replace(dt=shared.dt, outer_every=shared.outer_every)
    memory = [
        np.stack(parts, axis=-1, dtype=float) for parts in zip(*(s.memory for s in (*simulations, *spare)), strict=True)
    ]
    lanes = []
    for j, (simulation, (job, _)) in enumerate(zip(simulations, members, strict=True)):
        simulation.memory = Memory(*(array[..., j] for array in memory))
        lanes.append(Lane(simulation, flown(simulation, job.plan, job.rest_s, sources, ahead=True)))
    rows = cast(Sequence[Array], [Rows(array) for array in memory])
    group = Group(world, Memory(*rows), _scratch(simulations[0].declared.rotors.count), lanes, kernel)
    while any(lane.outcome is None for lane in lanes):
        group.run()
    return [lane.outcome for lane in lanes if lane.outcome is not None]


def _scratch(rotors: int) -> Scratch:
    def rows(*shape: int) -> Rows:
        return Rows(np.zeros((*shape, WIDTH)))

    return Scratch(
        control=rows(CONTROL_SIZE),
        led=rows(rotors),
        estimate=rows(ESTIMATE_SIZE),
        low_pass=rows(2, 6),
        last_pose=rows(7),
        asked=rows(rotors),
        noise=rows(6),
        row=rows(7),
        pose=rows(7),
    )


def _side_by_side(parts: Sequence[Array | None], width: int, empty: float) -> Rows:
    """Rows of each lane side by side, and one more; ``empty`` where a lane has none."""
    longest = max(len(part) for part in parts if part is not None)
    out = np.full((longest + 1, width, WIDTH), empty)
    for j, part in enumerate(parts):
        if part is not None:
            out[: len(part), :, j] = part
    return Rows(out)


def _inputs(lanes: Sequence[Lane], first: int, steps: int, ticks: int) -> Inputs:
    """What the flights that are still under way need of the next steps."""
    under_way = [lane if lane.outcome is None else None for lane in lanes]
    stretches = [(lane, lane.prepared.stretch) if lane else None for lane in under_way]

    def column(device: int, values: Callable[[Stretch], Array], width: int, empty: float = np.inf) -> Rows:
        parts = [values(pair[1])[pair[0].taken[device] :] if pair else None for pair in stretches]
        return _side_by_side(parts, width, empty)

    def per_step(values: Callable[[Stretch], Array], width: int) -> Rows:
        parts = [values(pair[1])[pair[0].steps : pair[0].steps + steps] if pair else None for pair in stretches]
        return _side_by_side(parts, width, 0.0)

    setpoints = [pair[1].setpoints[pair[0].ticks : pair[0].ticks + ticks] if pair else None for pair in stretches]
    flying, start = np.zeros(WIDTH), np.full(WIDTH, np.inf)
    for j, pair in enumerate(stretches):
        if pair:
            flying[j], start[j] = pair[1].mode == FLYING, pair[1].start_s
    return Inputs(
        first=first,
        steps=steps,
        flying=cast(float, Lanes(flying)),
        start_s=cast(float, Lanes(start)),
        setpoints=_side_by_side(setpoints, 11, 0.0),
        imu_s=column(0, lambda s: s.imu_s[:, None], 1),
        imu_noise=column(0, lambda s: s.imu_noise, 6, 0.0),
        poses=column(1, lambda s: np.column_stack([s.pose_s, s.pose_arrival_s, s.pose_frozen, s.pose_noise]), 9),
        speed_s=column(2, lambda s: s.speed_s[:, None], 1),
        battery_s=column(3, lambda s: s.battery_s[:, None], 1),
        drift_noise=per_step(lambda s: s.drift_noise, 6),
        gust_noise=per_step(lambda s: s.gust_noise, 3),
    )


class Group:
    """Eight lanes at the same step."""

    def __init__(self, world: World, memory: Memory, scratch: Scratch, lanes: Sequence[Lane], kernel: Kernel):
        self.lanes, self._world, self._memory, self._scratch, self._kernel = lanes, world, memory, scratch, kernel
        self._step = 0

    def run(self) -> None:
        """Advance to the next end of a stretch."""
        steps = min(lane.until_look for lane in self.lanes if lane.outcome is None)
        every = self._world.control_every
        ticks = (self._step + steps - 1) // every - (self._step - 1) // every
        inputs = _inputs(self.lanes, self._step, steps, ticks)
        out = _outputs(inputs, ticks, len(self._scratch.asked.values))
        self._kernel(self._world, self._memory, inputs, self._scratch, out)
        self._step += steps
        for j, lane in enumerate(self.lanes):
            if lane.outcome is None:
                taken = out.taken.values[:, j].astype(int)
                sampled = (out.imu, out.poses, out.speeds, out.volts)
                imu, poses, speeds, volts = (rows.values[:k, :, j] for rows, k in zip(sampled, taken, strict=True))
                commands, estimates = out.commands.values[..., j], out.estimates.values[..., j]
                found = Recorded(imu, poses, speeds, volts, commands, estimates)
                lane.advance(steps, found, taken)


def _outputs(inputs: Inputs, ticks: int, rotors: int) -> Outputs:
    def rows(count: int, width: int) -> Rows:
        return Rows(np.empty((count, width, WIDTH)))

    return Outputs(
        imu=rows(len(inputs.imu_s.values), 6),
        poses=rows(len(inputs.poses.values), 7),
        speeds=rows(len(inputs.speed_s.values), rotors),
        volts=rows(len(inputs.battery_s.values), 2),
        commands=rows(ticks, rotors),
        estimates=rows(ticks, 13),
        taken=Rows(np.zeros((4, WIDTH))),
    )
