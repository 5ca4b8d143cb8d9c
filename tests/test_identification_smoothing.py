"""The smoother of attitudes against the dense Gaussian posterior, and against a bias that walks."""

from __future__ import annotations

import numpy as np
import pytest
from flights import laboratory
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from groundstation.identification.preparation import prepare
from groundstation.identification.smoothing import integrated_level
from groundstation.identification.streams import stretches_in_the_air
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from studies.flown import flight_data


def _dense(z: np.ndarray, dt: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Posterior mean of the level: transition and noise of each step by Van Loan's matrix exponential (1978)."""
    sigma, tau, q, r = noise
    a, spread = np.array([[0.0, 1.0], [0.0, -1.0 / tau]]), np.diag([q * q, 2.0 * sigma**2 / tau])
    count = len(z)
    covariance = np.zeros((2 * count, 2 * count))
    covariance[:2, :2] = np.diag([1e4, sigma**2])
    for i in range(1, count):
        both = expm(np.block([[-a, spread], [np.zeros((2, 2)), a.T]]) * dt[i])
        step = both[2:, 2:].T
        now, before = slice(2 * i, 2 * i + 2), slice(2 * i - 2, 2 * i)
        covariance[now, : 2 * i] = step @ covariance[before, : 2 * i]
        covariance[: 2 * i, now] = covariance[now, : 2 * i].T
        covariance[now, now] = step @ covariance[before, before] @ step.T + step @ both[:2, 2:]
    level = covariance[::2, ::2]
    return level @ np.linalg.solve(level + r * r * np.eye(count), z)


@settings(max_examples=25, deadline=None)
@given(st.floats(0.0, 1.0), st.floats(0.05, 50.0), st.floats(0.01, 1.0), st.floats(0.1, 1.0), st.integers(0, 2**31 - 1))
def test_the_smoothed_level_is_the_posterior_mean(sigma, tau, q, r, seed):
    random = np.random.default_rng(seed)
    dt = np.concatenate([[0.0], random.uniform(0.005, 0.3, 39)])
    z = np.cumsum(random.standard_normal((40, 2)) * 0.3, axis=0)
    noise = np.array([sigma, tau, q, r])
    filtered, smoothed = integrated_level(z, dt, noise)
    assert smoothed == pytest.approx(_dense(z, dt, noise), abs=2e-3)
    assert filtered[-1] == pytest.approx(smoothed[-1])


def test_a_gap_of_unknown_turning_parts_the_level():
    z = np.concatenate([np.zeros((30, 1)), np.full((30, 1), 7.0)])
    dt = np.full(60, 0.01)
    dt[30] = 1e12
    for sigma in (0.0, 2e-4):
        filtered, smoothed = integrated_level(z, dt, np.array([sigma, 40.0, 1e-4, 1e-3]))
        assert np.abs(smoothed[:30]).max() < 1e-6 and np.abs(smoothed[30:] - 7.0).max() < 1e-6
        assert filtered[30] == pytest.approx(7.0)


@pytest.mark.parametrize("seed", [900, 913])
def test_a_knock_of_the_ground_and_a_walking_bias_tilt_no_room(seed):
    """The simulated ground sets the vehicle upright faster than its gyro sees, by 20 mrad beside this offset."""
    print("seed", seed)
    vehicle, plan = load_vehicle(find_config("vehicles", "x500")), load_plan(find_config("plans", "qball2"))
    flight = flight_data(simulate(vehicle, plan, laboratory(com_offset={"offset_m": [0.0, 0.009, 0.0]}), seed))
    ((begin, end),) = stretches_in_the_air(flight)
    found = prepare(flight).compatibility
    assert found is not None and begin < flight.window_s[0] and end > flight.window_s[1]
    for name in ("mocap_tilt_x_rad", "mocap_tilt_y_rad", "mocap_rotation_x_rad", "mocap_rotation_y_rad"):
        assert abs(found.values[name]) < 4.0 * found.std[name] < 1e-3, name
