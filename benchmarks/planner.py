"""The planner against sequential quadratic programming with finite differences (SLSQP), on the seed paper's problem.

Both start from the same random motions that keep every limit, have the same unknowns (so that SLSQP need not find the
rest conditions) and hold the limits at the same phases. Told are the CPU seconds until a plan is within 1 % of the best
known and exceeds no limit by more than 1e-3, or never. A start that SLSQP does not end is stopped at its share of the
time.

Run with ``python -m benchmarks.planner``; the output is kept in docs/benchmarks.md.
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np

from groundstation.planning import paper_problem
from groundstation.planning.limits import envelope, largest_violation
from groundstation.planning.optimiser import Budget, _Exchange, best_of, cost, random_start
from groundstation.planning.problem import Problem

BEST_KNOWN = 16.203
WITHIN = 1.01
VIOLATION = 1e-3


def problem() -> Problem:
    """The seed paper's, section III-B."""
    task = paper_problem()
    vehicle = task["vehicle"]
    timing = task["base_frequency_rad_s"], task["duration_s"]
    return Problem((vehicle,), (envelope(vehicle),), "condition", task["harmonics"], *timing, task["start"])


def ours(task: Problem, seed: int, budget_s: float) -> float:
    """CPU seconds until the first plan that counts; infinite if there is none."""
    began = time.process_time()
    starts = 0
    while time.process_time() - began < budget_s:
        starts += 1
        outcome = best_of([task], Budget(seed * 1000 + starts, starts=1))
        if outcome.cost <= WITHIN * BEST_KNOWN and outcome.violation <= VIOLATION:
            return time.process_time() - began
    return float("inf")


class _OutOfTime(Exception):
    """The time for this start is over."""


def finite_differences(task: Problem, seed: int, budget_s: float) -> float:
    """The same with SLSQP, gradients by finite differences, new random starts until the time is over."""
    from scipy.optimize import minimize

    exchange = _Exchange(task)
    phase = next(iter(exchange.coarse[0].values()))
    matrix, constant = task.flat_basis(phase)
    groups = [exchange.groups[0][name] for name in exchange.coarse[0]]
    rng = np.random.default_rng(seed)
    began = time.process_time()
    found = float("inf")

    def margins(unknowns: np.ndarray) -> np.ndarray:
        samples = matrix @ unknowns + constant
        return -np.concatenate([group.excess(samples).ravel() for group in groups])

    def objective(unknowns: np.ndarray) -> float:
        return float(np.log(cost(task.series(unknowns), task)))

    def watch(unknowns: np.ndarray) -> None:
        nonlocal found
        series = task.series(unknowns)
        if cost(series, task) <= WITHIN * BEST_KNOWN and largest_violation(series, task.envelopes) <= VIOLATION:
            found = time.process_time() - began
            raise _OutOfTime
        if time.process_time() - began > budget_s:
            raise _OutOfTime

    while time.process_time() - began < budget_s and found == float("inf"):
        try:
            minimize(
                objective,
                random_start(task, rng),
                method="SLSQP",
                constraints={"type": "ineq", "fun": margins},
                callback=watch,
                options={"maxiter": 200},
            )
        except _OutOfTime:
            break
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--budget-s", type=float, default=120.0, help="CPU seconds for each run of SLSQP.")
    arguments = parser.parse_args()
    task = problem()
    best_of([task], Budget(starts=1))  # compile what is compiled once
    planner = [ours(task, seed, arguments.budget_s) for seed in range(arguments.runs)]
    baseline = [finite_differences(task, seed, arguments.budget_s) for seed in range(arguments.runs)]
    for name, seconds in (("planner", planner), ("SLSQP, finite differences", baseline)):
        told = ", ".join("never" if s == float("inf") else f"{s:.1f}" for s in seconds)
        print(f"{name}: CPU seconds to within 1 % of {BEST_KNOWN}: {told} (median {statistics.median(seconds):.1f})")
    ratio = min(statistics.median(baseline), arguments.budget_s) / statistics.median(planner)
    least = "at least " if statistics.median(baseline) == float("inf") else ""
    print(f"ratio of medians: {least}{ratio:.0f}")


if __name__ == "__main__":
    main()
