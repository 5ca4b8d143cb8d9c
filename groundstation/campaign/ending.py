"""How a campaign ends, and the sentence that says so.

It is *settled* where nothing stands against the model and its targets are met; at its *limit* where nothing is left but
targets that further flights do not sharpen, and findings that no motion tells apart; *exhausted* where no more flights
may be flown.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from groundstation.campaign.deciding import flights_needed, left_open, promised
from groundstation.campaign.judging import at_floor
from groundstation.errors import BadInput
from groundstation.reporting.units import label, significant, split_unit
from groundstation.trajectory import Plan, load_plan

if TYPE_CHECKING:
    from groundstation.campaign.campaign import Campaign, Round

SETTLED, LIMIT, EXHAUSTED = "settled", "limit", "exhausted"
MISSED = 3
"""Effects that the last sentence names as what the flights would not have shown."""


def with_round(campaign: Campaign, done: Round) -> Campaign:
    """The campaign with a round more, ended where nothing is left to fly for or nothing more may be flown.

    Args:
        done: with ``not_settled`` of a refused flight; of others what stands against an end is found here.
    """
    limited = False
    if done.estimates:
        against, missed = _against(campaign, done), {name for name, share in done.reached.items() if share > 1.0}
        untold = _untold(done)
        done = replace(done, not_settled=tuple([*against, *untold, *_not_sharp(done)]))
        limited = not against and missed == set(stuck(campaign, done))
    rounds = (*campaign.rounds, done)
    if not done.not_settled:
        return replace(campaign, rounds=rounds, outcome=SETTLED, sentence=_settled(rounds))
    if limited:
        return replace(campaign, rounds=rounds, outcome=LIMIT, sentence=_at_limit(rounds))
    if len(rounds) < campaign.at_most:
        return replace(campaign, rounds=rounds)
    return replace(campaign, rounds=rounds, outcome=EXHAUSTED, sentence=_exhausted(campaign, done))


def _against(campaign: Campaign, done: Round) -> list[str]:
    """What stands against ending here beside targets, a sentence each."""
    out = []
    if done.verdict not in ("clean", "explained"):
        out.append(f"the verdict over all flights is {done.verdict}")
    rivals = left_open(done.findings)
    if rivals and not _untold(done):
        out.append(f"left open: {rivals}")
    sought = {done.sought, *(each.sought for each in campaign.rounds)}
    hinted = [h["effect"].replace("_", " ") for h in done.hints if h["effect"] not in sought]
    if hinted:
        out.append(f"a hint of {', '.join(hinted)} that no flight was planned to show yet")
    if not done.judged:
        return [*out, "no flight has judged the model yet"]
    before = campaign.rounds[campaign.model_round() - 1]
    if set(done.names()) != set(before.names()):
        out.append("this flight changed what is found, so the new model is not judged yet")
    elif not at_floor(done.judged["after"], before.seen):
        out.append("on the unseen flight the model's error was above that on its own flights")
    return out


def _untold(done: Round) -> list[str]:
    """What is left open and was when this flight was planned, where no motion told it apart."""
    rivals = left_open(done.findings)
    return [f"left open, and no flight was found that tells it: {rivals}"] if rivals and rivals == done.untold else []


def _not_sharp(done: Round) -> list[str]:
    missed = [f"{label(name)} ({share:.2f} times its target)" for name, share in done.reached.items() if share > 1.0]
    return [f"not sharp enough: {', '.join(missed)}"] if missed else []


def stuck(campaign: Campaign, done: Round) -> list[str]:
    """Targets that are missed, were missed before, and that the last flight sharpened by less than half of what one
    more of equal flights does by averaging, and of what its plan promised.

    Of n + 1 equal flights' noise the interval is sqrt(n / (n + 1)) times that of n.

    Args:
        campaign: before the round. done: with estimates.
    """
    number = campaign.model_round()
    if not number or (plan := _plan(done)) is None:
        return []
    before = campaign.rounds[number - 1]
    flights = 1 + sum(bool(each.estimates) for each in campaign.rounds)
    averaged = math.sqrt((flights - 1) / flights)
    out = []
    for name, share in promised(campaign.vehicle, before.estimates, plan).items():
        least, was = 0.5 * (1.0 + max(averaged, share)), before.reached.get(name, 0.0)
        if was > 1.0 and done.reached.get(name, 0.0) > max(1.0, least * was):
            out.append(name)
    return out


def _beyond_noise(campaign: Campaign, done: Round) -> list[str]:
    """Missed targets that less than one more flight of the last plan would meet, were the interval one of noise."""
    return [name for name, count in _needed(campaign, done).items() if 0.0 < count < 1.0]


def _needed(campaign: Campaign, done: Round) -> Mapping[str, float]:
    if not done.estimates or (plan := _plan(done)) is None:
        return {}
    return flights_needed(campaign.vehicle, done.estimates, campaign.targets, plan)


def _plan(done: Round) -> Plan | None:
    try:
        return load_plan(Path(done.folder) / "plan.toml")
    except BadInput:
        return None


def _settled(rounds: Sequence[Round]) -> str:
    return f"Settled after {_flown(rounds)}; targets met.{_may_have_missed(rounds[-1])}"


def _at_limit(rounds: Sequence[Round]) -> str:
    done = rounds[-1]
    missed = [name for name, share in done.reached.items() if share > 1.0]
    text = f"Ended after {_flown(rounds)}; {'; '.join(done.not_settled)}.{_may_have_missed(done)}"
    return text + _no_matter(missed) if missed else text


def _exhausted(campaign: Campaign, done: Round) -> str:
    """What was not reached, and how many flights it would still take by the last plan.

    Where less than one would do although one was just flown, the interval is not one of noise.
    """
    count = len(campaign.rounds) + 1
    text = f"Not settled after {count} flights: {'; '.join(done.not_settled)}.{_may_have_missed(done)}"
    if beyond := _beyond_noise(campaign, done):
        text += _no_matter(beyond)
    far = {name: count for name, count in _needed(campaign, done).items() if count >= 1.0}
    if far:
        text += (
            " Flights like the last that it would still take: "
            + ", ".join(f"{label(n)} {c:.1f}" for n, c in far.items())
            + "."
        )
    return text


def _no_matter(names: Sequence[str]) -> str:
    told = ", ".join(map(label, names))
    return (
        f" More flights like the last do not sharpen {told}: the interval holds what the formulas of the "
        "findings leave open, or how far flights differ beyond their own intervals, and no longer noise."
    )


def _flown(rounds: Sequence[Round]) -> str:
    names = ", ".join(rounds[-1].names()).replace("_", " ") or "nothing"
    return f"{len(rounds)} flights ({sum(r.seconds for r in rounds):.0f} s of excitation): found {names}"


def _may_have_missed(done: Round) -> str:
    """What the flights so far may have missed: the effects that could be largest, and below what size."""
    largest = sorted(done.would_show, key=lambda told: -told["share"])
    each = dict[str, str]()
    for told in largest:
        size = f"below {significant(told['least'], 2)} {split_unit(told['parameter'])[1]}".strip()
        name = f"{told['effect'].replace('_', ' ')} ({label(told['parameter'])})"
        each.setdefault(told["effect"], f"{name} {size if told['share'] < 1.0 else 'of any size'}")
    return f" They may have missed: {', '.join(list(each.values())[:MISSED])}." if each else ""
