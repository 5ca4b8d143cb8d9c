"""What a vehicle's geometry can hold: an estimate outside is evidence that something else is wrong, and is not
published.

A multirotor hovers only with its centre of mass inside the polygon of its rotors (the thrusts of a hover are positive
and balance about it). Its mass lies within twice the arm of its centre, so no moment exceeds m (2 arm)^2. A rotor that
gives none of its declared thrust, or three times as much, is another rotor, or its speeds, units or numbering are not
what is declared.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from groundstation.identification.results import Estimate
from groundstation.vehicle import Vehicle

THRUST_FACTOR = (0.0, 3.0)
"""Of the declared thrust: batteries, blades and height change it by a third; a factor of three is a wrong declaration.
"""
REACH = 2.0
"""Arms within which all of a vehicle's mass lies: rotors end at less than two."""
LONGEST_LAG_S = 1.0
"""No vehicle whose thrust takes longer to follow its command can be held in the air by attitude control."""
ELSE = (
    "; something else is wrong (rotor numbering, units, time stamps, or an effect the model lacks), so it is not "
    "published"
)


def outside(vehicle: Vehicle, parameters: Mapping[str, Estimate], model: Mapping[str, Estimate]) -> dict[str, str]:
    """Estimates that the vehicle's geometry cannot hold, each with the evidence in a sentence's end."""
    found = _moments(vehicle, parameters)
    mass = parameters.get("mass_kg")
    if mass is not None and mass.value <= 0.0:
        found["mass_kg"] = f"a mass of {mass.value:.4g} kg came out{ELSE}"
    for name, estimate in model.items():
        if (
            name.startswith(("rotor_lag_up", "rotor_lag_down", "input_delay"))
            and not 0.0 <= estimate.value < LONGEST_LAG_S
        ):
            found[name] = f"a lag of {estimate.value:.3g} s came out{ELSE}"
    return found | _centre(vehicle, model) | _thrust(vehicle, model)


def _moments(vehicle: Vehicle, parameters: Mapping[str, Estimate]) -> dict[str, str]:
    mass = parameters["mass_kg"].value if "mass_kg" in parameters else vehicle.mass_kg
    most = max(mass, vehicle.mass_kg) * (REACH * vehicle.arm_m()) ** 2
    found: dict[str, str] = {}
    for name in ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2"):
        if name in parameters and not 0.0 < parameters[name].value <= most:
            found[name] = (
                f"a moment of {parameters[name].value:.3g} kg m^2 came out, where this frame holds 0 to "
                f"{most:.3g}{ELSE}"
            )
    for name, (first, second) in {"ixy_kg_m2": "xy", "ixz_kg_m2": "xz", "iyz_kg_m2": "yz"}.items():
        pair = [parameters.get(f"i{axis}{axis}_kg_m2") for axis in (first, second)]
        limits = [most if p is None or p.value <= 0.0 else p.value for p in pair]
        if name in parameters and abs(parameters[name].value) > np.sqrt(limits[0] * limits[1]):
            found[name] = f"a product of {parameters[name].value:.3g} kg m^2 came out, more than its moments hold{ELSE}"
    return found


def _centre(vehicle: Vehicle, model: Mapping[str, Estimate]) -> dict[str, str]:
    """The offset of the centre of mass, where it lies outside the polygon of the rotors."""
    names = ("com_offset_x_m", "com_offset_y_m")
    if vehicle.rotors.input == "wrench" or not all(name in model for name in names):
        return {}
    point = np.array([model[name].value for name in names])
    if inside_polygon(point, np.asarray(vehicle.rotors.position_m, dtype=float)[:, :2]):
        return {}
    text = (
        f"a centre of mass at ({1e3 * point[0]:.0f}, {1e3 * point[1]:.0f}) mm came out, outside the rotors, where "
        f"nothing hovers{ELSE}"
    )
    return dict.fromkeys(names, text)


def inside_polygon(point: np.ndarray, corners: np.ndarray) -> bool:
    """Whether a point (2,) lies in the convex hull of corners (k, 2)."""
    around = corners - point
    angle = np.sort(np.arctan2(around[:, 1], around[:, 0]))
    return bool(np.max(np.diff(angle, append=angle[0] + 2.0 * np.pi)) < np.pi)


def _thrust(vehicle: Vehicle, model: Mapping[str, Estimate]) -> dict[str, str]:
    declared = vehicle.rotors.thrust_coefficient_n_s2
    found = model.get("thrust_coefficient_n_s2")
    if not declared or found is None:
        return {}
    factor = found.value / declared
    if THRUST_FACTOR[0] < factor < THRUST_FACTOR[1]:
        return {}
    return {"thrust_coefficient_n_s2": f"{factor:.3g} times the declared thrust came out{ELSE}"}
