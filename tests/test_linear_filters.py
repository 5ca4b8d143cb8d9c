"""Filters without SciPy's signal package give its numbers, and identifying imports none of it."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy import ndimage, signal

from groundstation.linear_filters import (
    band_pass,
    both_ways,
    correlation,
    fast_length,
    first_order,
    low_pass,
    moving_mean,
    power_spectrum,
)

SEED = 20261130


def walk(count: int, columns: int) -> np.ndarray:
    print("seed", SEED)
    return np.random.default_rng(SEED).normal(size=(count, columns)).cumsum(axis=0)


@pytest.mark.parametrize(("order", "cutoff_hz", "rate_hz"), [(2, 5.0, 500.0), (4, 8.0, 200.0), (2, 37.0, 1013.0)])
def test_a_low_pass_is_scipys(order: int, cutoff_hz: float, rate_hz: float) -> None:
    ours, theirs = low_pass(order, cutoff_hz, rate_hz), signal.butter(order, cutoff_hz, fs=rate_hz, output="sos")
    assert ours == pytest.approx(theirs, rel=1e-13)
    x = walk(900, 3)
    assert both_ways(ours, x) == pytest.approx(signal.sosfiltfilt(theirs, x, axis=0), rel=1e-10, abs=1e-10)
    assert both_ways(ours, x[:, 0], 30) == pytest.approx(signal.sosfiltfilt(theirs, x[:, 0], padlen=30), rel=1e-10)


@pytest.mark.parametrize(("band_hz", "rate_hz"), [((0.3, 4.0), 100.0), ((1.0, 8.0), 200.0), ((5.0, 40.0), 100.0)])
def test_a_band_pass_is_scipys(band_hz: tuple[float, float], rate_hz: float) -> None:
    ours, theirs = band_pass(2, band_hz, rate_hz), signal.butter(2, band_hz, "band", fs=rate_hz, output="sos")
    assert ours == pytest.approx(theirs, rel=1e-12, abs=1e-14)
    x = walk(900, 2)
    assert both_ways(ours, x) == pytest.approx(signal.sosfiltfilt(theirs, x, axis=0), rel=1e-9, abs=1e-9)


def test_frequencies_and_lengths_that_make_no_filter_are_refused() -> None:
    with pytest.raises(ValueError, match="60 Hz is not between zero and half of 100 Hz"):
        low_pass(2, 60.0, 100.0)
    with pytest.raises(ValueError, match="5 samples is not longer than its padding of 9"):
        both_ways(low_pass(2, 5.0, 100.0), np.zeros(5))


def test_recursions_correlations_and_means_are_scipys() -> None:
    x = walk(700, 3)
    assert first_order((0.2, 0.1), -0.7, x, x[:1]) == pytest.approx(
        signal.lfilter([0.2, 0.1], [1.0, -0.7], x, axis=0, zi=x[:1])[0], rel=1e-12
    )
    found = correlation(x[:, 0], x[:600, 1])
    assert found == pytest.approx(signal.correlate(x[:, 0], x[:600, 1], method="fft"), rel=1e-9, abs=1e-7)
    for width in (3, 31):
        assert moving_mean(x[:, 2], width) == pytest.approx(
            ndimage.uniform_filter1d(x[:, 2], width, mode="reflect"), rel=1e-11, abs=1e-11
        )


@pytest.mark.parametrize(("count", "length"), [(700, 128), (701, 127), (90, 90)])
def test_a_power_spectrum_is_scipys(count: int, length: int) -> None:
    x = walk(count, 2)
    for ours, theirs in zip(
        power_spectrum(x, 50.0, length), signal.welch(x, 50.0, nperseg=length, axis=0), strict=True
    ):
        assert ours == pytest.approx(theirs, rel=1e-9, abs=1e-12)


def test_a_fast_length_is_the_next_one_of_twos_threes_and_fives() -> None:
    numbers = sorted(2**a * 3**b * 5**c for a in range(15) for b in range(10) for c in range(7))
    for least in (1, 2, 7, 97, 1025, 8191, 10001):
        assert fast_length(least) == next(n for n in numbers if n >= least)


def test_an_identification_does_not_load_scipys_signal_package() -> None:
    code = (
        "import sys; from studies.study import draw; from groundstation.identification.pipeline import identify\n"
        "flight = draw(2001, 0.5)[0]; identify([flight], predictive=True)\n"
        "print([m for m in sys.modules if m in ('scipy.signal', 'scipy.stats')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]", "study seed 2001"
