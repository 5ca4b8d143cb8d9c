"""Vehicle, day and flight: intervals of each level hold, flights that agree are pooled, and those that do not widen the
estimate.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from groundstation.campaign.pooling import day_of, level_of, levels, pooled, widened
from groundstation.diagnosis.held_out import held_out
from groundstation.identification.results import Estimate


@pytest.mark.parametrize(("days", "flights"), [(1, 3), (3, 2)])
def test_intervals_hold_at_every_level(days, flights):
    """300 vehicles, scatter between days and flights up to 1.5 times a flight's own standard deviation: 91 to 98 % hold
    (binomial noise of 300 is 1.3 %)."""
    seed, vehicles = 29, 300
    print("seed", seed)
    random = np.random.default_rng(seed)
    hold: dict[str, list[bool]] = {"vehicle": [], "day": [], "flight": []}
    for _ in range(vehicles):
        between_days, between = random.uniform(0.0, 1.5, 2) * (days > 1, 1.0)
        day = random.normal(0.0, between_days, days)
        flight = day[:, None] + random.normal(0.0, between, (days, flights))
        std = random.lognormal(0.0, 0.3, flight.shape)
        seen = 7.0 + flight + random.normal(0.0, std)
        names = [f"day {i}" for i in range(days) for _ in range(flights)]
        found = levels(seen.ravel(), std.ravel(), names)
        hold["vehicle"].append(abs(found.vehicle.value - 7.0) < 1.96 * found.vehicle.std)
        hold["day"] += [
            abs(found.days[f"day {i}"].value - 7.0 - d) < 1.96 * found.days[f"day {i}"].std for i, d in enumerate(day)
        ]
        hold["flight"] += [
            abs(f.value - 7.0 - t) < 1.96 * f.std for f, t in zip(found.flights, flight.ravel(), strict=True)
        ]
    for level, each in hold.items():
        assert 0.91 < np.mean(each) < 0.98, (level, np.mean(each))


def test_many_flights_that_agree_are_nearly_the_weighted_mean():
    random = np.random.default_rng(5)
    std = np.full(40, 0.1)
    found = levels(random.normal(2.0, std), std, ["today"] * 40)
    assert found.vehicle.std == pytest.approx(0.1 / np.sqrt(40), rel=0.1)
    assert found.scatter_flights < 0.05
    assert found.days["today"].value == found.vehicle.value


def test_days_that_differ_are_told_from_flights_that_do():
    random = np.random.default_rng(6)
    days = np.repeat(random.normal(0.0, 1.0, 6), 4)
    found = levels(days + random.normal(0.0, 0.1, 24), np.full(24, 0.1), [f"{i // 4}" for i in range(24)])
    assert found.scatter_days > 4.0 * found.scatter_flights
    assert found.days["2"].std < 0.2 * found.vehicle.std


@pytest.mark.parametrize("unit", [1e-6, 1e3])
def test_levels_do_not_depend_on_the_unit(unit):
    values, stds, days = np.array([1.0, 1.3, 0.9]), np.array([0.1, 0.2, 0.1]), ["a", "a", "b"]
    one, other = levels(values, stds, days), levels(unit * values, unit * stds, days)
    assert other.vehicle.value == pytest.approx(unit * one.vehicle.value)
    assert other.vehicle.std == pytest.approx(unit * one.vehicle.std)


@pytest.mark.parametrize(("values", "stds"), [([], []), ([1.0], [0.0]), ([np.nan], [1.0]), ([1.0, 2.0], [1.0])])
def test_what_cannot_be_pooled_is_refused(values, stds):
    with pytest.raises(ValueError, match="pooling needs"):
        levels(values, stds, ["a"] * len(values))


def test_flights_that_disagree_widen_the_joint_estimate_and_others_do_not():
    def flights(*values: float) -> list[dict[str, Estimate]]:
        return [{"mass_kg": Estimate.normal(v, 0.01)} for v in values]

    joint = {"mass_kg": {"value": 2.0, "std": 0.01 / np.sqrt(2)}, "lag": {"value": 1.0, "std": 0.1}}
    agree, differ = flights(2.0, 2.001), flights(1.9, 2.1)
    near = widened(joint, pooled(agree, ["a", "a"]), agree)
    far = widened(joint, pooled(differ, ["a", "a"]), differ)
    assert joint["mass_kg"]["std"] < near["mass_kg"]["std"] < 2.0 * joint["mass_kg"]["std"]
    assert far["mass_kg"]["std"] > 2.0 * near["mass_kg"]["std"]
    assert near["lag"] == joint["lag"]
    assert pooled(agree[:1], ["a"]) == {}


def test_wind_is_of_the_day_and_the_tensor_of_the_vehicle():
    assert level_of("wind.velocity_x_m_s") == "day"
    assert level_of("ixx_kg_m2") == level_of("rotor_drag.d_x_kg_s") == "vehicle"
    assert day_of("2026-01-31T12-00-00-x500") == "2026-01-31"
    assert day_of("flight-1") == "flight-1"


def test_three_flights_are_held_out_one_by_one_and_two_by_blocks_of_time():
    def evidence(suspects: int, flights: int):
        times = np.tile(np.arange(0.0, 60.0, 0.5), flights)
        numbers = np.repeat(np.arange(flights), 120)
        rows = {"time_of_rows": lambda: (times, numbers * 0, numbers)}
        return SimpleNamespace(suspects=suspects, flights=range(flights), folds={}, **rows)

    whole = held_out(evidence(3, 4))  # type: ignore[arg-type]
    numbers = np.repeat(np.arange(4), 120)
    assert len(whole) == 3, "a reference flight is never judged"
    for number, (train, test) in enumerate(whole):
        assert set(numbers[test]) == {number}
        assert set(numbers[train]) == {0, 1, 2, 3} - {number}
    blocks = held_out(evidence(2, 2))  # type: ignore[arg-type]
    assert all(set(numbers[:240][test]) == {0, 1} for _, test in blocks)
