"""A vehicle with what was identified in place of what was declared, and which of the two each number is."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.identification.results import MASS_AND_TENSOR
from groundstation.json_types import Document
from groundstation.vehicle import INERTIA_NAMES, Vehicle, vehicle_from_dict, vehicle_to_dict

Array = NDArray[np.float64]

IN_THE_VEHICLE = frozenset({"motor_lag", "thrust_scale", "torque_scale"})
"""Effects whose parameters are numbers of a vehicle file."""
OF_THE_SENSORS = frozenset({"clock_offset", "imu_misalignment", "mocap_misalignment", "mocap_tilt"})
"""Findings about clocks and frames, which no vehicle model holds."""
_ROTOR_CONSTANTS = ("thrust_coefficient_n_s2", "torque_to_thrust_m")


@dataclass(frozen=True, slots=True)
class Identified:
    """What the simulators' formats are written from.

    Attributes:
        vehicle: validated, with the identified values in place.
        declared: as it was before.
        com_offset_m: centre of mass in the body, from the declared origin, shape (3,).
        rotor_effectiveness: thrust of each rotor as a share of what it should give, shape (n,).
        rotor_drag_kg_s: force against horizontal air speed at hover, body x and y; zero where none was found.
        damping_nms: angular damping about x, y, z; zero where none was found.
        climb_damping_kg_s: thrust lost per climb speed, at hover.
        delay_s: pure delay from command to thrust.
        effects: every effect that was found, with its parameters.
        model: the other parameters of the base fit that were identified.
        std: standard deviation of each identified parameter; what is not in here was declared.
        adjusted: what was changed so that a reader takes it, as a sentence for the file's head.
    """

    vehicle: Vehicle
    declared: Vehicle
    flight: str
    method: str
    com_offset_m: Array
    rotor_effectiveness: Array
    rotor_drag_kg_s: Array
    damping_nms: Array
    climb_damping_kg_s: float
    delay_s: float
    effects: Mapping[str, Mapping[str, float]]
    model: Mapping[str, float]
    std: Mapping[str, float]
    adjusted: str = ""

    def provenance(self, held: Collection[str] = ()) -> list[str]:
        """Sentences for a file's head: where the numbers come from, and which effects the format does not hold."""
        declared = [name for name in MASS_AND_TENSOR if name not in self.std]
        lost = sorted({name.partition("/")[0] for name in self.effects} - IN_THE_VEHICLE - OF_THE_SENSORS - set(held))
        sentences = [f"Identified from flight {self.flight or 'unnamed'} by {self.method or 'no method'}."]
        if self.adjusted:
            sentences.append(self.adjusted)
        if declared:
            sentences.append(f"Not identified, declared values kept: {', '.join(declared)}.")
        if lost:
            sentences.append(f"Found, and not held by this file: {', '.join(lost)}.")
        if self.delay_s > 0.0 and "input_delay" not in held:
            sentences.append(f"The delay of {self.delay_s:.4f} s from command to thrust is not held by this file.")
        return sentences

    def mean_lag_s(self) -> float:
        """One lag for simulators that know one."""
        return 0.5 * (self.vehicle.rotors.lag.up_s + self.vehicle.rotors.lag.down_s)

    def hover_speed_sum_rad_s(self) -> float | None:
        """Sum of the rotor speeds that carry the weight; None without a thrust coefficient."""
        k = self.vehicle.rotors.thrust_coefficient_n_s2
        if k is None:
            return None
        n = self.vehicle.rotors.count
        return float(n * np.sqrt(self.vehicle.mass_kg * self.vehicle.gravity_m_s2 / (n * k)))


def as_rigid_body(model: Identified) -> Identified:
    """The same where its tensor is a rigid body's, else with the nearest one, which the file's head then says.

    A rigid body's principal moments keep the triangle inequality, I3 <= I1 + I2 (Wensing, Kim and Slotine, RA-L 2018,
    eq. 8). The nearest tensor in the Frobenius norm keeps the axes and moves each moment by a third of the excess.
    """
    moments, axes = np.linalg.eigh(model.vehicle.inertia_tensor())
    excess = float(moments[2] - moments[0] - moments[1])
    if excess <= 1e-9 * moments[2]:
        return model
    shift = excess / 3.0 * (1.0 + 1e-6)  # readers test the inequality in their own arithmetic
    tensor = axes @ np.diag(moments + shift * np.array([1.0, 1.0, -1.0])) @ axes.T
    document = vehicle_to_dict(model.vehicle)
    document["vehicle"]["inertia_kg_m2"] = {
        a + b: float(tensor["xyz".index(a), "xyz".index(b)]) for a, b in INERTIA_NAMES
    }
    text = ", ".join(f"{m:.4g}" for m in moments)
    note = (
        f"The estimate belongs to no rigid body (principal moments {text} kg m^2); this is the nearest one, "
        f"each moment {shift:.2g} kg m^2 away."
    )
    return replace(model, vehicle=vehicle_from_dict(document, "the nearest rigid body"), adjusted=note)


def identified_from_document(document: Document) -> Identified:
    """Put a model document's estimates into its declared vehicle.

    Raises:
        BadInput: malformed, or estimates that are no vehicle (a negative mass, an indefinite tensor).
    """
    try:
        declared = vehicle_from_dict(dict(document["vehicle"]), "the model's vehicle")
        flat = {**_flat(document["parameters"]), **_flat(document.get("model", {}))}
        found = {name: _flat(values) for name, values in document.get("effects", {}).items()}
    except (KeyError, TypeError, AttributeError) as error:
        raise BadInput(f"the model document lacks {error}; write it again with `groundstation identify`.") from None
    for values in found.values():
        flat |= values
    for name in document.get("not_identifiable", ()):
        flat.pop(name, None)  # what the flight did not reveal stays as declared
    value = {name: pair[0] for name, pair in flat.items()}
    effects = {name: {key: pair[0] for key, pair in values.items()} for name, values in found.items()}
    drag = effects.get("rotor_drag", {})
    return Identified(
        vehicle=_updated(declared, value),
        declared=declared,
        flight=str(document.get("flight", "")),
        method=str(document.get("method", "")),
        com_offset_m=np.array([value.get(f"com_offset_{axis}_m", 0.0) for axis in "xyz"]),
        rotor_effectiveness=_effectiveness(declared.rotors.count, effects),
        rotor_drag_kg_s=np.array([drag.get(f"d_{axis}_kg_s", 0.0) for axis in "xy"]),
        damping_nms=np.array([value.get(f"damping_{axis}_nms", 0.0) for axis in "xyz"]),
        climb_damping_kg_s=effects.get("climb_inflow", {}).get("k_kg_s", value.get("damping_climb_kg_s", 0.0)),
        delay_s=max(0.0, value.get("input_delay_s", 0.0)),
        effects=effects,
        model={name: value[name] for name in document.get("model", {}) if name in value},
        std={name: pair[1] for name, pair in flat.items()},
    )


def _flat(estimates: Document) -> dict[str, tuple[float, float]]:
    return {name: (float(e["value"]), float(e["std"])) for name, e in estimates.items()}


def _updated(declared: Vehicle, value: Mapping[str, float]) -> Vehicle:
    """The declared vehicle with identified mass, tensor, rotor constants and lag."""
    document = vehicle_to_dict(declared)
    body, rotors = document["vehicle"], document["rotors"]
    body["mass_kg"] = value.get("mass_kg", body["mass_kg"])
    for name in MASS_AND_TENSOR[1:]:
        body["inertia_kg_m2"][name[1:3]] = value.get(name, body["inertia_kg_m2"][name[1:3]])
    for name in _ROTOR_CONSTANTS:
        if name in value and name in rotors:
            rotors[name] = value[name]
    if "thrust_curve" in rotors:
        rotors["thrust_curve"] = [value.get(f"thrust_curve_c{i}_n", c) for i, c in enumerate(rotors["thrust_curve"])]
    for side in ("up", "down"):
        if f"rotor_lag_{side}_s" in value:
            rotors["lag"][f"{side}_s"] = max(0.0, value[f"rotor_lag_{side}_s"])
    return vehicle_from_dict(document, "the identified vehicle")


def _effectiveness(count: int, effects: Mapping[str, Mapping[str, float]]) -> Array:
    """What weak rotors leave of their thrust."""
    share = np.ones(count)
    for name, values in effects.items():
        if name.partition("/")[0] == "weak_rotor" and "rotor" in values:
            rotor = values["rotor"]
            if not 1.0 <= rotor <= count:
                raise BadInput(f"the model has a weak rotor {rotor:g} of {count}; write it again with `identify`.")
            share[int(rotor) - 1] -= values.get("loss", 0.0)
    return share
