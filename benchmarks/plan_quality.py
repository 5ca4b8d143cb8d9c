"""One start from the library of solved rooms against several random starts, in rooms and for vehicles that the library
does not hold.

Both keep every limit; told are the criteria and processor seconds. Run with ``python -m benchmarks.plan_quality --rooms
N``; the rows are kept in docs/results/plan_quality.json.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from benchmarks.plan_library import draw_problem
from groundstation.planning.limits import largest_violation
from groundstation.planning.optimiser import Budget, best_of
from groundstation.planning.plan import solved_rooms

SEED = 21
"""Not the library's."""


def main() -> None:
    """Solve both ways and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rooms", type=int, default=6)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--starts", type=int, default=4, help="Random starts of the rival.")
    parser.add_argument("--output", type=Path, default=Path("docs/results/plan_quality.json"))
    options = parser.parse_args()
    library = solved_rooms()
    rows = json.loads(options.output.read_text(encoding="utf-8")) if options.first else []
    for room in range(options.first, options.first + options.rooms):
        task = draw_problem(np.random.default_rng([SEED, room]))
        row: dict[str, object] = {"room": room, "criterion": task.criterion, "harmonics": task.harmonics}
        ways = {"library, one start": (library, 1), "random starts": ((), options.starts)}
        for name, (known, starts) in ways.items():
            began = time.process_time()
            found = best_of([task], Budget(room, starts=starts), library=known)
            row[name] = {
                "starts": starts,
                "cost": round(found.cost, 6),
                "violation": largest_violation(found.series, task.envelopes),
                "seconds": round(time.process_time() - began, 2),
            }
        print(row, flush=True)
        rows.append(row)
    options.output.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
