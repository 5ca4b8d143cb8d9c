"""The one estimate of a flight: what every place shows, with the findings put in.

Estimates without them stand in the methods table alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot, sqrt
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.results import MASS_AND_TENSOR, Estimate, Identification
from groundstation.json_types import Document, JsonObject

if TYPE_CHECKING:  # the diagnosis is heavy to import, and only its type is needed
    from groundstation.diagnosis.results import Diagnosis

FITTED = frozenset({"motor_lag", "input_delay"})
"""Findings whose parameters are the model's own."""
MOST_SHARE = 0.99
HALF_95 = 1.959964


@dataclass(frozen=True, slots=True)
class Canonical:
    """The estimate.

    Attributes:
        parameters: mass, tensor and the rest of the model.
        source: the method, and "+ findings" where they are put in.
        correlation: of mass and tensor, (7, 7) in the order of MASS_AND_TENSOR; None where the method gives none.
        note: what the numbers ask to be read with, in a sentence; empty where there is nothing.
    """

    parameters: Mapping[str, Estimate]
    source: str
    note: str = ""
    correlation: NDArray[np.float64] | None = None

    def to_dict(self) -> JsonObject:
        """The block ``estimate`` of identification.json."""
        values = {name: estimate.to_dict() for name, estimate in self.parameters.items()}
        return {"source": self.source, "note": self.note, "parameters": values} | self.joint()

    def joint(self) -> JsonObject:
        """The block ``joint``: covariance and correlation of mass and tensor, and the names of their rows; empty where
        there is none.
        """
        if self.correlation is None:
            return {}
        kept = [i for i, name in enumerate(MASS_AND_TENSOR) if name in self.parameters]
        names = [MASS_AND_TENSOR[i] for i in kept]
        std = np.array([self.parameters[name].std for name in names])
        correlation = self.correlation[np.ix_(kept, kept)]
        covariance = correlation * np.outer(std, std)
        return {"joint": {"names": names, "covariance": covariance.tolist(), "correlation": correlation.tolist()}}


def canonical(identification: Identification, diagnosis: Diagnosis | None = None) -> Canonical:
    """The estimate of the best method; after a diagnosis, with its findings put in where they were adopted.

    What the flight does not reveal stays hidden. Where a residual remains that nothing explains, or findings are not
    put in, the intervals are widened: by what the residual adds to the noise they were made of (Birge 1932), and to
    hold the estimates with the findings and without.
    """
    best = identification.methods.get(identification.best)
    own = dict(best.parameters if best else {}) | dict(identification.model)
    if diagnosis is None or diagnosis.verdict == "refused":
        return Canonical(own, identification.best, correlation=correlated(best.covariance if best else None))
    found = dict(own)
    covariance = best.covariance if best else None
    source, notes, aside = identification.best, [], own
    if diagnosis.findings and diagnosis.adopted:
        found |= {n: e for n, e in diagnosis.parameters_after.items() if n not in identification.not_identifiable}
        for finding in diagnosis.findings:
            if finding.effect in FITTED:
                found |= {name: e for name, e in finding.parameters.items() if name in own}
        source, covariance = f"{identification.best} + findings", diagnosis.covariance_after
    elif diagnosis.findings:
        aside = diagnosis.parameters_after
        notes.append("The findings make the prediction worse and are not put in; the intervals hold both.")
    if diagnosis.unexplained or aside is not own:
        found = {name: _widened(estimate, aside.get(name), diagnosis) for name, estimate in found.items()}
    if diagnosis.unexplained:
        notes.append(
            "A residual remains that nothing explains: the intervals are widened, and may still not hold the truth."
        )
    return Canonical(found, source, " ".join(notes), correlated(covariance))


def correlated(covariance: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
    """The correlation of a covariance; what has no spread, or an infinite one, is correlated with nothing."""
    if covariance is None:
        return None
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    known = np.isfinite(std) & (std > 0.0)
    out = np.eye(len(std))
    index = np.ix_(known, known)
    out[index] = np.clip(covariance[index] / np.outer(std[known], std[known]), -1.0, 1.0)
    return out


def _widened(estimate: Estimate, other: Estimate | None, diagnosis: Diagnosis) -> Estimate:
    share = min(max((item.share for item in diagnosis.unexplained), default=0.0), MOST_SHARE)
    moved = 0.0 if other is None else abs(estimate.value - other.value)
    return Estimate.normal(estimate.value, hypot(estimate.std / sqrt(1.0 - share), moved / HALF_95))


def estimate_in(document: Document) -> tuple[str, Document]:
    """Source and parameters of the estimate in an identification's document; of one written before there was the block,
    its best method.
    """
    block = document.get("estimate")
    if block:
        return str(block["source"]), block["parameters"]
    best = document["best"]
    own = document.get("methods", {}).get(best, {}).get("parameters", {})
    return str(best), {**document.get("model", {}), **own}


def estimate_of(entry: Document | None) -> Estimate | None:
    """An estimate of a document's entry; None where it holds no number."""
    if not entry or entry.get("value") is None or entry.get("std") is None:
        return None
    normal = Estimate.normal(entry["value"], entry["std"])
    low, high = entry.get("ci95") or normal.ci95
    return Estimate(normal.value, normal.std, (low, high))
