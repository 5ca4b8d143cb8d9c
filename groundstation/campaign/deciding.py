"""What to fly next: the flight that separates what is left open, else the one that sharpens what is least known now."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from groundstation.errors import BadInput, GroundStationError
from groundstation.json_types import Document
from groundstation.planning import paper_plan, plan_excitation
from groundstation.planning.information import DEFAULT_NOISE, predicted_std
from groundstation.reporting.units import label
from groundstation.targets import HALF_95
from groundstation.trajectory import Plan
from groundstation.vehicle import Inertia, Vehicle

DURATION_S = 40.0
GENTLE_M_S2 = 1.2
"""An eighth of gravity: what hangs below leans by seven degrees there, and by some times that where it is driven in its
own rhythm, so that it neither goes over the top nor lets its cable slack.
"""
SWINGS = "a load swings below further than a model follows"
PLANNABLE = ("rotor_drag", "angular_damping", "com_offset", "flapping_moment", "motor_lag")
"""Effects that a plan weighs beside mass and inertia, where they were found."""


@dataclass(frozen=True, slots=True)
class Decision:
    """The next flight.

    Attributes:
        why: it is flown, a sentence.
        sought: the effect that it is to show after a hint of it, or "".
        untold: what is left open and no motion in this room tells apart, as :func:`left_open` says it, or "".
        gently: why it keeps below ``GENTLE_M_S2``, or "".
    """

    plan: Plan
    why: str
    sought: str = ""
    untold: str = ""
    gently: str = ""


def left_open(findings: Sequence[Document]) -> str:
    """Findings that another effect would explain as well, "" where there are none."""
    return "; ".join(f"{f['effect']} or {', '.join(f['alternatives'])}" for f in findings if f["alternatives"])


def first_plan(vehicle: Vehicle, *, seed: int, time_budget_s: float, **limits: float) -> Decision:
    """The best flight for mass and inertia of the declared vehicle (A-optimal)."""
    plan = plan_excitation(
        vehicle, criterion="A", duration_s=DURATION_S, seed=seed, time_budget_s=time_budget_s, **_any(limits)
    )
    return Decision(plan, "first flight: the one that reveals mass and inertia best, by what is declared")


def next_plan(
    vehicle: Vehicle,
    diagnosis: Document,
    estimates: Document,
    reached: Mapping[str, float],
    *,
    sought: Collection[str] = (),
    seed: int,
    time_budget_s: float,
    **limits: float,
) -> Decision:
    """The next flight.

    A hint is flown for once, when two flights are in or nothing else is asked: another flight may settle it anyway.

    Args:
        vehicle: as declared; the plan is made for the vehicle as it is estimated now.
        diagnosis: of schema groundstation.diagnosis/1, over all flights so far.
        estimates: canonical parameters now, name -> {"value", "std"}.
        reached: of :func:`~groundstation.targets.reached`.
        sought: effects that a flight was flown for.
    """
    bounds: dict[str, Any] = {name: value for name, value in limits.items() if name != "frequency_max_hz"}
    findings = diagnosis.get("findings", ())
    hints = [hint for hint in diagnosis.get("hints", ()) if hint["effect"] not in sought]
    in_turn = len(diagnosis.get("by_flight", ())) > 1 or max(reached.values(), default=0.0) <= 1.0
    shows: str = hints[0]["effect"] if hints and in_turn else ""
    aims, untold = list[tuple[str, Document, str]](), ""
    if left_open(findings):
        aims.append(("to separate what is left open", diagnosis, ""))
    if shows:
        settled: list[Document] = [{**finding, "alternatives": list[str]()} for finding in findings]
        aims.append(("to show what there is a hint of", {**diagnosis, "findings": settled, "hints": hints}, shows))
    for aim, document, effect in aims:
        from groundstation.diagnosis.next_flight import odds_sentence, plan_next

        try:
            separation = plan_next(document, vehicle, seed=seed, **bounds)
            return Decision(separation.plan, f"{aim}: {odds_sentence(separation)}", effect, untold)
        except GroundStationError:  # no motion tells; the flight then shows or sharpens what can be
            untold = untold if effect else left_open(findings)
    known = as_estimated(vehicle, estimates)
    found = {f["effect"] for f in diagnosis.get("findings", ())}
    effects = [name for name in PLANNABLE if name in found]
    plan = plan_excitation(
        known,
        criterion="A",
        duration_s=DURATION_S,
        effects=effects,
        seed=seed,
        time_budget_s=time_budget_s,
        **_any(limits),
    )
    worst = max(reached, key=lambda name: reached[name]) if reached else ""
    open_ = [name for name, share in reached.items() if share > 1.0]
    if open_:
        why = f"to sharpen what is least known now: {label(worst)}, {reached[worst]:.1f} times its target"
    else:
        why = "to judge the model on a flight that no estimate has seen"
    beside = f", with {', '.join(e.replace('_', ' ') for e in effects)} estimated beside it" if effects else ""
    return Decision(plan, why + beside, shows, untold)


def gentle_plan(plan: Callable[..., Decision], why: str, limits: Mapping[str, float]) -> Decision:
    """What a planner decides within gentle limits."""
    most = min(limits.get("acceleration_max_m_s2", GENTLE_M_S2), GENTLE_M_S2)
    found = plan(**{**limits, "acceleration_max_m_s2": most})
    return replace(found, why=f"{found.why}; gently, for {why}", gently=why)


def flights_needed(vehicle: Vehicle, estimates: Document, targets: Mapping[str, float], plan: Plan) -> dict[str, float]:
    """Flights of a plan that each target would still take, by the plan's predicted information; 0 where it is met.

    Variances add as information: with present variance v, the plan's own p and the target g, n solves
    1/v + n/p = 1/g.
    """
    predicted = predicted_std(plan.series(), as_estimated(vehicle, estimates), DEFAULT_NOISE)
    out: dict[str, float] = {}
    for name, share in targets.items():
        entry = estimates.get(name)
        if name not in predicted:
            continue
        value = abs(entry["value"]) if entry else abs(vehicle.parameters().get(name, np.nan))
        goal = (share * value / HALF_95) ** 2
        now = entry["std"] ** 2 if entry else np.inf
        out[name] = max(0.0, (1.0 / goal - 1.0 / now) * predicted[name] ** 2)
    return out


def promised(vehicle: Vehicle, estimates: Document, plan: Plan) -> dict[str, float]:
    """What one flight of a plan should make of each standard deviation, as its share, by the plan's predicted
    information: 1 / sqrt(1 + v/p) with present variance v and the plan's own p.
    """
    predicted = predicted_std(plan.series(), as_estimated(vehicle, estimates), DEFAULT_NOISE)
    return {
        name: float((1.0 + (entry["std"] / predicted[name]) ** 2) ** -0.5)
        for name, entry in estimates.items()
        if predicted.get(name, 0.0) > 0.0
    }


def paper_seconds(
    vehicle: Vehicle, estimates: Document, plans: Sequence[Plan], names: Sequence[str]
) -> dict[str, float]:
    """Seconds of the paper's trajectory, repeated, that tell each parameter as well as flown plans do, by predicted
    information.

    Both are predicted with the same noise, so its size does not matter. Parameters that one of them does not reveal are
    left out.
    """
    known, noise = as_estimated(vehicle, estimates), DEFAULT_NOISE
    repeated = predicted_std((paper := paper_plan().series()), known, noise)
    flown = [predicted_std(plan.series(), known, noise) for plan in plans]
    out: dict[str, float] = {}
    for name in names:
        information = sum(each[name] ** -2 for each in flown if each.get(name, np.inf) > 0.0)
        if 0.0 < repeated.get(name, np.inf) < np.inf and information > 0.0:
            out[name] = paper.duration_s * information * repeated[name] ** 2
    return out


def as_estimated(vehicle: Vehicle, estimates: Document) -> Vehicle:
    """The vehicle with mass and inertia as they are known now; as declared where they are unknown or of no rigid
    body.
    """
    names = ("xx", "yy", "zz", "xy", "xz", "yz")
    entries: dict[str, Any] = {n: getattr(vehicle.inertia_kg_m2, n) for n in names}
    entries |= {n: float(estimates[f"i{n}_kg_m2"]["value"]) for n in names if f"i{n}_kg_m2" in estimates}
    mass = float(estimates["mass_kg"]["value"]) if "mass_kg" in estimates else vehicle.mass_kg
    try:
        inertia = Inertia(**entries)
        return vehicle.model_copy(update={"mass_kg": mass, "inertia_kg_m2": inertia}) if mass > 0.0 else vehicle
    except (ValueError, BadInput):
        return vehicle


def _any(limits: Mapping[str, float]) -> dict[str, Any]:
    return dict(limits)
