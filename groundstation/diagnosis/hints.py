"""What the flights give a hint of: effects that beat chance, and do not stand as findings yet."""

from __future__ import annotations

from collections.abc import Sequence

from groundstation.diagnosis.attribution import Selection
from groundstation.diagnosis.beside import beside
from groundstation.diagnosis.results import Hint
from groundstation.diagnosis.rivals import Entry, began_once, has_changes


def hints(selection: Selection, named: Sequence[Entry]) -> list[Hint]:
    """Of each effect that is not named, its best setting if that beats chance and what the others' formulas may leave
    (:meth:`.Selection.suspected`), the likeliest first.

    A finding takes more: a smaller chance, a size that matters, a smaller error on data no estimate saw. More of the
    same flights does not give these if they tell little of it; a motion that is chosen for it may. So what begins at an
    instant, which need not come again, and what a search of one flight gives are no hints.

    Args:
        named: effects beside the baseline, as they were estimated together.
    """
    there = [*selection.baseline, *named]
    taken = {candidate.identifier for candidate, _ in there}
    pool = [entry for entry in selection.pool if entry[0].identifier not in taken and _comes_again(entry)]
    best = dict[str, Hint]()
    for found in beside(selection.evidence, there, pool):
        for entry, values, wald, fits in zip(
            found.entries, found.values, found.walds(), found.plausible(), strict=True
        ):
            beyond = float(wald) - selection.suspected(entry, values, named)
            candidate = entry[0]
            if not fits or beyond <= 0.0 or not selection.has_prerequisites(candidate, named):
                continue
            if candidate.identifier not in best or beyond > best[candidate.identifier].beyond:
                sizes = dict(zip(candidate.effect.names(), values.tolist(), strict=True))
                needed = selection.needed(entry, values, named)
                best[candidate.identifier] = Hint(
                    candidate.identifier, dict(candidate.settings), sizes, float(wald), needed, beyond
                )
    return sorted(best.values(), key=lambda hint: -hint.beyond)


def _comes_again(entry: Entry) -> bool:
    effect = entry[0].effect
    return effect.searched is None and not has_changes(effect) and not began_once(entry)
