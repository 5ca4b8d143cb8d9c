"""Trends over flights: planted steps and drifts come back with their place and size, and nothing is invented."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.fleet.trends import LIMIT, compare_groups, difference, holm, pooled, trend

FLEETS, FLIGHTS = 60, 30


def draw(seed, scatter=1.0, count=FLIGHTS):
    random = np.random.default_rng([19, seed])
    stds = random.uniform(0.5, 2.0, count)
    return random.normal(0.0, np.hypot(stds, scatter)), stds


def test_a_step_is_found_at_its_flight_and_its_size_lies_in_its_interval():
    found = []
    for seed in range(FLEETS):
        values, stds = draw(seed)
        values[17:] += 6.0
        found.append(trend(100.0 + values, stds, parameters=10).change)
    steps = [c for c in found if c is not None and c.kind == "step"]
    near = sum(abs(c.at - 17) <= 1 for c in steps)
    inside = sum(abs(c.size - 6.0) <= 1.96 * c.std for c in steps)
    assert near >= 0.95 * FLEETS, f"{near} of {FLEETS}"
    assert inside >= 0.85 * len(steps), f"{inside} of {len(steps)}"


def test_a_drift_is_a_drift_and_its_size_lies_in_its_interval():
    found = []
    for seed in range(FLEETS):
        values, stds = draw(1000 + seed)
        found.append(trend(values + 0.4 * np.arange(FLIGHTS), stds, parameters=10).change)
    drifts = [c for c in found if c is not None and c.kind == "drift"]
    inside = sum(abs(c.size - 0.4) <= 1.96 * c.std for c in drifts)
    assert len(drifts) >= 0.95 * FLEETS
    assert inside >= 0.85 * len(drifts), f"{inside} of {len(drifts)}"


@pytest.mark.parametrize("scatter", [0.0, 3.0])
def test_flights_that_only_scatter_have_no_trend(scatter):
    named = [seed for seed in range(FLEETS) if trend(*draw(2000 + seed, scatter), parameters=10).change is not None]
    assert named == [], f"seeds {named}"


def test_the_scatter_between_flights_is_estimated_and_widens_the_limits():
    values, stds = draw(7, scatter=5.0, count=60)
    found = trend(values, stds)
    assert 3.5 < found.scatter < 6.5
    assert np.allclose(found.high - found.mean, LIMIT * np.hypot(stds, found.scatter))
    exact = trend(*draw(8, scatter=0.0, count=60))
    assert exact.scatter < 0.5


def test_one_flight_apart_is_outside_its_limits_and_no_step():
    values, stds = draw(9, scatter=0.2)
    values[12] += 25.0
    found = trend(values, stds, parameters=10)
    assert 12 in found.outside
    assert found.change is None or found.change.kind != "step" or found.change.at != 12


def test_a_trend_does_not_depend_on_the_unit():
    values, stds = draw(3)
    values[10:] += 5.0
    small, large = trend(1e-6 * values, 1e-6 * stds).change, trend(1e6 * values, 1e6 * stds).change
    assert small is not None
    assert large is not None
    assert small.at == large.at
    assert small.size * 1e12 == pytest.approx(large.size)
    assert small.probability == pytest.approx(large.probability)


def test_few_flights_say_nothing():
    for count in range(4):
        found = trend(np.arange(count) * 10.0, np.full(count, 0.1))
        assert found.change is None
        assert found.probability == 0.0


@pytest.mark.parametrize(
    ("values", "stds"), [([1.0, np.nan], [1.0, 1.0]), ([1.0], [0.0]), ([1.0, 2.0], [1.0]), ([1.0], [-1.0])]
)
def test_bad_series_are_refused(values, stds):
    with pytest.raises(ValueError, match="finite values"):
        trend(values, stds)


def test_pooling_equal_flights_is_the_classical_mean():
    values, stds = np.full(25, 3.0), np.full(25, 0.5)
    mean, std = pooled(values, stds)
    assert mean == pytest.approx(3.0)
    assert 0.1 <= std < 0.13  # 0.5 / sqrt(25), and a little for the scatter that 25 flights cannot exclude
    assert pooled([2.0], [0.1]) == (2.0, 0.1)


def test_groups_that_differ_are_told_and_groups_that_do_not_are_not():
    random = np.random.default_rng(190)
    wrong = 0
    for _ in range(100):
        a, b = random.normal(5.0, 1.0, 8), random.normal(5.0, 1.0, 8)
        wrong += difference((a, np.full(8, 0.5)), (b, np.full(8, 0.5))).p < 0.01
    assert wrong <= 5
    heavy = difference((random.normal(5.0, 1.0, 8), np.full(8, 0.5)), (random.normal(9.0, 1.0, 8), np.full(8, 0.5)))
    assert heavy.p < 1e-3
    assert abs(heavy.size - 4.0) < 3.0 * heavy.std


def test_holms_correction():
    """Holm 1979, by hand: 0.01 x 4, 0.02 x 3, then never less than the one before."""
    assert holm([0.04, 0.01, 0.02, 0.5]) == pytest.approx([0.08, 0.04, 0.06, 0.5])
    assert compare_groups({"a": (np.array([1.0]), np.array([0.1]))}, {}) == {}
