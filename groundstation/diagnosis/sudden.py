"""What begins at an instant, found before any noise is modelled, so that the noise model does not take it for its own.

A noise model keeps out whatever looks like an effect of the library, in a few settings of each. A step between two of
these settings, many times the disturbance, would pass for a disturbance of long memory, and nothing would stand out
from that any more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.columns import Candidate
from groundstation.diagnosis.effect import Effect, Settings, library
from groundstation.identification.record_model import RecordModel
from groundstation.identification.sudden import AVERAGED_S, SHARE, Steps
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
UPWARDS = 2
"""Row of a wrench."""


def sudden(
    model: RecordModel, vehicle: Vehicle, signals: Signals, excited: Signals, left: tuple[Array, Array]
) -> list[Candidate]:
    """Effects that begin at an instant and explain most of what a base fit leaves of the vertical force, at theirs.

    Args:
        signals: of the flight. excited: some of them, for the settings to try.
        left: of the vertical specific force, the residual (blocks,) and the base's columns (blocks, m).
    """
    residual, columns = left
    if not np.isfinite(residual).all() or len(residual) < 2:
        return []
    steps, sharp = (Steps.of(model.t_s, residual, columns, averaged_s) for averaged_s in (AVERAGED_S, 0.0))
    block_s = float(np.median(np.diff(model.t_s)))

    def share(effect: Effect, settings: Settings, steps: Steps = steps) -> float:
        effect = effect.of(settings)
        if effect.straight is None:
            return steps.explained(model.average(effect.wrench(signals, vehicle, settings)[:, UPWARDS, 0]))[0]
        how_hard, direction = effect.straight(signals, vehicle, settings)
        return steps.explained(model.average(how_hard * direction[UPWARDS]))[0]

    found: list[Candidate] = []
    for effect in library().values():
        if not effect.instants or not effect.applies(vehicle):
            continue
        for tried in _by_place(effect.variants(excited, vehicle), effect.instants).values():
            best = max(tried, key=lambda settings: share(effect, settings))
            if share(effect, best) < 0.5 * SHARE:
                continue
            while best["within_s"] > 2.0 * AVERAGED_S:
                best = max(effect.finer(best), key=lambda settings: share(effect, settings))
            if share(effect, best) <= SHARE:
                continue
            while best["within_s"] > block_s:
                best = max(effect.finer(best), key=lambda settings: share(effect, settings, sharp))
            found.append(Candidate(effect.of(best), best))
    return found


def _by_place(variants: Sequence[Settings], instants: Sequence[str]) -> Mapping[object, list[Settings]]:
    """Settings that differ in their instants alone, together."""
    out: dict[object, list[Settings]] = {}
    for settings in variants:
        key = tuple(sorted((n, v) for n, v in settings.items() if n not in instants))
        out.setdefault(key, []).append(settings)
    return out
