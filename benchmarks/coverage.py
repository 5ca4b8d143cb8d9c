"""Do nominal 95 % intervals hold the truth in 95 of 100 flights? Counted over many short flights, each drawn as in the
study.

Run with ``make study`` or ``python -m benchmarks.coverage --flights N --seed S``; the output is kept in docs/study.md.
Flights last 20 s at 250 Hz. A parameter that a flight does not reveal gets no interval; it is counted apart.
"""

from __future__ import annotations

import argparse
import sys

from studies.coverage import Score, score, table
from studies.many import add_options, outcomes


def main() -> None:
    """Fly, identify, count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--flights", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=10_001, help="of the first flight; the others follow")
    add_options(parser)
    arguments = parser.parse_args()
    scores: list[Score] = []
    refused = 0
    for outcome in outcomes(score, range(arguments.seed, arguments.seed + arguments.flights), arguments):
        if outcome.value is None:
            refused += 1
        else:
            scores.append(outcome.value)
        if outcome.index % 50 == 49:
            print(f"\n{len(scores)} flights\n{table(scores)}", file=sys.stderr, flush=True)
    print(f"{len(scores)} flights from seed {arguments.seed}; {refused} more refused or not flown.\n\n{table(scores)}")


if __name__ == "__main__":
    main()
