r"""What explanations that nobody named leave open in a joint estimate: part of the intervals that no noise tells.

Beside the chosen effects others may beat chance and be named by nobody: they explain less than the formulas of what was
named may miss (:mod:`.discrepancy`), or help on no data that was not fitted. And a formula may be wrong in a way of its
own: with the speed, the height, the thrust or the rates. The strongest of these is estimated along, then the strongest
beside it, and so on while one beats chance. On the way from what is named to what would explain everything the estimate
moves by :math:`b_1, b_2, \dots`. How far along it the truth lies the data do not say; each stage counts by the evidence
:math:`W_k` that it adds (the variance between models of Bayesian model averaging; Hoeting, Madigan, Raftery, Volinsky
1999):

.. math:: \Sigma_o = \sum_k W_k b_k b_k^T / \sum_k W_k

A form of a named effect that does not beat chance may be there all the same, as far as the data allow: estimated along,
with the spread ``form_share`` that such forms have before a flight (or the effect's own, where its law is better known:
:attr:`.ParameterInfo.form`), it moves the estimate by :math:`b` and adds
:math:`\Delta` to its covariance. Forms are wrong independently of each other, so that :math:`b b^T + \Delta` is summed
over them.

A form has a part in the shape of its own effect: a drag with the square of the speed is, on one flight, mostly a drag
with the speed, of another size. That part counts for the effect's own parameters, whose value is the size that the
effect has on this flight.

Nothing is left open where nothing is named and nothing beats chance: a clean flight's intervals stay as sharp as its
noise allows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.beside import beside
from groundstation.diagnosis.columns import Candidate, Columns, Solution
from groundstation.diagnosis.effect import Effect, Followed, ParameterInfo, Settings
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.rivals import Entry, kind_of
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]


Change = Callable[[Signals], Callable[[Signals, Array], Array]]
"""From the signals of a flight to what makes of those of a part and of a wrench (k, 6, p) there another one."""

SOFT = 0.2
"""Of its RMS, below which a quantity that an effect is divided by counts as no smaller. Far above it the quotient is
that of the quantity itself: one by a sum with SOFT would be short by a constant, which is what moves a mass.
"""
QUANTITIES: Mapping[str, Callable[[Signals], Array]] = {
    "speed": lambda s: np.linalg.norm(s.velocity_world_m_s, axis=1),
    "level speed": lambda s: np.linalg.norm(s.velocity_body_m_s()[:, :2], axis=1),
    "height": lambda s: np.abs(s.position_m[:, 2]),
    "thrust": lambda s: s.thrust_n.sum(axis=1),
    "rates": lambda s: np.linalg.norm(s.rate_rad_s, axis=1),
}
"""What a formula may be wrong with: its power of each may be one more or one less. A body feels its speed, a rotor the
part of it in the rotor's plane.
"""


@dataclass(frozen=True, slots=True)
class _Beside:
    """What may be there beside the chosen.

    Attributes:
        shape: (p, count), what one of its parameters is in each of the joint estimate's: its part in the shape of its
            own effect; zero for what is no form of a chosen effect.
    """

    entry: Entry
    shape: Array


def left_open(
    evidence: Evidence, chosen: Sequence[Entry], pool: Sequence[Entry], threshold: Callable[[Candidate, Columns], float]
) -> Array:
    """Covariance (p, p), in the order of the joint estimate with the chosen, that explanations beside them leave open.

    Args:
        chosen: everything of the joint estimate.
        pool: what else could be there.
        threshold: Wald statistic that chance passes too rarely to be it.
    """
    named = evidence.solve(chosen)
    size = len(named.theta)
    forms = list(_misshapen(evidence, chosen, named))
    choice = [*(_Beside(entry, np.zeros((size, len(entry[0].effect.parameters)))) for entry in pool), *forms]
    along: list[_Beside] = []
    total, spread = 0.0, np.zeros((size, size))
    for _ in range(THRESHOLDS.effects_most):
        taken = [*chosen, *(each.entry for each in along)]
        margins = _margins(evidence, taken, [each.entry for each in choice], threshold)
        best = int(np.argmax(margins)) if margins else -1
        if best < 0 or margins[best] <= 0.0:
            break
        along.append(choice[best])
        moved = _seen_by(evidence, chosen, named, along)[0]
        total += margins[best]
        spread += margins[best] * np.outer(moved, moved)
        choice = [each for each, margin in zip(choice, margins, strict=True) if margin > 0.0]
    shown = {kind_of(entry) for entry in (*chosen, *(each.entry for each in along))}
    unseen = [_unseen(evidence, chosen, named, form) for form in forms if kind_of(form.entry) not in shown]
    return sum(unseen, spread / total if total > 0.0 else spread)


def _seen_by(
    evidence: Evidence, chosen: Sequence[Entry], named: Solution, along: Sequence[_Beside]
) -> tuple[Array, Array]:
    """How far the joint estimate moves (p,) where others are estimated along, and its covariance (p, p) then."""
    found = evidence.solve([*chosen, *(each.entry for each in along)])
    parts = np.concatenate([np.eye(len(named.theta)), *(each.shape for each in along)], axis=1)
    return parts @ found.theta - named.theta, parts @ found.covariance @ parts.T


def _unseen(evidence: Evidence, chosen: Sequence[Entry], named: Solution, form: _Beside) -> Array:
    """What a form that the data do not show leaves open, (p, p), as far as they allow it."""
    moved, covariance = _seen_by(evidence, chosen, named, [form])
    return np.outer(moved, moved) + _positive(covariance - named.covariance)


def _positive(matrix: Array) -> Array:
    """The part of a symmetric matrix that is a covariance, parameters in units of their own."""
    scale = np.sqrt(np.abs(np.diag(matrix)))
    scale[scale == 0.0] = 1.0
    values, axes = np.linalg.eigh(0.5 * (matrix + matrix.T) / np.outer(scale, scale))
    positive: Array = (axes * np.maximum(values, 0.0)) @ axes.T
    return positive * np.outer(scale, scale)


def _margins(
    evidence: Evidence,
    chosen: Sequence[Entry],
    choice: Sequence[Entry],
    threshold: Callable[[Candidate, Columns], float],
) -> list[float]:
    """By how much each entry beats chance beside others; nothing where it is among them or implausible."""
    taken = {kind_of(entry) for entry in chosen}
    out = [0.0] * len(choice)
    open_ones = [index for index, entry in enumerate(choice) if kind_of(entry) not in taken]
    for found in beside(evidence, chosen, [choice[index] for index in open_ones]):
        for place, wald, right in zip(found.index, found.walds(), found.plausible(), strict=True):
            margin = float(wald) - threshold(*choice[open_ones[place]])
            out[open_ones[place]] = margin if right and margin > 0.0 else 0.0
    return out


def _misshapen(evidence: Evidence, chosen: Sequence[Entry], solution: Solution) -> Iterator[_Beside]:
    """Each chosen effect, by parameter, with one power more or less of each quantity; and on each of its axes alone."""
    first = 0
    for candidate, columns in chosen:
        count = len(candidate.effect.parameters)
        values = solution.part(first, count)[0]
        own = slice(solution.base + first, solution.base + first + count)
        first += count
        for entry in forms_of(evidence, candidate, values):
            shape = np.zeros((len(solution.theta), 1))
            shape[own] = _in_shape(entry[1].sensitivity, columns.sensitivity)
            yield _Beside(entry, shape)


def forms_of(evidence: Evidence, candidate: Candidate, values: Array) -> Iterator[Entry]:
    """The forms of one effect of these values, each with one parameter: the share by which it takes it."""
    forms = list(_forms(candidate, values))
    for each, together in zip(forms, evidence.columns_of(forms), strict=True):
        if together is not None:
            yield from _one_by_one(evidence, each, together)


def _in_shape(form: Array, own: Array) -> Array:
    """What a form (rows, 1) is of its effect's own columns (rows, count), in the least squares sense, (count, 1)."""
    scale = np.linalg.norm(own, axis=0) + 1e-30
    found = np.asarray(np.linalg.lstsq(own / scale, form, rcond=1e-8)[0], dtype=np.float64)
    return found / scale[:, None]


def _one_by_one(evidence: Evidence, forms: Candidate, together: Columns) -> Iterator[Entry]:
    """A candidate of several parameters as one for each, without those that do nothing."""
    for number, parameter in enumerate(forms.effect.parameters):
        own = slice(number, number + 1)
        if np.any(together.sensitivity[:, own] != 0.0) and np.any(together.instrument[:, own] != 0.0):
            effect = replace(forms.effect, identifier=parameter.name, parameters=(parameter,))
            yield Candidate(effect, forms.settings), evidence.part(together, own)


def _forms(candidate: Candidate, values: Array) -> Iterator[Candidate]:
    """Forms of an effect of these values; a parameter is the share by which it takes one."""
    names = candidate.effect.names()
    for name, quantity in QUANTITIES.items():
        yield _changed(candidate, [f"{n} by {name}" for n in names], _scaled(quantity, values, over=False))
        yield _changed(candidate, [f"{n} over {name}" for n in names], _scaled(quantity, values, over=True))
    rows = [f"row {row}" for row in range(6)]
    yield _changed(candidate, rows, lambda whole: lambda signals, wrench: (wrench @ values)[:, :, None] * np.eye(6))


def _scaled(quantity: Callable[[Signals], Array], values: Array, *, over: bool) -> Change:
    def change(whole: Signals) -> Callable[[Signals, Array], Array]:
        typical = float(np.sqrt(np.mean(quantity(whole) ** 2, dtype=float))) or 1.0

        def changed(signals: Signals, wrench: Array) -> Array:
            size = quantity(signals) / typical
            return wrench * values * (1.0 / np.hypot(SOFT, size) if over else size)[:, None, None]

        return changed

    return change


def _changed(candidate: Candidate, names: Sequence[str], change: Change) -> Candidate:
    effect = candidate.effect
    spread = effect.parameters[0].form or THRESHOLDS.form_share
    shares = tuple(ParameterInfo(f"{effect.identifier}, {name}", lambda vehicle: spread) for name in names)

    def wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> Array:
        return change(signals)(signals, effect.wrench(signals, vehicle, settings))

    form = replace(
        effect,
        parameters=shares,
        wrench=wrench,
        straight=None,
        instrument=None,
        pointwise=False,
        followed=_followed(effect, change),
    )
    return Candidate(form, candidate.settings)


def _followed(
    effect: Effect, change: Change
) -> Callable[[Signals, Signals | None, Vehicle, Sequence[Settings], bool], Followed] | None:
    """A changed effect in a part of a flight; None where the effect itself needs the whole."""
    if not effect.pointwise and effect.followed is None:
        return None

    def along(whole: Signals, vehicle: Vehicle, settings: Settings) -> Callable[[Signals], Array]:
        changed = change(whole)
        if effect.followed is None:
            return lambda now: changed(now, effect.wrench(now, vehicle, settings))
        own = effect.followed(whole, None, vehicle, [settings], False)
        return lambda now: changed(now, own(now, None)[0])

    def followed(
        signals: Signals, planned: Signals | None, vehicle: Vehicle, several: Sequence[Settings], alone: bool
    ) -> Followed:
        seen = along(signals, vehicle, several[0])
        asked = None if planned is None else along(planned, vehicle, several[0])
        return lambda now, ahead: [seen(now), *([] if asked is None or ahead is None else [asked(ahead)])]

    return followed
