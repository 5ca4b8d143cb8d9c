"""Does a planned trajectory do what was predicted? Flies the published and a planned trajectory many times each.

The vehicle, the room, the tilt and the 40 s are the same; the base frequency is free for the planned one. Each flight
has its own disturbance (the planner's default: 0.3 % of weight, of weight times arm, 0.5 s) and gyro noise; least
squares identifies it, and the scatter of its estimates over the flights is set beside the prediction.

Run with ``python -m benchmarks.planned_flights``; the output is kept in docs/planning.md.
"""

from __future__ import annotations

import argparse

import numpy as np

from groundstation.identification.seed import identify_seed
from groundstation.planning import paper_plan, paper_problem, percentages, plan_excitation
from groundstation.planning.criteria import PARAMETERS
from groundstation.planning.plan import PAPER_START
from groundstation.trajectory import Plan
from groundstation.vehicle import Vehicle
from sim.flight import simulate
from sim.scenario import Scenario, scenario_from_dict
from studies.flown import flight_data

PUBLISHED_TILT_RAD = np.radians(6.2155)
DIAGONAL = ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")


def draughty_room() -> Scenario:
    """The planner's default noise in an otherwise ideal laboratory."""
    return scenario_from_dict(
        {
            "name": "draught",
            "imu": {"rate_hz": 500.0, "gyro_density": 3e-4, "accel_density": 5e-3},
            "mocap": {"rate_hz": 100.0, "position_std_m": 1e-4, "attitude_std_rad": 5e-4},
            "motors": {"rate_hz": 500.0},
            "control": {"attitude_hz": 500, "position_hz": 100.0},
            "disturbance": {"force_share": 0.003, "torque_share": 0.003, "correlation_s": 0.5},
            "truth": {"inertia_factor": [1.2, 0.9, 0.95]},
        }
    )


def relative_errors(vehicle: Vehicle, plan: Plan, flights: int, method: str) -> np.ndarray:
    """Estimate minus truth over the nominal size in per cent, shape (flights, 7)."""
    errors = np.empty((flights, len(PARAMETERS)))
    scenario = draughty_room()
    for k in range(flights):
        flown = simulate(vehicle, plan, scenario, seed=1000 + k)
        found = identify_seed(flight_data(flown))[method].parameters
        truth = [flown.truth.mass_kg, *flown.truth.inertia_tensor()[np.triu_indices(3)]]
        absolute = {name: found[name].value - true for name, true in zip(PARAMETERS, truth, strict=True)}
        errors[k] = list(percentages(absolute, vehicle).values())
    return errors


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=100)
    parser.add_argument("--starts", type=int, default=6)
    parser.add_argument("--method", default="LS")
    arguments = parser.parse_args()
    vehicle = paper_problem()["vehicle"]
    planned = plan_excitation(
        vehicle,
        criterion="A",
        duration_s=40.0,
        start=PAPER_START,
        starts=arguments.starts,
        tilt_max_rad=PUBLISHED_TILT_RAD,
    )
    worst = {}
    for name, plan in (("published", paper_plan()), ("planned", planned)):
        predicted = percentages(plan.predicted_std, vehicle)
        errors = relative_errors(vehicle, plan, arguments.flights, arguments.method)
        print(f"{name}: {arguments.flights} flights of {plan.series().duration_s:.0f} s, {arguments.method}")
        print(f"  {'per cent':<10}" + "".join(f"{p.split('_')[0]:>8}" for p in PARAMETERS))
        print(f"  {'predicted':<10}" + "".join(f"{predicted[p]:8.3f}" for p in PARAMETERS))
        print(f"  {'scatter':<10}" + "".join(f"{v:8.3f}" for v in errors.std(axis=0, ddof=1)))
        print(f"  {'mean error':<10}" + "".join(f"{v:8.3f}" for v in errors.mean(axis=0)))
        columns = [PARAMETERS.index(p) for p in DIAGONAL]
        worst[name] = max(predicted[p] for p in DIAGONAL), errors.std(axis=0, ddof=1)[columns].max()
    ratio = [a / b for a, b in zip(worst["published"], worst["planned"], strict=True)]
    print(f"worst diagonal inertia, published over planned: predicted {ratio[0]:.2f}, flown {ratio[1]:.2f}")


if __name__ == "__main__":
    main()
