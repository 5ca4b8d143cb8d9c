"""Streams of different rates and clocks come together as stated, and nothing is made up."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from seed_exact import exact_flight, table_2, true_vehicle

from groundstation.errors import NotIdentifiable
from groundstation.flightdata import STATE_COLUMNS, Stream
from groundstation.frames import quat_exp, quat_from_euler, quat_multiply, quat_rotate, slerp
from groundstation.identification.seed_signals import (
    Processing,
    differentiated_noise_gain,
    interpolate,
    process_flight,
    white_noise_std,
)
from groundstation.identification.streams import excitation_window
from groundstation.identification.wrench import declared_wrench, held_mean
from groundstation.paths import find_config
from groundstation.trajectory import rigid_motion
from groundstation.vehicle import load_vehicle, vehicle_from_dict, vehicle_to_dict


@pytest.fixture(scope="module")
def declared():
    return load_vehicle(find_config("vehicles", "qball2"))


@pytest.fixture(scope="module")
def flight(declared):
    return exact_flight(declared, true_vehicle(declared), series=table_2(2.0))


def exact(signals):
    return rigid_motion(table_2(2.0).sample(signals.t_s), 9.80665)


def test_signals_are_those_of_the_motion(flight):
    s = process_flight(flight)
    m = exact(s)
    u = s.used
    scale = np.abs(m.angular_acceleration_body_rad_s2[u]).max()
    np.testing.assert_allclose(s.rate[u], m.angular_velocity_body_rad_s[u], atol=2e-3)
    np.testing.assert_allclose(s.rate_derivative[u], m.angular_acceleration_body_rad_s2[u], atol=0.02 * scale)
    np.testing.assert_allclose(s.specific_force[u, 2], m.specific_thrust_m_s2[u], atol=5e-3)
    velocity = quat_rotate(quat_from_euler(*m.euler_rad.T), s.velocity_body)
    np.testing.assert_allclose(velocity[u], m.velocity_world_m_s[u], atol=5e-3)
    assert s.specific_force_source == "accelerometer"


def test_a_clock_offset_that_is_told_is_undone(declared, flight):
    shifted = exact_flight(declared, true_vehicle(declared), series=table_2(2.0), mocap_minus_imu_s=0.124)
    a, b = process_flight(flight), process_flight(shifted, Processing(mocap_minus_imu_s=0.124))
    wrong = process_flight(shifted)
    early, late = np.searchsorted(a.t_s, 5.0), np.searchsorted(b.t_s, 5.0)
    n = 4000
    np.testing.assert_allclose(a.velocity_body[early : early + n], b.velocity_body[late : late + n], atol=2e-3)
    there = np.searchsorted(wrong.t_s, 5.0)
    assert np.abs(wrong.velocity_body[there : there + n] - a.velocity_body[early : early + n]).max() > 0.03


def test_marker_offset_and_rotation_are_undone(declared, flight):
    document = vehicle_to_dict(declared)
    document["mocap"] = {"position_m": [0.05, -0.03, 0.1], "rotation_rad": [0.1, -0.2, 0.5]}
    mounted = vehicle_from_dict(document)
    q, p = flight.mocap.values[:, 3:], flight.mocap.values[:, :3]
    moved = np.column_stack(
        [p + quat_rotate(q, np.array([0.05, -0.03, 0.1])), quat_multiply(q, quat_exp([0.1, -0.2, 0.5]))]
    )
    other = replace(flight, vehicle=mounted, mocap=Stream(flight.mocap.t_s, moved, flight.mocap.columns))
    np.testing.assert_allclose(process_flight(other).velocity_body, process_flight(flight).velocity_body, atol=1e-10)


def test_accelerometer_lever_arm_is_removed(declared, flight):
    document = vehicle_to_dict(declared)
    document["imu"] = {"position_m": [0.1, 0.2, -0.05]}
    m = rigid_motion(table_2(2.0).sample(flight.imu.t_s), 9.80665)
    w, dw = m.angular_velocity_body_rad_s, m.angular_acceleration_body_rad_s2
    r = np.array([0.1, 0.2, -0.05])
    imu = flight.imu.values.copy()
    imu[:, 3:] += np.cross(dw, r) + np.cross(w, np.cross(w, r))
    moved = replace(
        flight, vehicle=vehicle_from_dict(document), imu=Stream(flight.imu.t_s, imu, flight.imu.columns), mocap=None
    )
    a, b = process_flight(moved), process_flight(replace(flight, mocap=None))
    np.testing.assert_allclose(a.specific_force[a.used], b.specific_force[b.used], atol=4e-3)


def test_the_accelerometer_is_used_only_where_it_is_quieter(declared):
    quiet = exact_flight(declared, true_vehicle(declared), accel_noise=0.02, position_noise=1e-3, series=table_2(2.0))
    loud = exact_flight(
        declared, true_vehicle(declared), accel_noise=20.0, position_noise=1e-5, mocap_hz=240.0, series=table_2(2.0)
    )
    assert process_flight(quiet).specific_force_source == "accelerometer"
    assert process_flight(loud).specific_force_source == "positions"


def test_accelerometer_bias_is_held_to_the_poses(flight):
    imu = flight.imu.values.copy()
    imu[:, 5] += 0.3
    biased = process_flight(replace(flight, imu=Stream(flight.imu.t_s, imu, flight.imu.columns)))
    plain = process_flight(flight)
    np.testing.assert_allclose(biased.specific_force, plain.specific_force, atol=1e-6)


def test_without_poses_motion_capture_or_imu_each_says_what_is_left_out(flight, declared):
    imu_only = process_flight(replace(flight, mocap=None))
    assert imu_only.velocity_body is None
    assert any("No poses" in note for note in imu_only.notes)

    poses_only = process_flight(replace(flight, imu=None))
    m = exact(poses_only)
    u = poses_only.used
    np.testing.assert_allclose(poses_only.rate[u], m.angular_velocity_body_rad_s[u], atol=0.02)
    assert poses_only.specific_force_source == "positions"
    assert any("No IMU" in note for note in poses_only.notes)

    t = np.arange(0.0, 20.0, 0.01)
    m = rigid_motion(table_2(2.0).sample(t), 9.80665)
    q = quat_from_euler(*m.euler_rad.T)
    values = np.column_stack([m.position_m, m.velocity_world_m_s, q, m.angular_velocity_body_rad_s])
    state_only = process_flight(replace(flight, imu=None, mocap=None, state=Stream(t, values, STATE_COLUMNS)))
    u = state_only.used
    np.testing.assert_allclose(state_only.specific_force[u, 2], exact(state_only).specific_thrust_m_s2[u], atol=0.02)
    assert state_only.specific_force_source == "state"

    with pytest.raises(NotIdentifiable, match="neither"):
        process_flight(replace(flight, imu=None, mocap=None))


def test_excluded_segments_and_gaps_are_not_used_nor_do_they_leak(flight):
    spoiled = flight.imu.values.copy()
    bad = (flight.imu.t_s > 10.0) & (flight.imu.t_s < 11.0)
    spoiled[bad] = 1e3
    keep = (flight.mocap.t_s < 14.0) | (flight.mocap.t_s > 14.5)
    holed = replace(flight, imu=Stream(flight.imu.t_s, spoiled, flight.imu.columns), mocap=flight.mocap.select(keep))
    s = process_flight(holed, Processing(exclude=((10.0, 11.0),)))
    inside = (s.t_s > 10.0) & (s.t_s < 11.0) | (s.t_s > 14.05) & (s.t_s < 14.45)
    assert not s.used[inside].any()
    m = exact(s)
    np.testing.assert_allclose(s.rate[s.used], m.angular_velocity_body_rad_s[s.used], atol=0.02)


def test_nothing_is_extrapolated(flight):
    late = replace(flight, mocap=flight.mocap.select((flight.mocap.t_s > 6.0) & (flight.mocap.t_s < 15.0)))
    s = process_flight(late)
    assert s.t_s[0] >= late.mocap.t_s[0]
    assert s.t_s[-1] <= late.mocap.t_s[-1]
    with pytest.raises(NotIdentifiable, match="overlap"):
        process_flight(replace(flight, mocap=flight.mocap.select(flight.mocap.t_s < 3.0)))


def test_window_is_the_excitation_less_the_transient_or_the_airborne_part(flight):
    assert excitation_window(replace(flight, window_s=(0.0, 50.0))) == (10.0, 50.0)
    assert excitation_window(replace(flight, window_s=(5.0, 15.0))) == (7.0, 15.0)
    motors = flight.motors.values.copy()
    t = flight.motors.t_s
    motors[(t < 3.0) | (t > 16.0)] *= 0.2
    start, end = excitation_window(replace(flight, window_s=None, motors=Stream(t, motors, flight.motors.columns)))
    assert start == pytest.approx(4.0, abs=0.01)
    assert end == pytest.approx(15.0, abs=0.01)
    with pytest.raises(NotIdentifiable, match="thrust"):
        excitation_window(replace(flight, window_s=None, motors=Stream(t, 0.0 * motors, flight.motors.columns)))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_slerp_meets_its_samples_and_halves_the_way(seed):
    rng = np.random.default_rng(seed)
    stamps = np.cumsum(rng.uniform(0.01, 0.1, 6))
    q = rng.normal(size=(6, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    at = slerp(stamps, stamps, q)
    np.testing.assert_allclose(np.abs(np.sum(at * q, axis=1)), 1.0, atol=1e-9)
    middle = slerp(0.5 * (stamps[1:] + stamps[:-1]), stamps, q)
    first = np.abs(np.sum(middle * q[:-1], axis=1))
    second = np.abs(np.sum(middle * q[1:], axis=1))
    np.testing.assert_allclose(first, second, atol=1e-9)


def test_linear_interpolation_is_linear():
    stamps = np.array([0.0, 1.0, 1.5])
    values = np.array([[0.0], [2.0], [4.0]])
    np.testing.assert_allclose(interpolate([0.0, 0.5, 1.25, 1.5], stamps, values)[:, 0], [0.0, 1.0, 3.0, 4.0])


def test_held_values_are_averaged_over_the_cell():
    stamps = np.array([0.0, 1.0, 2.0, 3.0, 4.0])
    values = np.array([[1.0], [2.0], [4.0], [8.0], [8.0]])
    out = held_mean(np.array([0.5, 1.5, 2.5]), stamps, values)
    np.testing.assert_allclose(out[:, 0], [1.0, 2.0, 4.0])
    np.testing.assert_allclose(held_mean(np.array([1.0, 2.0]), stamps, values)[:, 0], [1.5, 3.0])


def test_declared_lag_is_applied_to_what_was_commanded_and_only_to_that(declared):
    from groundstation.flightdata import motor_columns

    document = vehicle_to_dict(declared)
    document["rotors"] |= {"speed_source": "command", "lag": {"up_s": 0.05, "down_s": 0.1}}
    t = 0.002 * np.arange(1000)
    for start, end, tau in ((300.0, 400.0, 0.05), (400.0, 300.0, 0.1)):
        speed = np.where(t < 0.5, start, end)[:, None] * np.ones(4)
        stream = Stream(t, speed, motor_columns("rotor_speed", 4))
        lagging = declared_wrench(vehicle_from_dict(document), stream, None, t)[:, 0]
        expected = end + (start - end) * np.exp(-0.1 / tau)
        at = np.searchsorted(t, 0.6)
        k = declared.rotors.thrust_coefficient_n_s2
        assert lagging[at] == pytest.approx(4 * k * expected**2, rel=3e-3)
        document["rotors"]["speed_source"] = "telemetry"
        measured = declared_wrench(vehicle_from_dict(document), stream, None, t)[:, 0]
        assert measured[at] == pytest.approx(4 * k * end**2, rel=1e-9)
        document["rotors"]["speed_source"] = "command"


def test_declared_wrench_of_a_hover_is_the_weight(declared):
    from groundstation.flightdata import motor_columns

    hover = declared.motor_for_thrust(np.full((100, 4), declared.mass_kg * 9.80665 / 4))
    t = 0.002 * np.arange(100)
    wrench = declared_wrench(declared, Stream(t, hover, motor_columns("rotor_speed", 4)), None, t)
    np.testing.assert_allclose(wrench, [[declared.mass_kg * 9.80665, 0, 0, 0]] * 100, atol=1e-9)


def test_noise_is_measured_through_motion_and_predicted_through_the_filter():
    from groundstation.identification.filters import central_difference, zero_phase_low_pass

    rng = np.random.default_rng(5)
    t = 0.002 * np.arange(25000)
    x = np.sin(2 * np.pi * 0.5 * t)[:, None] + 0.01 * rng.normal(size=(25000, 1))
    assert white_noise_std(x)[0] == pytest.approx(0.01, rel=0.05)
    noise = 0.01 * rng.normal(size=25000)
    left = np.std(central_difference(zero_phase_low_pass(noise, 10.0, 0.002), 0.002))
    assert left == pytest.approx(0.01 * differentiated_noise_gain(1, 10.0, 500.0), rel=0.35)
