"""Is a load on a cable named with its size, and never where there is none? `python -m benchmarks.slung_load`

Loads of 5 to 10 % of the mass hang on 0.35 to 0.6 m below vehicles of two simulators: MuJoCo's Hummingbird (a rigid rod
on a ball joint that resists turning; `benchmarks.other_forms`), flown along plans of 1 m/s and 0.12 rad, and this
project's qball2 and x500 (a cable that gives way, in air; `studies.hidden`). In every other flight the declared mass
holds the load. `--clean` flies as many of each simulator without a load. Truth is drawn from a seed for each flight.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.other_forms import MASS_KG, Body
from benchmarks.other_forms import fly as fly_in_mujoco
from benchmarks.rotorpy_blind import declared as hummingbird
from groundstation.diagnosis import diagnose
from groundstation.diagnosis.results import Diagnosis
from groundstation.flightdata import FlightData
from groundstation.planning import plan_excitation
from groundstation.trajectory import Plan
from groundstation.vehicle import Vehicle
from sim.flight import simulate
from studies.flown import flight_data
from studies.hidden import declared, world

SLOW = {"speed_max_m_s": 1.0, "tilt_max_rad": 0.12}
"""Along plans of 2 m/s a load on half a metre goes over the top on that vehicle."""
VEHICLES = ("qball2", "x500")
NAMES = {"load_kg": "load_kg", "length_m": "length_m", "air_1_s": "air_1_s", "depth_m": "hook_m"}

Random = np.random.Generator


def plans_for(vehicle: Vehicle, seed: int, count: int) -> list[Plan]:
    """Plans of 40 s."""
    return [
        plan_excitation(vehicle, criterion="A", duration_s=40.0, seed=seed + i, time_budget_s=1.2) for i in range(count)
    ]


def drawn(random: Random, mass_kg: float) -> dict[str, float]:
    """A load."""
    names = ("load_kg", "length_m", "hook_m", "air_1_s")
    low, high = np.array([[0.05 * mass_kg, 0.35, 0.0, 0.05], [0.10 * mass_kg, 0.6, 0.06, 0.3]])
    return dict(zip(names, map(float, random.uniform(low, high)), strict=True))


def in_mujoco(seed: int, plans: Sequence[Plan], loaded: bool) -> tuple[FlightData, dict[str, float]]:
    """A Hummingbird's flight and its truth."""
    random, vehicle = np.random.default_rng([77, seed]), hummingbird(False)
    plan = plans[int(random.integers(len(plans)))]
    moments = np.diag(vehicle.inertia_tensor()) * random.uniform([0.95, 0.95, 0.8], [1.15, 1.15, 0.95])
    mass = vehicle.mass_kg * float(random.uniform(0.95, 1.05))
    load = drawn(random, MASS_KG) if loaded else {}
    mass -= load.get("load_kg", 0.0) * (seed % 2)
    hidden = {"slung_kg": load["load_kg"], **load} if loaded else {}
    return fly_in_mujoco(vehicle, plan, hidden, Body(mass, moments), random), {"mass_kg": mass, **load}


def in_our_own(seed: int, plans: dict[str, list[Plan]], loaded: bool) -> tuple[FlightData, dict[str, float]]:
    """A flight of a vehicle of configs/ and its truth."""
    random, name = np.random.default_rng([78, seed]), VEHICLES[seed % 2]
    vehicle = declared(name, ())
    plan = plans[name][int(random.integers(len(plans[name])))]
    load = drawn(random, vehicle.mass_kg) if loaded else {}
    table = {
        "mass_kg": load.get("load_kg"),
        "length_m": load.get("length_m"),
        "attachment_m": [0.0, 0.0, -load.get("hook_m", 0.0)],
        "damping_1_s": load.get("air_1_s"),
    }
    scenario = world(random, {"slung_load": table} if loaded else {}, vehicle)
    if loaded and (seed // 2) % 2:
        factor = scenario.truth.mass_factor - load["load_kg"] / vehicle.mass_kg
        scenario = scenario.model_copy(update={"truth": scenario.truth.model_copy(update={"mass_factor": factor})})
    flown = simulate(vehicle, plan, scenario, seed)
    return flight_data(flown, "unknown"), {"mass_kg": flown.truth.mass_kg, **load}


def row(name: str, found: Diagnosis, true: dict[str, float]) -> dict[str, Any]:
    """What is kept of a flight."""
    mass = found.parameters_after.get("mass_kg")
    load = next((f for f in found.findings if f.effect == "slung_load"), None)
    away = {}
    if load is not None and "load_kg" in true:
        away = {n: (load.parameters[n].value - true[t]) / load.parameters[n].std for n, t in NAMES.items()}
    return {
        "flight": name,
        "true": true,
        "verdict": found.verdict,
        "named": {f.effect: {n: [e.value, e.std] for n, e in f.parameters.items()} for f in found.findings},
        "away": away,
        "mass_away": None if mass is None else (mass.value - true["mass_kg"]) / mass.std,
        "warned": any("swings as a load" in warning for warning in found.warnings),
    }


def summary(rows: Sequence[dict[str, Any]]) -> str:
    """Counts."""
    loaded = [r for r in rows if "load_kg" in r["true"]]
    clean = [r for r in rows if "load_kg" not in r["true"]]
    first = [r for r in loaded if next(iter(r["named"]), "") == "slung_load"]
    lines = [f"loads named first: {len(first)} of {len(loaded)}"]
    for name in (*NAMES, "mass_kg"):
        away = [r["mass_away"] if name == "mass_kg" else r["away"].get(name) for r in loaded]
        known = [a for a in away if a is not None]
        lines.append(f"{name} inside the 95 % interval: {sum(abs(a) < 1.96 for a in known)} of {len(known)}")
    alarms = [r for r in clean if "slung_load" in r["named"] or r["warned"]]
    lines.append(f"loads named or warned of on clean flights: {len(alarms)} of {len(clean)}")
    lines.append(f"clean flights called clean: {sum(r['verdict'] == 'clean' for r in clean)} of {len(clean)}")
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Fly, diagnose, count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--flights", type=int, default=6, help="with a load, of each simulator")
    parser.add_argument("--clean", type=int, default=6, help="without one, of each simulator")
    parser.add_argument("--first", type=int, default=400, help="seed of the first; the others follow")
    parser.add_argument("--out", type=Path, help="keep the rows as JSON")
    options = parser.parse_args(argv)
    slow = hummingbird(False)
    slow = slow.model_copy(update={"limits": slow.limits.model_copy(update=SLOW)})
    for_mujoco = plans_for(slow, 7700, 3)
    ours = {name: plans_for(declared(name, ()), 7800, 2) for name in VEHICLES}
    rows: list[dict[str, Any]] = []
    for number in range(options.flights + options.clean):
        loaded, seed = number < options.flights, options.first + number
        for simulator, (flight, true) in (
            ("mujoco", in_mujoco(seed, for_mujoco, loaded)),
            ("ours", in_our_own(seed, ours, loaded)),
        ):
            rows.append(row(f"{simulator} {seed}", diagnose([flight]), true))
            print(json.dumps(rows[-1]), flush=True)
    print(summary(rows))
    if options.out:
        document = {"schema": "groundstation.benchmark.slung_load/1", "rows": rows}
        options.out.write_text(json.dumps(document, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
