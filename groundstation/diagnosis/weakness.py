"""What the planned motion is too weak an instrument for, said beside the numbers that rest on the motion as flown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

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
    strengths, labels = evidence.strengths(chosen), table()
    said = {labels[name].label: strengths[evidence.names.index(name)] for name in RIGID_BODY}
    first = evidence.x.shape[1]
    for candidate, _ in chosen:
        said[candidate.identifier] = strengths[first + np.array(candidate.effect.telling())].min()
        first += len(candidate.effect.parameters)
    weak = [f"{name} (F = {f:.2g})" for name, f in said.items() if f < THRESHOLDS.instruments_strong]
    if not weak:
        return ()
    return (
        f"Little of the plan shows in the motion that tells {', '.join(weak)}; F = {THRESHOLDS.instruments_strong:g} "
        "is asked for. These numbers rest on the motion as flown, and their intervals allow for what feedback makes of "
        "it. Plan more of that motion, or one that the vehicle follows more closely.",
    )
