"""How near to the Cramer-Rao bound do estimates scatter? The same flight many times, each with its own noise and
disturbance.

The reference scenario: the published trajectory of Table 2 for 40 s in the ``lab`` scenario. The bound is the one each
flight states: the information of its planned motion under its own coloured disturbance.

Run with ``make study`` or ``python -m benchmarks.scatter --flights N --seed S``; the output is kept in docs/study.md.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from groundstation.identification.anchoring import anchored
from groundstation.identification.dynamic_fit import fit_dynamics
from groundstation.identification.preparation import prepare
from groundstation.identification.results import MASS_AND_TENSOR
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from sim.scenario import load_scenario
from studies.flown import flight_data


def main() -> None:
    """Fly, identify, compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--flights", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1, help="of the first flight; the others follow")
    arguments = parser.parse_args()
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    plan = load_plan(find_config("plans", "paper_table2"))
    scenario = load_scenario(find_config("scenarios", "lab"))
    errors: dict[str, list[float]] = {name: [] for name in MASS_AND_TENSOR}
    bounds: dict[str, list[float]] = {name: [] for name in MASS_AND_TENSOR}
    for seed in range(arguments.seed, arguments.seed + arguments.flights):
        flight = flight_data(simulate(vehicle, plan, scenario, seed))
        assert flight.truth is not None
        truth = flight.truth.parameters()
        best = fit_dynamics([prepare(flight)]).best
        found, _ = anchored(vehicle, best.names, best.values, best.covariance)
        bound, _ = anchored(vehicle, best.names, best.values, best.bound)
        for name in MASS_AND_TENSOR:
            errors[name].append(found[name].value - truth[name])
            bounds[name].append(bound[name].std)
        print(f"seed {seed}", file=sys.stderr, flush=True)
    print(f"{arguments.flights} flights from seed {arguments.seed}\n")
    print("| parameter | scatter | mean error | bound | scatter over bound |\n|---|---|---|---|---|")
    for name in MASS_AND_TENSOR:
        scatter, bound = float(np.std(errors[name], ddof=1)), float(np.sqrt(np.mean(np.square(bounds[name]))))
        print(f"| {name} | {scatter:.3g} | {np.mean(errors[name]):+.2g} | {bound:.3g} | {scatter / bound:.2f} |")


if __name__ == "__main__":
    main()
