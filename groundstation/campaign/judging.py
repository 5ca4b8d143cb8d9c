"""How well a model does on a flight that no estimate has seen: errors of open-loop prediction, before and after its
effects.
"""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import library, wrench_of
from groundstation.json_types import Document, JsonObject
from groundstation.model.flight_states import FlightStates
from groundstation.model.prediction import predict_alone
from groundstation.model.vehicle_model import model_from_document
from groundstation.vehicle import vehicle_from_dict

HORIZON_S = 0.5
FLOOR = 1.25
"""A model predicts an unseen flight to its noise floor when its error there is at most so many times that on its own
flights. Set before any bench was run, for errors of 40 s flights that differ by a tenth or two; no study has checked it
yet.
"""

Errors = dict[str, float]


def prediction_errors(document: Document, states: FlightStates) -> Errors:
    """RMS error after :data:`HORIZON_S`, by quantity, of a model document on a flight's states."""
    declared = vehicle_from_dict(document["vehicle"], "the campaign's model")
    effects = document.get("effects", {})
    wrench = wrench_of(effects, declared) if any(name.partition("/")[0] in library() for name in effects) else None
    found = predict_alone(model_from_document(document, declared, wrench), states, horizon_s=HORIZON_S)
    return {name: float(entry["rms"]) for name, entry in found.error["model"][f"{HORIZON_S:g}"].items()}


def without_effects(document: Document, parameters: Document) -> JsonObject:
    """The same model as it was before the effects: mass and tensor estimated without them."""
    rigid = {name: {"value": e["value"], "std": e["std"]} for name, e in parameters.items()}
    return {**document, "effects": {}, "parameters": {**document["parameters"], **rigid}}


def at_floor(unseen: Errors, seen: Errors) -> bool:
    """Whether the error on an unseen flight is that of the model's own flights, within :data:`FLOOR`, in every
    quantity.
    """
    names = [name for name in unseen if name in seen and np.isfinite(seen[name]) and seen[name] > 0.0]
    return bool(names) and all(unseen[name] <= FLOOR * seen[name] for name in names)
