"""Every wrong declaration, on flights with a plan and without: found by a check or refused on reading, and false
alarms.

    python -m benchmarks.declarations [--seeds 12] [--first 900]
    python -m benchmarks.declarations --right [--seeds 150] [--first 900]

Flights are drawn as in the study (vehicles of 30 g to 3 kg, gentle and fast, with disturbance, noise, latency and clock
offsets); half of them without plan, setpoint and known window, their rotor speeds 100 Hz and filtered as slow telemetry
is. Each right flight is checked once, and once with each wrong declaration, which is found where reading refuses it or
a check contradicts or doubts it. With --right the right flights alone are checked: how often an alarm is false.
"""

from __future__ import annotations

import argparse
import json

import numpy as np

from groundstation.errors import FlightAborted
from studies.declarations import OUT, WRONG, as_right, unplanned, verdict, with_state
from studies.study import draw


def main() -> None:
    """Fly, check, print and keep."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--first", type=int, default=900)
    parser.add_argument("--right", action="store_true", help="check right flights alone, for false alarms")
    given = parser.parse_args()
    wrong = {} if given.right else WRONG
    out = OUT.with_name("declarations_right.json") if given.right else OUT
    tally = {kind: {name: [0, 0] for name in wrong} for kind in ("planned", "unplanned")}
    alarms: list[str] = []
    checked, seeds = 0, []
    for seed in range(given.first, given.first + given.seeds):
        try:
            flight = with_state(as_right(draw(seed, 0.5, 250.0)[0]))
        except FlightAborted:
            continue
        seeds.append(seed)
        random = np.random.default_rng([7, seed])
        for kind, right in (("planned", flight), ("unplanned", unplanned(flight))):
            checked += 1
            if said := verdict(right):
                alarms.append(f"seed {seed} {kind}: {', '.join(said)}")
            for name, change in wrong.items():
                said = verdict(change(right, random))
                tally[kind][name][0] += bool(said)
                tally[kind][name][1] += 1
                if not said:
                    print(f"missed: seed {seed} {kind}: {name}", flush=True)
    total = [sum(entry[i] for by in tally.values() for entry in by.values()) for i in (0, 1)]
    for name in wrong:
        print(f"| {name} | " + " | ".join(f"{tally[kind][name][0]} of {tally[kind][name][1]}" for kind in tally) + " |")
    print(f"found {total[0]} of {total[1]}; false alarms {len(alarms)} of {checked}; seeds {seeds}")
    print("\n".join(alarms))
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(
        json.dumps(
            {
                "schema": "groundstation.benchmark.declarations/1",
                "seeds": seeds,
                "found": total[0],
                "wrong": total[1],
                "false_alarms": alarms,
                "right": checked,
                "by": tally,
            },
            indent=1,
        )
        + "\n"
    )


if __name__ == "__main__":
    main()
