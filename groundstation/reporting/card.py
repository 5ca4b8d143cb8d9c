"""The landing card: three lines after a flight. Trust it or not; the mass and what changed; what to do next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from groundstation.identification.results import Estimate
from groundstation.json_types import Document
from groundstation.reporting.canonical import estimate_in, estimate_of
from groundstation.reporting.units import half_width, label, quantity, readable

MOMENTS = ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")
LEAST_CHANGE = 0.005
"""Share below which a difference from the declared value changes nothing in how the vehicle flies."""
SURE = 0.95
"""Confidence of the least certain finding from which the card raises no doubt."""


def landing_card(
    identification: Document,
    diagnosis: Document,
    declared: Mapping[str, float],
    refusal: str = "",
    planned: str = "",
) -> tuple[str, str, str]:
    """Three lines of the documents that an analysis writes.

    Args:
        identification, diagnosis: the documents; empty where there is none.
        declared: parameters as the vehicle file declares them.
        refusal: why there is no identification; planned: the file of the flight that would tell more, where one is
            proposed.
    """
    if not identification:
        return (
            f"Trust: no. {refusal or 'This flight was not identified.'}",
            "Mass: not known from this flight.",
            "Next: remove the cause and fly again.",
        )
    effects = {name for f in diagnosis.get("findings", ()) for name in (f["effect"], *f.get("alternatives", ()))}
    return (
        f"Trust: {readable(_trust(identification, diagnosis), effects)}",
        _changed(identification, diagnosis, declared),
        f"Next: {_next(identification, diagnosis, effects, planned)}",
    )


def _contradicted(identification: Document) -> Sequence[Document]:
    return [check for check in identification.get("declarations", ()) if check["verdict"] == "contradicted"]


def _trust(identification: Document, diagnosis: Document) -> str:
    """The gravest reason against the numbers, or that there is none."""
    if wrong := _contradicted(identification):
        return f"no. The flight contradicts the declared {' and '.join(str(check['name']) for check in wrong)}."
    if not diagnosis or diagnosis["verdict"] == "refused":
        return "open. The flight was identified and not diagnosed."
    if diagnosis["verdict"] == "unexplained":
        channels = " and ".join(label(item["channel"]) for item in diagnosis.get("unexplained", ())) or "the prediction"
        return f"with care. A residual in {channels} has no known cause; the intervals are widened."
    findings = diagnosis.get("findings", ())
    if findings and not diagnosis.get("adopted", True):
        return "with care. The findings make the prediction worse and are not put in."
    unsure = [f for f in findings if f["confidence"] < SURE or f.get("alternatives")]
    if unsure:
        rivals = " or ".join(unsure[0].get("alternatives", ())) or "chance"
        return f"with care. It may be {rivals} instead of {unsure[0]['effect']}."
    missing = identification.get("not_identifiable", ())
    if missing:
        return f"yes, but not all. The flight does not reveal {', '.join(label(name) for name in missing)}."
    return "yes. The model explains the flight down to noise and disturbance."


def _changed(identification: Document, diagnosis: Document, declared: Mapping[str, float]) -> str:
    """The mass with its interval, what differs from the declaration, and what was found."""
    known = estimate_in(identification)[1]
    mass = estimate_of(known.get("mass_kg"))
    text = "Mass: not revealed" if mass is None else f"Mass: {quantity('mass_kg', mass)}"
    own = "" if mass is None else difference(mass, declared.get("mass_kg"))
    if mass is not None and declared.get("mass_kg"):
        text += f", {own} than declared" if own else ", as declared"
    moments = ((name, estimate_of(known.get(name))) for name in MOMENTS)
    apart = [
        f"{label(name)} {more}" for name, e in moments if e is not None and (more := difference(e, declared.get(name)))
    ]
    if apart:
        text += f"; {', '.join(apart)}"
    found = [_finding(f) for f in diagnosis.get("findings", ())]
    return f"{text}. Found: {', '.join(found)}." if found else f"{text}."


def _finding(finding: Document) -> str:
    rotor = f" (rotor {finding['rotor']})" if finding.get("rotor") is not None else ""
    return f"{finding['effect'].replace('_', ' ')}{rotor}"


def _next(identification: Document, diagnosis: Document, effects: set[str], planned: str) -> str:
    """What comes first; the line of a vehicle file stands as it is to be written."""
    if wrong := _contradicted(identification):
        line = str(wrong[0].get("line") or "")
        return f"correct the vehicle file{f': {line}' if line else ''}, and analyse the flight again."
    if text := str(diagnosis.get("next_flight") or ""):
        if planned and (unsure := next((f for f in diagnosis["findings"] if f.get("alternatives")), None)):
            rivals = " or ".join(unsure["alternatives"])
            return f"fly {planned}; " + readable(f"it should tell {unsure['effect']} from {rivals}.", effects)
        return readable(text.split(". ")[0].rstrip(".") + ".", effects)
    if remedies := identification.get("remedies", {}):
        name, remedy = next(iter(remedies.items()))
        return f"to reveal {label(name)}: {readable(remedy)}"
    return "export the model, or fly again and predict that flight to confirm it."


def difference(estimate: Estimate, declared: float | None) -> str:
    """By how much it is more or less, in percent, where that is beyond the interval and matters; empty otherwise."""
    if not declared or abs(estimate.value - declared) <= half_width(estimate):
        return ""
    share = estimate.value / declared - 1.0
    if abs(share) < LEAST_CHANGE:
        return ""
    return f"{100.0 * abs(share):.1f} % {'more' if share > 0.0 else 'less'}"
