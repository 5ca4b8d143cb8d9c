"""The noise model of the prediction error estimate: innovations of planted colour are white, of unit variance, and
found.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from groundstation.identification.noise import (
    NoiseModel,
    Passing,
    fit_noise_model,
    innovations,
    minus_log_likelihood,
    whitening_polynomial,
)
from groundstation.model.rotors import cumulative, interpolate_columns, motor_input

STEP_S = 1 / 150.0
PLANTED = NoiseModel(disturbance=2.0, correlation_s=0.5, process=0.02, sensor=0.003)
ACCELEROMETER = NoiseModel(disturbance=0.2, correlation_s=0.4, process=1e-6, sensor=0.05)


def planted(colour: NoiseModel, count: int, seed: int, *, integrated: bool) -> np.ndarray:
    """z of the module's docstring, simulated ten times finer than it is sampled."""
    random = np.random.default_rng(seed)
    fine = 10
    h = STEP_S / fine
    phi = np.exp(-h / colour.correlation_s)
    drive = colour.disturbance * np.sqrt(1.0 - phi**2) * random.standard_normal(count * fine)
    disturbance = np.asarray(lfilter([1.0], [1.0, -phi], drive))
    sensor = colour.sensor * random.standard_normal(count)
    if not integrated:
        return disturbance[::fine] + sensor
    walk = disturbance * h + colour.process * np.sqrt(h) * random.standard_normal(count * fine)
    return np.cumsum(walk)[::fine] + sensor


def segments(count: int, restarts: tuple[int, ...] = (0,)) -> tuple[np.ndarray, np.ndarray]:
    """Steps and restarts of evenly sampled data."""
    restart = np.zeros(count, bool)
    restart[list(restarts)] = True
    return np.full(count, STEP_S), restart


def whiteness(e: np.ndarray, lags: int = 20) -> float:
    """Ljung-Box statistic over its expectation (1 for white data)."""
    e = e - e.mean()
    correlation = np.array([np.mean(e[k:] * e[:-k]) for k in range(1, lags + 1)]) / np.mean(e**2)
    return float(len(e) * np.sum(correlation**2) / lags)


@pytest.mark.parametrize(("colour", "integrated"), [(PLANTED, True), (ACCELEROMETER, False)])
def test_innovations_of_the_planted_colour_are_white_and_of_unit_variance(colour: NoiseModel, integrated: bool) -> None:
    count = 6000
    z = planted(colour, count, 3, integrated=integrated)
    dt, restart = segments(count, (0, 2500))
    e, s = innovations(z[:, None], dt, restart, colour, integrated=integrated)
    known = np.isfinite(s)
    normalised = e[known, 0] / np.sqrt(s[known])
    settled = normalised[200:2300]
    assert np.var(settled) == pytest.approx(1.0, abs=0.12)  # 4 standard deviations of a variance of 2100
    assert whiteness(settled) < 2.0
    if integrated:
        assert not known[2500], "the level is unknown where a segment begins"
    wrong = NoiseModel(colour.disturbance * 0.1, colour.correlation_s, colour.process * 0.1, colour.sensor)
    e, s = innovations(z[:, None], dt, restart, wrong, integrated=integrated)
    assert whiteness(e[200:2300, 0] / np.sqrt(s[200:2300])) > 3.0, "a wrong colour must show"


def test_sensitivities_pass_the_same_linear_filter() -> None:
    z = np.random.default_rng(0).standard_normal((400, 3))
    dt, restart = segments(400, (0, 150))
    mixed = np.column_stack([z, z @ [2.0, -1.0, 0.5]])
    for integrated in (True, False):
        e, _ = innovations(mixed, dt, restart, PLANTED, integrated=integrated)
        np.testing.assert_allclose(e[:, 3], e[:, :3] @ [2.0, -1.0, 0.5], rtol=0, atol=1e-12)


def test_columns_that_are_picked_from_others_are_whitened_as_when_they_are_handed_over() -> None:
    print("seed", 1)
    rows = np.random.default_rng(1).standard_normal((12, 400))
    steps, rest = segments(400, (0, 150)), np.array([1.0, -0.4])
    shown = np.array([0, 2, 3, 4, 5, 7, 8, 9, 10])
    for integrated in (True, False):
        picked, _ = Passing(PLANTED, rest, integrated=integrated)(rows[:1], steps, rows[1:], shown)
        handed, _ = Passing(PLANTED, rest, integrated=integrated)(rows[[0, *(1 + shown)]], steps)
        assert np.array_equal(picked, handed)


def test_a_constant_offset_of_an_integrated_channel_is_invisible() -> None:
    z = planted(PLANTED, 500, 1, integrated=True)[:, None]
    dt, restart = segments(500)
    first, _ = innovations(z, dt, restart, PLANTED, integrated=True)
    second, _ = innovations(z + 7.0, dt, restart, PLANTED, integrated=True)
    np.testing.assert_allclose(first, second, rtol=0, atol=1e-12)


@pytest.mark.parametrize("integrated", [True, False])
def test_the_colour_of_a_channel_is_found_from_its_residual(integrated: bool) -> None:
    colour = PLANTED if integrated else ACCELEROMETER
    z = planted(colour, 6000, 5, integrated=integrated)
    dt, restart = segments(6000)
    found = fit_noise_model(z, dt, restart, integrated=integrated)
    assert found.disturbance == pytest.approx(colour.disturbance, rel=0.3)
    assert found.correlation_s == pytest.approx(colour.correlation_s, rel=0.5)
    if not integrated:
        white = np.hypot(found.sensor, found.process / np.sqrt(STEP_S))  # one and the same at an even rate
        assert white == pytest.approx(colour.sensor, rel=0.1)
    # no worse than the truth: the search ends at the top of the likelihood, not on its way there
    assert minus_log_likelihood(z, dt, restart, found, integrated) < 2.0 + minus_log_likelihood(
        z, dt, restart, colour, integrated
    )


@pytest.mark.parametrize("integrated", [True, False])
@pytest.mark.parametrize("size", [1.0, 1e-11])
def test_the_likelihood_is_that_of_the_innovations_however_small(integrated: bool, size: float) -> None:
    colour = NoiseModel(*(PLANTED.vector() * [size, 1.0, size, size]))
    z = size * planted(PLANTED, 500, 1, integrated=integrated)
    dt, restart = segments(500, (0, 8, 200))
    e, s = innovations(z[:, None], dt, restart, colour, integrated=integrated)
    square = e[np.isfinite(s), 0] ** 2 / s[np.isfinite(s)]
    expected = np.sum(0.5 * np.log(s[np.isfinite(s)]) + 16.0 * (np.sqrt(1.0 + square / 16.0) - 1.0))
    assert minus_log_likelihood(z, dt, restart, colour, integrated) == pytest.approx(expected, rel=1e-10)


def test_the_whitening_polynomial_undoes_an_autoregression() -> None:
    a = np.array([1.0, -1.2, 0.5])
    x = np.asarray(lfilter([1.0], a, np.random.default_rng(2).standard_normal(8000)))
    x = x / np.std(x)  # as normalised innovations are: outliers are clipped at five sigma
    restart = np.zeros(8000, bool)
    polynomial = whitening_polynomial(x, restart)
    np.testing.assert_allclose(polynomial[:3], a, atol=0.05)
    assert whiteness(x) > 100.0
    assert whiteness(lfilter(polynomial, [1.0], x)[50:]) < 2.0


def test_white_innovations_are_left_alone() -> None:
    x = np.random.default_rng(4).standard_normal(5000)
    assert len(whitening_polynomial(x, np.zeros(5000, bool))) == 1


# Rotors behind a lag.


@given(tau=st.floats(0.005, 0.3), start=st.floats(-2.0, 2.0), end=st.floats(-2.0, 2.0))
@settings(max_examples=50, deadline=None)
def test_the_lagged_step_is_the_exponential_exactly(tau: float, start: float, end: float) -> None:
    t = np.arange(0.0, 1.0, 0.01)
    motors = motor_input(t, np.where(t < 0.2 - 1e-9, start, end)[:, None], measured=False)
    since = np.maximum(motors.t_s - 0.2, 0.0)
    expected = end + (start - end) * np.exp(-since / tau)
    np.testing.assert_allclose(motors.lagged(tau, tau)[:, 0], expected, atol=1e-9)


def test_up_and_down_have_their_own_lag() -> None:
    t = np.arange(0.0, 2.0, 0.01)
    command = np.where((t > 0.5 - 1e-9) & (t < 1.0 - 1e-9), 2.0, 1.0)[:, None]
    motors = motor_input(t, command, measured=False)
    lagged = motors.lagged(0.03, 0.09)[:, 0]
    grid = motors.t_s
    assert np.interp(0.53, grid, lagged) == pytest.approx(2.0 - np.exp(-1.0), abs=1e-6)
    assert np.interp(1.09, grid, lagged) == pytest.approx(1.0 + np.exp(-1.0), abs=1e-4)


@given(
    tau=st.floats(0.01, 0.2),
    start=st.floats(0.4, 1.6),
    end=st.floats(0.4, 1.6),
    slope=st.floats(-1.0, 1.0).filter(bool),
)
@settings(max_examples=50, deadline=None)
def test_a_lag_by_speed_is_the_exponential_at_the_rate_of_the_command(
    tau: float, start: float, end: float, slope: float
) -> None:
    t = np.arange(0.0, 1.0, 0.01)
    motors = motor_input(t, 400.0 * np.where(t < 0.2 - 1e-9, start, end)[:, None], measured=False, hover=400.0)
    since = np.maximum(motors.t_s - 0.2, 0.0)
    rate = (1.0 + slope * (end - 1.0)) / tau
    expected = 400.0 * (end + (start - end) * np.exp(-rate * since))
    np.testing.assert_allclose(motors.lagged(tau, tau, slope)[:, 0], expected, rtol=1e-9)


def test_no_lag_passes_the_command_through_and_holds_it_between_samples() -> None:
    motors = motor_input(np.array([0.0, 0.1, 0.2]), np.array([[1.0], [3.0], [2.0]]), measured=False)
    np.testing.assert_array_equal(motors.lagged(0.0, 0.0)[[0, 99, 100, 199, 200], 0], [1.0, 1.0, 3.0, 3.0, 2.0])
    measured = motor_input(np.array([0.0, 0.1, 0.2]), np.array([[1.0], [3.0], [2.0]]), measured=True)
    np.testing.assert_allclose(measured.value[[0, 50, 150], 0], [1.0, 2.0, 2.5])


def test_running_integrals_are_exact_for_held_and_for_linear_values() -> None:
    grid = np.linspace(0.0, 1.0, 101)
    assert cumulative(np.ones((101, 1)), 0.01, held=True)[-1, 0] == pytest.approx(1.0)
    assert cumulative(grid[:, None], 0.01, held=False)[-1, 0] == pytest.approx(0.5)
    query = np.array([-1.0, 0.255, 9.0])
    np.testing.assert_allclose(interpolate_columns(query, 0.0, 0.01, grid[:, None])[:, 0], [0.0, 0.255, 1.0], atol=1e-7)
