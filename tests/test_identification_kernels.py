"""The seed's filters in one step of the grid, against the finer grid that they stand for."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.identification.filters import seed_pair


def test_a_filter_in_one_step_is_that_on_the_finer_grid() -> None:
    print("seed", 4)
    x, steps = np.cumsum(np.random.default_rng(4).standard_normal((500, 2)), axis=0), 8
    pair = seed_pair(30.0, 0.002 / steps)
    fine = np.linspace(0.0, 499.0, 499 * steps + 1)
    lines = np.stack([np.interp(fine, np.arange(500.0), column) for column in x.T], axis=1)
    coarse = pair.at_every(steps)
    assert coarse.f(x) == pytest.approx(pair.f(lines)[::steps], rel=1e-9, abs=1e-9)
    assert coarse.g(x) == pytest.approx(pair.g(lines)[::steps], rel=1e-9, abs=1e-7)
    assert coarse.period_s == pytest.approx(0.002)
