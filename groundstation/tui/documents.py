"""Documents, and what of plan and status is written like them, as rows of text. Pure; here numbers are only written."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from groundstation.campaign.campaign import Campaign, Round
from groundstation.flight.messages import CoreStatus, KnownStatus
from groundstation.identification.results import MASS_AND_TENSOR, Estimate
from groundstation.json_types import Document
from groundstation.reporting.canonical import estimate_in, estimate_of
from groundstation.reporting.compare import change
from groundstation.reporting.units import (
    beyond_rounding,
    decimals,
    fixed,
    half_width,
    interval_text,
    label,
    method_text,
    percent,
    quantity,
    readable,
    scale_for,
    significant,
    split_unit,
)
from groundstation.trajectory import Plan, rigid_motion
from groundstation.tui.text import Row


def plan_lines(plan: Plan) -> str:
    """A plan before it is flown: how long, how far, how fast, and what it should tell."""
    series = plan.series()
    t_s = np.linspace(0.0, min(series.period_s, series.duration_s), 400)
    flat = series.sample(t_s)
    motion = rigid_motion(flat)
    tilt = np.degrees(np.arccos(np.cos(motion.euler_rad[:, 0]) * np.cos(motion.euler_rad[:, 1])))
    speed = np.linalg.norm(flat.position[1], axis=1)
    low, high = flat.position[0].min(axis=0), flat.position[0].max(axis=0)
    reach = ", ".join(f"{axis} {a:.2f} … {b:.2f}" for axis, a, b in zip("xyz", low, high, strict=True))
    lines = [
        f"the plan: {series.duration_s:.0f} s, up to {speed.max():.2f} m/s and {tilt.max():.1f}° of tilt",
        f"within {reach} m",
    ]
    for name in ("mass_kg", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2"):
        if name in plan.predicted_std:
            std = plan.predicted_std[name]
            scale = scale_for(split_unit(name)[1], [std])
            lines.append(f"should tell {label(name)} to ± {significant(1.96 * std * scale.factor, 2)} {scale.unit}")
    return "\n".join(lines)


def motor_lines(motors: Sequence[float], top: float, width: int = 16) -> str:
    """Rotor commands as bars against the largest seen."""
    if not motors:
        return "no rotor commands yet"
    scale = max(top, max(abs(m) for m in motors), 1e-9)
    return "\n".join(
        f"{number} {'█' * round(width * max(m, 0.0) / scale):<{width}} {significant(m)}"
        for number, m in enumerate(motors, 1)
    )


def live_rows(table: Mapping[str, tuple[float, float, float, float]]) -> list[Row]:
    """Parameter, nominal, estimate ± half width, unit; of a status."""
    return [
        (label(name), *_against_nominal(name, nominal, _estimate(value, low, high)))
        for name, (nominal, value, low, high) in table.items()
    ]


def until_lines(status: CoreStatus) -> str:
    """Time to target of each parameter, what is proposed, and what the flight so far lets suspect; empty where there is
    none of it.
    """
    lines = []
    if (until := status.until) is not None:
        lines.append(f"until known: {until.length_s:.0f} s as it stands, {until.at_most_s:.0f} s at the most")
        lines += [f"  {label(name)}: {_to_target(known)}" for name, known in until.parameters.items()]
        lines.append(until.proposal or until.text)
    for suspect in status.suspects:
        rivals = f" (or {', '.join(suspect.alternatives)})" if suspect.alternatives else ""
        lines.append(
            f"suspected after {status.suspects_s:.0f} s: {suspect.effect} likely, {suspect.odds:.0f}:1{rivals}"
        )
    return "\n".join(lines)


def _to_target(known: KnownStatus) -> str:
    if known.spent is None:
        return "not revealed yet"
    peeked = "" if known.at_any_time is None else f", {known.at_any_time:.2f} at any time"
    left = "met" if known.spent <= 1.0 else f"{known.seconds or 0.0:.0f} s to go"
    return f"{left} ({known.spent:.2f} of the target{peeked})"


def round_row(number: int, done: Round) -> Row:
    """One flight of a campaign: number, seconds, verdict, what is found, how far the worst target is, error before and
    after the effects.
    """
    worst = max(done.reached, key=lambda name: done.reached[name], default="")
    far = f"{label(worst)} {done.reached[worst]:.2f}" if worst else "–"
    errors = "–"
    if done.judged:
        errors = (
            " → ".join(significant(done.judged[kind]["body_rate_rad_s"]) for kind in ("before", "after")) + " rad/s"
        )
    found = ", ".join(done.names()).replace("_", " ") or "nothing"
    return str(number), f"{done.seconds:.0f}", done.verdict or "refused", found, far, errors


def rounds_text(campaign: Campaign) -> str:
    """How a campaign stands: vehicle, targets, why the last flight was flown, what is open, what is next."""
    goals = ", ".join(f"{label(name)} {100 * share:g} %" for name, share in campaign.targets.items())
    lines = [f"{campaign.folder.name}", f"until {goals}; at most {campaign.at_most} flights"]
    if campaign.rounds:
        lines.append(f"flight {len(campaign.rounds)} was flown {campaign.rounds[-1].why}")
        lines += [f"open: {text}" for text in campaign.rounds[-1].not_settled]
    lines.append(
        campaign.sentence or (f"next: {campaign.pending['why']}" if campaign.pending else "n plans the next flight")
    )
    return "\n".join(lines)


def _estimate(value: float, low: float, high: float) -> Estimate | None:
    return Estimate(value, 0.0, (low, high)) if math.isfinite(value) else None


def _against_nominal(name: str, nominal: float, estimate: Estimate | None) -> Row:
    known = [v for v in (nominal, estimate.value if estimate else math.nan) if math.isfinite(v)]
    scale = scale_for(split_unit(name)[1], known)
    if estimate is None:
        return fixed(nominal * scale.factor, 3), "not revealed", scale.unit
    places = decimals(half_width(estimate) * scale.factor)
    return fixed(nominal * scale.factor, places), interval_text(estimate, scale), scale.unit


def method_table(document: Document, declared: Mapping[str, float], most: int) -> tuple[Row, list[Row]]:
    """Header and rows of mass and tensor: the one estimate, then the methods, at most so many columns, with 95 % half
    widths.
    """
    source, estimate = estimate_in(document)
    methods = {**document["methods"], source: {"parameters": estimate}}
    names = [source, *(name for name in methods if name != source)][:most]
    header = ("parameter", "unit", "nominal", *(f"{name} (estimate)" if name == source else name for name in names))
    rows = []
    for parameter in MASS_AND_TENSOR:
        found = [estimate_of(methods.get(name, {}).get("parameters", {}).get(parameter)) for name in names]
        nominal = declared.get(parameter, math.nan)
        known = [abs(e.value) for e in found if e] + [abs(nominal)]
        scale = scale_for(split_unit(parameter)[1], [v for v in known if math.isfinite(v)])
        cells = [interval_text(e, scale) if e else "not revealed" for e in found]
        shown = fixed(nominal * scale.factor, decimals(half_width(found[0]) * scale.factor) if found[0] else 3)
        rows.append((label(parameter), scale.unit, shown, *cells))
    return header, rows


def _online(clock: Document) -> str:
    """What the link knew of the clocks in flight, where it told."""
    if clock.get("online_s") is None or clock.get("online_error_s") is None:
        return ""
    verdict = "agrees" if clock.get("online_agrees") else "differs"
    return f"; in flight {1e3 * clock['online_s']:+.2f} ± {1e3 * clock['online_error_s']:.2f} ms: {verdict}"


def identification_notes(document: Document) -> str:
    """Best method and why, clock, condition, what is not revealed, warnings, and the errors before and after."""
    because = readable(str(document.get("best_reason", "")).removeprefix(f"{document['best']}:").strip())
    lines = [f"best: {method_text(document['best'])}{f'; {because}' if because else ''}"]
    if clock := document.get("clock"):
        offset = Estimate.normal(clock["mocap_minus_imu_s"], clock["std_s"])
        lines.append(f"clock: motion capture minus IMU {quantity('offset_s', offset)}{_online(clock)}")
    conditions = {k: m.get("condition_number") for k, m in document["methods"].items()}
    known = ", ".join(f"{name} {value:.1f}" for name, value in conditions.items() if value)
    lines.append(f"condition number: {known or 'none given'}")
    lines += [f"not revealed: {label(name)}: {why}" for name, why in document.get("remedies", {}).items()]
    lines += [f"warning: {readable(text)}" for text in document.get("warnings", ())]
    lines += [f"recording: {readable(text)}" for text in document.get("quality", ())]
    return "\n".join(lines)


def validation_rows(document: Document) -> list[Row]:
    """Check, signal, error with the nominal vehicle, with the best method, and their ratio."""
    rows = []
    for check in document.get("validation", ()):
        before, after = check["rms"].get("nominal", {}), check["rms"].get(document["best"], {})
        for signal, value in after.items():
            start = before.get(signal)
            kind = check["kind"].replace("_", " ")
            model = f", {check['note'].split()[0].lower()}" if kind == "output" and check.get("note") else ""
            rows.append((kind + model, label(signal), *_change(signal, start, value)))
    return rows


def _change(signal: str, before: float | None, after: float | None) -> Row:
    before, after = (v if v is None else beyond_rounding(v) for v in (before, after))
    known = [v for v in (before, after) if v is not None]
    scale = scale_for(split_unit(signal)[1], known)
    texts = ["–" if v is None else f"{significant(v * scale.factor)} {scale.unit}" for v in (before, after)]
    ratio = "" if not before or after is None else _ratio_text(after / before)
    return (*texts, ratio)


def _ratio_text(ratio: float) -> str:
    """A change in percent; as a multiple where it grew so much that a percentage of a small base would say nothing."""
    return percent(ratio - 1.0, 0) if ratio < 2.0 else f"{significant(ratio, 2)} × worse"


def error_rows(diagnosis: Document) -> list[Row]:
    """Channel, held-out error with nominal values, identified, and with the findings, and what the findings change."""
    rows = []
    for where, stages in diagnosis.get("error", {}).items():
        before, after, nominal = (stages.get(k, {}) for k in ("before", "after", "nominal"))
        for channel, value in before.items():
            shown = _change(channel, value, after.get(channel))
            start = _change(channel, nominal.get(channel), value)[0]
            rows.append((f"{label(channel)}, {where.replace('_', ' ')}", start, *shown))
    return rows


def finding_text(diagnosis: Document) -> str:
    """Verdict, findings with their sentences, what stays unexplained, and the flight that would tell more."""
    lines = [f"verdict: {diagnosis['verdict']}"]
    if diagnosis.get("reason"):
        lines.append(diagnosis["reason"])
    for finding in diagnosis.get("findings", ()):
        rotor = f", rotor {finding['rotor']}" if finding.get("rotor") is not None else ""
        lines += ["", f"found: {finding['effect'].replace('_', ' ')}{rotor}, confidence {finding['confidence']:.3f}"]
        lines.append(f"  {finding['evidence']}")
        if finding.get("alternatives"):
            lines.append(f"  or: {', '.join(finding['alternatives']).replace('_', ' ')}")
    for item in diagnosis.get("unexplained", ()):
        lines += ["", f"unexplained: {100 * item['share']:.0f} % of {label(item['channel'])}"]
        if item.get("depends_on"):
            lines.append(f"  varies with {', '.join(label(name) for name in item['depends_on'])}")
        if item.get("proposal"):
            lines.append(f"  {item['proposal']}")
    lines += [f"warning: {readable(text)}" for text in diagnosis.get("warnings", ())]
    lines += ["", f"next flight: {diagnosis.get('next_flight') or 'none proposed'}"]
    return "\n".join(lines)


def suspect_rows(diagnosis: Document) -> list[Row]:
    """Effects that were tried: name, settings, and the evidence for them; then the hints."""
    rows = []
    for candidate in diagnosis.get("candidates", ()):
        settings = ", ".join(f"{name} {value}" for name, value in (candidate.get("settings") or {}).items())
        evidence = candidate.get("evidence")
        shown = significant(evidence) if isinstance(evidence, float | int) else str(evidence or "")
        rows.append((str(candidate.get("effect", "?")).replace("_", " "), settings, shown))
    for hint in diagnosis.get("hints", ()):
        evidence = f"{significant(hint['evidence'])}, a hint"
        rows.append((str(hint["effect"]).replace("_", " "), "", evidence))
    return rows


LONGEST_NAME = 30
"""Characters of a flight's name in the list: several flights identified together have all their names."""


def flight_row(row: Document) -> Row:
    """One flight of the catalogue: when, flight, vehicle, state, verdict, mass."""
    mass = row["parameters"].get("mass_kg")
    shown = f"{significant(mass['value'], 4)} kg" if mass else "–"
    vehicle = row["vehicle"]
    name = row["flight"].removesuffix(f"-{vehicle}")
    return (
        row["date"][5:16].replace("T", " "),
        name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 1]}…",
        vehicle or "–",
        row["state"],
        row["verdict"] or "–",
        shown,
    )


def comparison(first: Document, second: Document) -> list[Row]:
    """Two flights of the catalogue: parameter, unit, the values with half widths, and the change."""
    rows = []
    for name, a in first["parameters"].items():
        b = second["parameters"].get(name)
        if b is None:
            continue
        scale = scale_for(split_unit(name)[1], [a["value"], b["value"]])
        both = [Estimate.normal(e["value"], e["std"]) for e in (a, b)]
        cells = [interval_text(estimate, scale) for estimate in both]
        rows.append((label(name), scale.unit, *cells, change(name, *both)))
    return rows
