"""A seeded dozen of the study's flights, gentle and fast: every demand is met, or the parameter is given no number."""

from __future__ import annotations

import numpy as np
import pytest

from studies.study import draw, faults, study_flight


@pytest.mark.parametrize("seed", range(1001, 1013))
def test_a_drawn_flight_meets_every_demand(seed: int) -> None:
    flown = study_flight(seed)
    assert flown.found is not None, flown.reason
    assert faults(flown, "best") == []
    assert set(flown.found.not_identifiable).isdisjoint(flown.found.methods[flown.found.best].parameters)


def test_a_drawn_flight_is_the_same_again_and_another_is_not() -> None:
    (first, words, offset), (again, same_words, same_offset) = draw(2), draw(2)
    assert (words, offset) == (same_words, same_offset)
    assert first.imu is not None
    assert again.imu is not None
    np.testing.assert_array_equal(first.imu.values, again.imu.values)
    assert draw(3)[2] != offset
