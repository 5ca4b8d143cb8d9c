"""What the findings are, what is left beside them, and what they are worth on data that no estimate saw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.adoption import why_not
from groundstation.diagnosis.attribution import Named
from groundstation.diagnosis.case import Case
from groundstation.diagnosis.columns import Solution
from groundstation.diagnosis.comparison import (
    as_declared,
    base_parameters,
    held_out_errors,
    plain_gain,
    residual_series,
    splits_of,
    with_plain,
)
from groundstation.diagnosis.curve import with_exponent
from groundstation.diagnosis.forecast import forecast
from groundstation.diagnosis.form_error import form_covariance
from groundstation.diagnosis.proposal import with_proposals
from groundstation.diagnosis.results import Finding, Unexplained, Verdict
from groundstation.diagnosis.scale import scale_findings
from groundstation.diagnosis.screen import Dependence, unexplained
from groundstation.diagnosis.selection import Final, Progress, Selected
from groundstation.diagnosis.sentences import filled
from groundstation.diagnosis.timing import lag_findings
from groundstation.identification.results import Estimate

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Judged:
    """Findings and their worth.

    Attributes:
        findings: in order of the error they take away.
        unexplained: what is left, by channel.
        error: on data no estimate saw, by stage and channel or quantity.
        before, after: base parameters with the findings left out and put in.
        left_open: covariance (p, p) that the findings' formulas, and explanations beside them, leave open in the joint
            estimate.
        worse: the sentence that says what the findings predict worse; empty where they do not.
        residual: of the first flight over time, by channel.
    """

    findings: tuple[Finding, ...]
    unexplained: tuple[Unexplained, ...]
    error: Mapping[str, dict[str, float]]
    before: dict[str, Estimate]
    after: dict[str, Estimate]
    left_open: Array
    worse: str
    notes: tuple[str, ...]
    residual: dict[str, Array]

    @property
    def verdict(self) -> Verdict:
        """``clean``, ``explained`` or ``unexplained``."""
        if self.unexplained or self.worse:
            return "unexplained"
        return "explained" if self.findings else "clean"


def judge(
    case: Case,
    selected: Selected,
    final: Final,
    kinematic: Sequence[Finding],
    exponent_departure: float,
    left: Sequence[Dependence],
    progress: Progress,
) -> Judged:
    """Judge a selection.

    Args:
        case: its flights at the evidence's rate. selected: effects about the last base. final: their joint estimate.
        kinematic: findings of the sensors. left: what the residual still depends on.
        exponent_departure: of the thrust curve that all was estimated about from the declared one.
    """
    evidence, baseline, chosen = selected.evidence, selected.baseline, selected.chosen
    left_open = form_covariance(evidence, chosen, final.solution) + selected.left_open()
    spread = final.solution.covariance + left_open
    published = replace(final.solution, covariance=spread)
    lag = [] if case.healthy else lag_findings(evidence, final.solution, spread)
    plain = as_declared(evidence, case.vehicle) if lag or exponent_departure else None
    forces = with_exponent(force_findings(selected, published), exponent_departure, plain_gain(evidence, chosen, plain))
    before, after = base_parameters(final.evidence, case.vehicle, final.baseline, final.chosen, plain, left_open)
    findings = sorted([*lag, *forces, *kinematic, *scale_findings(case.vehicle, after)], key=lambda f: -f.gain)
    splits = splits_of(evidence, case.unseen)
    halves = splits if case.unseen else splits_of(evidence, (), 2)
    remaining = with_proposals(
        evidence, chosen, unexplained(left), lambda more: held_out_errors(evidence, chosen, list(more), splits)
    )
    if plain is not None:
        splits, halves = (with_plain(each, evidence, case.vehicle, plain) for each in (splits, halves))
    error = held_out_errors(evidence, baseline, chosen, splits)
    progress(0.95, "predicting what no estimate saw")
    ahead, notes = forecast(evidence, baseline, chosen, splits, halves)
    return Judged(
        findings=tuple(findings),
        unexplained=remaining,
        error=error | ahead,
        before=before,
        after=after,
        left_open=left_open,
        worse=why_not(ahead) if findings else "",
        notes=notes,
        residual=residual_series(evidence, baseline, chosen, plain),
    )


def force_findings(selected: Selected, published: Solution) -> list[Finding]:
    """The named effects as findings, with the values of the joint estimate and the covariance that is published."""
    offset = sum(len(candidate.effect.parameters) for candidate, _ in selected.baseline)
    out: list[Finding] = []
    for item in selected.named:
        out.append(item.measured or _finding(item, published, offset))
        offset += len(item.candidate.effect.parameters)
    return out


def _finding(item: Named, solution: Solution, offset: int) -> Finding:
    """One named effect whose parameters stand at ``offset`` behind the base's."""
    effect, settings = item.candidate.effect, dict(item.candidate.settings)
    values, covariance = solution.part(offset, len(effect.parameters))
    std = np.sqrt(np.diag(covariance))
    rotor = int(settings.pop("rotor")) if effect.of_one_rotor else None
    own = list(zip(effect.parameters, values, std, strict=True))
    parameters = {p.name: Estimate.normal(v, float(np.hypot(s, p.form * v))) for p, v, s in own if not p.changes}
    spread = effect.spread(settings, float(values[0]))
    parameters |= {n: Estimate.normal(v, spread.get(n, 0.0)) for n, v in settings.items()}
    for p, v, s in own:
        if p.changes:
            value = settings[p.changes] + v / values[0]
            parameters[p.changes] = Estimate.normal(value, float(np.hypot(s / values[0], p.form * value)))
    known = {name: estimate.value for name, estimate in parameters.items()}
    return Finding(
        effect=effect.identifier,
        parameters=parameters,
        sentence=filled(effect.sentence, **known, rotor=str(rotor)),
        confidence=item.confidence,
        alternatives=item.alternatives,
        rotor=rotor,
        gain=item.gain,
    )
