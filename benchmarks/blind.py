"""How often does the diagnosis name what was hidden, without being told? Run with ``make blind``; kept in
docs/diagnosis.md.

Every flight draws its vehicle, trajectory, true mass and inertia, disturbance, biases, stamp jitter and seed from a
master seed that is new each run and printed. One effect is hidden in a *single*, two in a *pair*, none in a *clean*
flight, and in an *invented* one something that no file of the library models. The diagnosis gets the recording and the
declared vehicle, nothing else. Sizes are drawn over a range around what such a vehicle shows; what is too small to see
is counted apart, as docs/diagnosis.md defines it: *detectable* is an expected t of 6 in the flight's own coloured
noise, taken from the joint estimate with the hidden effects told and kept out of the noise, and for kinematic effects
and delays a size above those of docs/diagnosis.md. An invented force of a place is told by the simulator's own formula;
thrust with memory counts as detectable.
"""

from __future__ import annotations

import argparse
import json
import math
import secrets
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.visibility import visibility
from groundstation.diagnosis import diagnose
from groundstation.diagnosis.results import Diagnosis
from groundstation.errors import FlightAborted, Refused
from groundstation.identification.results import Estimate
from groundstation.paths import find_config
from groundstation.planning import plan_excitation
from groundstation.trajectory import Plan
from groundstation.vehicle import Vehicle, load_vehicle
from sim.flight import simulate
from studies import many
from studies.flown import flight_data
from studies.hidden import INVENTED, Random, declared, sizes, world
from studies.tally import Outcome, report

VEHICLES = ("qball2", "x500")
DURATION_S = 40.0
PLANS = 2
"""Trajectories planned for each vehicle in a run."""
MASS_BOUND, MOMENT_BOUND = 0.01, 0.02
INERTIA = ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")


def _error_of_parameters(estimates: Any, truth: Vehicle) -> float:
    """Root mean square of the relative errors of mass and of the moments of inertia; NaN where one is missing."""
    tensor = np.diag(truth.inertia_tensor())
    true = dict(zip(("mass_kg", *INERTIA), (truth.mass_kg, *tensor), strict=True))
    errors = [estimates[n].value / v - 1.0 if n in estimates else math.nan for n, v in true.items()]
    return float(np.sqrt(np.mean(np.square(errors))))


def _meets_bounds(parameters: Mapping[str, Estimate], truth: Vehicle) -> bool:
    """Whether mass and moments are as near as the estimation study asks: 1 % and the larger of 2 % and three
    deviations.
    """
    moments = [(parameters.get(name), getattr(truth.inertia_kg_m2, name[1:3])) for name in INERTIA]
    mass = parameters.get("mass_kg")
    return (
        mass is not None
        and abs(mass.value - truth.mass_kg) <= MASS_BOUND * truth.mass_kg
        and all(e is not None and abs(e.value - own) <= max(MOMENT_BOUND * own, 3.0 * e.std) for e, own in moments)
    )


def fly(kind: str, names: Sequence[str], vehicle_name: str, plan: Plan, random: Random) -> Outcome | None:
    """Hide, fly, diagnose; None where the vehicle could not fly it."""
    vehicle = declared(vehicle_name, names)
    hidden = {name: sizes(vehicle)[name](random) for name in names}
    try:
        simulated = simulate(vehicle, plan, world(random, hidden, vehicle), int(random.integers(2**31)))
    except FlightAborted:
        return None
    flight = flight_data(simulated, "unknown")
    start = time.perf_counter()
    diagnosis: Diagnosis = diagnose([flight])
    seconds = time.perf_counter() - start
    try:
        seen = visibility(flight, list(hidden.items()))
    except Refused:
        seen = [(0.0, math.nan)] * len(names)
    rotors = tuple(
        f.rotor == hidden[f.effect]["rotor"] for f in diagnosis.findings if "rotor" in hidden.get(f.effect, {})
    )
    return Outcome(
        kind=kind,
        hidden=tuple(names),
        verdict=diagnosis.verdict,
        named=tuple(f.effect for f in diagnosis.findings),
        alternatives=diagnosis.findings[0].alternatives if diagnosis.findings else (),
        rotors=rotors,
        before=_error_of_parameters(diagnosis.parameters_before, simulated.truth),
        after=_error_of_parameters(diagnosis.parameters_after, simulated.truth),
        met_before=_meets_bounds(diagnosis.parameters_before, simulated.truth),
        met_after=_meets_bounds(diagnosis.parameters_after, simulated.truth),
        seconds=seconds,
        t=tuple(t for t, _ in seen),
        shares=tuple(share for _, share in seen),
    )


def schedule(random: Random, counts: dict[str, int]) -> list[tuple[str, tuple[str, ...]]]:
    """Kinds and hidden names; singles run through a fresh permutation of all effects, so that none is left out by
    chance.
    """
    known = [name for name in sizes(load_vehicle(find_config("vehicles", "x500"))) if name not in INVENTED]
    alone = [name for name in known if name != "wind"]
    singles: list[str] = []
    while len(singles) < counts["single"]:
        singles += [str(name) for name in random.permutation(alone)]
    work: list[tuple[str, tuple[str, ...]]] = [("single", (name,)) for name in singles[: counts["single"]]]
    work += [("clean", ())] * counts["clean"]
    for _ in range(counts["pair"]):
        pair = tuple(map(str, random.choice(known, 2, replace=False)))
        work.append(("pair", ("rotor_drag", "wind") if "wind" in pair else pair))  # air is felt through drag alone
    work += [("invented", (INVENTED[i % len(INVENTED)],)) for i in range(counts["invented"])]
    return [work[i] for i in random.permutation(len(work))]


def _fly(item: tuple[str, tuple[str, ...], str, Plan, Random]) -> Outcome | None:
    return fly(*item)


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="benchmarks.blind", description="Diagnosis of effects it was not told about.")
    for kind, number in (("singles", 44), ("pairs", 20), ("clean", 40), ("invented", 15)):
        parser.add_argument(f"--{kind}", type=int, default=number)
    parser.add_argument("--seed", type=int, default=None, help="master seed (default: a fresh one, printed)")
    parser.add_argument("--minutes", type=float, default=math.inf, help="start no flight after this time")
    parser.add_argument(
        "--rows", type=Path, default=None, help="append each flight's outcome to this file, as JSON lines"
    )
    many.add_options(parser)
    options = parser.parse_args(argv)
    over = time.monotonic() + 60.0 * options.minutes
    master = secrets.randbits(32) if options.seed is None else options.seed
    counts = {"single": options.singles, "pair": options.pairs, "clean": options.clean, "invented": options.invented}
    print("master seed", master, counts, flush=True)
    random = np.random.default_rng(master)
    plans = {
        name: [
            plan_excitation(
                load_vehicle(find_config("vehicles", name)),
                criterion="A",
                duration_s=DURATION_S,
                seed=int(random.integers(2**31)),
                time_budget_s=5.0,
            )
            for _ in range(PLANS)
        ]
        for name in VEHICLES
    }
    outcomes, lost = [], 0
    work = []
    planned = schedule(random, counts)
    for (kind, names), own in zip(planned, random.spawn(len(planned)), strict=True):
        vehicle = str(own.choice(VEHICLES))
        work.append((kind, names, vehicle, plans[vehicle][int(own.integers(PLANS))], own))
    for each in many.outcomes(_fly, work, options):
        kind, names, vehicle, *_ = each.item
        outcome = each.value
        if outcome is None:
            lost += 1
        else:
            outcomes.append(outcome)
            if options.rows is not None:
                with options.rows.open("a") as rows:
                    rows.write(json.dumps({"seed": master, "vehicle": vehicle, **asdict(outcome)}) + "\n")
            print(
                f"{each.index + 1}/{len(work)} {vehicle:8} {kind:8} {' + '.join(names) or 'nothing':30} -> "
                f"{outcome.verdict}: {', '.join(outcome.named) or 'no finding'}",
                flush=True,
            )
        if time.monotonic() > over:
            print("out of time: the rest was not flown")
            break
    if lost:
        print(f"{lost} flights ended on the floor and are left out")
    report(outcomes)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
