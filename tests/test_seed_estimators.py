"""Least squares and gradient descent: planted values, evolution, coloured intervals, refusal of what is not
determined.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from groundstation.errors import NotIdentifiable
from groundstation.identification import estimators
from groundstation.identification.estimators import gradient_descent, least_squares
from groundstation.identification.uncertainty import coloured_covariance

PERIOD_S = 0.01


def regression(rng, samples=2000, parameters=3, outputs=2):
    t = PERIOD_S * np.arange(samples)
    tones = rng.uniform(0.2, 1.0, (outputs, parameters))
    gamma = np.cos(2 * np.pi * tones * t[:, None, None] + rng.uniform(0, 6, (outputs, parameters)))
    return t, gamma


def test_least_squares_is_the_solution_of_the_stacked_equations_at_every_point():
    rng = np.random.default_rng(0)
    t, gamma = regression(rng)
    y = gamma @ [1.0, -2.0, 3.0] + rng.normal(size=(len(t), 2))
    used = rng.uniform(size=len(t)) > 0.3
    estimate = least_squares(gamma, y, t, used, points=37)
    assert len(estimate.evolution_t_s) == 37
    for index in (10, 25, 36):
        until = used & (t <= estimate.evolution_t_s[index])
        expected = np.linalg.lstsq(gamma[until].reshape(-1, 3), y[until].ravel(), rcond=None)[0]
        np.testing.assert_allclose(estimate.evolution[index], expected, rtol=1e-9)
    np.testing.assert_allclose(estimate.values, estimate.evolution[-1])
    assert estimate.condition_number == pytest.approx(np.linalg.cond(gamma[used].reshape(-1, 3)), rel=1e-9)
    residual = (gamma @ estimate.values - y)[used]
    np.testing.assert_allclose(estimate.rms_residual, np.sqrt(np.mean(residual**2, axis=0)))


def test_gradient_descent_goes_to_the_planted_values_where_the_printed_step_explodes():
    rng = np.random.default_rng(1)
    t, gamma = regression(rng, samples=4000)
    gamma[:, :, 0] *= 1e3
    truth = np.array([1e-3, -2.0, 3.0])
    y = gamma @ truth
    estimate = gradient_descent(gamma, y, t, np.ones(len(t), bool))
    np.testing.assert_allclose(estimate.values, truth, rtol=1e-3)
    theta = np.zeros(3)
    with np.errstate(all="ignore"):
        for g, target in zip(gamma[:100], y[:100], strict=True):
            theta = theta - 30.0 * PERIOD_S * g.T @ (g @ theta - target)
    assert not np.abs(theta).max() < 1e6


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 1e4))
def test_gradient_descent_never_moves_away_from_consistent_data(seed, rate):
    rng = np.random.default_rng(seed)
    t, gamma = regression(rng, samples=200)
    gamma *= 10.0 ** rng.uniform(-4, 4, 3)
    truth = rng.normal(size=3) / np.abs(gamma).max(axis=(0, 1))
    estimate = gradient_descent(gamma, gamma @ truth, t, np.ones(len(t), bool), rate_per_s=rate, points=200)
    weight = np.sqrt(np.mean(gamma**2, axis=(0, 1)))
    distance = np.linalg.norm((estimate.evolution - truth) * weight, axis=1)
    assert np.all(np.diff(distance) <= 1e-9 * distance[0])


def scatter_over_claim(estimator, colour, runs=200):
    """Scatter of the estimates of one regression over runs of noise, over the mean standard deviation they claim."""
    rng = np.random.default_rng(11)
    t, gamma = regression(rng, samples=3000)
    used = np.ones(len(t), bool)
    used[1000:1200] = False
    values, claims = [], []
    for _ in range(runs):
        white = rng.normal(size=(len(t) + 500, 2))
        noise = lfilter([np.sqrt(1 - colour**2)], [1, -colour], white, axis=0)[500:]
        noise[:, 1] += 0.5 * noise[:, 0]
        estimate = estimator(gamma, gamma @ [1.0, -2.0, 3.0] + 0.2 * noise, t, used, points=2)
        values.append(estimate.values)
        claims.append(np.diag(estimate.covariance))
    return np.std(values, axis=0) / np.sqrt(np.mean(claims, axis=0))


@pytest.mark.parametrize("estimator", [least_squares, gradient_descent])
@pytest.mark.parametrize("colour", [0.0, 0.9, 0.98])
def test_claimed_standard_deviation_is_the_scatter_whatever_the_colour(estimator, colour):
    ratio = scatter_over_claim(estimator, colour)
    assert np.all(np.abs(ratio - 1.0) < 0.2), ratio


def test_white_residual_gives_the_textbook_covariance():
    rng = np.random.default_rng(3)
    t, gamma = regression(rng, samples=4000, outputs=1)
    a = np.tensordot(gamma, gamma, axes=((0, 1), (0, 1)))
    influence = np.linalg.inv(a) @ gamma.transpose(0, 2, 1)
    got = np.mean(
        [coloured_covariance(influence, 0.3 * rng.normal(size=(len(t), 1)), PERIOD_S) for _ in range(50)], axis=0
    )
    np.testing.assert_allclose(np.diag(got), 0.09 * np.diag(np.linalg.inv(a)), rtol=0.1)


def test_what_the_motion_does_not_determine_gets_no_number():
    rng = np.random.default_rng(4)
    t, gamma = regression(rng, parameters=4)
    gamma[:, :, 1] = 2.0 * gamma[:, :, 2]  # two that only show together
    gamma[:, :, 3] = 0.0  # one that does not show
    y = gamma @ [1.0, -2.0, 3.0, 7.0]
    estimate = least_squares(gamma, y, t, np.ones(len(t), bool))
    assert estimate.values[0] == pytest.approx(1.0)
    assert np.isnan(estimate.values[1:]).all()
    assert np.isinf(np.diag(estimate.covariance)[1:]).all()
    assert estimate.condition_number == np.inf
    np.testing.assert_allclose(estimate.rms_residual, 0.0, atol=1e-9)


@pytest.mark.parametrize("estimator", [least_squares, gradient_descent])
def test_no_samples_is_a_refusal(estimator):
    t, gamma = regression(np.random.default_rng(5))
    with pytest.raises(NotIdentifiable):
        estimator(gamma, np.zeros((len(t), 2)), t, np.zeros(len(t), bool))


def test_a_descent_stops_looking_back_where_it_has_forgotten_what_was_before(monkeypatch):
    rng = np.random.default_rng(12)
    t, gamma = regression(rng, samples=12000)
    y = gamma @ [1.0, -2.0, 3.0] + rng.normal(size=(len(t), 2))
    monkeypatch.setattr(estimators, "STRETCH", 3000)
    looked: list[int] = []
    heard = estimators.coloured_covariance
    monkeypatch.setattr(estimators, "coloured_covariance", lambda *part: looked.append(1) or heard(*part))
    near = gradient_descent(gamma, y, t, np.ones(len(t), bool))
    parts = len(looked)
    monkeypatch.setattr(estimators, "FORGOTTEN", 0.0)
    whole = gradient_descent(gamma, y, t, np.ones(len(t), bool))
    assert parts < len(looked) - parts == 4
    assert np.array_equal(near.covariance, whole.covariance) and np.array_equal(near.values, whole.values)
