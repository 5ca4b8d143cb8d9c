"""The regressors against the rigid body's own equations on random states."""

import numpy as np
import pytest
from seed_exact import table_2

from groundstation.identification.regressors import (
    coriolis_gravity_regressor,
    momentum_regressor,
    six_row_regressor,
    standard_regressor,
)
from groundstation.trajectory import rigid_motion


@pytest.fixture
def state():
    rng = np.random.default_rng(1)
    k = 200
    return {
        "velocity": rng.normal(size=(k, 3)),
        "rate": rng.normal(size=(k, 3)),
        "rate_derivative": rng.normal(size=(k, 3)),
        "velocity_derivative": rng.normal(size=(k, 3)),
        "gravity": rng.normal(size=(k, 3)),
    }


def random_parameters(rng):
    a = rng.normal(size=(3, 3))
    tensor = a @ a.T
    theta = np.array([1.7, *tensor[np.triu_indices(3)]])
    return theta, tensor


def test_six_rows_are_newton_and_euler(state):
    theta, tensor = random_parameters(np.random.default_rng(2))
    w, dw = state["rate"], state["rate_derivative"]
    specific = state["velocity_derivative"] + np.cross(w, state["velocity"]) + state["gravity"]
    torque = dw @ tensor.T + np.cross(w, w @ tensor.T)
    expected = np.column_stack([theta[0] * specific, torque])
    np.testing.assert_allclose(six_row_regressor(specific, w, dw) @ theta, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(
        standard_regressor(specific[:, 2], w, dw) @ theta, expected[:, 2:], rtol=1e-12, atol=1e-12
    )


def test_filtered_pair_of_regressors_is_momentum_and_the_rest(state):
    theta, tensor = random_parameters(np.random.default_rng(3))
    v, w, g = state["velocity"], state["rate"], state["gravity"]
    momentum = np.column_stack([theta[0] * v[:, 2], w @ tensor.T])
    rest = np.column_stack([theta[0] * (np.cross(w, v) + g)[:, 2], np.cross(w, w @ tensor.T)])
    np.testing.assert_allclose(momentum_regressor(v, w) @ theta, momentum, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(coriolis_gravity_regressor(v, w, g) @ theta, rest, rtol=1e-12, atol=1e-12)


def test_published_trajectory_has_the_published_condition_number():
    """Paper-notes: cond(W) = 16.22 over one period at 2 ms, 1.479 for the six inertia columns."""
    motion = rigid_motion(table_2(1.0).sample(np.arange(0.0, 10.0, 0.002)), 9.81)
    w = standard_regressor(
        motion.specific_thrust_m_s2, motion.angular_velocity_body_rad_s, motion.angular_acceleration_body_rad_s2
    )
    assert np.linalg.cond(w.reshape(-1, 7)) == pytest.approx(16.22, abs=0.01)
    assert np.linalg.cond(w[:, 1:, 1:].reshape(-1, 6)) == pytest.approx(1.479, abs=0.001)
