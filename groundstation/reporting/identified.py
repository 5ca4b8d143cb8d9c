"""A vehicle with what was identified in place of what was declared, and which of the two each number is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput, Refused
from groundstation.identification.results import MASS_AND_TENSOR
from groundstation.vehicle import Vehicle, vehicle_from_dict, vehicle_to_dict

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Identified:
    """What the simulators' formats are written from.

    Attributes:
        vehicle: validated, with the identified values in place.
        com_offset_m: centre of mass in the body, from the declared origin, shape (3,).
        rotor_drag_kg_s: force against horizontal air speed at hover, body x and y; zero where none was found.
        damping_nm_s: angular damping about x, y, z; zero where none was found.
        delay_s: pure delay from command to thrust.
        std: standard deviation of each identified parameter; what is not in here was declared.
        lost: what was identified and is in none of these fields, by name.
    """

    vehicle: Vehicle
    flight: str
    method: str
    com_offset_m: Array
    rotor_drag_kg_s: Array
    damping_nm_s: Array
    delay_s: float
    std: Mapping[str, float]
    lost: tuple[str, ...]

    def provenance(self) -> list[str]:
        """Sentences for a file's head: where mass and tensor come from."""
        declared = [name for name in MASS_AND_TENSOR if name not in self.std]
        sentences = [f"Identified from flight {self.flight or 'unnamed'} by {self.method or 'no method'}."]
        if declared:
            sentences.append(f"Not identified, declared values kept: {', '.join(declared)}.")
        if self.lost:
            sentences.append(f"Found but not held by this format: {', '.join(self.lost)}.")
        return sentences

    def hover_speed_sum_rad_s(self) -> float | None:
        """Sum of the rotor speeds that carry the weight; None without a thrust coefficient."""
        k = self.vehicle.rotors.thrust_coefficient_n_s2
        if k is None:
            return None
        n = self.vehicle.rotors.count
        return float(n * np.sqrt(self.vehicle.mass_kg * self.vehicle.gravity_m_s2 / (n * k)))

    def require_rigid(self, reader: str) -> None:
        """Refuse a tensor that belongs to no rigid body (principal moments against the triangle inequality).

        Raises:
            Refused: with the moments.
        """
        moments = np.linalg.eigvalsh(self.vehicle.inertia_tensor())
        if moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-9):
            text = ", ".join(f"{m:.4g}" for m in moments)
            raise Refused(
                f"The identified tensor belongs to no rigid body (principal moments {text} kg m^2: the largest exceeds "
                f"the sum of the others), and {reader} would not load it.",
                "Identify with a method that keeps to real bodies, or export another format.",
                ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2"),
            )


_ROTOR_KEYS = ("thrust_coefficient_n_s2", "torque_to_thrust_m")
_EFFECTS_HELD = {"rotor_drag", "com_offset", "angular_damping", "motor_lag", "input_delay"}


def identified_from_document(document: Mapping[str, Any]) -> Identified:
    """Put a model document's estimates into its declared vehicle.

    Raises:
        BadInput: malformed, or estimates that are no vehicle (a negative mass, an indefinite tensor).
    """
    try:
        declared = vehicle_from_dict(dict(document["vehicle"]), "the model's vehicle")
        flat = {**_flat(document["parameters"]), **_flat(document.get("model", {}))}
        effects = {name: _flat(values) for name, values in document.get("effects", {}).items()}
    except (KeyError, TypeError, AttributeError) as error:
        raise BadInput(f"the model document lacks {error}; write it again with `groundstation identify`.") from None
    for values in effects.values():
        flat |= values
    value = {name: pair[0] for name, pair in flat.items()}

    updated = vehicle_to_dict(declared)
    body, rotors = updated["vehicle"], updated["rotors"]
    body["mass_kg"] = value.get("mass_kg", body["mass_kg"])
    for name in MASS_AND_TENSOR[1:]:
        body["inertia_kg_m2"][name[1:3]] = value.get(name, body["inertia_kg_m2"][name[1:3]])
    for name in _ROTOR_KEYS:
        if name in value and name in rotors:
            rotors[name] = value[name]
    if "thrust_curve" in rotors:
        rotors["thrust_curve"] = [value.get(f"thrust_curve_c{i}_n", c) for i, c in enumerate(rotors["thrust_curve"])]
    for side in ("up", "down"):
        if f"rotor_lag_{side}_s" in value:
            rotors["lag"][f"{side}_s"] = max(0.0, value[f"rotor_lag_{side}_s"])
    return Identified(
        vehicle=vehicle_from_dict(updated, "the identified vehicle"),
        flight=str(document.get("flight", "")),
        method=str(document.get("method", "")),
        com_offset_m=_vector(value, "com_offset_{}_m"),
        rotor_drag_kg_s=_vector(value, "d_{}_kg_s")[:2],
        damping_nm_s=_vector(effects.get("angular_damping", {}), "d_{}_nm_s"),
        delay_s=max(0.0, value.get("input_delay_s", 0.0)),
        std={name: pair[1] for name, pair in flat.items()},
        lost=tuple(sorted(set(effects) - _EFFECTS_HELD)),
    )


def _flat(estimates: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    return {name: (float(e["value"]), float(e["std"])) for name, e in estimates.items()}


def _vector(values: Mapping[str, Any], pattern: str) -> Array:
    found = [values.get(pattern.format(axis), 0.0) for axis in "xyz"]
    return np.array([v[0] if isinstance(v, tuple) else v for v in found], dtype=float)
