"""Flights nobody planned for an identification: what is revealed, are the intervals right, does the model predict?

    python -m benchmarks.unplanned [--vehicles 20] [--first 3000] [--out docs/results/unplanned.json]

Each seed draws a vehicle of 30 g to 3 kg, declared wrongly, and two flights of it: a pilot's wandering, waypoints flown
by minimum-jerk legs, or circles and figures of eight. The recordings hold neither plan nor setpoints nor a known
window, 100 Hz each, rotor speeds behind a filter (5 to 30 ms) and late (0 to 20 ms) by what no stamp says. Air resists
turning and moving, each effect with a chance of a half. The air is told from the first flight and from both; the first
flight is identified, and the model file's own choice predicts the second one, which nothing has seen. `--fewer`
identifies the first flight as logs without IMU, poses or both have it, with telemetry and with commands.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from groundstation.errors import FlightAborted
from studies.unplanned import air, fewer, fewer_summary, one, summary


def main() -> None:
    """Fly, judge, print and keep."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--vehicles", type=int, default=20)
    parser.add_argument("--first", type=int, default=3000, help="first seed; the others follow")
    parser.add_argument(
        "--diagnose", type=int, default=0, help="diagnose the first flight of so many of the vehicles, too"
    )
    parser.add_argument("--air", action="store_true", help="tell the effects of the air alone, which is quick")
    parser.add_argument("--fewer", action="store_true", help="identify alone, of logs that lack streams")
    parser.add_argument("--out", type=Path, default=Path("docs/results/unplanned.json"))
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    seed = options.first
    while len(rows) < options.vehicles:
        try:
            if options.fewer:
                rows.append(fewer(seed))
            else:
                rows.append(air(seed) if options.air else one(seed, len(rows) < options.diagnose))
            print(json.dumps(rows[-1]), flush=True)
        except FlightAborted as aborted:
            print(f"seed {seed}: {aborted}", flush=True)
        seed += 1
    print(fewer_summary(rows) if options.fewer else summary(rows))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps({"schema": "groundstation.benchmark.unplanned/1", "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
