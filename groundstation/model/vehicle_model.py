"""What a prediction knows of a vehicle, from its file or from a model document."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.json_types import Document
from groundstation.model.disturbance import TurningDisturbance
from groundstation.model.parameters import FREE, RIGID_BODY, Parameters, declared_parameters
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Wrench = Callable[[Signals], Array]


@runtime_checkable
class RememberingWrench(Protocol):
    """A wrench of what has a past, as a pendulum has: windows that start in a flight go on from what it was there."""

    def __call__(self, signals: Signals) -> Array:
        """Along a flight, (k, 6)."""
        ...

    def begun(self, signals: Signals, index: NDArray[np.int64]) -> Wrench:
        """Of windows side by side that start at stamps ``index`` of a flight; called at one instant after another."""
        ...


@dataclass(frozen=True, slots=True)
class VehicleModel:
    """What a prediction needs to know of a vehicle.

    Attributes:
        vehicle: declared geometry and constants; thrusts are its own times ``thrust_scale``.
        tensor: about the centre of mass, (3, 3).
        com_m: centre of mass in the body.
        damping_nms, climb_damping_kg_s: linear damping of rates and climb.
        wrench: further body force and torque about the origin, (k, 6), from signals; None for none.
        disturbance: what turns it besides; None for none.
    """

    vehicle: Vehicle
    mass_kg: float
    tensor: Array
    lag_up_s: float = 0.0
    lag_down_s: float = 0.0
    lag_slope: float = 0.0
    delay_s: float = 0.0
    thrust_scale: float = 1.0
    com_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_trim_nm: float = 0.0
    damping_nms: tuple[float, float, float] = (0.0, 0.0, 0.0)
    climb_damping_kg_s: float = 0.0
    wrench: Wrench | None = None
    disturbance: TurningDisturbance | None = None


def declared_model(vehicle: Vehicle) -> VehicleModel:
    """The vehicle as declared."""
    lag = vehicle.rotors.lag
    return VehicleModel(vehicle, vehicle.mass_kg, vehicle.inertia_tensor(), lag.up_s, lag.down_s)


DAMPING = ("damping_x_nms", "damping_y_nms", "damping_z_nms")
CLIMB_DAMPING = "damping_climb_kg_s"
"""Of the fit's wrench terms: names in a model document."""


def _parameters(vehicle: Vehicle, values: Mapping[str, float], *, offsets: bool) -> Parameters:
    """The declared parameters with those that are named; without ``offsets`` the effects of a document say those."""
    lag = vehicle.rotors.lag
    p = replace(declared_parameters(vehicle), lag_up_s=lag.up_s, lag_down_s=lag.down_s)
    for entry in FREE:
        if entry.name in values and (offsets or not entry.offset):
            p = entry.put(p, values[entry.name])
    return p


def model_from_document(document: Document, vehicle: Vehicle, wrench: Wrench | None = None) -> VehicleModel:
    """The model in an ``identification.toml``; what it does not hold is as declared.

    Args:
        document: with ``parameters`` and ``model``, name -> {value, std}, and ``effects``.
        vehicle: as declared when the model was made.
        wrench: of the document's effects; then dampings and offsets come from there and not from the base fit.
    """
    values = _values_in(document)
    p = _parameters(vehicle, values, offsets=wrench is None)
    if not all(name in values for name in RIGID_BODY[1:]):
        p = replace(p, tensor=nearest_mixture(p.tensor, vehicle.inertia_tensor()))
    if np.linalg.eigvalsh(p.tensor)[0] <= 0.0:
        raise BadInput("the model's inertia tensor is not positive definite; identify on a flight that reveals it.")
    vehicle, scale = _with_thrust(vehicle, values)
    damping = {name: values.get(name, 0.0) if wrench is None else 0.0 for name in (*DAMPING, CLIMB_DAMPING)}
    x, y, z = (damping[name] for name in DAMPING)
    return VehicleModel(
        vehicle=vehicle,
        mass_kg=p.mass_kg,
        tensor=p.tensor,
        lag_up_s=p.lag_up_s,
        lag_down_s=p.lag_down_s,
        lag_slope=p.lag_slope,
        delay_s=p.delay_s,
        thrust_scale=scale,
        com_m=(float(p.com_m[0]), float(p.com_m[1]), 0.0),
        yaw_trim_nm=p.yaw_trim_nm,
        damping_nms=(x, y, z),
        climb_damping_kg_s=damping[CLIMB_DAMPING],
        wrench=wrench,
        disturbance=TurningDisturbance.from_dict(document["disturbance"]) if "disturbance" in document else None,
    )


def _values_in(document: Document) -> dict[str, float]:
    """Every number of the model, those that effects say of the rotors' timing among them."""
    effects = document.get("effects", {})
    parts = [document.get(part, {}) for part in ("parameters", "model")]
    parts += [effects.get(name, {}) for name in ("motor_lag", "input_delay")]
    return {name: float(entry["value"]) for part in parts for name, entry in part.items()}


def _with_thrust(vehicle: Vehicle, values: Mapping[str, float]) -> tuple[Vehicle, float]:
    """The vehicle with the thrust curve that was found, and the factor on its thrusts."""
    rotors = vehicle.rotors
    if "thrust_coefficient_n_s2" in values and rotors.thrust_coefficient_n_s2:
        return vehicle, values["thrust_coefficient_n_s2"] / rotors.thrust_coefficient_n_s2
    if "thrust_curve_c1_n" in values and rotors.thrust_curve is not None:
        curve = tuple(values.get(f"thrust_curve_c{i}_n", c) for i, c in enumerate(rotors.thrust_curve))
        return vehicle.model_copy(update={"rotors": rotors.model_copy(update={"thrust_curve": curve})}), 1.0
    return vehicle, 1.0


def nearest_mixture(tensor: Array, declared: Array) -> Array:
    """A tensor that is partly measured, with as much of the declared one as makes a rigid body of it, shape (3, 3).

    Moments must be positive and obey the triangle inequality: the second moment of mass tr(J)/2 1 - J is positive
    definite.
    """
    for share in np.linspace(0.0, 1.0, 21):
        mixed = (1.0 - share) * tensor + share * declared
        if np.linalg.eigvalsh(0.5 * np.trace(mixed) * np.eye(3) - mixed)[0] > 0.0:
            return np.asarray(mixed, dtype=float)
    return declared
