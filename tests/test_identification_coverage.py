"""The nominal 95 % intervals hold the truth in 95 of 100 flights, each of another vehicle, plan and laboratory."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from groundstation.errors import GroundStationError
from groundstation.identification.results import MASS_AND_TENSOR
from studies.coverage import Score, score, table
from studies.tally import HALF_95

FLIGHTS = 100
STANDARD_ERRORS = 3.3
"""Once in a thousand, of a normal distribution."""


@pytest.mark.timeout(1200)  # more than a minute of one core, which a busy machine stretches
def test_the_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """Each number within the 0.1 % band of a binomial count at 95 %, at least 87 of 100; all together, by their share
    in each flight, within what flights scatter.
    """
    scores: list[Score] = []
    for seed in range(70_001, 70_001 + FLIGHTS):
        try:
            scores.append(score(seed))
        except GroundStationError:
            continue
    assert len(scores) > 0.97 * FLIGHTS
    for name in (*MASS_AND_TENSOR, "mocap_minus_imu_s"):
        z = np.array([s.z[name] for s in scores if name in s.z])
        assert len(z) > 0.6 * FLIGHTS, name
        low, high = binom.interval(0.999, len(z), 0.95)
        assert low <= np.sum(np.abs(z) <= HALF_95) <= high, table(scores)
    inside = [np.mean([abs(z) <= HALF_95 for z in s.z.values()]) for s in scores]
    error = np.std(inside, ddof=1) / np.sqrt(len(inside))
    assert abs(np.mean(inside) - 0.95) < STANDARD_ERRORS * error, table(scores)
