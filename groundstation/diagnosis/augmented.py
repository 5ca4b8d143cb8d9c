"""What an earlier flight found, taken as known: the diagnosis of the next one says what the augmented model still
lacks.
"""

from __future__ import annotations

from collections.abc import Mapping

from groundstation.diagnosis.columns import Candidate
from groundstation.diagnosis.effect import library


def known_candidates(effects: Mapping[str, Mapping[str, Mapping[str, float]]]) -> tuple[Candidate, ...]:
    """The force effects of a model document, with their settings; their sizes are estimated anew, and not judged.

    Args:
        effects: of schema groundstation.model/1, name -> parameter -> {value, std}; a second one stands under "name/2".
    """
    found: list[Candidate] = []
    for name, values in effects.items():
        effect = library().get(name.partition("/")[0])
        if effect is not None:
            own = effect.names()
            settings = {n: float(e["value"]) for n, e in values.items() if n not in own}
            found.append(Candidate(effect.of(settings), settings))
    return tuple(found)


def is_among(candidate: Candidate, known: tuple[Candidate, ...]) -> bool:
    """Whether a candidate is one of those known, in the same setting."""
    return any(candidate.effect is k.effect and dict(candidate.settings) == dict(k.settings) for k in known)
