"""What the planned motion is too weak an instrument for, said beside the numbers that rest on the motion as flown."""

from __future__ import annotations

from collections.abc import Sequence

from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.rivals import Entry
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.model.parameters import RIGID_BODY, table


def weak_instruments(evidence: Evidence, chosen: Sequence[Entry]) -> tuple[str, ...]:
    """A note on mass, moments and the chosen effects' parameters whose instruments are weak; nothing where none is.

    Without a plan there are no instruments to speak of, and a warning of the diagnosis says so.
    """
    if any(flight.prepared.planned is None for flight in evidence.flights):
        return ()
    labels = {name: table()[name].label for name in RIGID_BODY}
    names = [*evidence.names, *("" for _ in range(evidence.x.shape[1] - len(evidence.names)))]
    names += [f"{candidate.identifier}.{name}" for candidate, _ in chosen for name in candidate.effect.names()]
    found = dict(zip(names, evidence.strengths(chosen).tolist(), strict=True))
    said = {name: found[name] for name in names if name in labels or "." in name}
    weak = [f"{labels.get(n, n)} (F = {f:.2g})" for n, f in said.items() if f < THRESHOLDS.instruments_strong]
    if not weak:
        return ()
    return (
        f"The plan hardly shows in how the vehicle moved where these are told: {', '.join(weak)}; "
        f"{THRESHOLDS.instruments_strong:g} is asked for. Their numbers rest on the motion as flown, and their "
        "intervals allow for what feedback makes of it. Fly what the vehicle follows closely: slower, or smaller.",
    )
