"""How good are the estimates over many different vehicles, plans and laboratories? One simulated flight of each.

Every flight draws its own vehicle (30 g to 3 kg, declared wrongly), plan (gentle: tilt up to 5.73 degrees; fast: three
times that), rotor lag (20 to 100 ms, declared as none), motion capture (30, 120 or 240 Hz), clock offset (up to 50 ms)
and coloured force and torque disturbance (0.1 to 0.5 % of weight and of weight times arm). The estimator is told none
of it.

Run with ``make study`` or ``python -m benchmarks.study --flights N --seed S``; the output is kept in docs/study.md.
"""

from __future__ import annotations

import argparse
import sys

from studies.many import add_options, outcomes
from studies.study import Flown, faults, study_flight, tables


def main() -> None:
    """Fly, identify, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--flights", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1001, help="of the first flight; the others follow")
    add_options(parser)
    arguments = parser.parse_args()
    flights: list[Flown] = []
    unflown: list[str] = []
    for outcome in outcomes(study_flight, range(arguments.seed, arguments.seed + arguments.flights), arguments):
        if outcome.value is None:
            unflown.append(f"seed {outcome.item}: {outcome.failure}")
            continue
        flights.append(outcome.value)
        said = flights[-1].reason or ", ".join(faults(flights[-1], "best")) or "meets everything"
        print(f"seed {outcome.item}: {said}", file=sys.stderr, flush=True)
    if flights:
        print(tables(flights))
    for line in unflown:
        print(f"\nNot flown: {line}")


if __name__ == "__main__":
    main()
