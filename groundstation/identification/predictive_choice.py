"""From prepared flights and the physical fit to the ``[prediction]`` section of a model file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.identification.predictive_fit import SHORTEST_S, WINDOWS, Judgement, Shooting, judged, shooting
from groundstation.identification.preparation import Prepared
from groundstation.identification.results import Estimate
from groundstation.identification.starts import own_states, smoothed_states
from groundstation.json_types import Document, JsonObject
from groundstation.model.disturbance import TurningDisturbance
from groundstation.model.flight_states import FlightStates
from groundstation.model.predictive import PredictiveModel
from groundstation.model.vehicle_model import (
    VehicleModel,
    declared_model,
    model_from_document,
    nearest_mixture,
)
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

UNITS = {"position_m": "m", "velocity_m_s": "m/s", "attitude_rad": "rad", "body_rate_rad_s": "rad/s"}
WORDS = {
    "fitted": "the fitted prediction model",
    "without_torque": "the fitted prediction model, which leaves the rotors' torque alone",
    "physical": "the physical model",
    "unpublished": "the physical model with moments that only predict and are not published",
    "declared": "the declared vehicle",
    "constant_velocity": "constant velocity and rate",
}


def physical_model(
    vehicle: Vehicle,
    parameters: Mapping[str, Estimate],
    model: Mapping[str, Estimate],
    disturbance: TurningDisturbance | None,
) -> VehicleModel:
    """The published physical model, as ``predict`` makes it of a model file."""
    document: dict[str, Any] = {
        part: {name: {"value": estimate.value} for name, estimate in values.items()}
        for part, values in (("parameters", parameters), ("model", model))
    }
    if disturbance is not None:
        document["disturbance"] = disturbance.to_dict()
    return model_from_document(document, vehicle)


def with_moments(physical: VehicleModel, tensor: Array, disturbance: TurningDisturbance | None) -> VehicleModel:
    """The physical model with another tensor, or with as much of it as makes a rigid body beside the declared one."""
    return replace(physical, tensor=nearest_mixture(tensor, physical.vehicle.inertia_tensor()), disturbance=disturbance)


def prediction_section(
    prepared: Sequence[Prepared], physical: VehicleModel, unpublished: VehicleModel | None = None
) -> JsonObject:
    """Fit, choose, and say it. An empty section where the flights are too short to do either.

    Args:
        prepared: the flights, pooled.
        physical: the identified model; the gains of a fitted one refer to it.
        unpublished: the same with moments that are not published; None where all are.
    """
    used_s = sum(float(np.sum(p.record.keep)) * float(np.median(np.diff(p.record.t_s))) for p in prepared)
    if used_s < SHORTEST_S:
        return {}
    each = WINDOWS // len(prepared)
    shots = [shot for i, item in enumerate(prepared) if (shot := _shots(item, i, each)) is not None]
    if not shots:
        return {}
    found = judged(shots, physical, _base(physical, prepared[0].record.vehicle), unpublished)
    return section(found, unpublished if found.kind == "unpublished" else None)


def _base(physical: VehicleModel, vehicle: Vehicle) -> VehicleModel:
    """The physical model where its accelerations are of the size of the declared ones; the declared model otherwise."""
    declared = declared_model(vehicle)
    ratio = np.diag(physical.tensor) / np.diag(declared.tensor)
    return physical if np.all((ratio > 0.2) & (ratio < 5.0)) else declared


def _shots(prepared: Prepared, flight: int, windows: int) -> Shooting | None:
    """Windows from the vehicle's own state where it recorded one as densely as rates need, else from the smoothed
    motion.
    """
    state = prepared.flight.state
    record = prepared.record
    if state is not None and len(state) >= 50 and state.rate_hz() >= 50.0:
        states = own_states(prepared)
        return shooting(states, flight, _kept(states, record.t_s, record.keep), windows)
    return shooting(smoothed_states(prepared), flight, record.keep, windows)


def _kept(states: FlightStates, t_s: NDArray[np.float64], keep: NDArray[np.bool_]) -> NDArray[np.bool_]:
    nearest = np.clip(np.searchsorted(t_s, states.t_s), 0, len(t_s) - 1)
    return keep[nearest] & (np.abs(t_s[nearest] - states.t_s) < 0.1)


def section(found: Judgement, unpublished: VehicleModel | None = None) -> JsonObject:
    """The ``[prediction]`` section of a model file; of unpublished moments with these."""
    return {
        "kind": "fitted" if found.model is not None else found.kind,
        "candidate": found.kind,
        "summary": summary(found),
        "reason": found.reason,
        "blocks": found.blocks,
        "error": {name: {h: dict(by) for h, by in errors.items()} for name, errors in found.errors.items()},
        **({} if found.model is None else found.model.to_dict()),
        **({} if unpublished is None else _moments(unpublished)),
    }


def _moments(model: VehicleModel) -> JsonObject:
    """What :func:`with_moments` takes."""
    tensor = {"tensor": [[float(x) for x in row] for row in model.tensor]}
    return tensor if model.disturbance is None else {**tensor, "disturbance": model.disturbance.to_dict()}


def _with_moments_of(found: Document, physical: VehicleModel) -> VehicleModel:
    """Inverse of :func:`_moments`.

    Raises:
        BadInput: the tensor is missing, or no rigid body's.
    """
    try:
        tensor = np.array(found["tensor"], dtype=float).reshape(3, 3)
    except (KeyError, TypeError, ValueError):
        raise BadInput("the model's [prediction] lacks its tensor; identify again.") from None
    if not np.isfinite(tensor).all() or np.linalg.eigvalsh(tensor)[0] <= 0.0:
        raise BadInput("the model's [prediction] tensor belongs to no rigid body; identify again.")
    disturbance = TurningDisturbance.from_dict(found["disturbance"]) if "disturbance" in found else None
    return replace(physical, tensor=tensor, disturbance=disturbance)


def summary(found: Judgement) -> str:
    """One sentence: what predicts, how well on unseen blocks, and where constant velocity does better."""
    own, still = found.errors[found.kind]["0.5"], found.errors["constant_velocity"]["0.5"]
    sizes = ", ".join(f"{own[q]:.3g} {UNITS[q]} ({still[q]:.3g})" for q in own if q in still)
    lost = ", ".join(f"{q.rsplit('_', 1)[0] if q != 'velocity_m_s' else 'velocity'} at {h} s" for h, q in found.loses)
    worse = f"WORSE than constant velocity in {lost}. " if lost else ""
    return (
        f"{worse}{WORDS[found.kind].capitalize()} predicts best; 0.5 s ahead on unseen parts of these flights "
        f"(constant velocity): {sizes}."
    )


def chosen_name(document: Document) -> str:
    """What the predictor of a model file is called."""
    return WORDS.get(document.get("prediction", {}).get("candidate", "physical"), "the model")


def chosen_predictor(document: Document, physical: VehicleModel) -> VehicleModel | PredictiveModel | None:
    """What a model file's ``[prediction]`` section asks to predict with; None stands for constant velocity.

    Raises:
        BadInput: the section is malformed.
    """
    found = document.get("prediction", {})
    kind = found.get("kind", "physical")
    if kind == "fitted":
        return PredictiveModel.from_dict(found)
    if kind == "physical":
        return physical
    if kind == "unpublished":
        return _with_moments_of(found, physical)
    if kind == "declared":
        return declared_model(physical.vehicle)
    if kind == "constant_velocity":
        return None
    raise BadInput(f"the model's [prediction] is of the kind '{kind}', which is unknown; identify again.")
