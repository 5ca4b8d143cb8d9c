"""Whether findings are put into the estimate: not where the flight is predicted worse with them than without."""

from __future__ import annotations

from collections.abc import Mapping

from groundstation.diagnosis.thresholds import THRESHOLDS

JUDGED = {"velocity_m_s": ("velocity", "m/s"), "body_rate_rad_s": ("body rate", "rad/s")}
"""What a model predicts; position and attitude are their integrals."""
AHEAD = "prediction_0.5_s"


def why_not(stages: Mapping[str, Mapping[str, float]]) -> str:
    """The sentence that says what the findings make worse; empty where nothing is.

    Args:
        stages: held-out errors by stage and quantity, ``prediction_0.5_s_before`` and ``_after`` among them.
    """
    before, after = stages.get(f"{AHEAD}_before", {}), stages.get(f"{AHEAD}_after", {})
    worse = [
        f"{words} {before[name]:.3g} → {after[name]:.3g} {unit}"
        for name, (words, unit) in JUDGED.items()
        if name in before and after.get(name, 0.0) > THRESHOLDS.prediction_worse * before[name]
    ]
    if not worse:
        return ""
    return (
        f"The findings make the prediction 0.5 s ahead worse ({', '.join(worse)}): they are not put into the estimate."
    )
