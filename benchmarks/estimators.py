"""The four estimators on 50 s at 500 Hz against the same sums in a per-sample Python loop, and the whole of
``identify``.

Run with ``OMP_NUM_THREADS=1 python -m benchmarks.estimators`` for one core; medians of the processor time of several
runs in one process, warm, and what the first took.
"""

from __future__ import annotations

import statistics

import numpy as np

from groundstation.flightdata import FlightData
from groundstation.identification.estimators import gradient_descent, least_squares
from groundstation.identification.pipeline import identify
from studies.estimators import (
    DURATION_S,
    IDENTIFIED,
    IDENTIFIED_SEED,
    PERIOD_S,
    RUNS,
    loop_gradient_descent,
    loop_least_squares,
    median_s,
    problem,
)
from studies.study import draw
from studies.timing import seconds


def main() -> None:
    """Print times and ratios."""
    print(f"identify by all methods, study flight {IDENTIFIED_SEED}, 500 Hz, processor time of all threads")
    for share, excitation_s, budget_s in IDENTIFIED:
        flight, _, _ = draw(IDENTIFIED_SEED, share)

        def whole(flight: FlightData = flight) -> object:
            return identify([flight])

        first = seconds(whole)
        warm = statistics.median(seconds(whole) for _ in range(RUNS))
        print(
            f"  {excitation_s:.0f} s of excitation    {warm:6.2f} s   (median of {RUNS}; first {first:.2f} s; budget "
            f"{budget_s:.0f} s)"
        )
    gamma, upsilon, t = problem()
    used = np.ones(len(t), bool)
    ours = {"LS": least_squares, "GD": gradient_descent}
    loops = {"LS": loop_least_squares, "GD": loop_gradient_descent}
    for name, estimator in ours.items():
        ending = loops[name](gamma, upsilon)[-1]
        np.testing.assert_allclose(estimator(gamma, upsilon, t, used).values, ending, rtol=1e-6, atol=1e-9)

    # The filtered model has a regressor of the same shape, so two of each are the four.
    def four() -> None:
        for estimator in (*ours.values(), *ours.values()):
            estimator(gamma, upsilon, t, used)

    def four_in_loops() -> None:
        for loop in (*loops.values(), *loops.values()):
            loop(gamma, upsilon)

    fast, slow = median_s(four), median_s(four_in_loops, 1)
    print(f"four estimators with evolution and intervals, {DURATION_S:.0f} s at {1 / PERIOD_S:.0f} Hz")
    print(f"  ours                     {fast:8.3f} s   (median of {RUNS}; budget 0.5 s)")
    print(f"  per-sample Python loop   {slow:8.3f} s   (without intervals)")
    print(f"  ratio                    {slow / fast:8.1f}")


if __name__ == "__main__":
    main()
