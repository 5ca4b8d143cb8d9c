"""Do nominal 95 % intervals hold the truth in 95 of 100 flights? Counted over many short flights, each drawn as in the study.

Run with ``make study`` or ``python -m benchmarks.coverage --flights N --seed S``; the output is kept in docs/study.md. Flights last 20 s
at 250 Hz. A parameter that a flight does not reveal gets no interval; it is counted apart.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.many import add_options, outcomes
from benchmarks.study import draw
from benchmarks.tally import HALF_95, wilson
from groundstation.identification.anchoring import anchored
from groundstation.identification.dynamic_fit import fit_dynamics
from groundstation.identification.identifiability import unrevealed
from groundstation.identification.preparation import prepare
from groundstation.identification.results import MASS_AND_TENSOR

SHARE, RATE_HZ = 0.5, 250.0


@dataclass(frozen=True, slots=True)
class Score:
    """Error over standard deviation of what a flight gave a number for, and what it gave none for."""

    z: Mapping[str, float]
    hidden: tuple[str, ...]


def score(seed: int) -> Score:
    """Draw, fly and identify one short flight.

    Raises:
        GroundStationError: what was drawn cannot be flown, or the flight was refused.
    """
    flight, _, offset = draw(seed, SHARE, RATE_HZ)
    assert flight.truth is not None
    truth = flight.truth.parameters()
    prepared = prepare(flight)
    fitted = fit_dynamics([prepared])
    hidden = unrevealed(fitted.best, [prepared])
    best = fitted.best
    found, _ = anchored(prepared.record.vehicle, best.names, best.values, best.covariance)
    z = {name: (found[name].value - truth[name]) / found[name].std for name in MASS_AND_TENSOR if name not in hidden}
    if prepared.clock is not None:
        z["mocap_minus_imu_s"] = (prepared.clock.mocap_minus_imu_s - offset) / prepared.clock.std_s
    return Score(z, tuple(hidden))


def table(scores: Iterable[Score]) -> str:
    """Markdown: per parameter how often the interval held the truth, with Wilson's bounds."""
    scores = list(scores)
    lines = [
        "| parameter | numbers given | no number | inside the 95 % interval | Wilson bounds | RMS error over std | mean |",
        "|---|---|---|---|---|---|---|",
    ]
    for name in (*MASS_AND_TENSOR, "mocap_minus_imu_s"):
        z = np.array([s.z[name] for s in scores if name in s.z])
        if not len(z):
            continue
        inside = int(np.sum(np.abs(z) <= HALF_95))
        low, high = wilson(inside, len(z))
        lines.append(
            f"| {name} | {len(z)} | {len(scores) - len(z)} | {inside} ({100.0 * inside / len(z):.1f} %) | "
            f"{100.0 * low:.1f} .. {100.0 * high:.1f} % | {np.sqrt(np.mean(z**2)):.2f} | {np.mean(z):+.2f} |"
        )
    return "\n".join(lines)


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
