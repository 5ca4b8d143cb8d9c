"""Is anything impossible, hidden or unreadable ever published of an odd flight? `python -m benchmarks.odd_flights`

    python -m benchmarks.odd_flights [--first 450000] [--only NAME] [--out docs/results/odd_flights.json]

Flies what `studies.odd` lists, runs what `identify`, `predict` and `diagnose` run, and looks at every number of their
documents and of the model files. Exit status 1 where something is published that cannot be.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

from studies.odd import FLIGHTS, Outcome, flight_of, judged, seeded


def outcome(name: str, first: int) -> Outcome:
    """Of one flight; a traceback is a fault, too."""
    try:
        with tempfile.TemporaryDirectory() as folder:
            return judged(flight_of(name, first), Path(folder))
    except Exception:
        return Outcome([], [traceback.format_exc(limit=-4)])


def main() -> int:
    """Fly, judge, print and keep."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--first", type=int, default=450000, help="seed of the first; the others follow")
    parser.add_argument("--only", action="append", choices=list(FLIGHTS), help="this one alone (repeatable)")
    parser.add_argument("--out", type=Path, help="keep the rows as JSON")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for name in options.only or FLIGHTS:
        began = time.process_time()
        found = outcome(name, options.first)
        seed, _ = seeded(name, options.first)
        rows.append({"flight": name, "seed": seed, "said": found.said, "faults": found.faults})
        print(f"{name} ({rows[-1]['seed']}), {time.process_time() - began:.0f} s of CPU", flush=True)
        for line in (*found.said, *(f"FAULT {fault}" for fault in found.faults)):
            print(f"    {line}", flush=True)
    bad = [row["flight"] for row in rows if row["faults"]]
    print(f"flights: {len(rows)}; with something published that cannot be: {len(bad)} {bad}")
    if options.out:
        document = {"schema": "groundstation.benchmark.odd_flights/1", "rows": rows}
        options.out.write_text(json.dumps(document, indent=1) + "\n")
    return bool(bad)


if __name__ == "__main__":
    raise SystemExit(main())
