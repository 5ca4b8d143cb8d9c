"""What a diagnosis would have found: the least size of each effect of the library that is not among its findings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.attribution import Selection
from groundstation.diagnosis.beside import beside
from groundstation.diagnosis.effect import Effect
from groundstation.diagnosis.results import WouldShow
from groundstation.diagnosis.rivals import Entry, has_changes
from groundstation.diagnosis.thresholds import THRESHOLDS

Array = NDArray[np.float64]

NINE_OF_TEN = 1.2816
"""Quantile of the normal distribution that nine of ten draws stay below."""


def would_show(selection: Selection, named: Sequence[Entry]) -> list[WouldShow]:
    r"""Of each effect that is not there, parameter by parameter, the size that is found nine times out of ten.

    Beside what is there, an effect of one parameter :math:`\theta` has the Wald statistic
    :math:`(\theta/\sigma + e)^2`, with :math:`\sigma^{-2}` the parameter's information where the effect's others are
    known to be zero, and e normal. It stands above w with that chance from :math:`\sigma (\sqrt w + z)` on, z the
    quantile. What matters to nobody is not named. Not told are sizes in directions between parameters, and effects
    whose settings a search of the flight gives.

    Args:
        named: effects beside the baseline, as they were estimated together.
    """
    there = [*selection.baseline, *named]
    taken = {candidate.identifier for candidate, _ in there}
    pool = [entry for entry in selection.pool if _is_told(entry[0].effect, taken)]
    worst = dict[tuple[str, str], WouldShow]()
    for found in beside(selection.evidence, there, pool):
        telling = list(found.telling)
        for place, entry in enumerate(found.entries):
            own: Array = found.covariance[place][np.ix_(telling, telling)]
            information = np.asarray(np.linalg.pinv(own, hermitian=True), dtype=float)
            for row, index in enumerate(telling):
                told = _told(selection, named, entry, index, float(information[row, row]))
                key = told.effect, told.parameter
                if key not in worst or told.share > worst[key].share:
                    worst[key] = told
    return [told for told in worst.values() if np.isfinite(told.least)]


def _is_told(effect: Effect, taken: set[str]) -> bool:
    """Whether a size of it can be named: by one parameter, in settings that the vehicle or the clock gives."""
    rests = not effect.rests_on or bool(taken.intersection(effect.rests_on))
    return effect.identifier not in taken and effect.searched is None and not has_changes(effect) and rests


def _told(selection: Selection, named: Sequence[Entry], entry: Entry, index: int, information: float) -> WouldShow:
    """One parameter of one candidate."""
    candidate, columns = entry
    unit = np.zeros(len(candidate.effect.parameters))
    unit[index] = 1.0
    rms = float((columns.wrench_rms @ unit / selection.evidence.scale).max())
    least = np.inf
    if information > 0.0 and rms > 0.0:
        stands = np.sqrt(selection.needed(entry, unit, named)) + NINE_OF_TEN
        least = max(float(stands / np.sqrt(information)), THRESHOLDS.material_share / rms)
    return WouldShow(candidate.identifier, candidate.effect.parameters[index].name, least, least * rms)
