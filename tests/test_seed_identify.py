"""identify_seed on exact motion: planted parameters, the pair's bias, anchors, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from seed_exact import exact_flight, table_2, true_vehicle

from groundstation.errors import NotIdentifiable
from groundstation.flightdata import Stream
from groundstation.identification.estimators import least_squares
from groundstation.identification.filters import matched_pair, seed_pair
from groundstation.identification.results import MASS_AND_TENSOR, OUTPUTS
from groundstation.identification.seed import Regressions, filtered_regression, identify_seed, seed_methods
from groundstation.identification.seed_signals import process_flight
from groundstation.paths import find_config
from groundstation.trajectory import RestToRest
from groundstation.vehicle import Vehicle, load_vehicle, vehicle_from_dict, vehicle_to_dict

TENSOR = {"xx": 0.021, "yy": 0.036, "zz": 0.05, "xy": 0.001, "xz": -0.0008, "yz": 0.0005}


@pytest.fixture(scope="module")
def declared() -> Vehicle:
    return load_vehicle(find_config("vehicles", "qball2"))


@pytest.fixture(scope="module")
def truth(declared):
    return true_vehicle(declared, mass_kg=1.83, **TENSOR)


@pytest.fixture(scope="module")
def flight(declared, truth):
    return exact_flight(declared, truth)


def theta(vehicle):
    return np.array([vehicle.mass_kg, *vehicle.inertia_tensor()[np.triu_indices(3)]])


def values(result):
    return np.array([result.parameters[name].value for name in MASS_AND_TENSOR])


@pytest.mark.parametrize("method", ["LS", "FMLS"])
def test_exact_motion_gives_mass_to_a_thousandth_and_the_tensor_to_half_a_percent_of_its_trace(flight, truth, method):
    got, expected = values(identify_seed(flight)[method]), theta(truth)
    assert got[0] == pytest.approx(expected[0], rel=1e-3)
    np.testing.assert_allclose(got[1:], expected[1:], atol=0.005 * truth.inertia_tensor().trace())


@pytest.mark.parametrize("method", ["GD", "FMGD"])
def test_gradient_descent_comes_close_too(flight, truth, method):
    got, expected = values(identify_seed(flight)[method]), theta(truth)
    np.testing.assert_allclose(got[1:], expected[1:], atol=0.01 * truth.inertia_tensor().trace())


def test_the_papers_filter_pair_makes_inertias_three_percent_low_and_a_matched_one_does_not(flight, truth):
    signals = process_flight(flight)
    got = {}
    for name, pair in (("seed", seed_pair), ("matched", matched_pair)):
        r = filtered_regression(signals, pair, period_s=0.002)
        got[name] = least_squares(r.regressor, r.output, r.t_s, r.used).values
    diagonal = [1, 4, 6]
    expected = theta(truth)[diagonal]
    low = (1 - np.exp(-30 * 0.002)) / (30 * 0.002) - 1
    np.testing.assert_allclose(got["seed"][diagonal] / expected - 1, low, atol=2e-3)
    np.testing.assert_allclose(got["matched"][diagonal] / expected - 1, 0.0, atol=5e-4)
    paper = seed_methods(Regressions.of(signals, filter_period_s=0.002), flight.vehicle)["FMLS"]
    assert paper.parameters["ixx_kg_m2"].value == pytest.approx(got["seed"][1])
    assert "2.00 ms" in paper.note


def test_results_carry_evolution_condition_number_and_output_error(flight):
    for result in identify_seed(flight).values():
        assert result.condition_number == pytest.approx(16.2, abs=0.15)
        assert tuple(result.rms_output_error) == OUTPUTS
        evolution = result.evolution
        assert set(evolution.values) == set(MASS_AND_TENSOR)
        assert len(evolution.t_s) <= 400
        assert evolution.t_s[0] >= 10.0
        assert evolution.values["mass_kg"][-1] == result.parameters["mass_kg"].value


def test_anchor_mass_estimates_the_thrust_constant_in_place_of_mass(declared, truth):
    document = vehicle_to_dict(truth)
    document["rotors"]["thrust_coefficient_n_s2"] *= 0.9
    document["identification"]["anchor"] = "mass"
    believed = vehicle_from_dict(document)
    result = identify_seed(exact_flight(believed, truth))["LS"]
    k = truth.rotors.thrust_coefficient_n_s2
    assert result.parameters["thrust_coefficient_n_s2"].value == pytest.approx(k, rel=1e-3)
    assert result.parameters["mass_kg"].value == truth.mass_kg
    np.testing.assert_allclose(values(result)[1:], theta(truth)[1:], atol=0.005 * 0.107)
    document["identification"]["anchor"] = "thrust"
    wrong = identify_seed(exact_flight(vehicle_from_dict(document), truth))["LS"]
    assert wrong.parameters["mass_kg"].value == pytest.approx(0.9 * truth.mass_kg, rel=1e-3)


def test_intervals_widen_with_the_anchors_own_uncertainty(declared, truth):
    document = vehicle_to_dict(declared)
    document["identification"] |= {"thrust_coefficient_std": 0.02, "torque_to_thrust_std": 0.05}
    result = identify_seed(exact_flight(vehicle_from_dict(document), truth))["LS"]
    p = result.parameters
    assert p["mass_kg"].std == pytest.approx(0.02 * p["mass_kg"].value, rel=0.01)
    assert p["ixx_kg_m2"].std == pytest.approx(0.02 * p["ixx_kg_m2"].value, rel=0.01)
    assert p["izz_kg_m2"].std == pytest.approx(np.hypot(0.02, 0.05) * p["izz_kg_m2"].value, rel=0.01)


def test_without_poses_all_is_still_identified_and_without_imu_too(flight, truth):
    for part in (replace(flight, mocap=None), replace(flight, imu=None)):
        result = identify_seed(part)
        np.testing.assert_allclose(values(result["LS"]), theta(truth), rtol=0.02, atol=0.02 * 0.107)


def hover(declared, truth, **noise):
    from groundstation.trajectory import rigid_motion

    class Still:
        duration_s = 20.0

        def sample(self, t):
            return RestToRest(np.array([0, 0, 1.0, 0]), np.array([0, 0, 1.0, 0]), 20.0).sample(t)

    assert rigid_motion(Still().sample([0.0])).specific_thrust_m_s2[0] > 9.0
    return exact_flight(declared, truth, series=Still(), **noise)


def test_a_hover_tells_the_mass_and_no_inertia(declared, truth):
    result = identify_seed(hover(declared, truth, gyro_noise=0.002, accel_noise=0.05, position_noise=2e-4))
    for method in result.values():
        assert set(method.parameters) == {"mass_kg"}, method.note
        assert "izz_kg_m2 gets no number" in method.note
    assert result["LS"].parameters["mass_kg"].value == pytest.approx(truth.mass_kg, rel=2e-3)


def test_motion_about_one_axis_tells_that_axis_only(declared, truth):
    series = table_2()
    for row in (0, 1, 2):
        series.a[row] = series.b[row] = 0.0
    flown = exact_flight(declared, truth, series=series, gyro_noise=0.001, accel_noise=0.02, position_noise=1e-4)
    parameters = identify_seed(flown)["LS"].parameters
    assert "izz_kg_m2" in parameters
    assert {"ixx_kg_m2", "iyy_kg_m2", "ixy_kg_m2"}.isdisjoint(parameters)


def test_a_flight_that_reveals_nothing_is_refused_by_name(declared, truth):
    still = hover(declared, truth, gyro_noise=0.002)
    empty = replace(
        still, mocap=None, imu=Stream(still.imu.t_s, still.imu.values * [1, 1, 1, 0, 0, 0], still.imu.columns)
    )
    with pytest.raises(NotIdentifiable) as refusal:
        identify_seed(empty)
    assert set(refusal.value.not_identifiable) == set(MASS_AND_TENSOR)
