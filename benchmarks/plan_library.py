"""Makes ``configs/library/plans.json``, the solved rooms that ``groundstation plan`` starts from.

Rooms, vehicles and base frequencies are drawn at random (their seed is in the file); each is solved from several random
starts and the best is kept, in units of g and its base frequency. No room that a benchmark or a test plans for is put
in by hand.

Run with ``python -m benchmarks.plan_library --rooms N --starts K``.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import numpy as np

from groundstation.errors import BadInput
from groundstation.paths import configs_dir
from groundstation.planning.library import Solved, solved
from groundstation.planning.limits import envelope
from groundstation.planning.optimiser import Budget, best_of
from groundstation.planning.problem import Problem
from studies.study import draw_vehicle

SEED = 20
HARMONICS = (5, 5, 5, 3, 8)
CRITERIA = ("condition", "condition", "A")


def log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(np.exp(random.uniform(math.log(low), math.log(high))))


def draw_problem(random: np.random.Generator) -> Problem:
    """A room, a vehicle, a criterion and a base frequency; every second room is started from its floor."""
    vehicle = draw_vehicle(random)
    floor = float(random.uniform(0.2, 0.8))
    limits = {
        "x_max_m": log_uniform(random, 0.5, 4.0),
        "y_max_m": log_uniform(random, 0.5, 4.0),
        "z_min_m": floor,
        "z_max_m": floor + log_uniform(random, 0.4, 3.0),
        "yaw_max_rad": math.pi,
        "speed_max_m_s": log_uniform(random, 0.3, 3.0),
        "yaw_rate_max_rad_s": log_uniform(random, 0.3, 2.0),
        "tilt_max_rad": log_uniform(random, 0.05, 0.4),
    }
    harmonics = int(random.choice(HARMONICS))
    frequency = 2.0 * math.pi * random.uniform(0.3, 1.0) * min(0.2, 1.0 / harmonics)
    start = (0.0, 0.0, floor, 0.0) if random.random() < 0.5 else None
    criterion = str(random.choice(CRITERIA))
    return Problem((vehicle,), (envelope(vehicle, limits),), criterion, harmonics, float(frequency), 40.0, start)


def main() -> None:
    """Solve and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rooms", type=int, default=24)
    parser.add_argument(
        "--first", type=int, default=0, help="Number of the first room; above 0 the file's rooms are kept."
    )
    parser.add_argument("--starts", type=int, default=4)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--output", type=Path, default=configs_dir() / "library" / "plans.json")
    options = parser.parse_args()
    plans: list[Solved] = []
    if options.first:
        plans = [Solved.from_dict(each) for each in json.loads(options.output.read_text(encoding="utf-8"))["plans"]]
    for room in range(options.first, options.first + options.rooms):
        random = np.random.default_rng([options.seed, room])
        try:
            task = draw_problem(random)
        except BadInput as error:
            print(f"room {room}: {error}")
            continue
        found = best_of([task], Budget(room, starts=options.starts))
        print(f"room {room}: {task.criterion}, {task.harmonics} harmonics, {found.cost:.4g}", flush=True)
        plans.append(solved(found.series, task))
    document = {"schema": "groundstation.plan_library/1", "seed": options.seed, "starts": options.starts}
    lines = ",\n".join(json.dumps(plan.to_dict()) for plan in plans)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(f'{json.dumps(document)[:-1]}, "plans": [\n{lines}\n]}}\n', encoding="utf-8")


if __name__ == "__main__":
    main()
