"""Where the plan is a weak instrument the joint estimate stays finite, its intervals hold, and strong ones do not
change.
"""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.diagnosis.joint import Products, estimated, strengths

ROWS = 2000


def products(x: np.ndarray, z: np.ndarray, y: np.ndarray) -> Products:
    return Products(z.T @ x, z.T @ z, x.T @ x, z.T @ y, x.T @ y, len(y))


def drawn(random: np.random.Generator, weight: float, feedback: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two regressors that answer the noise, of unit size; the instrument of the second has a given weight in it.

    Args:
        feedback: correlation of regressors and noise.
    """
    z, e = random.standard_normal((ROWS, 2)), random.standard_normal(ROWS)
    own = np.sqrt(1.0 - feedback**2) * random.standard_normal((ROWS, 2)) + feedback * e[:, None]
    shares = np.array([0.8, weight])
    return z * shares + np.sqrt(1.0 - shares**2) * own, z, e


def test_strong_instruments_give_the_plain_estimate():
    seed = 11
    print("seed", seed)
    x, z, e = drawn(np.random.default_rng(seed), 0.5, 0.7)
    found = products(x, z, e)
    theta, covariance = estimated(found)
    inverse = np.linalg.inv(found.zx)
    std = np.sqrt(np.diag(inverse @ found.zz @ inverse.T))
    assert np.all(strengths(found) > 400.0)
    assert np.all(np.abs(theta - inverse @ found.zy) < 0.05 * std)
    assert np.sqrt(np.diag(covariance)) == pytest.approx(std, rel=5e-3)


@pytest.mark.parametrize("weight", [0.0, 0.02, 0.05, 0.1])
@pytest.mark.parametrize("feedback", [0.0, 0.5, 0.95])
def test_a_weak_instrument_leaves_a_finite_estimate_whose_interval_holds(weight, feedback):
    """F from nothing to twenty, up to nearly as much feedback as can be. Where chance alone ties the instrument to the
    motion, its tie to the noise comes along: nine in ten hold there, and none is far off.
    """
    seed, rounds = 3, 400
    print("seed", seed)
    random = np.random.default_rng(seed)
    scores = np.empty((rounds, 2))
    for index in range(rounds):
        theta, covariance = estimated(products(*drawn(random, weight, feedback)))
        scores[index] = theta / np.sqrt(np.diag(covariance))
    assert np.all(np.mean(np.abs(scores) < 1.96, axis=0) > (0.91 if feedback < 0.9 else 0.86)), "less 4 deviations"
    assert np.all(np.abs(scores) < 6.0), "no flight in 400 names an effect that is not there (5.3 deviations)"


def test_what_a_model_lacks_does_not_run_away_with_a_weak_direction():
    """A large effect that nobody has named yet stands in the residual, as damping does before it is found."""
    seed = 5
    print("seed", seed)
    x, z, e = drawn(np.random.default_rng(seed), 0.003, 0.0)
    lacking = 30.0 * (x[:, 1] + np.random.default_rng(seed + 1).standard_normal(ROWS))
    found = products(x, z, e + lacking)
    plain, (theta, _) = np.linalg.solve(found.zx, found.zy), estimated(found)
    rms = [float(np.sqrt(np.mean((e + lacking - x @ each) ** 2))) for each in (np.zeros(2), plain, theta)]
    print("residual without, plain, Fuller", rms, "F", strengths(found))
    assert rms[1] > 2.0 * rms[0], "the plain estimate makes the residual larger than it was"
    assert rms[2] < rms[0]


def test_a_prior_is_rows_of_its_own_and_what_no_row_is_of_stays():
    seed = 7
    print("seed", seed)
    x, z, e = drawn(np.random.default_rng(seed), 0.5, 0.3)
    x[:, 1] = z[:, 1] = 0.0
    theta, covariance = estimated(products(x, z, e).with_prior(np.diag([0.0, 25.0])))
    assert theta[1] == 0.0
    assert np.sqrt(covariance[1, 1]) == pytest.approx(0.2)


def test_instruments_that_are_the_regressors_are_least_squares():
    seed = 9
    print("seed", seed)
    x, _, e = drawn(np.random.default_rng(seed), 0.5, 0.9)
    found = products(x, x, e)
    theta, covariance = estimated(found)
    assert theta == pytest.approx(np.linalg.lstsq(x, e, rcond=None)[0])
    assert covariance == pytest.approx(np.linalg.inv(x.T @ x))
    assert np.all(strengths(found) > 1e9)
