r"""What explanations that nobody named leave open in mass and tensor: part of the interval that no noise tells.

Beside the chosen effects others may beat chance and be named by nobody: they explain less than the formulas of what was named may
miss (:mod:`.discrepancy`), or help on no data that was not fitted. And a formula may be wrong in a way of its own: with the speed, the
thrust or the rates. The strongest of these is estimated along, then the strongest beside it, and so on while one beats chance. On the
way from what is named to what would explain everything the base moves by :math:`b_1, b_2, \dots`. How far along it the truth lies the
data do not say; each stage counts by the evidence :math:`W_k` that it adds (the variance between models of Bayesian model averaging;
Hoeting, Madigan, Raftery, Volinsky 1999):

.. math:: \Sigma_o = \sum_k W_k b_k b_k^T / \sum_k W_k

Nothing is left open where nothing beats chance: a clean flight's intervals stay as sharp as its noise allows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.effect import ParameterInfo, Settings
from groundstation.diagnosis.evidence import Candidate, Columns, Evidence, Solution
from groundstation.diagnosis.rivals import Entry, kind_of, plausible
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.model.parameters import RIGID_BODY
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]



def _relative(size: Array) -> Array:
    return np.asarray(size / (float(np.sqrt(np.mean(size**2))) or 1.0), dtype=float)


MODES: dict[str, Callable[[Signals], Array]] = {
    "speed": lambda s: _relative(np.linalg.norm(s.velocity_world_m_s, axis=1)),
    "thrust": lambda s: _relative(s.thrust_n.sum(axis=1)),
    "rates": lambda s: _relative(np.linalg.norm(s.rate_rad_s, axis=1)),
}
"""What a formula may be wrong with."""


def left_open(
    evidence: Evidence, chosen: Sequence[Entry], pool: Sequence[Entry], threshold: Callable[[Candidate, Columns], float]
) -> Array:
    """Covariance (7, 7), in the order of RIGID_BODY, that explanations beside the chosen leave open.

    Args:
        chosen: everything of the joint estimate.
        pool: what else could be there.
        threshold: Wald statistic that chance passes too rarely to be it.
    """
    index = [evidence.names.index(name) for name in RIGID_BODY]
    named = evidence.solve(chosen)
    choice = [*pool, *_misshapen(evidence, chosen, named)]
    beside, total, spread = list(chosen), 0.0, np.zeros((len(index), len(index)))
    for _ in range(THRESHOLDS.effects_most):
        margin, entry = _strongest(evidence, beside, choice, threshold)
        if entry is None:
            break
        beside.append(entry)
        moved = evidence.solve(beside).theta[index] - named.theta[index]
        total += margin
        spread += margin * np.outer(moved, moved)
    return spread / total if total > 0.0 else spread


def _strongest(
    evidence: Evidence,
    beside: Sequence[Entry],
    choice: Sequence[Entry],
    threshold: Callable[[Candidate, Columns], float],
) -> tuple[float, Entry | None]:
    """The plausible entry that beats chance by most beside others, and by how much."""
    offset = sum(len(candidate.effect.parameters) for candidate, _ in beside)
    taken = {kind_of(entry) for entry in beside}
    best: tuple[float, Entry | None] = (0.0, None)
    for entry in choice:
        effect = entry[0].effect
        if kind_of(entry) in taken:
            continue
        found = evidence.solve([*beside, entry])
        margin = found.wald(offset, effect.telling()) - threshold(*entry)
        if margin > best[0] and plausible(entry[0], *found.part(offset, len(effect.parameters))):
            best = margin, entry
    return best


def _misshapen(evidence: Evidence, chosen: Sequence[Entry], solution: Solution) -> Iterator[Entry]:
    """Each chosen effect changed along with the speed, the thrust or the rates, by parameter, and by the axes it acts on."""
    first = 0
    for candidate, _ in chosen:
        count = len(candidate.effect.parameters)
        values = solution.part(first, count)[0]
        first += count
        for changed in _changes(candidate, values):
            columns = evidence.columns(changed)
            if columns is not None and np.all(np.any(columns.sensitivity != 0.0, axis=0)):
                yield changed, columns


def _changes(candidate: Candidate, values: Array) -> Iterator[Candidate]:
    for number, value in enumerate(values):
        own = np.zeros(len(values))
        own[number] = value
        name = candidate.effect.parameters[number].name
        for mode in MODES:
            yield _changed(candidate, own, f"{name} by {mode}", lambda s, w, mode=mode: w * MODES[mode](s)[:, None])
    for row in range(6):
        yield _changed(candidate, values, f"row {row}", lambda s, w, row=row: w * np.eye(6)[row])


def _changed(
    candidate: Candidate, values: Array, name: str, change: Callable[[Signals, Array], Array]
) -> Candidate:
    """The share by which an effect of these values may differ in a way of its own."""
    effect = candidate.effect

    def wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> Array:
        return change(signals, effect.wrench(signals, vehicle, settings) @ values)[:, :, None]

    share = ParameterInfo("share", lambda vehicle: 1.0)
    form = replace(effect, identifier=f"{effect.identifier}, {name}", parameters=(share,), wrench=wrench)
    return Candidate(form, candidate.settings)
