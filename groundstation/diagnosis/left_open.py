r"""What explanations that nobody named leave open in mass and tensor: part of the interval that no noise tells.

Beside the chosen effects others may beat chance and be named by nobody: they explain less than the formulas of what was
named may miss (:mod:`.discrepancy`), or help on no data that was not fitted. And a formula may be wrong in a way of its
own: with the speed, the height, the thrust or the rates. The strongest of these is estimated along, then the strongest
beside it, and so on while one beats chance. On the way from what is named to what would explain everything the base
moves by :math:`b_1, b_2, \dots`. How far along it the truth lies the data do not say; each stage counts by the evidence
:math:`W_k` that it adds (the variance between models of Bayesian model averaging; Hoeting, Madigan, Raftery, Volinsky
1999):

.. math:: \Sigma_o = \sum_k W_k b_k b_k^T / \sum_k W_k

A form of a named effect that does not beat chance may be there all the same, as far as the data allow: estimated along,
with the spread ``form_share`` that such forms have before a flight, it moves the base by :math:`b` and adds
:math:`\Delta` to its covariance. Forms are wrong independently of each other, so that :math:`b b^T + \Delta` is summed
over them.

Nothing is left open where nothing is named and nothing beats chance: a clean flight's intervals stay as sharp as its
noise allows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.columns import Candidate, Columns, Solution
from groundstation.diagnosis.effect import ParameterInfo, Settings
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.rivals import Entry, kind_of, plausible
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.model.parameters import RIGID_BODY
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]


def _relative(size: Array) -> Array:
    return np.asarray(size / (float(np.sqrt(np.mean(size**2))) or 1.0), dtype=float)


SOFT = 0.2
"""Of its RMS, below which a quantity that an effect is divided by counts as no smaller."""
QUANTITIES: Mapping[str, Callable[[Signals], Array]] = {
    "speed": lambda s: np.linalg.norm(s.velocity_world_m_s, axis=1),
    "height": lambda s: np.abs(s.position_m[:, 2]),
    "thrust": lambda s: s.thrust_n.sum(axis=1),
    "rates": lambda s: np.linalg.norm(s.rate_rad_s, axis=1),
}
"""What a formula may be wrong with: its power of each may be one more or one less."""


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
    forms = list(_misshapen(evidence, chosen, named))
    beside, total, spread = list(chosen), 0.0, np.zeros((len(index), len(index)))
    for _ in range(THRESHOLDS.effects_most):
        margin, entry = _strongest(evidence, beside, [*pool, *forms], threshold)
        if entry is None:
            break
        beside.append(entry)
        moved = evidence.solve(beside).theta[index] - named.theta[index]
        total += margin
        spread += margin * np.outer(moved, moved)
    shown = {kind_of(entry) for entry in beside}
    unseen = [_unseen(evidence, chosen, named, form, index) for form in forms if kind_of(form) not in shown]
    return sum(unseen, spread / total if total > 0.0 else spread)


def _unseen(evidence: Evidence, chosen: Sequence[Entry], named: Solution, form: Entry, index: list[int]) -> Array:
    """What a form that the data do not show leaves open, (7, 7), as far as they allow it."""
    found = evidence.solve([*chosen, form])
    moved = found.theta[index] - named.theta[index]
    more = found.covariance[np.ix_(index, index)] - named.covariance[np.ix_(index, index)]
    values, axes = np.linalg.eigh(0.5 * (more + more.T))
    return np.outer(moved, moved) + (axes * np.maximum(values, 0.0)) @ axes.T


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
    """Each chosen effect, by parameter, with one power more or less of each quantity; and on each of its axes alone."""
    first = 0
    for candidate, _ in chosen:
        count = len(candidate.effect.parameters)
        forms = _forms(candidate, solution.part(first, count)[0])
        first += count
        together = evidence.columns(forms)
        if together is None:
            continue
        for number, parameter in enumerate(forms.effect.parameters):
            own = slice(number, number + 1)
            columns = Columns(together.sensitivity[:, own], together.instrument[:, own], together.wrench_rms[:, own])
            if np.any(columns.sensitivity != 0.0) and np.any(columns.instrument != 0.0):
                name = f"{candidate.identifier}, {parameter.name}"
                effect = replace(forms.effect, identifier=name, parameters=(parameter,))
                yield Candidate(effect, candidate.settings), columns


def _forms(candidate: Candidate, values: Array) -> Candidate:
    """All the forms of one effect of these values, a parameter each: the share by which it takes that form."""
    effect = candidate.effect
    names = [f"{p.name} {way} {q}" for q in QUANTITIES for way in ("by", "over") for p in effect.parameters]

    def wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> Array:
        plain = effect.wrench(signals, vehicle, settings) * values
        sizes = [_relative(quantity(signals)) for quantity in QUANTITIES.values()]
        scales = [scale for size in sizes for scale in (size, 1.0 / (SOFT + size))]
        parts = [plain * np.where(np.isfinite(s).all(), s, 0.0)[:, None, None] for s in scales]
        return np.concatenate([*parts, plain.sum(axis=2)[:, :, None] * np.eye(6)], axis=2)

    shares = tuple(
        ParameterInfo(name, lambda vehicle: THRESHOLDS.form_share)
        for name in (*names, *(f"row {row}" for row in range(6)))
    )
    return Candidate(replace(effect, parameters=shares, wrench=wrench), candidate.settings)
