"""What stands first: the verdict, the findings with a sentence each, the error before and after, the next flight."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from groundstation.errors import Refused
from groundstation.identification.results import Estimate, Identification
from groundstation.reporting import figures
from groundstation.reporting.canonical import canonical
from groundstation.reporting.card import difference, landing_card
from groundstation.reporting.markup import Markup, element, fragment, sentence_list, table
from groundstation.reporting.page import Page
from groundstation.reporting.sections.parameters import reason
from groundstation.reporting.sections.tables import UNCHANGED, error_table, estimate_cell, row_name
from groundstation.reporting.units import (
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

if TYPE_CHECKING:  # the diagnosis is heavy to import, and only its type is needed
    from groundstation.diagnosis.results import Diagnosis

VERDICTS: Mapping[str, str] = {
    "clean": "Clean: mass, inertia and the declared constants explain this flight down to its noise.",
    "explained": "Explained: what the declared vehicle lacks was found, and the rest is noise.",
    "unexplained": "Unexplained: a real residual remains that no known effect removes.",
    "refused": "Refused: this flight cannot answer the question.",
}
NOT_DIAGNOSED = "Next: diagnose it (`groundstation report`), to find what the declared vehicle lacks."
_SYMBOLS: Mapping[str, str] = {"clean": "✓", "explained": "✓", "unexplained": "?", "refused": "✕", "open": "•"}
_NAMES: Mapping[str, str] = {
    "com_offset": "Centre-of-mass offset",
    "imu_misalignment": "IMU misalignment",
    "mocap_misalignment": "Marker-body misalignment",
    "mocap_tilt": "Motion-capture tilt",
}


def effect_name(effect: str) -> str:
    """An identifier of the effects' vocabulary in words."""
    return _NAMES.get(effect, effect.replace("_", " ").capitalize())


def add_verdict(
    page: Page, identification: Identification | Refused, diagnosis: Diagnosis | None, declared: Mapping[str, float]
) -> None:
    """The section a reader sees first; the tiles tell what differs from what was declared."""
    warnings = _warnings(identification, diagnosis)
    if isinstance(identification, Refused):
        content = _banner(
            "refused", VERDICTS["refused"], readable(identification.reason), readable(identification.remedy)
        )
        page.section("verdict", "Verdict", content, _missing(identification.not_identifiable))
        return
    if diagnosis is None:
        best = f"Best estimate: {identification.best}. {reason(identification)}"
        page.section(
            "verdict",
            "Verdict",
            _banner("open", "Identified; not diagnosed.", best, NOT_DIAGNOSED),
            warnings,
            _cards(identification, None, declared),
        )
        return
    page.section(
        "verdict",
        "Verdict",
        _judgement(identification, diagnosis),
        warnings,
        _cards(identification, diagnosis, declared),
        _reason(diagnosis),
        _findings(diagnosis),
        _unexplained(diagnosis),
        _before_after(page, diagnosis),
        _bias(diagnosis),
        _next_flight(diagnosis),
        _candidates(diagnosis),
    )


def _judgement(identification: Identification, diagnosis: Diagnosis) -> Markup:
    """The verdict with the landing card's word on trust and on what is next: a tick stands only where nothing is in
    doubt.
    """
    trust, _, following = landing_card(identification.to_dict(), diagnosis.to_dict(), {})
    doubtful = diagnosis.verdict in ("clean", "explained") and not trust.startswith("Trust: yes")
    refused = readable(diagnosis.reason) if diagnosis.verdict == "refused" else ""
    return _banner("open" if doubtful else diagnosis.verdict, VERDICTS[diagnosis.verdict], trust, refused, following)


def _reason(diagnosis: Diagnosis) -> Markup | None:
    """What the verdict rests on, below the tiles; a refusal has it in its banner."""
    if diagnosis.verdict == "refused":
        return None
    return element("p", readable(diagnosis.reason, _identifiers(diagnosis)))


def _banner(kind: str, title: str, *sentences: str) -> Markup:
    symbol = element("span", _SYMBOLS[kind] + " ", aria_hidden="true")
    return element(
        "div",
        element("strong", symbol, title),
        [element("p", s[:1].upper() + s[1:]) for s in sentences if s],
        class_=f"verdict {kind}",
    )


def _warnings(identification: Identification | Refused, diagnosis: Diagnosis | None) -> Markup | None:
    """How many warnings there are, where they stand."""
    found = {*(() if isinstance(identification, Refused) else identification.warnings)}
    found |= {*(diagnosis.warnings if diagnosis else ())}
    if not found:
        return None
    text = "One warning: read it" if len(found) == 1 else f"{len(found)} warnings: read them"
    return element("p", element("a", f"{text} before you use these numbers.", href="#warnings"))


def _missing(names: tuple[str, ...]) -> Markup | None:
    return element("p", "No number is given for: ", ", ".join(label(n) for n in names), ".") if names else None


def _cards(identification: Identification, diagnosis: Diagnosis | None, declared: Mapping[str, float]) -> Markup:
    """Mass, moments and lag of the one estimate, and what it is to be read with."""
    estimate = canonical(identification, diagnosis)
    kept = estimate.parameters
    shown = [name for name in ("mass_kg", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2") if name in kept]
    shown += [name for name in kept if name.startswith("rotor_lag")][:1]
    note = f"Estimate by {method_text(estimate.source)}; percentages are against the declared vehicle. {estimate.note}"
    widened = diagnosis is not None and bool(diagnosis.unexplained)
    return fragment(
        element("div", [_card(name, kept[name], declared.get(name), widened) for name in shown], class_="cards"),
        element("p", note.strip(), class_="note"),
    )


def _card(name: str, estimate: Estimate, declared: float | None, widened: bool) -> Markup:
    """Name, how far from the declared value, value with interval, unit; a widened interval is called so."""
    scale = scale_for(split_unit(name)[1], [estimate.value])
    number = element("b", interval_text(estimate, scale), " ", element("span", scale.unit))
    doubt = element("span", "interval widened", class_="doubt") if widened else None
    more = percent(estimate.value / declared - 1.0) if declared and difference(estimate, declared) else None
    head = element("span", element("span", label(name)), element("span", more, title="against declared"), class_="name")
    return element("div", head, number, doubt, class_="card")


def _identifiers(diagnosis: Diagnosis) -> set[str]:
    """Effects that its sentences may name."""
    return {name for finding in diagnosis.findings for name in (finding.effect, *finding.alternatives)}


def _findings(diagnosis: Diagnosis) -> Markup | None:
    if not diagnosis.findings:
        return None
    items = []
    for finding in diagnosis.findings:
        where = f", rotor {finding.rotor}" if finding.rotor is not None else ""
        tags = [element("span", f"{label(n)} {quantity(n, e)}", class_="tag") for n, e in finding.parameters.items()]
        tags.append(element("span", f"confidence {significant(100 * finding.confidence)} %", class_="tag"))
        rivals = ", ".join(effect_name(a).lower() for a in finding.alternatives)
        doubt = element("p", f"This flight cannot tell it from: {rivals}.", class_="note") if rivals else None
        items.append(
            element(
                "li",
                element("h3", effect_name(finding.effect), where),
                element("p", readable(finding.sentence, _identifiers(diagnosis))),
                tags,
                doubt,
            )
        )
    return fragment(
        element("h3", "Findings, in the order in which they reduce the error"), element("ol", items, class_="findings")
    )


def _unexplained(diagnosis: Diagnosis) -> Markup | None:
    if not diagnosis.unexplained:
        return None
    rows = [
        (
            label(item.channel),
            percent(item.share).lstrip("+"),
            ", ".join(label(d) for d in item.depends_on) or "nothing that was tried",
            item.proposal or "–",
        )
        for item in diagnosis.unexplained
    ]
    caption = "What is left: share of the channel's residual variance, and what it varies with."
    header = ("channel", "share", "varies with", "proposed formula")
    return fragment(element("h3", "Left unexplained"), table(caption, header, rows, class_="text"))


def _before_after(page: Page, diagnosis: Diagnosis) -> Markup | None:
    """Tables of every check, and one figure of what the findings removed."""
    parts: list[Markup] = []
    for check, stages in diagnosis.error.items():
        for prefix, title in (("", "residual"), ("simulation_", "closed-loop simulation against flight")):
            known = {
                stage: stages[prefix + stage] for stage in ("nominal", "before", "after") if stages.get(prefix + stage)
            }
            if "before" not in known:
                continue
            caption = (
                f"RMS, {check.replace('_', '-')} data: {title}. Before: mass and inertia re-estimated on the same "
                "training blocks without the effects. After: with them (▾ it fell). Nominal: the vehicle as declared."
            )
            rms = error_table(caption, known, reference="before", improved="after")
            if _differ(known):
                parts.append(element("div", rms, _relative(page, known, title), class_="pair"))
            else:
                parts.append(element("details", element("summary", f"{title.capitalize()}: {_SAME}"), rms))
        parts += [part for part in (_prediction(stages),) if part is not None]
    parts += [element("p", note, class_="note") for note in diagnosis.notes]
    if not diagnosis.adopted:
        parts.insert(0, element("p", readable(diagnosis.reason), class_="worse"))
    return fragment(element("h3", "Error before and after"), parts) if parts else None


def _prediction(stages: Mapping[str, Mapping[str, float]]) -> Markup | None:
    """Open-loop prediction by quantity and horizon, with how many times smaller the findings make its error."""
    columns = ("nominal", "before", "after")
    rows = []
    for name in stages:
        if not (name.startswith("prediction_") and name.endswith("_before")):
            continue
        horizon = name.removesuffix("_before")
        ahead = horizon.removeprefix("prediction_").removesuffix("_s")
        for error, before in stages[name].items():
            values = [stages.get(f"{horizon}_{stage}", {}).get(error, math.nan) for stage in columns]
            scale = scale_for(split_unit(error)[1], values)
            nominal, _, after = (significant(scale.factor * value) for value in values)
            name_and_unit = fragment(f"{label(error)}, {ahead} s", element("small", scale.unit))
            told = fragment(after, _ratio(before, values[-1]))
            rows.append((name_and_unit, nominal, significant(scale.factor * before), told))
    caption = (
        "RMS, held-out data: open-loop prediction with the recorded inputs, from what the sensors had said until its "
        "start. Ratio: error before over error after."
    )
    return table(caption, ("prediction", *columns), rows, highlight=3) if rows else None


def _ratio(before: float, after: float) -> Markup | None:
    """How many times smaller the findings make an error; a word where they change nothing."""
    if not (after > 0.0 and before > 0.0):
        return None
    if abs(after / before - 1.0) < UNCHANGED:
        return element("small", "unchanged")
    kind = "worse" if after > before else "better"
    return element("small", f"ratio {significant(before / after)}", class_=kind)


_SAME = "unchanged, as no finding adds a force."


def _differ(stages: Mapping[str, Mapping[str, float]]) -> bool:
    """The findings changed the error of some channel by more than would be written as 0.0 %."""
    after = stages.get("after", {})
    return any(abs(after[c] - v) > UNCHANGED * v for c, v in stages["before"].items() if c in after)


def _relative(page: Page, stages: Mapping[str, Mapping[str, float]], title: str) -> Markup:
    channels = [c for c, v in stages["before"].items() if v > 0.0]
    groups = {
        stage: {label(c): 100.0 * stages[stage][c] / stages["before"][c] for c in channels if c in stages[stage]}
        for stage in ("before", "after")
        if stage in stages
    }
    figure = figures.bar_figure(groups, "RMS, % of before")
    return page.figure(figure, f"Held-out error, {title}, relative to the error before.")


def _bias(diagnosis: Diagnosis) -> Markup | None:
    before, after = diagnosis.parameters_before, diagnosis.parameters_after
    shared = [name for name in after if name in before]
    if not any(after[name].value != before[name].value for name in shared):
        return None
    trace = sum(abs(after[n].value) for n in ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2") if n in after)
    tensor = scale_for("kg m²", [e.value for n, e in (*before.items(), *after.items()) if n.endswith("kg_m2")])
    rows = []
    for name in shared:
        scale = tensor if name.endswith("kg_m2") else scale_for(split_unit(name)[1], [before[name].value])
        cells = [estimate_cell(name, source[name], scale) for source in (before, after)]
        rows.append((row_name(name, scale), *cells, _bias_share(name, before[name], after[name], trace)))
    caption = (
        "Parameters with the effects left out and put in: the difference is the bias that leaving them out causes."
    )
    return table(caption, ("parameter", "effects left out", "effects put in", "bias removed"), rows)


def _bias_share(name: str, before: Estimate, after: Estimate, trace: float) -> str:
    """The shift as a share of the value; of products as a share of the tensor's trace."""
    product = name in {"ixy_kg_m2", "ixz_kg_m2", "iyz_kg_m2"}
    size = trace if product else abs(after.value)
    if size <= half_width(after):  # a share of what may as well be zero says nothing
        return "–"
    return percent((before.value - after.value) / size, 2) + (" of trace" if product else "")


def _next_flight(diagnosis: Diagnosis) -> Markup | None:
    if not diagnosis.next_flight:
        return None
    return fragment(
        element("h3", "Next flight"), element("p", readable(diagnosis.next_flight, _identifiers(diagnosis)))
    )


def _candidates(diagnosis: Diagnosis) -> Markup | None:
    if not diagnosis.candidates:
        return None
    columns = list(dict.fromkeys(key for candidate in diagnosis.candidates for key in candidate))
    rows = [[_text(candidate.get(column)) for column in columns] for candidate in diagnosis.candidates]
    listing = table("Every effect that was tried.", [c.replace("_", " ") for c in columns], rows, class_="text")
    return element("details", element("summary", f"{len(rows)} effects were tried"), listing)


def _text(value: object) -> str | Markup:
    if value is None:
        return "–"
    if isinstance(value, float):
        return significant(value)
    if isinstance(value, Mapping):
        return ", ".join(f"{label(str(name))} {_text(item)}" for name, item in value.items()) or "–"
    if isinstance(value, (list, tuple)):
        return sentence_list(str(v) for v in value)
    return str(value)
