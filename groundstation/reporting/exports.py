"""Identified models as files: our own TOML and JSON, and the formats of the simulators people use.

A *model document* is a plain dictionary that carries everything a prediction needs::

    {"schema": "groundstation.model/1", "flight": "...", "method": "PE",
     "vehicle": {...},                                          # vehicle.toml as it was declared
     "parameters": {"mass_kg": {"value": 1.62, "std": 0.002}},  # mass and tensor of the best method
     "model": {"rotor_lag_up_s": {"value": 0.045, "std": 0.001}},
     "effects": {"rotor_drag": {"d_x_kg_s": {"value": 0.3, "std": 0.01}}},
     "disturbance": {"acceleration_rad_s2": [1.2, 1.3, 0.4], ...},  # what turns it besides (model/disturbance.py)
     "prediction": {"kind": "fitted", ...},          # what predicts best (model/predictive.py)
     "not_identifiable": ["com_offset_z_m"]}

An effect that is found more than once (two weak rotors) has the later ones under "weak_rotor/2" and so on. Settings of
an effect (which rotor, since when) stand among its parameters, without a spread.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from groundstation.documents import (
    IDENTIFICATION_SCHEMA,
    MODEL_SCHEMA,
    IdentificationDocument,
    ModelDocument,
    checked,
    require_best,
)
from groundstation.errors import BadInput
from groundstation.identification.results import Estimate, Identification
from groundstation.json_types import Document, JsonObject
from groundstation.outside import read_json, read_toml
from groundstation.reporting import mujoco, robotics, rotorpy, simulators
from groundstation.reporting.canonical import canonical, estimate_in
from groundstation.reporting.identified import Identified, identified_from_document
from groundstation.reporting.scenario import to_scenario
from groundstation.texts import shown
from groundstation.vehicle import Vehicle, vehicle_to_dict
from groundstation.writing import write_whole

if TYPE_CHECKING:  # the diagnosis is heavy to import, and only its type is needed
    from groundstation.diagnosis.results import Diagnosis

SCHEMA = MODEL_SCHEMA


def model_document(identification: Identification, vehicle: Vehicle, diagnosis: Diagnosis | None = None) -> JsonObject:
    """The model document of an identification: the one estimate, and the effects whose findings were adopted."""
    estimate = canonical(identification, diagnosis)
    model = {name: e for name, e in estimate.parameters.items() if name in identification.model}
    parameters = {name: e for name, e in estimate.parameters.items() if name not in model}
    effects: dict[str, dict[str, dict[str, float]]] = {}
    if diagnosis is not None and diagnosis.findings and diagnosis.adopted:
        for finding in diagnosis.findings:
            again = sum(name.partition("/")[0] == finding.effect for name in effects)
            entry = effects[f"{finding.effect}/{again + 1}" if again else finding.effect] = _values(finding.parameters)
            if finding.rotor is not None:
                entry["rotor"] = {"value": float(finding.rotor), "std": 0.0}
    return {
        "schema": SCHEMA,
        "flight": identification.flight,
        "method": estimate.source,
        "anchor": identification.anchor,
        "vehicle": vehicle_to_dict(vehicle),
        "parameters": _values(parameters),
        "model": _values(model),
        "effects": effects,
        **estimate.joint(),
        **({} if identification.disturbance is None else {"disturbance": identification.disturbance.to_dict()}),
        **({"prediction": dict(identification.prediction)} if identification.prediction else {}),
        "not_identifiable": list(identification.not_identifiable),
    }


def _values(estimates: Mapping[str, Estimate]) -> dict[str, dict[str, float]]:
    return {name: {"value": float(e.value), "std": float(e.std)} for name, e in estimates.items()}


def model_from_identification_json(document: Document, vehicle: Vehicle, source: str) -> JsonObject:
    """The model document in what ``identify --json`` printed, which names the vehicle but does not carry it.

    Raises:
        BadInput: the best method is not among the methods.
    """
    require_best(document, source)
    source_name, found = estimate_in(document)
    model = document.get("model", {})

    def values(estimates: Document) -> dict[str, dict[str, float]]:
        return {name: {"value": e["value"], "std": e["std"]} for name, e in estimates.items()}

    return {
        "schema": SCHEMA,
        "flight": document.get("flight", ""),
        "method": source_name,
        "anchor": document.get("anchor", "thrust"),
        "vehicle": vehicle_to_dict(vehicle),
        "parameters": values({name: e for name, e in found.items() if name not in model}),
        "model": values({name: e for name, e in found.items() if name in model}),
        "effects": {},
        **({"prediction": document["prediction"]} if document.get("prediction") else {}),
        "not_identifiable": list(document.get("not_identifiable", [])),
    }


def read_model(path: str | Path, vehicle: Vehicle | None = None) -> JsonObject:
    """Read a model document from ``identification.toml`` or ``.json``, or from the JSON of ``identify``.

    Args:
        path: the file.
        vehicle: replaces the declared vehicle; needed for JSON of ``identify``, which carries none.

    Raises:
        BadInput: missing, malformed, of another schema, or without a vehicle.
    """
    path = Path(path)
    read = read_json if path.suffix == ".json" else read_toml
    document = read(path, "an identification file")
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema == SCHEMA:
        found = checked(document, ModelDocument, str(path))
        return {**found, "vehicle": vehicle_to_dict(vehicle)} if vehicle is not None else found
    if schema == IDENTIFICATION_SCHEMA:
        if vehicle is None:
            raise BadInput(f"{path}: names its vehicle but does not carry it; give the vehicle file with --vehicle.")
        return model_from_identification_json(checked(document, IdentificationDocument, str(path)), vehicle, str(path))
    raise BadInput(
        f"{path}: has schema {shown(repr(schema), limit=60)}; {SCHEMA} or {IDENTIFICATION_SCHEMA} is expected."
    )


def write_model(path: str | Path, document: Document) -> Path:
    """Write a model document as TOML, or as JSON where the name ends in .json."""
    path = Path(path)
    return write_whole(path, _json(document) if path.suffix == ".json" else _toml(document))


def _toml(document: Document) -> str:
    import tomli_w

    return tomli_w.dumps(dict(document))


def _json(document: Document) -> str:
    return json.dumps(_without_nan(document), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _without_nan(value: Any) -> Any:
    """The same with null for a number that is none: JSON has no other word for it."""
    if isinstance(value, Mapping):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _simulator(write: Callable[[Identified], str]) -> Callable[[Document], str]:
    return lambda document: write(identified_from_document(document))


FORMATS: Mapping[str, Callable[[Mapping[str, Any]], str]] = {
    "toml": _toml,
    "json": _json,
    "csv": _simulator(simulators.to_csv),
    "vehicle": _simulator(simulators.to_vehicle_toml),
    "px4-sih": _simulator(simulators.to_px4_sih),
    "sdf": _simulator(simulators.to_sdf),
    "urdf": _simulator(simulators.to_urdf),
    "mjcf": _simulator(mujoco.to_mjcf),
    "rotorpy": _simulator(rotorpy.to_rotorpy),
    "scenario": _simulator(to_scenario),
    "ardupilot-sitl": _simulator(robotics.to_ardupilot_sitl),
    "pybullet": _simulator(robotics.to_pybullet),
    "crazyflow": _simulator(robotics.to_crazyflow),
    "crazyflie": _simulator(robotics.to_crazyflie),
    "agilicious": _simulator(robotics.to_agilicious),
    "webots": _simulator(robotics.to_webots),
    "matlab": _simulator(robotics.to_matlab),
    "ros2": _simulator(robotics.to_ros2),
}
"""Writers by the name of the format."""


UPRIGHT_ONLY = frozenset({"px4-sih", "rotorpy", "ardupilot-sitl", "pybullet", "crazyflow", "agilicious"})
"""Formats whose rotors all push along body z."""


def mat_file(model: Document | str | Path, vehicle: Vehicle | None = None) -> bytes:
    """An identified model as a MAT-file; arguments and errors are those of :func:`export`."""
    return robotics.to_matfile(identified_from_document(_document(model, vehicle)))


def export(model: Document | str | Path, format_name: str, vehicle: Vehicle | None = None) -> str:
    """An identified model in another format.

    Args:
        model: a model document, or the file it is in.
        format_name: a key of :data:`FORMATS`.
        vehicle: replaces the vehicle declared in the document.

    Raises:
        BadInput: unknown format, malformed model, or a model that the format cannot hold.
        Refused: numbers that the simulator would not load.
    """
    if format_name not in FORMATS:
        raise BadInput(f"unknown format '{format_name}'; there are {', '.join(FORMATS)}.")
    document = _document(model, vehicle)
    if format_name in UPRIGHT_ONLY and identified_from_document(document).vehicle.rotors.tilted:
        raise BadInput(
            f"{format_name} has upright rotors only, and this vehicle's are tilted; export mjcf, sdf or webots."
        )
    return FORMATS[format_name](document)


def _document(model: Document | str | Path, vehicle: Vehicle | None) -> Document:
    if isinstance(model, (str, Path)):
        return read_model(model, vehicle)
    return {**model, "vehicle": vehicle_to_dict(vehicle)} if vehicle is not None else dict(model)
