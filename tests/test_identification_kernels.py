"""What identification computes its own way to be quick, against the plain or well-known form of the same."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, correlate, lfilter, sosfiltfilt

from groundstation.identification.butterworth import band_pass, correlation, low_pass, run, without_phase
from groundstation.identification.filters import seed_pair
from groundstation.identification.innovation_kernel import filtered, filtered_one, huber_sum, moving_average
from groundstation.identification.noise import NoiseModel, gains_of, innovations


def walk(seed: int, samples: int = 3000, columns: int = 3) -> np.ndarray:
    print("seed", seed)
    return np.cumsum(np.random.default_rng(seed).standard_normal((samples, columns)), axis=0)


@pytest.mark.parametrize(("order", "edge_hz", "rate_hz"), [(2, 5.0, 500.0), (4, 8.0, 200.0), (2, 0.5, 50.0)])
def test_a_low_pass_without_phase_is_scipys(order: int, edge_hz: float, rate_hz: float) -> None:
    x = walk(1)
    known = sosfiltfilt(butter(order, edge_hz, fs=rate_hz, output="sos"), x, axis=0)
    assert without_phase(low_pass(order, edge_hz, rate_hz), x) == pytest.approx(known, abs=1e-10 * np.abs(x).max())


@pytest.mark.parametrize(("edges_hz", "rate_hz"), [((0.3, 8.0), 100.0), ((0.2, 8.0), 200.0), ((0.3, 4.0), 100.0)])
def test_a_band_pass_without_phase_is_scipys(edges_hz: tuple[float, float], rate_hz: float) -> None:
    x = walk(2)
    known = sosfiltfilt(butter(2, edges_hz, btype="band", fs=rate_hz, output="sos"), x, axis=0)
    assert without_phase(band_pass(edges_hz, rate_hz), x) == pytest.approx(known, abs=1e-10 * np.abs(x).max())


def test_a_signal_shorter_than_the_padding_is_refused() -> None:
    with pytest.raises(ValueError, match="too short"):
        without_phase(low_pass(2, 5.0, 100.0), np.zeros((9, 1)))


def test_correlation_and_recursions_are_scipys() -> None:
    x = walk(3)
    first, second = x[:, 0], x[:2000, 1]
    assert correlation(first, second) == pytest.approx(correlate(first, second), rel=1e-9, abs=1e-6)
    section = np.array([[0.2, 0.0, 0.0, 1.0, -0.8, 0.0]])
    assert run(section, x, False) == pytest.approx(lfilter([0.2], [1.0, -0.8], x, axis=0), rel=1e-12)
    weights = np.array([1.0, -0.5, 0.25])
    assert moving_average(weights, x) == pytest.approx(lfilter(weights, [1.0], x, axis=0), rel=1e-12, abs=1e-12)


def test_a_filter_in_one_step_is_that_on_the_finer_grid() -> None:
    x, steps = walk(4, 500, 2), 8
    pair = seed_pair(30.0, 0.002 / steps)
    fine = np.linspace(0.0, 499.0, 499 * steps + 1)
    lines = np.stack([np.interp(fine, np.arange(500.0), column) for column in x.T], axis=1)
    coarse = pair.at_every(steps)
    assert coarse.f(x) == pytest.approx(pair.f(lines)[::steps], rel=1e-9, abs=1e-9)
    assert coarse.g(x) == pytest.approx(pair.g(lines)[::steps], rel=1e-9, abs=1e-7)
    assert coarse.period_s == pytest.approx(0.002)


@pytest.mark.parametrize("integrated", [True, False])
def test_gains_filter_every_column_alike(integrated: bool) -> None:
    z = walk(5, 2000, 4)
    dt = np.random.default_rng(6).uniform(0.006, 0.007, len(z))
    restart = np.zeros(len(z), dtype=bool)
    restart[[0, 900]] = True
    colour = NoiseModel(2.0, 0.4, 0.1, 0.5)
    e, variance = innovations(z, dt, restart, colour, integrated=integrated)
    gains, same = gains_of(dt, restart, colour, integrated=integrated)
    assert np.array_equal(variance, same)
    white = filtered(z, gains, np.sqrt(variance), np.zeros((2, 4)))
    assert white == pytest.approx(np.where(np.isinf(variance)[:, None], 0.0, e / np.sqrt(variance)[:, None]), rel=1e-12)
    assert filtered_one(z[:, 2], gains, np.sqrt(variance)) == pytest.approx(white[:, 2], rel=1e-12)


def test_hubers_cost_is_a_parabola_and_then_a_line() -> None:
    assert huber_sum(np.array([0.5, -1.0, 3.0, -5.0]), 3.0) == pytest.approx(0.125 + 0.5 + 4.5 + (15.0 - 4.5))
