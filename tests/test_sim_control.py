"""The simulated vehicle's control law and mixer, and whole flights of vehicles from 30 g to 3 kg."""

from __future__ import annotations

import time
from math import exp

import numpy as np
import pytest
from flights import rest_to_rest_plan
from hypothesis import given, settings
from hypothesis import strategies as st
from sim_states import vehicle_of

from groundstation import frames
from groundstation.paths import find_config
from groundstation.vehicle import RotorLag, load_vehicle, vehicle_from_dict, vehicle_to_dict
from sim.autopilot import (
    CONTROL_SIZE,
    ESTIMATE_SIZE,
    FORCE,
    LEAD_RATIO,
    SETPOINT_SIZE,
    attitude_loop,
    lead,
    mix,
    motor_value,
)
from sim.build import build_law
from sim.feasibility import why_not
from sim.flight import simulate
from sim.scenario import ControlModel, MocapModel, Scenario, Truth, load_scenario
from studies.flown import flight_data

LAB = load_scenario(find_config("scenarios", "lab"))
QBALL = load_vehicle(find_config("vehicles", "qball2"))


def _tracking_error(flight) -> float:
    """Largest distance from the setpoint during the excitation, by motion capture, m."""
    data = flight_data(flight)
    asked, seen = data.setpoint, data.mocap
    inside = (asked.t_s > flight.window_s[0]) & (asked.t_s < flight.window_s[1])
    error = [np.interp(asked.t_s, seen.t_s, seen.values[:, i]) - asked.values[:, i] for i in range(3)]
    return float(np.linalg.norm(np.array(error), axis=0)[inside].max())


def test_on_an_ideal_vehicle_the_law_hovers_at_the_weight_and_tracks_closely():
    flight = simulate(QBALL, rest_to_rest_plan(periods=1.0), Scenario(control=ControlModel(position_hz=500.0)), 1)
    stamps, _, speeds = flight.streams["motors"]
    settled = (stamps > flight.window_s[0] - 1.0) & (stamps < flight.window_s[0])
    thrust = QBALL.thrust(speeds[settled]).sum(axis=1).mean()
    assert thrust == pytest.approx(QBALL.mass_kg * QBALL.gravity_m_s2, rel=1e-3)
    assert _tracking_error(flight) < 0.05


@pytest.mark.parametrize("mass_kg", [0.03, 0.3, 3.0])
@pytest.mark.parametrize(("lag_s", "amplitude_m", "rate_hz"), [(0.02, 1.0, 30.0), (0.1, 0.3, 30.0), (0.1, 1.0, 240.0)])
def test_vehicles_from_30_g_to_3_kg_fly_gentle_and_fast_plans_with_slow_rotors(mass_kg, lag_s, amplitude_m, rate_hz):
    vehicle = vehicle_of(mass_kg, arm_m=0.16 * mass_kg ** (1.0 / 3.0))
    truth = Truth(mass_factor=1.05, inertia_factor=(1.3, 0.8, 1.2), lag=RotorLag(up_s=lag_s, down_s=1.2 * lag_s))
    scenario = LAB.model_copy(update={"truth": truth, "mocap": LAB.mocap.model_copy(update={"rate_hz": rate_hz})})
    flight = simulate(vehicle, rest_to_rest_plan("square", amplitude_m=amplitude_m, periods=1.0), scenario, 2)
    assert _tracking_error(flight) < 0.7


@pytest.mark.parametrize("vehicle", ["qball2", "crazyflie21", "x500"])
@pytest.mark.parametrize("scenario", ["clean", "seed", "lab"])
def test_shipped_vehicles_fly_by_their_own_gains_in_every_laboratory(vehicle, scenario):
    declared = load_vehicle(find_config("vehicles", vehicle))
    world = load_scenario(find_config("scenarios", scenario))
    assert _tracking_error(simulate(declared, rest_to_rest_plan(vehicle, periods=1.0), world, 3)) < 0.15


def test_gains_are_the_files_where_it_has_some_and_tuned_where_it_has_none():
    assert build_law(QBALL, Scenario()).position_p == QBALL.control.position_p
    assert build_law(QBALL, Scenario()).lead_s == 0.0
    bare = vehicle_of()
    copied = vehicle_from_dict(vehicle_to_dict(bare))
    assert build_law(bare, Scenario()).attitude_p == build_law(copied, Scenario()).attitude_p
    slow, quick = (
        build_law(bare, Scenario(truth=Truth(lag=RotorLag(up_s=lag, down_s=lag)))).attitude_d[0] for lag in (0.1, 0.05)
    )
    assert slow < quick


@settings(max_examples=200, deadline=None)
@given(
    st.floats(0.0, 60.0),
    st.tuples(*[st.floats(-5.0, 5.0)] * 3),
    st.sampled_from([QBALL, vehicle_of(), vehicle_of(0.03)]),
)
def test_the_mixer_keeps_every_rotor_within_its_limits_and_gives_small_wrenches_exactly(thrust, torque, vehicle):
    law = build_law(vehicle, Scenario())
    values = np.zeros(4)
    mix(law, thrust, torque, values)
    thrusts = vehicle.thrust(values)
    assert thrusts.min() >= law.rotor_min * (1.0 - 1e-9)
    assert thrusts.max() <= law.rotor_max * (1.0 + 1e-9)
    weight = vehicle.mass_kg * vehicle.gravity_m_s2
    small = 0.001 * weight * vehicle.arm_m() * np.array(torque) * [1.0, 1.0, 0.1]
    mix(law, weight, tuple(small), values)
    np.testing.assert_allclose(vehicle.allocation() @ vehicle.thrust(values), [weight, *small], atol=1e-9 * weight)


def test_the_torque_does_the_work_that_the_law_asks_for_along_the_euler_angles():
    """tau . omega = u . d(eta)/dt for every omega, which is eq. (31) with W^T in place of the printed W^-T."""
    law = build_law(QBALL, Scenario())._replace(attitude_i=(0.0, 0.0, 0.0), attitude_d=(0.0, 0.0, 0.0))
    angles = np.array([0.4, -0.3, 0.1])
    estimate, control, setpoint = np.zeros(ESTIMATE_SIZE), np.zeros(CONTROL_SIZE), np.zeros(SETPOINT_SIZE)
    estimate[6:10] = frames.quat_from_euler(*angles)
    control[FORCE + 2] = law.mass * law.gravity
    setpoint[9] = 0.3
    _, torque = attitude_loop(law, control, estimate, setpoint, 0.002, False)
    u = np.array(law.attitude_p) * ([0.0, 0.0, 0.3] - angles)
    h = 1e-6
    for rate in np.eye(3):
        q = frames.quat_multiply(estimate[6:10], frames.quat_exp(h * rate))
        euler_rate = (frames.euler_from_quat(q) - angles) / h
        assert np.dot(torque, rate) == pytest.approx(u @ euler_rate, abs=1e-5)


def test_saturated_the_mixer_gives_up_yaw_first_and_tilt_last():
    vehicle = vehicle_of()
    law = build_law(vehicle, Scenario())
    weight = vehicle.mass_kg * vehicle.gravity_m_s2
    tilt = 0.3 * weight * vehicle.arm_m()
    values = np.zeros(4)
    mix(law, 10.0 * weight, (tilt, 0.0, 100.0), values)
    wrench = vehicle.allocation() @ vehicle.thrust(values)
    assert wrench[1] == pytest.approx(tilt)
    assert weight < wrench[0] < 2.56 * weight
    assert abs(wrench[3]) < 1.0


def test_the_lead_undoes_a_known_lag_but_for_its_share():
    """Lag T after the lead answers a step as a lag of LEAD_RATIO T would."""
    vehicle = vehicle_of()
    law = build_law(vehicle, Scenario(truth=Truth(lag=RotorLag(up_s=0.1, down_s=0.1))))
    assert law.lead_s == pytest.approx(0.1)
    dt, low, high = 0.0005, 500.0, 505.0
    law = law._replace(lead_share=1.0 - exp(-dt / (LEAD_RATIO * law.lead_s)))
    state, speed = np.full(4, low), low
    for _ in range(round(LEAD_RATIO * 0.1 / dt)):
        values = np.full(4, high)
        lead(law, state, values)
        speed += dt / 0.1 * (values[0] - speed)
    assert (speed - low) / (high - low) == pytest.approx(1.0 - np.exp(-1.0), abs=0.01)


def test_motor_values_invert_the_declared_thrust_for_every_kind_of_vehicle():
    kinds = [
        vehicle_of(),
        vehicle_of(input="command"),
        vehicle_of(input="command", thrust_curve=(0.05, 1.0, 3.0)),
        vehicle_of(input="command", thrust_curve=(0.0, 5.0, 0.0)),
        vehicle_of(input="wrench"),
    ]
    for vehicle in kinds:
        law = build_law(vehicle, Scenario())
        value = motor_value(law, 2.0)
        given_back = value if vehicle.rotors.input == "wrench" else float(vehicle.thrust(value))
        assert given_back == pytest.approx(2.0)
        plan = rest_to_rest_plan("square", amplitude_m=0.2, periods=1.0)
        flight = simulate(vehicle, plan, Scenario(), 1)
        assert _tracking_error(flight) < 0.1


def test_a_path_at_the_edge_of_a_rotors_thrust_is_flown_and_past_it_refused():
    from groundstation.trajectory import flight_path

    path = flight_path(rest_to_rest_plan("square"), np.array([0.0, 0.0, 0.1, 0.0]))
    strong, weak = vehicle_of(speed_max_rad_s=560.0), vehicle_of(speed_max_rad_s=500.0)
    assert why_not(strong, path, 0.1) == ""
    assert "keep" in why_not(weak, path, 0.1) or "kept" in why_not(weak, path, 0.1)


def test_simulation_runs_at_least_fifty_times_real_time_with_all_sensors_on():
    scenario = LAB.model_copy(update={"mocap": MocapModel(rate_hz=240.0, position_std_m=1e-4)})
    plan = rest_to_rest_plan(periods=2.0)
    simulate(QBALL, plan, scenario, 1)
    started = time.process_time()
    flight = simulate(QBALL, plan, scenario, 2)
    spent = time.process_time() - started
    assert flight.streams["imu"][1][-1] / spent > 50.0
