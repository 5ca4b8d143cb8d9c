"""Thrust and mass: whether the declared rotors carry the declared vehicle."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from groundstation.identification.declarations.check import Check
from groundstation.identification.declarations.signals import Flown
from groundstation.identification.results import Estimate
from groundstation.vehicle import Vehicle

PARTS = 6

DOUBTFUL = 1.15
"""A vehicle is weighed, and its thrust taken from a bench, to a few percent; 15 % off is worth a question before
anything else.
"""
WRONG = 1.5
"""No battery, payload or wear comes near: it is another vehicle, another constant or another unit."""
FAST_M_S = 4.0
"""About the speed of the air through hovering rotors: a rotor that moves as fast has a tenth to a third more thrust at
the same speed of turning (Leishman 2006, Principles of Helicopter Aerodynamics, 2.14), and constants from a bench no
longer tell the mass.
"""


def scale_checks(flown: Flown, vehicle: Vehicle) -> list[Check]:
    """Check "thrust": the declared thrust of all rotors over what the declared mass felt, in flight."""
    if flown.thrust is None or not np.any(flown.used):
        return []
    total = flown.thrust.sum(axis=1)[flown.used]
    gravity = vehicle.gravity_m_s2
    felt = np.full(len(total), gravity) if flown.force is None else flown.force[flown.used, 2]
    parts = [
        float(np.mean(t)) / (vehicle.mass_kg * float(np.mean(f)))
        for t, f in zip(np.array_split(total, PARTS), np.array_split(felt, PARTS), strict=True)
        if np.mean(f) > 0.3 * gravity
    ]
    tested = "Thrust of all rotors by the declared constants over declared mass times specific force"
    if len(parts) < 3:
        return [Check("thrust", tested, "the accelerometer felt no weight", "cannot tell")]
    ratio = float(np.mean(parts))
    if ratio <= 0.0:
        says = "The recorded rotor values make no thrust in flight: they are not what drove these rotors."
        return [Check("thrust", tested, f"{ratio:.3g}, where 1 is right", "contradicted", says)]
    spread = float(np.std(parts, ddof=1) / np.sqrt(len(parts)))
    evidence = f"{ratio:.3f} +- {spread:.3f}, where 1 is right"
    off = max(ratio, 1.0 / ratio)
    trusted = "thrust constant" if vehicle.identification.anchor == "thrust" else "mass"
    free = off < (DOUBTFUL if vehicle.identification.anchor == "thrust" else WRONG)
    if free or abs(ratio - 1.0) < 3.0 * spread:
        return [Check("thrust", tested, evidence, "agrees")]
    if off <= WRONG and (flown.speed_m_s or 0.0) > FAST_M_S:
        evidence += f" where it flies slowly; half of this flight is faster than {flown.speed_m_s:.1f} m/s"
        return [Check("thrust", tested, evidence, "cannot tell")]
    mass = vehicle.mass_kg * ratio
    line = [f"mass_kg = {mass:.4g}"]
    if vehicle.rotors.thrust_curve is not None:
        line.append(f"or thrust_curve = {[float(f'{c / ratio:.4g}') for c in vehicle.rotors.thrust_curve]}")
    else:
        line.append(f"or thrust_coefficient_n_s2 = {(vehicle.rotors.thrust_coefficient_n_s2 or 0.0) / ratio:.4g}")
    unit = _unit(float(np.sqrt(ratio)))
    says = (
        f"Is this the right vehicle? The declared rotors make {ratio:.2f} times the thrust that the declared mass "
        f"needs; the {trusted} is trusted, so the other follows it{unit}."
    )
    return [Check("thrust", tested, evidence, "contradicted" if off > WRONG else "doubtful", says, " ".join(line))]


THICKNESS = 1.02
"""A plate's largest moment is the sum of the other two; declared numbers are rounded to a percent or two."""


def tensor_checks(vehicle: Vehicle) -> list[Check]:
    """Check "tensor": whether any rigid body has the declared one. It says nothing where one has.

    No moment of a body exceeds the sum of the other two (the triangle inequality: Wensing, Kim and Slotine 2018, IEEE
    RA-L 3(1)).
    """
    moments = np.linalg.eigvalsh(vehicle.inertia_tensor())
    tested = "Principal moments of the declared tensor"
    evidence = ", ".join(f"{moment:.4g}" for moment in moments) + " kg m^2"
    if moments[0] > 0.0 and moments[2] <= THICKNESS * (moments[0] + moments[1]):
        return []
    why = "is not positive" if moments[0] <= 0.0 else "is larger than the other two together"
    which = "smallest" if moments[0] <= 0.0 else "largest"
    says = f"No rigid body has the declared tensor: its {which} principal moment {why}."
    line = (
        "[vehicle.inertia_kg_m2] with every moment below the sum of the other two; look for a unit, a swapped axis or "
        "a product's sign"
    )
    return [Check("tensor", tested, evidence, "doubtful", says, line)]


def _unit(speed: float) -> str:
    """A factor of rotor speed that a unit makes."""
    known = {1.0 / 6.2832: "turns per second", 9.5493: "rpm", 6.0: "electrical rad/s of 12 poles",
             7.0: "electrical rad/s of 14 poles", 1.0 / 9.5493: "rad/s divided by 9.55 twice"}  # fmt: skip
    for factor, name in known.items():
        if 0.93 < speed / factor < 1.07:
            return f"; rotor speeds in {name} would do that"
    return ""


def lag_doubts(found: Mapping[str, Estimate], vehicle: Vehicle) -> list[str]:
    """Sentences about declared lags of the rotors that are plainly not this vehicle's."""
    said: list[str] = []
    for name, key in (("rotor_lag_up_s", "up_s"), ("rotor_lag_down_s", "down_s")):
        declared, estimate = getattr(vehicle.rotors.lag, key), found.get(name)
        if estimate is None or declared <= 0.0:
            continue
        away = abs(estimate.value - declared)
        if away > (DOUBTFUL - 1.0) * declared and away > 3.0 * estimate.std:
            said.append(
                f"Is this the right vehicle? Its rotors lag by {1e3 * estimate.value:.0f} +- {1e3 * estimate.std:.0f} "
                f"ms ({key}), "
                f"where {1e3 * declared:.0f} ms are declared. Write: [rotors.lag] {key} = {estimate.value:.4g}"
            )
    return said
