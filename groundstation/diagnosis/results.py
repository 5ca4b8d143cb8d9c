"""What a diagnosis yields: findings, what is left unexplained, and the error before and after."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.results import Estimate
from groundstation.json_types import JsonObject
from groundstation.tabular import Record, Tabular

Verdict = Literal["explained", "unexplained", "clean", "refused"]


@dataclass(frozen=True, slots=True)
class Finding:
    """An effect that the declared vehicle lacks (identifier of docs/diagnosis.md), with its parameters and a sentence
    for people, which documents call "evidence".

    ``gain`` is how far the whitened squared error falls with it: on blocks no estimate saw for forces and torques, in
    the comparison of the sensors for clocks and frames. Findings stand in its order.
    """

    effect: str
    parameters: Mapping[str, Estimate]
    sentence: str
    confidence: float
    alternatives: tuple[str, ...] = ()
    rotor: int | None = None
    gain: float = 0.0

    def to_dict(self) -> JsonObject:
        """JSON form of docs/formats.md."""
        return {
            "effect": self.effect,
            "parameters": {name: estimate.to_dict() for name, estimate in self.parameters.items()},
            "evidence": self.sentence,
            "confidence": self.confidence,
            "alternatives": list(self.alternatives),
            "rotor": self.rotor,
        }


@dataclass(frozen=True, slots=True)
class Unexplained:
    """Where a residual lives: channel, share of the channel's residual variance, and what it varies with."""

    channel: str
    share: float
    depends_on: tuple[str, ...] = ()
    proposal: str = ""

    def to_dict(self) -> JsonObject:
        """JSON form of docs/formats.md."""
        return {
            "channel": self.channel,
            "share": self.share,
            "depends_on": list(self.depends_on),
            "proposal": self.proposal,
        }


@dataclass(frozen=True, slots=True)
class WouldShow:
    """An effect that was not found, and the size from which on it would have been.

    Attributes:
        effect, parameter: what it is called; its size is this parameter, the effect's others zero.
        least: in the parameter's unit; of the rotor and the instant that show worst.
        share: root mean square of its force over weight, or of its torque over weight times arm, at that size.
    """

    effect: str
    parameter: str
    least: float
    share: float

    def to_dict(self) -> JsonObject:
        """JSON form of docs/formats.md."""
        return {"effect": self.effect, "parameter": self.parameter, "least": self.least, "share": self.share}


@dataclass(frozen=True, slots=True)
class Hint:
    """An effect that beats chance and is no finding yet.

    Attributes:
        effect, settings: what it is called, and in which settings it explains most.
        values: of its parameters, as they come out.
        evidence: Wald statistic; needed: from which one it could be a finding; beyond: by how much it beats chance.
    """

    effect: str
    settings: Mapping[str, float]
    values: Mapping[str, float]
    evidence: float
    needed: float
    beyond: float

    def to_dict(self) -> JsonObject:
        """JSON form of docs/formats.md."""
        return {
            "effect": self.effect,
            "settings": dict(self.settings),
            "values": dict(self.values),
            "evidence": self.evidence,
            "needed": self.needed,
        }


@dataclass(frozen=True, slots=True)
class Diagnosis(Tabular):
    """The result of ``diagnose``.

    Attributes:
        error: {"held_out": {"before": {channel: rms}, "after": {...}, "nominal": {...},
            "prediction_0.1_s_before": {quantity: rms}, ..., "simulation_before": {signal: rms}, "simulation_after":
            {...}}}.
        covariance_after: of mass and tensor with the findings put in, (7, 7) in the order of MASS_AND_TENSOR.
        by_flight: of several flights, each one's own mass, tensor and parameters of the findings; the anchor's error is
            left out.
        adopted: whether the findings are put into the estimate; not where they make the prediction worse.
        notes: what these errors are of, and which of them are left out, and why.
        residual: time series that the report draws: "t_s", each channel before, and "channel/after" with the findings.
        candidates: for each effect tried, its held-out gain and why it was kept or dropped.
        would_show: from what size on an effect that is not among the findings would be; only of flights with a plan.
        hints: effects that beat chance and are no findings yet, the likeliest first; only of flights with a plan.
        swing: "load_kg" and "length_m" of a load that a warning tells of and no finding does; empty without one.
    """

    flight: str
    vehicle: str
    verdict: Verdict
    findings: tuple[Finding, ...] = ()
    unexplained: tuple[Unexplained, ...] = ()
    error: Mapping[str, Mapping[str, Mapping[str, float]]] = field(
        default_factory=dict[str, Mapping[str, Mapping[str, float]]]
    )
    parameters_before: Mapping[str, Estimate] = field(default_factory=dict[str, Estimate])
    parameters_after: Mapping[str, Estimate] = field(default_factory=dict[str, Estimate])
    covariance_after: NDArray[np.float64] | None = None
    next_flight: str = ""
    reason: str = ""
    warnings: tuple[str, ...] = ()
    declarations: tuple[Mapping[str, Any], ...] = ()
    notes: tuple[str, ...] = ()
    candidates: tuple[Mapping[str, Any], ...] = ()
    adopted: bool = True
    by_flight: tuple[Mapping[str, Estimate], ...] = ()
    residual: Mapping[str, NDArray[np.float64]] = field(default_factory=dict[str, NDArray[np.float64]])
    would_show: tuple[WouldShow, ...] = ()
    hints: tuple[Hint, ...] = ()
    swing: Mapping[str, float] = field(default_factory=dict[str, float])

    def records(self) -> list[Record]:
        """One row per parameter of each finding, with its 95 % interval and the finding's confidence."""
        return [
            {
                "effect": finding.effect if finding.rotor is None else f"{finding.effect}, rotor {finding.rotor}",
                "parameter": name,
                "value": e.value,
                "std": e.std,
                "low": e.ci95[0],
                "high": e.ci95[1],
                "confidence": finding.confidence,
            }
            for finding in self.findings
            for name, e in finding.parameters.items()
        ]

    def _title(self) -> str:
        return f"{self.flight}: {self.verdict}" + (f". {self.reason}" if self.reason else "")

    def to_dict(self) -> JsonObject:
        """The document ``diagnose --json`` prints (docs/formats.md)."""
        return {
            "schema": "groundstation.diagnosis/1",
            "flight": self.flight,
            "vehicle": self.vehicle,
            "verdict": self.verdict,
            "findings": [finding.to_dict() for finding in self.findings],
            "unexplained": [item.to_dict() for item in self.unexplained],
            "error": {k: {stage: dict(v) for stage, v in stages.items()} for k, stages in self.error.items()},
            "parameters_before": {k: v.to_dict() for k, v in self.parameters_before.items()},
            "parameters_after": {k: v.to_dict() for k, v in self.parameters_after.items()},
            "by_flight": [{n: e.to_dict() for n, e in each.items()} for each in self.by_flight],
            "next_flight": self.next_flight,
            "reason": self.reason,
            "declarations": [dict(check) for check in self.declarations],
            "warnings": list(self.warnings),
            "notes": list(self.notes),
            "adopted": self.adopted,
            "candidates": [dict(c) for c in self.candidates],
            "would_show": [each.to_dict() for each in self.would_show],
            "hints": [each.to_dict() for each in self.hints],
            "swing": dict(self.swing),
        }
