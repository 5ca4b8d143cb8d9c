"""Noise drawn in compiled code is, to the last bit, what NumPy's generators and sums give: a seed stays its flight."""

from __future__ import annotations

import numpy as np
import pytest

from sim.noise import BiasedNoise, Stamper, noisy_speeds, normal
from sim.scenario import Clock

SEED = 50
TRUE_S = np.linspace(0.0, 8.0, 4000)


def _random() -> np.random.Generator:
    print(f"seed {SEED}")
    return np.random.default_rng(SEED)


def test_normal_numbers_are_those_of_numpy_and_leave_its_generator_where_numpy_does():
    ours, theirs = _random(), _random()
    np.testing.assert_array_equal(normal(ours, (20_000, 6)), theirs.standard_normal((20_000, 6)))
    assert ours.bit_generator.state == theirs.bit_generator.state


@pytest.mark.parametrize("latency_jitter_s", [0.0, 0.003])
def test_stamps_and_arrivals_are_those_of_the_formulas_in_numpy(latency_jitter_s):
    clock = Clock(
        offset_s=0.01, drift_ppm=20.0, jitter_s=1e-4, latency_s=0.002, latency_jitter_s=latency_jitter_s, phase=0.0
    )
    draws = _random().standard_normal((len(TRUE_S), 2))
    uniform = np.clip(1.0 / (1.0 + np.exp(-1.702 * draws[:, 1])), 0.0, 1.0 - 1e-12)
    late = -np.log1p(-uniform) * latency_jitter_s
    arrivals = np.maximum.accumulate(TRUE_S + clock.latency_s + late)
    stamper = Stamper(clock, _random())
    parts = [stamper.stamp(part) for part in (TRUE_S[:0], TRUE_S[:1], TRUE_S[1:1500], TRUE_S[1500:])]
    np.testing.assert_array_equal(np.concatenate([p[1] for p in parts]), arrivals)
    stamps = TRUE_S * (1.0 + 1e-6 * clock.drift_ppm) + clock.offset_s + clock.jitter_s * draws[:, 0]
    np.testing.assert_array_equal(np.concatenate([p[0] for p in parts]), stamps)


def test_a_bias_is_summed_up_piece_by_piece_however_many_are_drawn_at_once():
    white, start, walk = np.full(6, 0.3), np.full(6, 0.1), np.full(6, 1e-3)
    counts = [250, 0, 1, 249, 500]
    random, expected = _random(), []
    bias = start * random.standard_normal(6)
    for count in counts:
        draws = random.standard_normal((count, 2, 6))
        walked = np.cumsum(draws[:, 1] * walk, axis=0) + bias
        expected.append(walked + draws[:, 0] * white)
        bias = walked[-1] if count else bias
    np.testing.assert_array_equal(BiasedNoise(white, start, walk, _random()).draw(counts), np.concatenate(expected))
    again = BiasedNoise(white, start, walk, _random())
    cut = [again.draw(part) for part in (counts[:1], counts[1:3], counts[3:])]
    np.testing.assert_array_equal(np.concatenate(cut), np.concatenate(expected))


def test_speeds_have_noise_where_the_rotor_turns():
    speeds = np.repeat([[400.0, 0.0, 300.0, -1.0]], 500, axis=0)
    expected = np.where(speeds > 0.0, speeds + 2.0 * _random().standard_normal(speeds.shape), 0.0)
    np.testing.assert_array_equal(noisy_speeds(_random(), 2.0, speeds), expected)
    aside = np.stack([speeds] * 8, axis=-1)[..., 3]  # as it comes out of a lane
    np.testing.assert_array_equal(noisy_speeds(_random(), 2.0, aside), expected)
