"""One rotor that gives less thrust than declared: what an identification that knows of none puts into the mass.

A weak rotor looks like an offset of the centre of mass and a steady torque about yaw, and a fit that has both free
leaves nothing. What tells them apart is that the lost thrust goes with the thrust of that rotor and not of all: the
same joint estimate through the plan that a diagnosis makes (:mod:`.evidence`), of one rotor beside an offset, a steady
wrench, another thrust curve and the torques that bend a tensor.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.base import for_evidence
from groundstation.diagnosis.columns import Candidate
from groundstation.diagnosis.effect import bending, has_rotors, library
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.flight_evidence import FlightEvidence
from groundstation.diagnosis.linearisation import linearisation
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.identification.dynamic_fit import DynamicFit
from groundstation.identification.results import MASS_AND_TENSOR, Estimate
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class WeakRotor:
    """A rotor (from 1), the share of its thrust that it lacks with its standard deviation, and of how many rotors it is
    one.
    """

    rotor: int
    loss: float
    std: float
    of: int

    @property
    def share(self) -> float:
        """Of the thrust of all rotors."""
        return self.loss / self.of

    def sentence(self) -> str:
        """The warning of an identification."""
        return (
            f"Rotor {self.rotor} seems to give {self.loss:.1%} +- {self.std:.1%} less thrust than declared. A fit of "
            "healthy rotors takes that for an offset of the centre of mass and for mass and moments that are up to "
            f"{self.share:.1%} too large; intervals hold that where the declared thrust tells them. Run `groundstation "
            "diagnose`, which tells a weak rotor from other causes and corrects the numbers."
        )


def weakest_rotor(fitted: DynamicFit) -> WeakRotor | None:
    """The rotor that stands out in the liveliest part of the first flight; None without a plan, which alone is free of
    feedback, or where none does.
    """
    flight = fitted.prepared[0]
    vehicle = flight.record.vehicle
    if fitted.instrumental is None or not has_rotors(vehicle):
        return None
    effects, count = library(), vehicle.rotors.count
    steady = [effects[name] for name in ("com_offset", "constant_wrench", "thrust_curve")]
    beside = [Candidate(effect, {}) for effect in (*steady, *bending()) if effect.applies(vehicle)]
    rotors = [Candidate(effects["weak_rotor"], {"rotor": float(rotor)}) for rotor in range(1, count + 1)]
    part, about = for_evidence(flight.liveliest()), linearisation(fitted)
    evidence = Evidence([FlightEvidence(part, about, fitted.options, (*beside, *rotors), generic=False)])
    columns = evidence.columns_of([*beside, *rotors])
    known = [(c, own) for c, own in zip(beside, columns[: len(beside)], strict=True) if own is not None]
    first = sum(len(candidate.effect.parameters) for candidate, _ in known)
    found: list[WeakRotor] = []
    for number, (candidate, own) in enumerate(zip(rotors, columns[len(beside) :], strict=True), 1):
        if own is not None:
            values, covariance = evidence.solve([*known, (candidate, own)]).part(first, 1)
            found.append(WeakRotor(number, float(values[0]), float(np.sqrt(covariance[0, 0])), count))
    best = max(found, key=lambda each: each.loss / each.std, default=None)
    if best is None or best.loss < max(THRESHOLDS.worn_loss, THRESHOLDS.worn_std * best.std):
        return None
    return best


def widened(
    parameters: Mapping[str, Estimate], covariance: Array | None, share: float, vehicle: Vehicle
) -> tuple[dict[str, Estimate], Array | None]:
    """Estimates and their covariance with a common factor of the thrust open by ``share``, which mass and moments
    follow; all as they are where the mass was weighed.
    """
    if vehicle.identification.anchor == "mass":
        return dict(parameters), covariance
    own = {name: e for name, e in parameters.items() if name in MASS_AND_TENSOR}
    wider = {name: Estimate.normal(e.value, float(np.hypot(e.std, share * e.value))) for name, e in own.items()}
    if covariance is not None:
        values = np.array([own[name].value if name in own else 0.0 for name in MASS_AND_TENSOR])
        covariance = covariance + share**2 * np.outer(values, values)
    return {**parameters, **wider}, covariance
