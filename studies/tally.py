"""Outcomes of blind flights counted: shares with Wilson's bounds, confusion, detection limits, bias of the
parameters.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from scipy.stats import norm

HALF_95 = float(norm.ppf(0.975))
DETECTABLE = 6.0
"""Estimate over standard deviation that is expected of an effect that a flight can show (docs/diagnosis.md)."""


@dataclass(frozen=True)
class Outcome:
    """One flight: what was hidden, what was said, and the error of mass and inertia before and after, as shares.

    ``met`` says whether they are within the bounds of the estimation study: mass 1 %, moments 2 % or three of their
    deviations.

    Of each hidden effect, ``t`` is the expected t (infinite where the sensors alone tell), and ``shares`` its RMS as a
    share of weight or of weight times arm (NaN where it is no force).
    """

    kind: str
    hidden: tuple[str, ...]
    verdict: str
    named: tuple[str, ...]
    alternatives: tuple[str, ...]
    rotors: tuple[bool, ...]
    before: float
    after: float
    met_before: bool
    met_after: bool
    seconds: float
    t: tuple[float, ...]
    shares: tuple[float, ...]

    def detectable(self) -> bool:
        """Whether the flight can show all that is hidden in it."""
        return min(self.t, default=math.inf) >= DETECTABLE

    def first(self) -> str:
        """The first name, or the verdict where there is none."""
        return self.named[0] if self.named else self.verdict


def load(path: Path) -> list[Outcome]:
    """Rows of a run, one JSON object a line."""
    names = [field.name for field in fields(Outcome)]
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    return [
        Outcome(**{name: tuple(row[name]) if isinstance(row[name], list) else row[name] for name in names})
        for row in rows
    ]


def wilson(hits: int, count: int) -> tuple[float, float]:
    """95 % bounds of a share (Wilson 1927)."""
    centre = (hits + HALF_95**2 / 2.0) / (count + HALF_95**2)
    half = HALF_95 / (count + HALF_95**2) * math.sqrt(hits * (count - hits) / count + HALF_95**2 / 4.0)
    return max(centre - half, 0.0), min(centre + half, 1.0)


def share(hits: int, count: int) -> str:
    """A share in words, with its 95 % Wilson interval."""
    if count == 0:
        return "not run"
    low, high = wilson(hits, count)
    return f"{hits} of {count} ({hits / count:.0%}; 95 % interval {low:.0%} to {high:.0%})"


def _fault(o: Outcome) -> str:
    """What is wrong with the answer to one flight; empty where nothing is."""
    if o.kind == "clean":
        return "false alarm" if o.verdict != "clean" else ""
    if o.kind == "invented":
        return "not unexplained" if o.verdict != "unexplained" else ""
    if not set(o.hidden) <= set(o.named) or (o.kind == "single" and o.first() != o.hidden[0]):
        return "missed"
    if set(o.named) - set(o.hidden):
        return "further name"
    return "" if o.met_after else f"parameters {o.after:.1%} off"


def report(outcomes: Sequence[Outcome]) -> None:
    """Shares, confusion and bias."""
    kinds = {kind: [o for o in outcomes if o.kind == kind] for kind in ("single", "pair", "clean", "invented")}
    singles = [o for o in kinds["single"] if o.detectable()]
    right = [o for o in singles if o.first() == o.hidden[0]]
    told = [o for o in singles if o.first() == o.hidden[0] or o.hidden[0] in o.alternatives]
    silent = [o for o in singles if o.verdict in ("clean", "refused")]
    print(f"\nsingles, detectable                        {share(len(singles), len(kinds['single']))}")
    print(f"detectable singles, right first name       {share(len(right), len(singles))}")
    print(f"  first name or an alternative to it       {share(len(told), len(singles))}")
    print(f"  said clean or refused                    {share(len(silent), len(singles))}")
    rotors = [hit for o in singles for hit in o.rotors]
    print(f"  right rotor, where one was named         {share(sum(rotors), len(rotors))}")
    blind = [o for o in kinds["single"] if not o.detectable()]
    named = [o for o in blind if o.hidden[0] in o.named]
    wrong = [o for o in blind if o.named and o.hidden[0] not in o.named]
    print(f"too small to be detectable, named          {share(len(named), len(blind))}")
    print(f"  wrongly named                            {share(len(wrong), len(blind))}")
    pairs = [o for o in kinds["pair"] if o.detectable()]
    both = [o for o in pairs if set(o.hidden) <= set(o.named)]
    more = [o for o in singles + pairs if set(o.named) - set(o.hidden)]
    print(f"detectable pairs, both named               {share(len(both), len(pairs))}")
    print(f"detectable, with a further name beside     {share(len(more), len(singles + pairs))}")
    alarms = [o for o in kinds["clean"] if o.verdict != "clean"]
    print(f"clean flights, false alarms                {share(len(alarms), len(kinds['clean']))}")
    left = [o for o in kinds["invented"] if o.verdict == "unexplained"]
    print(f"invented, verdict unexplained              {share(len(left), len(kinds['invented']))}")
    shown = [o for o in kinds["invented"] if o.detectable()]
    left = [o for o in shown if o.verdict == "unexplained"]
    print(f"  of those detectable                      {share(len(left), len(shown))}")
    print("\nhidden (down), first name (counts)")
    for hidden in sorted({o.hidden for o in outcomes}):
        counts = Counter(o.first() for o in outcomes if o.hidden == hidden)
        print(f"  {' + '.join(hidden) or 'nothing':40} " + ", ".join(f"{n} {c}" for n, c in counts.most_common()))
    print(
        "\nhidden alone: detectable and right of all; RMS share of weight or weight times arm at which |t| is 6 "
        "(median)"
    )
    for name in sorted({o.hidden[0] for o in kinds["single"]}):
        own = [o for o in kinds["single"] if o.hidden[0] == name]
        seen = [o for o in own if o.detectable()]
        limits = [o.shares[0] * DETECTABLE / o.t[0] for o in own if np.isfinite(o.shares[0]) and o.t[0] > 0.0]
        limit = f"{np.median(limits):.2%}" if limits else "told by the sensors"
        print(f"  {name:20} {sum(o.first() == name for o in seen):3} of {len(seen):3} of {len(own):3}   {limit}")
    print("\nmass within 1 %, moments within 2 % or three of their deviations, of those detectable")
    for kind, members in (("single", singles), ("pair", pairs)):
        print(f"  {kind}s, before                          {share(sum(o.met_before for o in members), len(members))}")
        print(f"  {kind}s, after                           {share(sum(o.met_after for o in members), len(members))}")
    for kind in ("single", "pair"):
        sizes_of = np.array([(o.before, o.after) for o in kinds[kind] if o.named and np.isfinite(o.before + o.after)])
        if len(sizes_of):
            before, after = np.median(sizes_of, axis=0)
            print(f"\n{kind}s, RMS relative error of mass and inertia: median {before:.1%} before, {after:.1%} after")
    if outcomes:
        seconds = np.array([o.seconds for o in outcomes])
        print(f"\ndiagnosis of a flight: median {np.median(seconds):.1f} s, longest {seconds.max():.1f} s")
    print("\nwhat went otherwise")
    for o in outcomes:
        if o.detectable() and (fault := _fault(o)):
            seen = ", ".join(f"{t:.0f}" for t in o.t)
            print(
                f"  {' + '.join(o.hidden) or 'nothing':40} {fault}: {', '.join(o.named) or 'no name'} ({o.verdict}; "
                f"expected t {seen})"
            )
