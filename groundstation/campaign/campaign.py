"""The campaign: fly, judge the model on the new flight, put the flight in, find what is missing, decide what is next,
or stop.

Everything that is decided is written to ``campaign.json`` before it is acted on, whole or not at all. A campaign that
was killed goes on from there: a flight that was flown is not flown again, and a round that was not finished is done
again from its recording.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from groundstation.campaign.deciding import SWINGS, Decision, first_plan, gentle_plan, next_plan
from groundstation.campaign.ending import with_round
from groundstation.campaign.judging import Errors, prediction_errors, without_effects
from groundstation.campaign.pooling import day_of, pooled, widened
from groundstation.documents import read_diagnosis
from groundstation.errors import BadInput, Refused
from groundstation.flightdata import FlightData
from groundstation.outside import read_json
from groundstation.paths import find_config
from groundstation.planning.plan import AUTOPILOT
from groundstation.targets import parse_targets, reached
from groundstation.vehicle import Vehicle, load_vehicle, vehicle_from_dict, vehicle_to_dict
from groundstation.writing import write_whole

if TYPE_CHECKING:  # analyses are heavy to import
    from groundstation.campaign.kept import Kept
    from groundstation.model.flight_states import FlightStates

SCHEMA = "groundstation.campaign/1"
FILE = "campaign.json"
VEHICLE = "vehicle.toml"
PLAN_S = 6.0
"""Seconds of search for each plan."""

AIMS = ("sought", "untold", "gently")
"""What a flight is for beside its sentence, and a round keeps."""
NO_AIMS: Mapping[str, str] = {}

Say = Callable[[str], None]


class Flyer(Protocol):
    """What flies."""

    def place(self) -> Path:
        """A new folder's name for a flight; the campaign writes it down before anything flies."""
        ...

    def fly(self, plan: Path, folder: Path) -> None:
        """Fly a plan file, recorded as ``flight.mcap`` in a folder that is made."""
        ...

    def was_flown(self, folder: Path) -> bool:
        """Whether the flight in a folder ended as planned, although this program did not see it."""
        ...


@dataclass(frozen=True, slots=True)
class Round:
    """One flight and what it changed.

    Attributes:
        folder: of the flight.
        why: it was flown.
        seconds: of excitation.
        judged: errors on this flight before it was used: of the "declared" vehicle, of the rigid body ("before") and of
            the model with its effects ("after") as the flights before had left them; empty for the first.
        seen: errors of this round's model on the flights it was made of, their mean.
        verdict: of the diagnosis over all flights so far.
        findings: documents of what it found.
        estimates: canonical parameters now, widened by the scatter between flights: name -> {"value", "std"}.
        reached: half widths over targets; 1 or less is met.
        not_settled: why the campaign did not end here; empty where it did.
        levels: by parameter what belongs to the vehicle, the days and the flights
            (:class:`~groundstation.campaign.pooling.Levels`).
        would_show: documents of what would have been found, and from what size on.
        hints: documents of what beats chance and is no finding yet.
        sought: the effect that the flight was to show after a hint of it, or "".
        untold: what was left open when the flight was planned and no motion tells apart, or "".
        gently: why the flight was planned to be gentle, or "". From the first such flight on estimates are of these
            alone: what made them necessary was beyond what a model follows.
    """

    folder: str
    why: str
    seconds: float
    judged: Mapping[str, Errors] = field(default_factory=dict)
    seen: Errors = field(default_factory=dict)
    verdict: str = ""
    findings: tuple[Mapping[str, Any], ...] = ()
    estimates: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    reached: Mapping[str, float] = field(default_factory=dict)
    not_settled: tuple[str, ...] = ()
    levels: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    would_show: tuple[Mapping[str, Any], ...] = ()
    hints: tuple[Mapping[str, Any], ...] = ()
    sought: str = ""
    untold: str = ""
    gently: str = ""

    def names(self) -> tuple[str, ...]:
        """What was found, with rotors: "weak_rotor 2"."""
        return tuple(f"{f['effect']} {f['rotor']}" if f.get("rotor") else str(f["effect"]) for f in self.findings)


@dataclass(frozen=True, slots=True)
class Campaign:
    """A campaign as it stands; immutable, each step gives the next.

    Attributes:
        pending: a decision that is not yet worked through: {"why", "plan", "sought", "untold", "gently"}, and "folder"
            from the moment it may fly.
        outcome: "" while it goes on, or one of :mod:`~groundstation.campaign.ending`; ``sentence`` says why.
    """

    folder: Path
    vehicle: Vehicle
    targets: Mapping[str, float]
    at_most: int
    seed: int
    rounds: tuple[Round, ...] = ()
    pending: Mapping[str, str] = field(default_factory=dict)
    outcome: str = ""
    sentence: str = ""

    def model_round(self) -> int:
        """Number of the last round that left a model, from 1; 0: none did. A refused flight leaves none."""
        return max((n for n, r in enumerate(self.rounds, 1) if r.estimates), default=0)

    def save(self) -> Campaign:
        """Write it down; returns itself."""
        document = {
            "schema": SCHEMA,
            "vehicle": vehicle_to_dict(self.vehicle),
            "targets": dict(self.targets),
            "at_most": self.at_most,
            "seed": self.seed,
            "rounds": [asdict(r) for r in self.rounds],
            "pending": dict(self.pending),
            "outcome": self.outcome,
            "sentence": self.sentence,
        }
        self.folder.mkdir(parents=True, exist_ok=True)
        write_whole(self.folder / FILE, json.dumps(_finite(document), indent=1, ensure_ascii=False) + "\n")
        return self


def load_campaign(folder: Path) -> Campaign:
    """A campaign that was begun.

    Raises:
        BadInput: there is none, or its file is damaged.
    """
    if not (folder / FILE).is_file():
        raise BadInput(f"{folder}: holds no campaign; name the folder that `groundstation campaign` made.")
    document = read_json(folder / FILE, "a campaign")
    try:
        if document["schema"] != SCHEMA:
            raise BadInput(f"{folder / FILE}: has schema {document['schema']!r}; {SCHEMA} is expected.")
        rounds = tuple(
            Round(
                **{
                    **r,
                    "findings": tuple(r["findings"]),
                    "not_settled": tuple(r["not_settled"]),
                    "would_show": tuple(r.get("would_show", ())),
                    "hints": tuple(r.get("hints", ())),
                }
            )
            for r in document["rounds"]
        )
        return Campaign(
            folder,
            vehicle_from_dict(document["vehicle"], str(folder / FILE)),
            document["targets"],
            int(document["at_most"]),
            int(document["seed"]),
            tuple(_infinite(r) for r in rounds),
            document["pending"],
            document["outcome"],
            document["sentence"],
        )
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise BadInput(
            f"{folder / FILE}: is damaged ({error}); begin a new campaign with --from and its flights."
        ) from None


def run(campaign: Campaign, flyer: Flyer, *, say: Say = lambda text: None, **limits: float) -> Campaign:
    """Carry a campaign on until it ends.

    Args:
        flyer: flies a plan; what it raises leaves the campaign as it was before that flight.
    """
    from groundstation.campaign.kept import Kept

    kept = Kept()
    while True:
        campaign = advance(campaign, flyer.was_flown, say=say, limits=limits, kept=kept)
        if campaign.outcome:
            return campaign
        folder = flyer.place()
        campaign = replace(campaign, pending={**campaign.pending, "folder": str(folder)}).save()
        flyer.fly(Path(campaign.pending["plan"]), folder)


def advance(
    campaign: Campaign,
    flown: Callable[[Path], bool],
    *,
    say: Say = lambda text: None,
    limits: Mapping[str, float],
    kept: Kept | None = None,
) -> Campaign:
    """Up to the next flight: what was flown is taken in, and the next is decided; or the campaign's end. Each step is
    written down.

    Args:
        flown: whether the flight in a folder ended as planned.
        limits: of plans. kept: what earlier rounds left.
    """
    folder = campaign.pending.get("folder")
    if folder and not campaign.outcome and flown(Path(folder)):
        aims = {name: campaign.pending.get(name, "") for name in AIMS}
        campaign = take_in(campaign, Path(folder), campaign.pending["why"], aims=aims, say=say, kept=kept)
        campaign = replace(campaign, pending={}).save()
    if campaign.pending or campaign.outcome:
        return campaign
    return _decide(campaign, say, limits).save()


def begin(logs: Path, vehicle: str, until: str, *, at_most: int = 5, seed: int = 1) -> Campaign:
    """A new campaign in a folder of its own, with a copy of the vehicle's file.

    Raises:
        BadInput: there is no such vehicle, or a target is none.
    """
    source = find_config("vehicles", vehicle).resolve()
    declared = load_vehicle(source)
    folder = logs.resolve() / f"campaign-{time.strftime('%Y-%m-%dT%H-%M-%S')}-{declared.name}"
    stand = Campaign(folder, declared, parse_targets(until), at_most, seed).save()
    (folder / VEHICLE).write_bytes(source.read_bytes())
    return stand


def was_flown(folder: Path) -> bool:
    """Whether the core of a flight's folder ended it as planned."""
    from groundstation.flight.client.client import outcome

    try:
        return (folder / "flight.mcap").is_file() and outcome(folder)[0] in (0, Refused.exit_status)
    except BadInput:
        return False


def autopilot_limits(vehicle: Vehicle) -> dict[str, float]:
    """Of plans for an autopilot whose tuning is not known."""
    asked = vehicle.limits.acceleration_max_m_s2 or AUTOPILOT["acceleration_max_m_s2"]
    return {**AUTOPILOT, "acceleration_max_m_s2": min(asked, AUTOPILOT["acceleration_max_m_s2"])}


def _decide(campaign: Campaign, say: Say, limits: Mapping[str, float]) -> Campaign:
    from groundstation.analysis.plans import write_plan

    number = len(campaign.rounds) + 1
    decision = _decision(campaign, limits)
    say(f"flight {number}: {decision.why}")
    path = campaign.folder / f"plan-{number}.toml"
    campaign.folder.mkdir(parents=True, exist_ok=True)
    write_plan(decision.plan, path)
    aims = {"sought": decision.sought, "untold": decision.untold, "gently": decision.gently}
    return replace(campaign, pending={"why": decision.why, "plan": str(path), **aims})


def _decision(campaign: Campaign, limits: Mapping[str, float]) -> Decision:
    options: dict[str, Any] = {"seed": campaign.seed + len(campaign.rounds), "time_budget_s": PLAN_S, **limits}
    number = campaign.model_round()
    if not number:
        return first_plan(campaign.vehicle, **options)
    last = campaign.rounds[number - 1]
    diagnosis = read_diagnosis(campaign.folder / f"diagnosis-{number}.json")
    sought = [r.sought for r in campaign.rounds]
    plan = partial(next_plan, campaign.vehicle, diagnosis, last.estimates, last.reached, sought=sought)
    why = SWINGS if diagnosis.get("swing") else next((r.gently for r in campaign.rounds if r.gently), "")
    return gentle_plan(plan, why, options) if why else plan(**options)


def take_in(
    campaign: Campaign,
    folder: Path,
    why: str,
    *,
    aims: Mapping[str, str] = NO_AIMS,
    say: Say = lambda text: None,
    kept: Kept | None = None,
) -> Campaign:
    """Judge the model on a flight, then put the flight in.

    A flight with which the estimate is refused counts as flown and leaves the model of the flights before as it is;
    later estimates are made without it.

    Args:
        aims: ``sought``, ``untold`` and ``gently`` of the round.
        kept: what earlier rounds left, and this one leaves.

    Raises:
        BadInput: the flight cannot be read.
    """
    from groundstation.analysis.documents import write_json
    from groundstation.campaign.kept import Kept
    from groundstation.diagnosis import diagnose
    from groundstation.diagnosis.doubted import identify
    from groundstation.reporting.exports import model_document, write_model

    number, kept = len(campaign.rounds) + 1, kept or Kept()
    sought, untold, gently = (aims.get(name, "") for name in AIMS)
    flight = kept.flight(folder, campaign.vehicle)
    judged: Mapping[str, Errors] = {}
    like = [r for r in campaign.rounds if r.estimates and (r.gently or not gently)]
    folders = [*(Path(r.folder) for r in like), folder]
    flights = [*(kept.flight(each, campaign.vehicle) for each in folders[:-1]), flight]
    try:
        states = kept.states(flights)
        judged = _judge(campaign, states[-1], say)
        together = f"{len(flights)} flights together" if len(flights) > 1 else "it"
        say(f"flight {number}: identifying and diagnosing {together}")
        found = identify(flights, work=kept.work)
        diagnosis = diagnose(flights, work=kept.work)
    except Refused as error:
        say(f"flight {number}: refused, and left out of later estimates: {error}")
        refused = Round(
            str(folder), why, _seconds(flight), judged, not_settled=(str(error),), sought=sought, untold=untold,
            gently=gently,
        )  # fmt: skip
        return with_round(campaign, refused)
    model = model_document(found, campaign.vehicle, diagnosis)
    rigid = without_effects(model, {n: e.to_dict() for n, e in diagnosis.parameters_before.items()})
    write_model(campaign.folder / f"model-{number}.toml", model)
    write_model(campaign.folder / f"rigid-{number}.toml", rigid)
    write_json(campaign.folder / f"diagnosis-{number}.json", diagnosis.to_dict())
    seen = _mean([prediction_errors(model, each) for each in states])
    by_level = pooled(diagnosis.by_flight, [day_of(each.name) for each in folders])
    estimates = widened({**model["model"], **model["parameters"]}, by_level, diagnosis.by_flight)
    done = Round(
        str(folder), why, _seconds(flight), judged, seen, diagnosis.verdict,
        tuple(f.to_dict() for f in diagnosis.findings), estimates, reached(estimates, campaign.targets),
        levels={name: each.to_dict() for name, each in by_level.items()},
        would_show=tuple(each.to_dict() for each in diagnosis.would_show),
        hints=tuple(each.to_dict() for each in diagnosis.hints), sought=sought, untold=untold, gently=gently,
    )  # fmt: skip
    return with_round(campaign, done)


def _judge(campaign: Campaign, states: FlightStates, say: Say) -> dict[str, Errors]:
    """Errors on a flight that the campaign's model has not seen."""
    from groundstation.reporting.exports import read_model

    number = campaign.model_round()
    if not number:
        return {}
    say(f"flight {len(campaign.rounds) + 1}: judging the model after flight {number} on it")
    after, before = (
        read_model(campaign.folder / f"model-{number}.toml"),
        read_model(campaign.folder / f"rigid-{number}.toml"),
    )
    declared = {**without_effects(after, {}), "parameters": _declared(campaign.vehicle), "model": {}}
    declared.pop("disturbance", None)
    documents = {"declared": declared, "before": before, "after": after}
    return {name: prediction_errors(document, states) for name, document in documents.items()}


def _declared(vehicle: Vehicle) -> dict[str, dict[str, float]]:
    return {name: {"value": value, "std": 0.0} for name, value in vehicle.parameters().items()}


def _seconds(flight: FlightData) -> float:
    """Of excitation; of the recording's motors where its window is not known."""
    if flight.window_s is not None:
        return float(flight.window_s[1] - flight.window_s[0])
    motors = flight.motors
    return 0.0 if motors is None or not len(motors) else float(motors.t_s[-1] - motors.t_s[0])


def _mean(errors: Sequence[Errors]) -> Errors:
    return {name: sum(e[name] for e in errors) / len(errors) for name in errors[0]}


def _finite(value: Any) -> Any:
    from groundstation.analysis.documents import finite

    return finite(value)


def _infinite(done: Round) -> Round:
    """JSON has no infinity: a target that is not revealed was written as null."""
    return replace(done, reached={n: float("inf") if v is None else v for n, v in done.reached.items()})
