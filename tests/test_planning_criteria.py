"""The published numbers, and the regressor and information against independent ways to the same value."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from groundstation.errors import BadInput
from groundstation.frames import matrix_from_quat, quat_from_euler
from groundstation.planning.criteria import (
    PARAMETERS,
    condition_number,
    inertia_regressor,
    regressor,
    stacked_regressor,
)
from groundstation.planning.information import (
    DEFAULT_NOISE,
    Noise,
    information,
    parameters,
    percentages,
    predicted_std,
    signals,
)
from groundstation.planning.limits import envelope, excesses, wrench
from groundstation.planning.plan import PAPER_START, paper_plan, paper_problem
from groundstation.trajectory import FourierSeries, rigid_motion

PAPER_GRAVITY = 9.81


@pytest.fixture(scope="module")
def published() -> FourierSeries:
    return paper_plan().series()


@pytest.fixture(scope="module")
def qball():
    return paper_problem()["vehicle"]


def one_period(series: FourierSeries, gravity: float = PAPER_GRAVITY):
    t = np.arange(5000) * 0.002
    return rigid_motion(series.sample(t), gravity)


def test_table_2_has_the_published_condition_number_tilt_and_yaw_rate(published):
    assert condition_number(published, PAPER_GRAVITY) == pytest.approx(16.22, abs=0.005)
    inertia_columns = stacked_regressor(dataclasses.replace(published, periods=1.0), PAPER_GRAVITY)[:, 1:]
    assert np.linalg.cond(inertia_columns) == pytest.approx(1.479, abs=0.001)
    motion = one_period(published)
    roll, pitch = np.degrees(np.abs(motion.euler_rad[:, :2]).max(axis=0))
    assert roll == pytest.approx(6.2153, abs=2e-4)
    assert pitch == pytest.approx(6.0697, abs=2e-3)
    assert np.abs(motion.euler_rate_rad_s[:, 2]).max() == pytest.approx(0.5014, abs=1e-4)


def test_table_2_starts_and_ends_where_the_paper_says_to_its_printed_digits(published):
    ends = published.derivatives([0.0, published.period_s], 2)
    assert ends[0] == pytest.approx(np.array([PAPER_START, PAPER_START]), abs=2e-4)
    assert ends[1:] == pytest.approx(0.0, abs=3e-4)


def test_regressor_times_parameters_is_the_newton_euler_wrench():
    rng = np.random.default_rng(1)
    rate, turning = rng.normal(size=(2, 50, 3))
    entries = np.array([0.03, 0.002, -0.001, 0.025, 0.0015, 0.04])
    tensor = np.empty((3, 3))
    tensor[np.triu_indices(3)] = entries
    tensor.T[np.triu_indices(3)] = entries
    expected = turning @ tensor + np.cross(rate, rate @ tensor)
    assert inertia_regressor(rate, turning) @ entries == pytest.approx(expected, abs=1e-12)


def test_thrust_carries_acceleration_plus_gravity(published):
    motion = one_period(published)
    felt = motion.acceleration_world_m_s2 + np.array([0.0, 0.0, PAPER_GRAVITY])
    rotation = matrix_from_quat(quat_from_euler(*motion.euler_rad.T))
    body = np.einsum("kji,kj->ki", rotation, felt)
    assert body[:, :2] == pytest.approx(0.0, abs=1e-12)
    assert regressor(motion)[:, 0, 0] == pytest.approx(body[:, 2], abs=1e-12)


def test_body_velocity_signal_is_the_rotated_world_velocity(published):
    motion = one_period(published)
    rotation = matrix_from_quat(quat_from_euler(*motion.euler_rad.T))
    expected = np.einsum("kji,kj->ki", rotation, motion.velocity_world_m_s)
    assert signals(motion)[:, 19:22] == pytest.approx(expected, abs=1e-12)


def test_wrench_of_a_motion_is_the_regressor_times_the_nominal_parameters(published, qball):
    motion = one_period(published, qball.gravity_m_s2)
    tensor = qball.inertia_tensor()
    theta = np.concatenate([[qball.mass_kg], tensor[np.triu_indices(3)]])
    assert regressor(motion) @ theta == pytest.approx(wrench(motion, envelope(qball)), abs=1e-12)


def test_information_in_white_noise_is_the_ordinary_least_squares_information(published, qball):
    """With a disturbance far whiter than the motion, M must equal Gamma^T Gamma dt / S summed in the time domain."""
    noise = Noise(correlation_s=1e-5, gyro_rad_s_rthz=0.0, accelerometer_m_s2_rthz=0.0)
    spectrum = noise.spectra(qball, np.zeros(1))[:, 0]
    phi = regressor(rigid_motion(published.sample(np.arange(20000) * 0.002), qball.gravity_m_s2))
    scales = np.array([p.scale for p in parameters(qball)])
    expected = np.einsum("krp,r,krq->pq", phi, 0.002 / spectrum[2:], phi) * np.outer(scales, scales)
    assert information(published, qball, noise) == pytest.approx(expected, rel=1e-6, abs=1e-6 * expected.max())


def test_predicted_spread_is_that_of_whitened_estimates_in_simulated_coloured_noise(published, qball):
    """Generalised least squares on synthetic wrenches with Ornstein-Uhlenbeck noise scatters as predicted."""
    rng = np.random.default_rng(7)
    step, decay = 0.02, np.exp(-0.02 / DEFAULT_NOISE.correlation_s)
    t = np.arange(2000) * step
    phi = regressor(rigid_motion(published.sample(t), qball.gravity_m_s2))
    weight = qball.mass_kg * qball.gravity_m_s2
    rms = np.array([1.0, *[qball.arm_m()] * 3]) * 0.003 * weight
    flights = 300
    noise = np.empty((flights, len(t), 4))
    noise[:, 0] = rng.normal(size=(flights, 4))
    for k in range(1, len(t)):
        noise[:, k] = decay * noise[:, k - 1] + np.sqrt(1 - decay**2) * rng.normal(size=(flights, 4))
    noise *= rms

    def whiten(values):
        return (values[..., 1:, :] - decay * values[..., :-1, :]) / rms

    gamma = ((phi[1:] - decay * phi[:-1]) / rms[:, None]).reshape(-1, 7)
    errors = np.linalg.lstsq(gamma, whiten(noise).reshape(flights, -1).T, rcond=None)[0]
    quiet = Noise(gyro_rad_s_rthz=0.0, accelerometer_m_s2_rthz=0.0)
    predicted = predicted_std(published, qball, quiet)
    for name, scatter in zip(PARAMETERS, errors.std(axis=1), strict=True):
        assert predicted[name] == pytest.approx(scatter, rel=0.15), name


def test_four_periods_halve_the_spread_of_one(published, qball):
    one = predicted_std(dataclasses.replace(published, periods=1.0), qball)
    four = predicted_std(published, qball)
    assert all(four[name] == pytest.approx(one[name] / 2.0) for name in one)


def test_a_hover_reveals_mass_and_no_inertia(qball):
    hover = FourierSeries(np.zeros((4, 3)), np.zeros((4, 3)), np.array([0.0, 0.0, 1.0, 0.0]), 0.5, 4.0)
    std = predicted_std(hover, qball)
    assert np.isfinite(std["mass_kg"])
    assert all(np.isinf(std[name]) for name in PARAMETERS[1:])


def test_estimating_effects_too_never_sharpens_a_parameter(published, qball):
    alone = predicted_std(published, qball)
    effects = ("rotor_drag", "com_offset", "angular_damping", "motor_lag", "flapping_moment")
    together = predicted_std(published, qball, effects=effects)
    assert all(together[name] >= alone[name] * (1 - 1e-9) for name in alone)
    assert set(together) - set(alone) >= {"d_x_kg_s", "com_offset_x_m", "damping_z_nms", "rotor_lag_s", "k_nm_s_m"}


def test_lag_and_delay_are_told_apart_only_by_fast_motion(qball):
    """At the 0.5 Hz of a position series they nearly coincide; three times as fast they separate better."""
    slow = paper_plan().series()
    fast = dataclasses.replace(slow, base_frequency_rad_s=3.0 * slow.base_frequency_rad_s, periods=12.0)

    def penalty(series: FourierSeries) -> float:
        both = predicted_std(series, qball, effects=("motor_lag", "input_delay"))["rotor_lag_s"]
        return both / predicted_std(series, qball, effects=("motor_lag",))["rotor_lag_s"]

    assert penalty(slow) > 2.0 * penalty(fast)


def test_percentages_are_relative_to_the_nominal_values(published, qball):
    std = predicted_std(published, qball)
    assert percentages(std, qball)["mass_kg"] == pytest.approx(100.0 * std["mass_kg"] / qball.mass_kg)


def test_unknown_effect_is_refused_by_name_with_the_known_ones(published, qball):
    with pytest.raises(BadInput, match=r"wind.*rotor_drag"):
        predicted_std(published, qball, effects=("wind",))


def test_excesses_name_what_table_2_exceeds(published, qball):
    over = {
        name
        for name, excess in excesses(one_period(published, qball.gravity_m_s2), envelope(qball)).items()
        if excess > 1e-4
    }
    assert over == {"tilt_max_rad", "yaw_rate_max_rad_s"}
