"""A whole simulated flight in one call, for studies and tests: take-off, settle, excitation, landing."""

from __future__ import annotations

from collections.abc import Generator, Hashable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import FlightAborted
from groundstation.trajectory import Plan, Sequence, flight_path
from groundstation.vehicle import Vehicle
from sim.autopilot import SETPOINT_SIZE
from sim.build import STEP_S
from sim.scenario import Scenario
from sim.simulation import Prepared, Samples, SetpointSource, Simulation

Array = NDArray[np.float64]

EXCITATION = 3
"""Which part of :func:`groundstation.trajectory.flight_path` is the excitation."""

_CHUNK = 500  # steps after which a flight is asked whether it is over
_AT_ONCE = 16  # of these prepared together while it cannot be
_REMEMBERED = 400  # of these of which the setpoints are kept: three minutes, 10 MB
_SINK_M_S = 0.3  # how fast the setpoint goes on down after the landing leg, until the floor is felt


@dataclass(frozen=True, slots=True)
class SimulatedFlight:
    """What was recorded, and what was true.

    Attributes:
        streams: name to stamps, arrivals and values in docs/formats.md column order; empty streams are left out.
        vehicle: as declared.
        truth: as it was.
        window_s: start and end of the excitation on the motors' clock.
        plan: what was flown.
        scenario: its name.
    """

    streams: dict[str, Samples]
    vehicle: Vehicle
    truth: Vehicle
    window_s: tuple[float, float]
    plan: Plan
    scenario: str


def path_setpoints(path: Sequence, start_s: float) -> SetpointSource:
    """Setpoint rows along a path that began at ``start_s``; past its end they sink until the floor is felt."""

    def rows(times_s: Array) -> Array:
        t = times_s - start_s
        flat = path.sample(t)
        out = np.empty((len(t), SETPOINT_SIZE))
        out[:, :9] = np.concatenate(list(flat.position[:3]), axis=1)
        out[:, 9], out[:, 10] = flat.yaw[0], flat.yaw[1]
        over = np.maximum(t - path.duration_s, 0.0)
        out[:, 2] -= _SINK_M_S * over
        out[over > 0.0, 5] = -_SINK_M_S
        return out

    return rows


def excitation_window(path: Sequence, start_s: float) -> tuple[float, float]:
    """True start and end of the excitation of a :func:`groundstation.trajectory.flight_path`."""
    begin = start_s + sum(part.duration_s for part in path.parts[:EXCITATION])
    return begin, begin + path.parts[EXCITATION].duration_s


def _refuse_what_cannot_be_flown(simulation: Simulation, name: str, give_up_s: float) -> None:
    """End a flight that hit the floor, or is in the air though its time is up."""
    if simulation.crashed:
        raise FlightAborted(
            f"{name} hit the floor {simulation.crashed_s - simulation.flight_start_s:.1f} s after take-off; "
            "fly a gentler plan, or look whether the scenario leaves it enough thrust."
        )
    if simulation.time_s > give_up_s:
        raise FlightAborted(f"{name} did not come down within 20 s after the plan's end; is its thrust too high?")


def simulate(vehicle: Vehicle, plan: Plan, scenario: Scenario, seed: int, *, rest_s: float = 1.0) -> SimulatedFlight:
    """Fly a plan.

    Args:
        vehicle: the declared vehicle, which the simulated one differs from as the scenario says.
        plan: what to fly.
        scenario: the world.
        seed: same seed, same flight.
        rest_s: seconds on the floor before take-off and after landing.

    Raises:
        FlightAborted: the vehicle hit the floor or did not come down.
        BadInput: the scenario does not fit the vehicle.
    """
    simulation = Simulation(vehicle, scenario, seed)
    flight = flown(simulation, plan, rest_s, {})
    prepared = next(flight)
    while True:
        try:
            prepared = flight.send(simulation.run(prepared))
        except StopIteration as end:
            return end.value


@dataclass(slots=True)
class LastRows:
    """Setpoint rows of whole stretches, worked out once where several flights in a row ask for the same ones.

    Attributes:
        source: of the rows; asked piece by piece, so that their last bits do not depend on how many a stretch has.
        start_s: true time at which the first piece begins.
    """

    source: SetpointSource
    start_s: float
    _latest: dict[tuple[float, int], Array] = field(default_factory=dict)

    def __call__(self, times_s: Array) -> Array:
        """Rows at true times, which are control ticks one after the other."""
        key = (float(times_s[0]), len(times_s))
        if key not in self._latest:
            if len(self._latest) >= _REMEMBERED:
                del self._latest[next(iter(self._latest))]
            piece = np.floor((times_s - self.start_s + 1e-9) / (_CHUNK * STEP_S))
            parts = np.split(times_s, np.flatnonzero(np.diff(piece)) + 1)
            self._latest[key] = np.concatenate([self.source(part) for part in parts])
        return self._latest[key]


def flown(
    simulation: Simulation, plan: Plan, rest_s: float, sources: dict[Hashable, SetpointSource], *, ahead: bool = False
) -> Generator[Prepared, dict[str, Samples], SimulatedFlight]:
    """A flight as stretches to run, each answered by what was recorded on it; returns the whole.

    Args:
        simulation: of the vehicle, on the floor at time zero.
        plan: what to fly.
        rest_s: seconds on the floor before and after.
        sources: setpoints of flights side by side, by plan and start; added to.
        ahead: whether a stretch may be told to be shorter than it was prepared, where the vehicle lands on it.

    Raises:
        FlightAborted: the vehicle hit the floor or did not come down.
    """
    vehicle, scenario = simulation.declared, simulation.scenario
    chunks = [(yield simulation.ready_to_idle(round(rest_s / STEP_S)))]
    start = scenario.start
    path = flight_path(plan, np.array([*start.position_m, start.yaw_rad]))
    simulation.take_off_now()
    key = (id(plan), start.position_m, start.yaw_rad, simulation.time_s)
    source = sources.setdefault(key, LastRows(path_setpoints(path, simulation.time_s), simulation.time_s))
    begin, end = excitation_window(path, simulation.time_s)
    lands = simulation.time_s + path.duration_s
    give_up = lands + 20.0
    while not (simulation.standing and simulation.time_s > end):
        sure = int((end - simulation.time_s) / (_CHUNK * STEP_S))  # pieces after which it cannot have landed
        if sure > 0 or not ahead:
            ready = simulation.ready_to_fly(_CHUNK, source, min(max(sure, 1), _AT_ONCE))
        else:
            last = int((lands - simulation.time_s) / (_CHUNK * STEP_S)) + 2  # the floor is felt about then
            ready = simulation.ready_to_fly(_CHUNK, source, min(max(last, 1), _AT_ONCE), may_land_s=end)
        chunks.append((yield ready))
        _refuse_what_cannot_be_flown(simulation, vehicle.name, give_up)
    chunks.append((yield simulation.ready_to_idle(round(rest_s / STEP_S))))
    joined = {name: tuple(np.concatenate([chunk[name][i] for chunk in chunks]) for i in range(3)) for name in chunks[0]}
    clock = simulation.motor_clock_s
    return SimulatedFlight(
        streams={name: (s[0], s[1], s[2]) for name, s in joined.items() if len(s[0])},
        vehicle=vehicle,
        truth=simulation.truth,
        window_s=(clock(begin), clock(end)),
        plan=plan,
        scenario=scenario.name,
    )
