"""What is to fly and over which link, as chosen on the Station screen; and how a flight of it is begun."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.access import Access
from groundstation.errors import BadInput
from groundstation.flight.children import Child
from groundstation.flight.client.client import FlightOrder, new_flight_folder, start_core
from groundstation.paths import configs_dir, find_config, shipped_config
from groundstation.texts import file_name
from groundstation.tui.margins import FlightLimits

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from groundstation.trajectory import Plan

SIMULATOR = "simulator"
UDP = "udpin://127.0.0.1:14540"
PATH_POINTS = 240


@dataclass(frozen=True, slots=True)
class Setup:
    """What flies.

    Attributes:
        vehicle: vehicle file, or the name of a shipped one.
        link: ``simulator``, or the address of a MAVLink vehicle.
        scenario: of the simulated drone.
        seed: of the simulated drone.
        real_time: let the simulated drone fly at the wall clock's pace.
        station: station file of a linked vehicle.
    """

    vehicle: str = "qball2"
    link: str = SIMULATOR
    scenario: str = "seed"
    seed: int = 1
    real_time: bool = True
    station: str = "default"

    @property
    def simulated(self) -> bool:
        """Nothing real moves, so that no typed confirmation is asked."""
        return self.link == SIMULATOR


def shipped(kind: str) -> list[str]:
    """Names of the shipped files of a kind."""
    return sorted(path.stem for path in (configs_dir() / kind).glob("*.toml"))


def links() -> list[str]:
    """Links there are to choose from: the simulator, the usual UDP port, and the serial ports found."""
    from serial.tools import list_ports

    ports = [f"serial://{port.device}:921600" for port in list_ports.comports() if port.hwid != "n/a"]
    return [SIMULATOR, UDP, *sorted(ports)]


def plan_at_hand(setup: Setup, newest: Plan | None) -> Plan | None:
    """The newest plan where it was made for what flies, else the one that ships for it, if one does."""
    from groundstation.trajectory import load_plan

    if newest is not None and newest.vehicle == setup.vehicle:
        return newest
    path = configs_dir() / "plans" / f"{file_name(setup.vehicle)}.toml"
    return load_plan(path) if path.is_file() else None


def begin_flight(setup: Setup, plan: Plan, logs: Path, *, analyse: bool = True) -> tuple[Child, Access, Path]:
    """Start the core of a flight: its process, endpoint and folder. It waits for the operator's start.

    Raises:
        BadInput: vehicle, scenario or station do not exist.
    """
    from groundstation.analysis.plans import write_plan
    from groundstation.flight.client.rehearse import LinkOrder, linked_vehicle, simulated_drone
    from groundstation.flight.station import load_station
    from groundstation.flight.until import lasting_until
    from groundstation.vehicle import load_vehicle

    vehicle = find_config("vehicles", setup.vehicle).resolve()
    until = load_vehicle(vehicle).until or load_station(setup.station).until
    if until is not None:
        plan = lasting_until(plan, until, automatic=setup.simulated)
    folder = new_flight_folder(logs.resolve(), vehicle.stem)
    if setup.simulated:
        scenario = find_config("scenarios", setup.scenario).resolve()
        drone = simulated_drone(vehicle, scenario, setup.seed, real_time=setup.real_time)
    else:
        drone = linked_vehicle(folder, vehicle, LinkOrder(setup.link, setup.station))
    folder.mkdir(parents=True)
    plan_file = write_plan(plan, folder / "plan.toml")
    core, endpoint = start_core(FlightOrder(folder, plan_file, vehicle, drone, analyse=analyse))
    return core, endpoint, folder


def flight_limits(folder: Path, station: str, *, simulated: bool) -> FlightLimits:
    """What bounds the flight in a folder: its plan's room and path, and where the guard of a station file acts."""
    from groundstation.flight.station import load_station
    from groundstation.trajectory import load_plan
    from groundstation.vehicle import load_vehicle

    try:
        limits = load_station(station)
        box = limits.box
        known = FlightLimits(
            tracking_m=limits.guard.tracking.limit,
            tilt_rad=limits.guard.tilt.limit,
            speed_m_s=limits.guard.speed.limit,
            box=(box.x_m, box.y_m, box.z_m),
            station=limits.name,
            watched=not simulated,
        )
    except BadInput:
        known = FlightLimits()
    try:
        plan = load_plan(folder / "plan.toml")
        empty_v = load_vehicle(shipped_config("vehicles", plan.vehicle)).battery.empty_v
    except BadInput:
        return known
    return replace(known, room=dict(plan.limits), empty_v=empty_v, path=plan_path(plan))


def plan_path(plan: Plan) -> NDArray[np.float64]:
    """Positions of one period of the excitation, shape (k, 3)."""
    import numpy as np

    series = plan.series()
    return series.sample(np.linspace(0.0, min(series.period_s, series.duration_s), PATH_POINTS)).position[0]
