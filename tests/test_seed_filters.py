"""The seed's filter pair does not belong together; ours does."""

import numpy as np
import pytest

from groundstation.identification.filters import (
    central_difference,
    matched_pair,
    seed_pair,
    zero_phase_low_pass,
)

PERIOD_S = 0.002
CUTOFF_RAD_S = 30.0


def response(numerator, denominator, w):
    z = np.exp(1j * w * PERIOD_S)
    return np.polyval(numerator, z) / np.polyval(denominator, z)


@pytest.mark.parametrize("w", [0.6, 3.0, 12.0])
def test_seed_pair_is_three_percent_too_large_and_leads_by_half_a_sample(w):
    pair = seed_pair(CUTOFF_RAD_S, PERIOD_S)
    ratio = response(pair.derivative, pair.denominator, w) / response(pair.low_pass, pair.denominator, w) / (1j * w)
    assert abs(ratio) == pytest.approx(CUTOFF_RAD_S * PERIOD_S / (1 - np.exp(-CUTOFF_RAD_S * PERIOD_S)), rel=1e-3)
    assert abs(ratio) == pytest.approx(1.030, abs=1e-3)
    assert np.angle(ratio) == pytest.approx(w * PERIOD_S / 2, rel=1e-6)
    assert pair.gain_ratio() == pytest.approx(1.0303, abs=1e-4)


@pytest.mark.parametrize("w", [0.6, 3.0, 12.0])
def test_matched_pair_is_one_filter_and_one_derivative(w):
    pair = matched_pair(CUTOFF_RAD_S, PERIOD_S)
    f = response(pair.low_pass, pair.denominator, w)
    ratio = response(pair.derivative, pair.denominator, w) / f / (1j * w)
    assert abs(ratio - 1.0) < (w * PERIOD_S) ** 2 / 10.0
    assert np.angle(ratio) == pytest.approx(0.0, abs=1e-12)
    assert f == pytest.approx(CUTOFF_RAD_S / (1j * w + CUTOFF_RAD_S), rel=1e-3)
    assert pair.gain_ratio() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("make", [seed_pair, matched_pair])
def test_filters_start_in_the_steady_state_of_their_first_sample(make):
    pair = make(CUTOFF_RAD_S, PERIOD_S)
    constant = np.full((50, 2), 3.0)
    np.testing.assert_allclose(pair.f(constant), constant, atol=1e-12)
    np.testing.assert_allclose(pair.g(constant), 0.0, atol=1e-12)


def test_low_pass_has_no_phase_and_the_stated_gain():
    t = PERIOD_S * np.arange(20000)
    for frequency, gain in ((0.5, 1 / (1 + 0.1**4)), (5.0, 0.5)):
        x = np.sin(2 * np.pi * frequency * t)
        y = zero_phase_low_pass(x, 5.0, PERIOD_S)
        middle = slice(5000, 15000)
        in_phase = 2 * np.mean(y[middle] * x[middle])
        quadrature = 2 * np.mean(y[middle] * np.cos(2 * np.pi * frequency * t[middle]))
        assert in_phase == pytest.approx(gain, abs=2e-4)
        assert quadrature == pytest.approx(0.0, abs=1e-6)


def test_low_pass_leaves_short_and_slow_signals_alone():
    x = np.arange(5.0)
    np.testing.assert_array_equal(zero_phase_low_pass(x, 5.0, 0.002), x)
    np.testing.assert_array_equal(zero_phase_low_pass(np.arange(100.0), 50.0, 0.01), np.arange(100.0))


def test_central_difference_is_that_of_the_paper():
    x = np.random.default_rng(0).normal(size=(30, 2))
    np.testing.assert_allclose(central_difference(x, 0.5)[1:-1], (x[2:] - x[:-2]) / 1.0)
