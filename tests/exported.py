"""What the tests of exports write: an X frame, an identification with a full tensor, and what was found on it."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from typing import Any

import numpy as np

from groundstation.diagnosis.results import Diagnosis, Finding
from groundstation.identification.results import Estimate, Identification
from groundstation.paths import find_config
from groundstation.reporting.exports import model_document
from groundstation.vehicle import Vehicle, load_vehicle, vehicle_from_dict, vehicle_to_dict
from tests.reporting_fixture import identification

TENSOR = np.array([[0.0268, 0.0011, -0.0006], [0.0011, 0.0331, 0.0004], [-0.0006, 0.0004, 0.0412]])


MASS = 1.8258


OFFSET = np.array([0.004, -0.003, 0.002])


def x_frame(**rotors: object) -> Vehicle:
    """An X quadrotor with PX4's numbering and spins."""
    document = vehicle_to_dict(load_vehicle(find_config("vehicles", "qball2")))
    document["rotors"] |= {
        "position_m": [[0.16, -0.18, 0.01], [-0.16, 0.18, 0.01], [0.16, 0.18, 0.01], [-0.16, -0.18, 0.01]]
    }
    document["rotors"] |= {"spin": [1, 1, -1, -1], **rotors}
    return vehicle_from_dict(document)


def planted(tensor: np.ndarray = TENSOR) -> Identification:
    axes = [("xx", 0, 0), ("xy", 0, 1), ("xz", 0, 2), ("yy", 1, 1), ("yz", 1, 2), ("zz", 2, 2)]
    parameters = {
        "mass_kg": Estimate.normal(MASS, 0.002),
        **{f"i{n}_kg_m2": Estimate.normal(tensor[i, j], 1e-4) for n, i, j in axes},
    }
    base = identification()
    model = {
        "rotor_lag_up_s": Estimate.normal(0.04, 0.001),
        "rotor_lag_down_s": Estimate.normal(0.06, 0.001),
        "input_delay_s": Estimate.normal(0.002, 0.001),
        **{f"com_offset_{a}_m": Estimate.normal(v, 1e-4) for a, v in zip("xyz", OFFSET, strict=True)},
    }
    methods = {"PE": replace(base.methods["PE"], parameters=parameters)}
    return replace(base, methods=methods, model=model, not_identifiable={})


def drag() -> Diagnosis:
    finding = Finding(
        "rotor_drag", {"d_x_kg_s": Estimate.normal(0.3, 0.01), "d_y_kg_s": Estimate.normal(0.3, 0.01)}, "", 0.99
    )
    return Diagnosis("f", "v", "explained", findings=(finding,))


def xml(text: str) -> Any:
    """The root of what we wrote."""
    return ET.fromstring(text)  # noqa: S314


def document(vehicle: Vehicle | None = None, tensor: np.ndarray = TENSOR) -> dict:
    return model_document(planted(tensor), vehicle or x_frame(), drag())


def tensor_of(get) -> np.ndarray:
    xx, xy, xz, yy, yz, zz = (float(get(n)) for n in ("xx", "xy", "xz", "yy", "yz", "zz"))
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def weak_rotors() -> Diagnosis:
    def loss(value: float) -> dict[str, Estimate]:
        return {"loss": Estimate.normal(value, 0.01)}

    findings = (
        Finding("weak_rotor", loss(0.1), "", 0.9, rotor=3),
        Finding("weak_rotor", loss(0.2), "", 0.9, rotor=1),
        Finding(
            "payload_change",
            {"mass_change_kg": Estimate.normal(0.2, 0.01), "at_s": Estimate(12.0, 0.0, (12.0, 12.0))},
            "",
            0.9,
        ),
        Finding("clock_offset", {"mocap_minus_imu_s": Estimate.normal(0.01, 0.001)}, "", 0.9),
    )
    return Diagnosis("f", "v", "explained", findings=findings)
