"""Fly until known: seconds flown against the fixed plan's, and whether the intervals hold at the stop.

    python -m benchmarks.until --flights 500 --json docs/results/until.json

Every flight draws a vehicle (30 g to 3 kg, declared wrongly, lag declared or rotor speeds measured), a laboratory and
the study's fast plan (the paper's trajectory at twice its pace, tilted up to 17 degrees; periods of 5 s), and is flown
for 80 s in simulation; the live estimator reads it as it would have in flight. Then the rule of ``--until`` is applied
to what it had at each rest point, for several targets: they give 500 flights as many stop times each. A flight on which
a target is not met by the end stops there. Counted: whether the truth lies in the interval at the stop, by each kind of
interval, and for the spent and the any-time interval also whether it lay in the intervals of *all* looks.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np

from groundstation.identification.recursive import SHOWN, replay
from groundstation.identification.sequential import Spending, at_any_time, at_one_moment
from groundstation.vehicle import Vehicle
from sim.flight import simulate
from studies import many
from studies.flown import flight_data
from studies.study import draw_plan, draw_scenario, draw_vehicle
from studies.tally import wilson

PLANNED_S, AT_MOST_S, RATE_HZ, AHEAD_S = 40.0, 80.0, 250.0, 0.3
TARGETS = (0.01, 0.015, 0.02, 0.03, 0.05)
MASS_SHARE = 0.25
"""The mass' target as a share of the moments': 0.5 % beside 2 %."""


@dataclass(frozen=True, slots=True)
class Flown:
    """One flight: its rest points, and what was known at each: value and standard deviation over the truth, by
    parameter.
    """

    seed: int
    rest_s: tuple[float, ...]
    looks: tuple[Mapping[str, tuple[float, float]], ...]


def declared(random: np.random.Generator, vehicle: Vehicle, lag: object) -> Vehicle:
    """Half of the vehicles measure their rotors' speeds; the others declare the lag that they have."""
    measured = bool(random.random() < 0.5)
    change = {"speed_source": "telemetry" if measured else "command", **({} if measured else {"lag": lag})}
    return vehicle.model_copy(update={"rotors": vehicle.rotors.model_copy(update=change)})


def fly(seed: int) -> Flown:
    """Draw, plan, fly, and read as it would have been read in flight."""
    random = np.random.default_rng([17, seed])
    vehicle = draw_vehicle(random)
    scenario, _ = draw_scenario(random, vehicle, RATE_HZ)
    vehicle = declared(random, vehicle, scenario.truth.lag)
    plan = draw_plan(random, fast=True)
    longest = plan.model_copy(update={"periods": 2.0 * plan.periods})
    flight = flight_data(simulate(vehicle, longest, scenario, seed), f"until {seed}")
    assert flight.truth is not None
    assert flight.window_s is not None
    truth = flight.truth.parameters()
    found = replay(flight, 0.1)
    period_s = plan.series().period_s
    rests = [period_s * k for k in range(1, round(AT_MOST_S / period_s) + 1)]
    looks = []
    for rest in rests:
        seen = [e for e in found if e.t_s <= flight.window_s[0] + rest - AHEAD_S]
        last = seen[-1].parameters if seen else {}
        looks.append({n: (e.value / truth[n], e.std / truth[n]) for n, e in last.items()})
    return Flown(seed, tuple(rests), tuple(looks))


@cache
def spent(stds: tuple[float, ...]) -> tuple[float, ...]:
    """Critical values of looks at estimates with these standard deviations."""
    spending = Spending(len(stds))
    return tuple(spending.look(std) for std in stds)


def criticals(flown: Flown, name: str, target: float, kind: str) -> tuple[float, ...]:
    """Critical values of one kind of interval at each rest point."""
    known = [look.get(name, (math.nan, math.inf)) for look in flown.looks]
    if kind == "looked at once":
        return (at_one_moment(),) * len(known)
    if kind == "spent":
        return spent(tuple(std for _, std in known))
    return tuple(at_any_time(std, target * abs(value) / at_one_moment()) for value, std in known)


def target_of(name: str, target: float) -> float:
    """Of a parameter, as a share of it."""
    return MASS_SHARE * target if name == "mass_kg" else target


@dataclass(slots=True)
class Count:
    """Over flights, targets and parameters."""

    stops: int = 0
    holds: int = 0
    series: int = 0
    series_hold: int = 0


def tally(flights: Sequence[Flown], kind: str) -> tuple[Count, list[float], list[float]]:
    """Coverage when the rule stops by one kind of interval; seconds flown where the targets of 2 % were met, and the
    shares met.
    """
    count, seconds, met_share = Count(), [], []
    for flown in flights:
        for target in TARGETS:
            by_name = {n: criticals(flown, n, target_of(n, target), kind) for n in SHOWN}
            stop = _stop(flown, by_name, target)
            met = stop is not None
            at = len(flown.looks) - 1 if stop is None else stop
            for name, critical in by_name.items():
                inside = [
                    abs(look[name][0] - 1.0) <= c * look[name][1]
                    for look, c in zip(flown.looks, critical, strict=True)
                    if name in look
                ]
                if name in flown.looks[at]:
                    value, std = flown.looks[at][name]
                    count.stops += 1
                    count.holds += abs(value - 1.0) <= critical[at] * std
                    count.series += 1
                    count.series_hold += all(inside)
            if target == 0.02:
                met_share.append(float(met))
                seconds.append(flown.rest_s[at])
    return count, seconds, met_share


def _stop(flown: Flown, critical: Mapping[str, Sequence[float]], target: float) -> int | None:
    for k, look in enumerate(flown.looks):
        if all(n in look and critical[n][k] * look[n][1] <= target_of(n, target) * look[n][0] for n in SHOWN):
            return k
    return None


def fixed(flights: Sequence[Flown]) -> tuple[int, int]:
    """Of intervals at 40 s, without a rule: how many hold the truth."""
    hold = total = 0
    for flown in flights:
        at = int(np.argmin(np.abs(np.array(flown.rest_s) - PLANNED_S)))
        for value, std in flown.looks[at].values():
            total += 1
            hold += abs(value - 1.0) <= at_one_moment() * std
    return hold, total


def table(flights: Sequence[Flown]) -> str:
    """Markdown."""

    def share(count: int, of: int) -> str:
        low, high = wilson(count, of)
        return f"{100 * count / max(of, 1):.1f} % ({100 * low:.1f}-{100 * high:.1f})"

    hold, total = fixed(flights)
    rows = [
        f"{len(flights)} flights; at 40 s, no rule, the interval looked at once holds the truth in "
        f"{share(hold, total)}",
        "",
        "| the rule stops by the interval | holds at the stop | holds at every look | seconds flown for 2 %, "
        "median (10th-90th) | met within 80 s |",
        "|---|---|---|---|---|",
    ]
    for kind in ("looked at once", "spent", "at any time"):
        count, seconds, met = tally(flights, kind)
        low, middle, high = np.percentile(seconds, [10, 50, 90])
        rows.append(
            f"| {kind} | {share(count.holds, count.stops)} | {share(count.series_hold, count.series)} | {middle:.0f} s "
            f"({low:.0f}-{high:.0f}) | {100 * np.mean(met):.0f} % |"
        )
    return "\n".join(rows)


def main() -> None:
    """Fly those that are not kept yet, count, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--flights", type=int, default=100)
    parser.add_argument("--seed", type=int, default=17_001, help="of the first flight; the others follow")
    parser.add_argument(
        "--json", type=Path, default=None, help="flights are kept here; those that are there are not flown again"
    )
    many.add_options(parser)
    arguments = parser.parse_args()
    kept: list[Flown] = []
    if arguments.json is not None and arguments.json.is_file():
        kept = [
            Flown(f["seed"], tuple(f["rest_s"]), tuple(f["looks"]))
            for f in json.loads(arguments.json.read_text())["flights"]
        ]
    there = {f.seed for f in kept}
    wanted = [s for s in range(arguments.seed, arguments.seed + arguments.flights) if s not in there]
    for outcome in many.outcomes(fly, wanted, arguments):
        if outcome.value is not None:
            kept.append(outcome.value)
        if arguments.json is not None and (len(kept) % 20 == 0 or outcome.index == len(wanted) - 1):
            arguments.json.parent.mkdir(parents=True, exist_ok=True)
            arguments.json.write_text(json.dumps({"flights": [asdict(f) for f in kept]}) + "\n")
    print(table(kept))


if __name__ == "__main__":
    main()
