"""The seed's closed loop obeys mechanics, its limits and its sampling; the comparison finds the set that flew."""

from dataclasses import replace

import numpy as np
import pytest
from seed_exact import table_2, true_vehicle

from groundstation.errors import NotIdentifiable
from groundstation.flightdata import MOCAP_COLUMNS, WRENCH_COLUMNS, FlightData, Stream
from groundstation.frames import matrix_from_quat, quat_from_euler
from groundstation.identification.results import MASS_AND_TENSOR, Estimate, MethodResult
from groundstation.identification.validation import (
    CLOSED_LOOP_SIGNALS,
    closed_loop_validation,
    improvement_percent,
    parameter_sets,
    validate,
)
from groundstation.model.closed_loop import Body, Conditions, Start, simulate_closed_loop
from groundstation.paths import find_config
from groundstation.trajectory import Plan, RestToRest, coefficients_from_arrays
from groundstation.vehicle import Control, load_vehicle, vehicle_from_dict, vehicle_to_dict


@pytest.fixture(scope="module")
def declared():
    return load_vehicle(find_config("vehicles", "qball2"))


@pytest.fixture(scope="module")
def truth(declared):
    return true_vehicle(declared, mass_kg=1.83, xx=0.02, yy=0.035, zz=0.045, xy=0.001, yz=0.001)


@pytest.fixture(scope="module")
def plan():
    series = table_2(2.0)
    return Plan(
        vehicle="qball2",
        base_frequency_rad_s=series.base_frequency_rad_s,
        periods=2.0,
        coefficients=coefficients_from_arrays(series.a, series.b, series.c),
    )


def hover(height=1.0, duration=5.0):
    point = np.array([0.0, 0.0, height, 0.0])
    return RestToRest(point, point, duration)


def test_free_spin_conserves_energy_and_angular_momentum_in_the_world(declared, truth):
    none = (0.0, 0.0, 0.0)
    loose = declared.model_copy(
        update={
            "control": Control(
                position_p=none, position_i=none, position_d=none, attitude_p=none, attitude_i=none, attitude_d=none
            )
        }
    )
    start = np.zeros(12)
    start[6:9], start[9:] = (0.1, -0.2, 0.3), (0.4, -0.3, 0.5)
    tensor = truth.inertia_tensor()
    flown = simulate_closed_loop(loose, hover(duration=2.0), Body(1.0, tensor), Start(state=start))
    rotation = matrix_from_quat(quat_from_euler(*flown.euler_rad.T))
    momentum = np.einsum("kij,kj->ki", rotation, flown.rate_rad_s @ tensor)
    energy = np.einsum("ki,ij,kj->k", flown.rate_rad_s, tensor, flown.rate_rad_s)
    np.testing.assert_allclose(momentum, momentum[:1] * np.ones((len(momentum), 1)), atol=1e-10)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-10)
    assert np.ptp(flown.rate_rad_s, axis=0).min() > 1e-3


def test_hover_thrust_is_the_weight_of_the_plant_not_of_the_controller(declared, truth):
    flown = simulate_closed_loop(declared, hover(duration=60.0), Body(1.83, truth.inertia_tensor()))
    assert flown.wrench[-1, 0] == pytest.approx(1.83 * declared.gravity_m_s2, rel=1e-3)
    np.testing.assert_allclose(flown.wrench[-1, 1:], 0.0, atol=1e-6)


def test_nominal_vehicle_follows_the_published_trajectory(declared):
    series = table_2(2.0)
    flown = simulate_closed_loop(declared, series, Body(declared.mass_kg, declared.inertia_tensor()))
    error = flown.position_m - series.sample(flown.t_s).position[0]
    assert np.sqrt(np.mean(error[10000:] ** 2, axis=0)).max() < 0.03


def test_wrench_and_rotors_saturate(declared):
    jump = RestToRest(np.array([0.0, 0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0, 0.0]), 1.0)
    start = np.zeros(12)
    start[2], start[6], start[8] = -3.0, 0.8, 1.5
    begun = Body(declared.mass_kg, declared.inertia_tensor()), Start(state=start)
    by_wrench = simulate_closed_loop(declared, jump, *begun)
    assert by_wrench.wrench[0, 0] == pytest.approx(34.4)
    assert np.abs(by_wrench.wrench[:, 1:]).max() == pytest.approx(1.72)
    by_rotor = simulate_closed_loop(declared, jump, *begun, conditions=Conditions(rotor_level=True))
    thrusts = by_rotor.wrench @ np.linalg.pinv(declared.allocation()).T
    assert thrusts.min() >= -1e-9
    assert thrusts.max() <= declared.rotor_thrust_max_n() + 1e-9
    assert np.abs(by_rotor.wrench[:, 3]).max() < 0.3  # four rotors cannot give 1.72 N m of yaw


def test_position_is_held_between_samples(declared):
    """Between poses only the tilt and its rates change the thrust, so without tilt it is a staircase at 30 Hz."""
    start = np.zeros(12)
    start[2] = 0.5
    rise = RestToRest(np.array([0.0, 0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0, 0.0]), 1.0)
    flown = simulate_closed_loop(declared, rise, Body(declared.mass_kg, declared.inertia_tensor()), Start(state=start))
    steps = np.abs(np.diff(flown.wrench[:, 0])) > 0.02
    assert 25 <= np.count_nonzero(steps) <= 30
    assert np.diff(np.flatnonzero(steps)).min() >= 33


def recorded(declared, plan, truth):
    """A flight made by the simulated loop itself."""
    flown = simulate_closed_loop(
        declared, plan.series(), Body(truth.mass_kg, truth.inertia_tensor()), Start(-3.0, duration_s=23.0)
    )
    document = vehicle_to_dict(declared)
    document["rotors"]["input"] = "wrench"
    pose = np.column_stack([flown.position_m, quat_from_euler(*flown.euler_rad.T)])
    t = flown.t_s + 100.0
    return FlightData(
        name="loop",
        vehicle=vehicle_from_dict(document),
        motors=Stream(t, flown.wrench, WRENCH_COLUMNS),
        mocap=Stream(t + 0.05, pose, MOCAP_COLUMNS),
        window_s=(103.0, 123.0),
        plan=plan,
    )


def test_comparison_is_exact_for_the_set_that_flew_and_ranks_the_others(declared, plan, truth):
    flight = recorded(declared, plan, truth)
    theta = dict(zip(MASS_AND_TENSOR, (truth.mass_kg, *truth.inertia_tensor()[np.triu_indices(3)]), strict=True))
    method = MethodResult({name: Estimate.normal(value, 0.0) for name, value in theta.items()})
    sets = parameter_sets(declared, {"LS": method})
    got = closed_loop_validation(flight, sets, mocap_minus_imu_s=0.05, conditions=Conditions())
    assert set(got.rms) == {"nominal", "LS"}
    assert tuple(got.rms["LS"]) == CLOSED_LOOP_SIGNALS
    gain = improvement_percent(got)["LS"]
    for signal in ("x_m", "z_m", "roll_rad", "pitch_rad", "force_z_n", "torque_x_nm"):
        assert gain[signal] > 80.0, (signal, got.rms)


def test_comparison_leaves_out_what_no_body_has_and_says_so(declared, plan, truth):
    flight = recorded(declared, plan, truth)
    sets = parameter_sets(declared, {"LS": MethodResult({"ixx_kg_m2": Estimate.normal(-0.01, 0.0)})})
    got = closed_loop_validation(flight, sets, mocap_minus_imu_s=0.05)
    assert set(got.rms) == {"nominal"}
    assert "LS" in got.note
    with pytest.raises(NotIdentifiable, match="poses"):
        closed_loop_validation(replace(flight, mocap=None), sets)
    with pytest.raises(NotIdentifiable, match="excitation"):
        closed_loop_validation(replace(flight, window_s=None), sets)
    with pytest.raises(NotIdentifiable, match="plan"):
        closed_loop_validation(replace(flight, plan=None), sets)


def test_all_checks_that_a_flight_allows(declared, plan, truth):
    flight = replace(recorded(declared, plan, truth), plan=plan)
    theta = dict(zip(MASS_AND_TENSOR, (truth.mass_kg, *truth.inertia_tensor()[np.triu_indices(3)]), strict=True))
    method = MethodResult({name: Estimate.normal(value, 0.0) for name, value in theta.items()})
    checks = validate(flight, {"LS": method}, mocap_minus_imu_s=0.05)
    assert [check.kind for check in checks] == ["output", "output", "closed_loop"]
    for check in checks:
        assert check.rms["LS"]["force_z_n"] < check.rms["nominal"]["force_z_n"]
    assert [check.kind for check in validate(replace(flight, plan=None), {"LS": method})] == ["output", "output"]
    assert validate(replace(flight, mocap=None), {"LS": method}) == ()
