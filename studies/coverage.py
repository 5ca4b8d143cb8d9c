"""Do nominal 95 % intervals hold the truth in 95 of 100 flights? Counted over many short flights, each drawn as in the
study.

Flights last 20 s at 250 Hz. A parameter that a flight does not reveal gets no interval; it is counted apart
(``benchmarks.coverage``).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from groundstation.identification.anchoring import anchored
from groundstation.identification.dynamic_fit import fit_dynamics
from groundstation.identification.identifiability import unrevealed
from groundstation.identification.preparation import prepare
from groundstation.identification.results import MASS_AND_TENSOR
from studies.study import draw
from studies.tally import HALF_95, wilson

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
        "| parameter | numbers given | no number | inside the 95 % interval | Wilson bounds | RMS error over std | "
        "mean |",
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
