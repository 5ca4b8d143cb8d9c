"""Any rotors: three to twelve of them, tilted and upright, planned for, flown in simulation and identified.

``python -m benchmarks.rotor_layouts [--flights 2]`` flies the shipped hexacopters and the tricopter, and rings of eight
and twelve rotors with tilts and heights drawn at random, in the laboratory with mass, tensor and centre of mass drawn
beside what is declared; and keeps the deviations from the truth in docs/results/rotor_layouts.json.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TypedDict

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from groundstation.errors import GroundStationError
from groundstation.flightdata import FlightData
from groundstation.identification.pipeline import identify
from groundstation.paths import find_config
from groundstation.planning import plan_excitation
from groundstation.reporting.canonical import canonical
from groundstation.vehicle import Vehicle, load_vehicle, vehicle_from_dict, vehicle_to_dict
from groundstation.writing import write_whole
from sim.flight import simulate
from sim.scenario import load_scenario
from studies.flown import flight_data

SEED = 20261129
RESULTS = Path(__file__).resolve().parents[1] / "docs" / "results" / "rotor_layouts.json"
JUDGED = ("mass_kg", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")


class Row(TypedDict):
    """One flight: (estimate - truth) / standard deviation by parameter, and what was not revealed."""

    vehicle: str
    rotors: int
    seed: int
    deviations: dict[str, float]
    relative: dict[str, float]
    hidden: list[str]


def ring(count: int, rng: np.random.Generator) -> Vehicle:
    """The hexacopter's body under a ring of rotors at drawn heights, tilted about their arms by turns, by a drawn
    angle.
    """
    document = vehicle_to_dict(load_vehicle(find_config("vehicles", "hexa")))
    angle = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    place = 0.3 * np.column_stack([np.cos(angle), np.sin(angle), rng.uniform(-0.1, 0.1, count)])
    spin = np.where(np.arange(count) % 2, 1, -1)
    tilt = np.radians(rng.uniform(5.0, 15.0)) * -spin
    axes = np.column_stack([-np.sin(tilt) * np.sin(angle), np.sin(tilt) * np.cos(angle), np.cos(tilt)])
    document["rotors"] |= {"position_m": place.tolist(), "axis": axes.tolist(), "spin": spin.tolist()}
    document["vehicle"]["name"] = f"ring of {count}"
    return vehicle_from_dict(document)


def vehicles() -> Iterator[Vehicle]:
    """What is flown."""
    for name in ("hexa", "hexa-tilted", "tricopter"):
        yield load_vehicle(find_config("vehicles", name))
    rng = np.random.default_rng(SEED)
    for count in (4, 8, 12):
        yield ring(count, rng)


def flown(vehicle: Vehicle, seed: int, periods: float) -> FlightData:
    """A flight of a plan of its own."""
    plan = plan_excitation(vehicle, criterion="D", harmonics=3, duration_s=10.0, seed=seed, starts=1, time_budget_s=5.0)
    plan = plan.model_copy(update={"periods": periods})
    return flight_data(simulate(vehicle, plan, load_scenario(find_config("scenarios", "lab")), seed))


def row_of(flight: FlightData, seed: int) -> Row:
    """Identified against the truth."""
    truth, found = flight.truth, identify([flight])
    if truth is None:
        raise ValueError("a simulated flight knows its truth")
    known, estimates = truth.parameters(), canonical(found, None).parameters
    shown = {name: estimates[name] for name in JUDGED if name in estimates}
    return {
        "vehicle": flight.vehicle.name,
        "rotors": flight.vehicle.rotors.count,
        "seed": seed,
        "deviations": {name: round((e.value - known[name]) / e.std, 2) for name, e in shown.items()},
        "relative": {name: round(e.value / known[name] - 1.0, 5) for name, e in shown.items()},
        "hidden": [name for name in JUDGED if name not in shown],
    }


def main() -> None:
    """Fly all, print and keep the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=2)
    parser.add_argument("--periods", type=float, default=4.0)
    parser.add_argument("--only", action="append", default=[])
    options = parser.parse_args()
    rows: list[Row] = []
    wanted = [vehicle for vehicle in vehicles() if not options.only or vehicle.name in options.only]
    for kind, vehicle in enumerate(wanted):
        for number in range(options.flights):
            seed = SEED + 100 * kind + number
            try:
                rows.append(row_of(flown(vehicle, seed, options.periods), seed))
                print(rows[-1], flush=True)
            except GroundStationError as error:
                print(f"{vehicle.name}: {error}", flush=True)
    if options.only and RESULTS.is_file():
        kept = json.loads(RESULTS.read_text(encoding="utf-8"))["rows"]
        rows = [*(row for row in kept if row["vehicle"] not in options.only), *rows]
    judged = [abs(value) for row in rows for value in row["deviations"].values()]
    inside = sum(value <= 1.96 for value in judged)
    print(f"{inside} of {len(judged)} within the 95 % interval; largest deviation {max(judged, default=0.0):.1f} sigma")
    if rows:
        document = {"schema": "groundstation.rotor_layouts/1", "rows": rows, "inside": inside, "judged": len(judged)}
        write_whole(RESULTS, json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
