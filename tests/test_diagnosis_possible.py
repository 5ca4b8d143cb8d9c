"""What no vehicle has is not published of a diagnosis."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.diagnosis.possible import possible
from groundstation.diagnosis.results import Diagnosis, Finding
from groundstation.identification.consistency import physically_consistent
from groundstation.identification.results import MASS_AND_TENSOR, Estimate
from groundstation.paths import find_config
from groundstation.vehicle import Vehicle, load_vehicle


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    """The one of the paper."""
    return load_vehicle(find_config("vehicles", "qball2"))


def diagnosed(vehicle: Vehicle, *findings: Finding, **changed: float) -> Diagnosis:
    """One whose numbers are the declared ones but for some."""
    declared = vehicle.parameters()
    values = {name: declared.get(name, 0.0) for name in MASS_AND_TENSOR} | changed
    std = np.array([0.001 * values["mass_kg"], *(0.01 * vehicle.inertia_kg_m2.xx for _ in range(6))])
    after = {n: Estimate.normal(v, s) for (n, v), s in zip(values.items(), std, strict=True)}
    return Diagnosis(
        "flight", vehicle.name, "explained", findings, parameters_after=after, covariance_after=np.diag(std**2)
    )


def finding(effect: str, **parameters: float) -> Finding:
    """One with these values."""
    return Finding(effect, {n: Estimate.normal(v, abs(v) / 10.0) for n, v in parameters.items()}, "", 0.9)


def test_what_a_vehicle_may_have_stays_as_it_is(vehicle):
    found = diagnosed(vehicle, finding("com_offset", com_offset_x_m=0.01, com_offset_y_m=-0.01))
    assert possible(found, vehicle) is found


@pytest.mark.parametrize(
    ("name", "value"), [("ixx_kg_m2", -1e-4), ("izz_kg_m2", 11.7), ("mass_kg", -0.5), ("iyy_kg_m2", 0.0)]
)
def test_a_number_that_no_vehicle_has_is_not_given_and_explains_nothing(vehicle, name, value):
    found = possible(diagnosed(vehicle, **{name: value}), vehicle)
    assert name not in found.parameters_after
    assert found.verdict == "unexplained"
    assert any(text.startswith(f"{name}: ") for text in found.warnings), found.warnings


def test_a_centre_of_mass_outside_the_rotors_is_no_finding(vehicle):
    drag = finding("rotor_drag", d_x_kg_s=0.2, d_y_kg_s=0.2)
    outside = finding("com_offset", com_offset_x_m=3.0 * vehicle.arm_m(), com_offset_y_m=0.0)
    found = possible(diagnosed(vehicle, outside, drag), vehicle)
    assert [each.effect for each in found.findings] == ["rotor_drag"]
    assert (found.verdict, found.adopted) == ("unexplained", False)
    assert "outside the rotors" in " ".join(found.warnings)


def test_a_lag_of_seconds_is_no_finding(vehicle):
    found = possible(diagnosed(vehicle, finding("motor_lag", rotor_lag_up_s=2.5, rotor_lag_down_s=0.1)), vehicle)
    assert not found.findings
    assert found.verdict == "unexplained"


@pytest.mark.parametrize("weighed", [False, True])
def test_a_tensor_of_no_rigid_body_becomes_the_nearest_one_and_says_so(vehicle, weighed):
    largest = 1.1 * (vehicle.inertia_kg_m2.xx + vehicle.inertia_kg_m2.yy)
    found = diagnosed(vehicle, izz_kg_m2=largest)
    if weighed:
        found.covariance_after[0] = found.covariance_after[:, 0] = 0.0
    assert physically_consistent(found.parameters_after)
    rigid = possible(found, vehicle)
    assert not physically_consistent(rigid.parameters_after)
    assert any("no rigid body" in text for text in rigid.warnings)
    moved = abs(rigid.parameters_after["izz_kg_m2"].value - largest)
    assert moved < 0.1 * largest, "the nearest, not any"
    assert rigid.parameters_after["mass_kg"].value == pytest.approx(vehicle.mass_kg, rel=1e-3 if weighed else 0.02)
