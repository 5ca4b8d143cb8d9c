"""Nothing unphysical or unrevealed is published: bounds by geometry, hidden numbers, verdicts, predictions that are
numbers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_predictive_model import bad_telemetry, flown, small, still

from groundstation.diagnosis.published import published
from groundstation.diagnosis.results import Diagnosis
from groundstation.errors import Refused
from groundstation.identification.physical_limits import inside_polygon, outside
from groundstation.identification.results import Estimate
from groundstation.model.prediction import predict
from groundstation.model.vehicle_model import declared_model, model_from_document
from groundstation.paths import find_config
from groundstation.vehicle import Vehicle, load_vehicle


def qball() -> Vehicle:
    return load_vehicle(find_config("vehicles", "qball2"))


def estimate(value: float) -> Estimate:
    return Estimate.normal(value, 1e-3 * abs(value) + 1e-9)


@pytest.mark.parametrize(
    ("parameters", "model", "name", "said"),
    [
        ({"ixx_kg_m2": 11.7}, {}, "ixx_kg_m2", "moment of 11.7"),
        ({"iyy_kg_m2": -1.1e-4}, {}, "iyy_kg_m2", "moment of -0.00011"),
        ({"ixy_kg_m2": 9.0}, {}, "ixy_kg_m2", "product of 9"),
        ({"mass_kg": -1.0}, {}, "mass_kg", "mass of -1"),
        ({}, {"com_offset_x_m": 0.4, "com_offset_y_m": 0.0}, "com_offset_x_m", "outside the rotors"),
        ({}, {"rotor_lag_up_s": 2.5}, "rotor_lag_up_s", "lag of 2.5"),
    ],
)
def test_what_the_geometry_cannot_hold_is_evidence_of_something_else(
    parameters: dict[str, float], model: dict[str, float], name: str, said: str
) -> None:
    vehicle = qball()
    found = outside(
        vehicle, {k: estimate(v) for k, v in parameters.items()}, {k: estimate(v) for k, v in model.items()}
    )
    assert said in found[name]
    assert "something else is wrong" in found[name]


@pytest.mark.parametrize(("factor", "kept"), [(-0.107, False), (0.8, True), (3.4, False)])
def test_a_thrust_factor_below_nought_or_above_three_is_not_published(factor: float, kept: bool) -> None:
    vehicle = small()
    value = factor * 3.7e-8
    assert (outside(vehicle, {}, {"thrust_coefficient_n_s2": estimate(value)}) == {}) is kept


def test_declared_numbers_are_within_every_limit() -> None:
    for name in ("qball2", "x500", "crazyflie21"):
        vehicle = load_vehicle(find_config("vehicles", name))
        own = {key: estimate(value) for key, value in vehicle.parameters().items() if value != 0.0}
        assert outside(vehicle, own, {"com_offset_x_m": estimate(1e-3), "com_offset_y_m": estimate(0.0)}) == {}, name


def test_the_polygon_of_the_rotors() -> None:
    corners = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    assert inside_polygon(np.array([0.9, 0.9]), corners)
    assert not inside_polygon(np.array([1.1, 0.0]), corners)


def diagnosed(after_force: float) -> Diagnosis:
    """An explained flight, whose vertical force is predicted with that error after."""
    numbers = {"mass_kg": estimate(1.6), "ixx_kg_m2": estimate(-1e-4)}
    error = {
        "held_out": {
            "before": {"force_z_n": 1.0, "torque_x_nm": 1.0},
            "after": {"force_z_n": after_force, "torque_x_nm": 0.2},
        }
    }
    return Diagnosis("f", "v", "explained", error=error, parameters_before=numbers, parameters_after=numbers)


def test_what_the_identification_hides_stays_hidden_in_the_diagnosis() -> None:
    found = published(diagnosed(0.5), {"ixx_kg_m2": "roll"})
    assert set(found.parameters_after) == set(found.parameters_before) == {"mass_kg"}
    assert found.verdict == "explained"


def test_no_flight_is_explained_where_a_channel_got_worse() -> None:
    found = published(diagnosed(1.3), {})
    assert found.verdict == "unexplained"
    assert "force_z_n is predicted worse" in found.warnings[-1]


def test_no_flight_is_explained_on_an_unrevealed_base() -> None:
    hidden: dict[str, str] = dict.fromkeys(("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2"), "turn")
    assert published(diagnosed(0.5), hidden).verdict == "unexplained"


def test_a_tensor_of_which_only_a_part_is_revealed_is_a_rigid_body_in_a_prediction() -> None:
    document = {"parameters": {"ixx_kg_m2": {"value": 9e-4}, "ixy_kg_m2": {"value": 2e-5}}}
    tensor = model_from_document(document, small()).tensor
    moments = np.linalg.eigvalsh(tensor)
    assert moments[0] > 0.0
    assert moments[2] <= moments[0] + moments[1] + 1e-12


def test_a_model_that_runs_away_is_refused_and_not_an_empty_field() -> None:
    states = flown(bad_telemetry(), still(small(), 6.0))
    runaway = replace(declared_model(small()), damping_nms=(-1e-1, -1e-1, -1e-1))
    with pytest.raises(Refused, match="runs away"):
        predict(runaway, states, horizon_s=0.5)
