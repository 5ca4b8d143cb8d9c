"""Nothing that no vehicle has is published of a diagnosis: what its joint estimate gives is held against the frame's
geometry and the rigid body, as an identification's numbers are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from groundstation.diagnosis.results import Diagnosis
from groundstation.identification.consistency import nearest_values, physically_consistent
from groundstation.identification.physical_limits import outside
from groundstation.identification.results import MASS_AND_TENSOR, Estimate
from groundstation.vehicle import Vehicle

NARROWEST = 1e-4
"""Spread of a number that is given and not estimated, as a share of mass or trace, for the distance to a rigid body."""


def possible(found: Diagnosis, vehicle: Vehicle) -> Diagnosis:
    """The same without what the vehicle cannot hold, and with the nearest rigid body where the estimate is none."""
    return _of_a_rigid_body(_within_limits(found, vehicle))


def _within_limits(found: Diagnosis, vehicle: Vehicle) -> Diagnosis:
    """Without numbers outside the geometry. A finding with such a number is none, and what was estimated beside it is
    not put in.
    """
    impossible = outside(vehicle, found.parameters_after, found.parameters_after)
    kept, told = list(found.findings), [f"{name}: {text}." for name, text in impossible.items()]
    for finding in found.findings:
        wrong = outside(vehicle, {}, finding.parameters)
        if wrong:
            kept.remove(finding)
            told += [f"{finding.effect}: {text}." for text in dict.fromkeys(wrong.values())]
    if not told:
        return found
    return replace(
        found,
        findings=tuple(kept),
        parameters_after=_without(found.parameters_after, impossible),
        verdict="unexplained" if found.verdict in ("clean", "explained") else found.verdict,
        adopted=found.adopted and len(kept) == len(found.findings),
        warnings=(*found.warnings, *told),
    )


def _without(parameters: Mapping[str, Estimate], names: Mapping[str, str]) -> dict[str, Estimate]:
    return {name: estimate for name, estimate in parameters.items() if name not in names}


def _of_a_rigid_body(found: Diagnosis) -> Diagnosis:
    trouble = physically_consistent(found.parameters_after)
    if not trouble or found.covariance_after is None:
        return found
    measured = np.array([found.parameters_after[name].value for name in MASS_AND_TENSOR])
    trace = float(np.abs(measured[[1, 4, 6]]).sum())
    fixed = NARROWEST * np.array([abs(measured[0]), *[trace] * 6])  # a mass that was weighed has no spread
    values, away = nearest_values(measured, found.covariance_after + np.diag(fixed**2))
    nearest = {
        name: Estimate.normal(float(value), found.parameters_after[name].std)
        for name, value in zip(MASS_AND_TENSOR, values, strict=True)
    }
    warning = (
        f"The estimate with the findings belongs to no rigid body ({trouble}): the nearest that does, {away:.1f} "
        "standard deviations away, is given."
    )
    return replace(
        found,
        parameters_after={**found.parameters_after, **nearest},
        warnings=(*found.warnings, warning),
    )
