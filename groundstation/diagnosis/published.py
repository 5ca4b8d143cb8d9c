"""What of a diagnosis is published beside an identification of the same flights: nothing that the identification
hides.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from groundstation.diagnosis.results import Diagnosis
from groundstation.diagnosis.thresholds import THRESHOLDS

MOMENTS = ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")


def published(diagnosis: Diagnosis, hidden: Mapping[str, str]) -> Diagnosis:
    """Without the numbers that are hidden, and not ``explained`` where it stands on nothing or made a channel worse.

    Args:
        diagnosis: of the flights.
        hidden: what their identification does not publish, with the reasons.
    """
    before, after = (
        {name: value for name, value in numbers.items() if name not in hidden}
        for numbers in (diagnosis.parameters_before, diagnosis.parameters_after)
    )
    doubts = _doubts(diagnosis, hidden) if diagnosis.verdict == "explained" else []
    return replace(
        diagnosis,
        parameters_before=before,
        parameters_after=after,
        verdict="unexplained" if doubts else diagnosis.verdict,
        warnings=(*diagnosis.warnings, *doubts),
    )


def _doubts(diagnosis: Diagnosis, hidden: Mapping[str, str]) -> list[str]:
    """Why findings do not explain the flight, in sentences."""
    doubts: list[str] = []
    errors = diagnosis.error.get("held_out", {})
    before, after = errors.get("before", {}), errors.get("after", {})
    worse = [name for name, size in after.items() if name in before and size > THRESHOLDS.channel_worse * before[name]]
    if worse:
        doubts.append(
            f"With the findings, {', '.join(worse)} is predicted worse on unseen data: they do not explain this flight."
        )
    if "mass_kg" in hidden or all(name in hidden for name in MOMENTS):
        doubts.append(
            "The flight reveals no mass or no moment of inertia, so findings that stand on these do not explain it."
        )
    return doubts
