"""A regression of 50 s at 500 Hz, and the seed's estimators as a Python loop over its samples
(``benchmarks.estimators``).
"""

from __future__ import annotations

import statistics
from collections.abc import Callable

import numpy as np

from groundstation.identification.estimators import ADAPTATION_RATE_PER_S
from groundstation.identification.regressors import standard_regressor
from groundstation.paths import find_config
from groundstation.trajectory import load_plan, rigid_motion
from groundstation.vehicle import load_vehicle
from studies.timing import seconds

DURATION_S, PERIOD_S = 50.0, 0.002
RUNS = 5
IDENTIFIED = ((0.5, 20.0, 2.0), (1.5, 60.0, 5.0))
"""Share of the study's plan, seconds of excitation, budget in seconds."""
IDENTIFIED_SEED = 2001
"""Of the study: rotors by command, so lag and delay are free, which is the slower case."""


def problem() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Regressor, output and times of the published trajectory with white noise on the wrench."""
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    plan = load_plan(find_config("plans", "paper_table2")).model_copy(update={"periods": 5.0})
    t = np.arange(0.0, DURATION_S, PERIOD_S)
    motion = rigid_motion(plan.series().sample(t))
    gamma = standard_regressor(
        motion.specific_thrust_m_s2, motion.angular_velocity_body_rad_s, motion.angular_acceleration_body_rad_s2
    )
    theta = np.array([vehicle.mass_kg, *vehicle.inertia_tensor()[np.triu_indices(3)]])
    noise = np.random.default_rng(0).normal(size=(len(t), 4)) * [0.1, 0.01, 0.01, 0.01]
    return gamma, gamma @ theta + noise, t


def loop_least_squares(gamma: np.ndarray, upsilon: np.ndarray) -> np.ndarray:
    """Eq. (40) sample by sample: add to the sums, solve; shape (k, 7)."""
    normal, moment = 1e-12 * np.eye(gamma.shape[2]), np.zeros(gamma.shape[2])
    out = np.empty((len(gamma), gamma.shape[2]))
    for h in range(len(gamma)):
        normal += gamma[h].T @ gamma[h]
        moment += gamma[h].T @ upsilon[h]
        out[h] = np.linalg.solve(normal, moment)
    return out


def loop_gradient_descent(gamma: np.ndarray, upsilon: np.ndarray) -> np.ndarray:
    """Eq. (42), scaled and implicit as ours is, sample by sample; shape (k, 7)."""
    gain = ADAPTATION_RATE_PER_S * PERIOD_S / np.mean(np.sum(gamma**2, axis=1), axis=0)
    theta = np.zeros(gamma.shape[2])
    out = np.empty((len(gamma), gamma.shape[2]))
    for h in range(len(gamma)):
        for row in range(gamma.shape[1]):
            g = gamma[h, row]
            theta = theta - gain * g * (g @ theta - upsilon[h, row]) / (1.0 + gain @ g**2)
        out[h] = theta
    return out


def median_s(function: Callable[[], object], runs: int = RUNS) -> float:
    """Median processor time of a call, after one that warms up."""
    function()
    return statistics.median(seconds(function) for _ in range(runs))
