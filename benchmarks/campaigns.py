"""Campaigns over vehicles with one to three hidden effects: does each end by itself with all of them named, and nothing
else?

    python -m benchmarks.campaigns --campaigns 60 --workers 2 --json docs/results/campaigns.json

Every campaign draws its vehicle, effects, true mass and inertia, disturbance and seeds from a master seed that is new
each run and printed, and kept with the outcomes: the same command goes on where it was ended. It may fly five times.
With ``--keep`` the folders of those that miss or do not settle are kept, to be looked at.
Beside it stand its first flight alone, and the seconds that the paper's trajectory, repeated, would take to the same
worst interval: one 40 s flight of it is flown and identified, and variances are scaled by the number of flights. Sizes
are those parameters of findings that a scenario states one to one (studies/effect_sizes.py). What is too small for a
campaign's flights to show is counted apart, as docs/diagnosis.md defines it for one flight: detectable is an expected t
of 6 in the coloured noise, here over all its flights together.
"""

from __future__ import annotations

import argparse
import json
import secrets
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.visibility import visibility
from groundstation.campaign.campaign import Campaign, run
from groundstation.diagnosis import diagnose
from groundstation.errors import GroundStationError
from groundstation.flightdata import FlightData
from groundstation.identification.results import MASS_AND_TENSOR
from groundstation.paths import find_config
from groundstation.recording import write_mcap
from groundstation.targets import parse_targets, reached
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from groundstation.writing import write_whole
from sim.flight import simulate
from studies import many
from studies.effect_sizes import deviations
from studies.flown import flight_data
from studies.hidden import COMMANDED, INVENTED, Random, Table, declared, sizes, world
from studies.tally import DETECTABLE, wilson

VEHICLES = ("qball2", "x500", "qball2-commanded")
TARGETS = "ixx,iyy,izz:2%,mass:0.5%"
AT_MOST = 5
PAPER_S = 40.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """One campaign: what was hidden, what was named after one flight and at the end, how it ended, and what it cost."""

    vehicle: str
    hidden: tuple[str, ...]
    first: tuple[str, ...]
    named: tuple[str, ...]
    outcome: str
    flights: int
    seconds: float
    paper_seconds: float
    z: Mapping[str, float]
    """Mass and moments: error over standard deviation."""
    errors: tuple[Mapping[str, Any], ...]
    """Of each unseen flight: velocity and rate errors declared, before and after."""
    sizes: Mapping[str, float] = field(default_factory=dict)
    """Parameters of what was hidden and named: (found - true) over standard deviation."""
    sentence: str = ""
    """How it ended."""
    t: Mapping[str, float | None] = field(default_factory=dict)
    """Of each hidden effect, expected over all flights; None where the sensors alone tell it."""

    def detectable(self) -> bool:
        """Whether its flights can show all that is hidden."""
        return all(t is None or t >= DETECTABLE for t in self.t.values())


def draw(master: int, count: int) -> list[tuple[int, str, tuple[str, ...]]]:
    """(seed, vehicle, hidden effects) of each campaign.

    Wind is felt through drag alone, so it comes with it or not at all.
    """
    random = np.random.default_rng(master)
    out = []
    for _ in range(count):
        vehicle = str(random.choice(VEHICLES))
        known = [
            name
            for name in sizes(load_vehicle(find_config("vehicles", vehicle)))
            if name not in (*INVENTED, "wind") and (name not in COMMANDED or vehicle.endswith("commanded"))
        ]
        names = tuple(map(str, random.choice(known, int(random.integers(1, 4)), replace=False)))
        out.append((int(random.integers(2**31)), vehicle, names))
    return out


class _Hall:
    """Flies in this process."""

    def __init__(self, folder: Path, vehicle: Any, scenario: Any, random: Random):
        self._folder, self._vehicle, self._scenario, self._random = folder, vehicle, scenario, random
        self.flown = list[FlightData]()
        self.truth: Mapping[str, float] = {}

    def place(self) -> Path:
        return self._folder / f"flight-{len(self.flown) + 1}"

    def was_flown(self, folder: Path) -> bool:
        return (folder / "flight.mcap").is_file()

    def fly(self, plan: Path, folder: Path) -> None:
        simulated = simulate(self._vehicle, load_plan(plan), self._scenario, int(self._random.integers(2**31)))
        self.truth = simulated.truth.parameters()
        folder.mkdir()
        (folder / "plan.toml").write_bytes(plan.read_bytes())
        self.flown.append(flight_data(simulated, folder.name))
        write_mcap(self.flown[-1], folder / "flight.mcap")


def campaign(item: tuple[int, str, tuple[str, ...]], keep: Path | None = None) -> Outcome:
    """Hide, fly until it ends, count.

    Args:
        keep: where its folder is kept if it misses or does not settle.
    """
    with tempfile.TemporaryDirectory() as folder:
        outcome = _flown(item, Path(folder))
        if keep is not None and not (all(is_right(outcome)) and outcome.outcome == "settled"):
            shutil.copytree(folder, keep / str(item[0]), dirs_exist_ok=True)
    return outcome


def _flown(item: tuple[int, str, tuple[str, ...]], folder: Path) -> Outcome:
    seed, name, names = item
    random: Random = np.random.default_rng(seed)
    vehicle = declared(name, names)
    hidden = {effect: sizes(vehicle)[effect](random) for effect in names}
    scenario = world(random, hidden, vehicle)
    hall = _Hall(folder, vehicle, scenario, random)
    done = run(Campaign(folder / "campaign", vehicle, parse_targets(TARGETS), AT_MOST, seed % 1000), hall)
    truth = hall.truth
    last = done.rounds[-1]
    z = {
        n: (last.estimates[n]["value"] - truth[n]) / last.estimates[n]["std"]
        for n in MASS_AND_TENSOR
        if n in last.estimates and last.estimates[n]["std"] > 0
    }
    errors = [
        {kind: {q: e[q] for q in ("velocity_m_s", "body_rate_rad_s")} for kind, e in r.judged.items()}
        for r in done.rounds
        if r.judged
    ]
    return Outcome(
        name,
        names,
        done.rounds[0].names(),
        last.names(),
        done.outcome,
        len(done.rounds),
        sum(r.seconds for r in done.rounds),
        _paper_seconds(vehicle, scenario, last.reached, int(random.integers(2**31))),
        z,
        tuple(errors),
        deviations(list(last.findings), hidden, vehicle),
        done.sentence,
        _expected(hall.flown, hidden),
    )


def _expected(flights: list[FlightData], hidden: Mapping[str, Table]) -> dict[str, float | None]:
    """Expected t of each hidden effect over flights together: information adds."""
    each = [[t for t, _ in visibility(flight, list(hidden.items()))] for flight in flights]
    together = np.sqrt(np.sum(np.square(each), axis=0)).tolist()
    return {name: t if np.isfinite(t) else None for name, t in zip(hidden, together, strict=True)}


def _paper_seconds(vehicle: Any, scenario: Any, goal: Mapping[str, float], seed: int) -> float:
    """Seconds of the paper's trajectory to the campaign's worst interval (or the target, where the campaign went
    below).
    """
    try:
        simulated = simulate(vehicle, load_plan(find_config("plans", "paper_table2")), scenario, seed)
        diagnosis = diagnose([flight_data(simulated, "paper")])
        found = {n: e.to_dict() for n, e in diagnosis.parameters_after.items()}
        worst = max(reached(found, parse_targets(TARGETS)).values())
        return PAPER_S * max(1.0, (worst / max(max(goal.values()), 1.0)) ** 2)
    except GroundStationError:
        return float("nan")


def is_right(outcome: Outcome) -> tuple[bool, bool]:
    """All named, and nothing false."""
    names = {n.split()[0] for n in outcome.named}
    return set(outcome.hidden) <= names, names <= set(outcome.hidden)


def table(found: list[Outcome], lost: int, master: int) -> str:
    """Markdown."""
    both = sum(all(is_right(o)) for o in found)
    first = sum({n.split()[0] for n in o.first} == set(o.hidden) for o in found)
    settled = [o for o in found if o.outcome == "settled"]
    limited = [o for o in found if o.outcome == "limit"]
    shown = [o for o in found if o.detectable()]
    z = np.array([v for o in found for v in o.z.values()])
    deviation = np.array([v for o in found for v in o.sizes.values()])
    gain = np.array([o.paper_seconds / o.seconds for o in settled if np.isfinite(o.paper_seconds)])

    def share(count: int, of: int) -> str:
        low, high = wilson(count, of)
        return f"{count} of {of} ({100 * count / max(of, 1):.0f} %, {100 * low:.0f}-{100 * high:.0f})"

    rows = [
        ("campaigns (master seed)", f"{len(found)} ({master}); {lost} could not be flown"),
        ("all hidden effects detectable", share(len(shown), len(found))),
        ("of these all named and none false, at the end", share(sum(all(is_right(o)) for o in shown), len(shown))),
        ("of all campaigns all named and none false, at the end", share(both, len(found))),
        ("the same after the first flight alone", share(first, len(found))),
        ("all named", share(sum(is_right(o)[0] for o in found), len(found))),
        ("none false", share(sum(is_right(o)[1] for o in found), len(found))),
        ("ended by themselves, settled", share(len(settled), len(found))),
        ("ended by themselves where flights sharpened nothing that was missed", share(len(limited), len(found))),
        ("mass and tensor within 3 standard deviations", share(int(np.sum(np.abs(z) <= 3.0)), len(z))),
        ("sizes of effects within 3 standard deviations", share(int(np.sum(np.abs(deviation) <= 3.0)), len(deviation))),
        ("flights, median", f"{np.median([o.flights for o in found]):.0f}"),
        ("seconds of excitation, median", f"{np.median([o.seconds for o in found]):.0f}"),
        (
            "paper's trajectory repeated to the same worst interval, over these seconds, median",
            f"{np.median(gain):.1f}" if len(gain) else "-",
        ),
    ]
    return "\n".join(["| what | figure |", "|---|---|", *(f"| {a} | {b} |" for a, b in rows)])


def kept_before(path: Path | None) -> tuple[int | None, dict[int, Outcome], dict[int, str]]:
    """Master seed, outcomes and failures by number of the campaign, of an earlier run; nothing without one."""
    if path is None or not path.is_file():
        return None, {}, {}
    document = json.loads(path.read_text())
    found = {
        int(n): Outcome(**{**o, **{k: tuple(o[k]) for k in ("hidden", "first", "named", "errors")}})
        for n, o in document["campaigns"].items()
    }
    return document["seed"], found, {int(n): why for n, why in document["lost"].items()}


def main() -> None:
    """Draw, fly what is not kept yet, count, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--campaigns", type=int, default=60)
    parser.add_argument(
        "--seed", type=int, default=None, help="master seed (default: that of the file, else a fresh one, printed)"
    )
    parser.add_argument("--json", type=Path, default=None, help="outcomes are kept here; a run that was ended goes on")
    parser.add_argument(
        "--keep", type=Path, default=None, help="folders of campaigns that miss or do not settle are kept here"
    )
    many.add_options(parser)
    arguments = parser.parse_args()
    before, found, lost = kept_before(arguments.json)
    master = arguments.seed or before or secrets.randbits(32)
    if before is not None and master != before:
        parser.error(f"{arguments.json} holds campaigns of master seed {before}; name another file.")
    print("master seed", master, flush=True)
    numbers = [n for n in range(arguments.campaigns) if n not in found and n not in lost]
    drawn = draw(master, arguments.campaigns)
    for each in many.outcomes(partial(campaign, keep=arguments.keep), [drawn[n] for n in numbers], arguments):
        number = numbers[each.index]
        if each.value is None:
            lost[number] = each.failure
        else:
            o = found[number] = each.value
            print(
                f"{number}: {o.vehicle} hid {' + '.join(o.hidden)}: {o.outcome} after {o.flights}, named "
                f"{', '.join(o.named) or 'nothing'}",
                flush=True,
            )
        if arguments.json is not None:
            arguments.json.parent.mkdir(parents=True, exist_ok=True)
            document = {"seed": master, "lost": lost, "campaigns": {n: asdict(o) for n, o in sorted(found.items())}}
            write_whole(arguments.json, json.dumps(document, indent=1) + "\n")
    if found:
        print(table(list(found.values()), len(lost), master))


if __name__ == "__main__":
    main()
