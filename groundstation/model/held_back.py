r"""A model's prediction, weighed against constant velocity by what both have missed of late.

What a model misses hardly depends on how lively a flight is: rotor torque that answers a disturbance nobody records is
missed in any. What constant velocity misses does, so that on a flight far gentler than those it was fitted to the best
model can be the worse guess. Two forecasts together err less than either (Bates and Granger 1969, Operational Research
Quarterly 20(4)):

.. math:: x = x_c + k (x_m - x_c), \qquad k = \sum w \, d \cdot e / \sum w \, d \cdot d

with :math:`d = x_m - x_c`, :math:`e` the truth less :math:`x_c`, and weights w that forget. The sums run over windows
that had ended when this one starts, so that a vehicle that flies knows them, too. Each quantity and each horizon has
its own k. It may exceed 1 (combined forecasts need no constraint: Granger and Ramanathan 1984, Journal of Forecasting
3(2)): a gain fitted to telemetry whose noise is as large as a gentle flight's torque is too small for a lively one. As
the model is the better guess where nothing else is known, k exceeds 1 only by what is more than its standard error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.flightdata import resampled
from groundstation.frames import quat_conjugate, quat_exp, quat_log, quat_multiply, quat_normalise
from groundstation.linear_filters import first_order
from groundstation.model.flight_states import FlightStates

Array = NDArray[np.float64]
State = Mapping[str, Array]
"""Position, velocity, quaternion and rate of each window, by name."""

MEMORY_S = 10.0
"""Windows older than this weigh little: long beside half a second, short beside a flight."""
WEIGHT_STD = 0.5
"""Of the model's weight about 1 before any window has ended: a model that was chosen is seldom worth nothing."""
MOST = 2.0
"""Of the model's weight: a signal that was half noise in the flights of the fit has half its gain."""
NAMES = ("position", "velocity", "quaternion", "rate")


def held_back(
    path: Mapping[float, State], still: Mapping[float, State], states: FlightStates, start_s: Array
) -> tuple[dict[float, dict[str, Array]], dict[float, dict[str, float]]]:
    """The same windows so weighed, and the mean share k of the model in each quantity at each horizon.

    Args:
        path: what a model predicts, by horizon.
        still: what constant velocity does.
        states: of the flight; starts are what is known at each stamp.
        start_s: when each window starts, ascending.
    """
    out: dict[float, dict[str, Array]] = {}
    shares: dict[float, dict[str, float]] = {}
    for horizon, found in path.items():
        own = still[horizon]
        truth = _known(states, start_s + horizon)
        ended = np.searchsorted(start_s, start_s - horizon, side="right") - 1
        step = float(np.median(np.diff(start_s))) if len(start_s) > 1 else 1.0
        apart = {name: _difference(name, found[name], own[name]) for name in NAMES}
        missed = {name: _difference(name, truth[name], own[name]) for name in NAMES}
        share = {name: _share(apart[name], missed[name], ended, step, horizon) for name in NAMES}
        out[horizon] = {name: _moved(name, own[name], share[name][:, None] * apart[name]) for name in NAMES}
        shares[horizon] = {name: float(share[name].mean()) for name in NAMES}
    return out, shares


def _known(states: FlightStates, at_s: Array) -> State:
    """The states a vehicle knows at times, as its starts have them."""
    nearest = np.clip(np.searchsorted(states.t_s, at_s - 1e-9), 0, len(states.t_s) - 1)
    columns: Sequence[Array] = (states.start_position_m, states.start_velocity_m_s, states.start_rate_rad_s)
    position, velocity, rate = (resampled(at_s, states.t_s, each) for each in columns)
    return {
        "position": position,
        "velocity": velocity,
        "quaternion": quat_normalise(states.start_quaternion[nearest]),
        "rate": rate,
    }


def _difference(name: str, one: Array, other: Array) -> Array:
    """One less another, (k, 3); of attitudes the rotation vector between them."""
    if name == "quaternion":
        return quat_log(quat_normalise(quat_multiply(quat_conjugate(other), one)))
    return one - other


def _moved(name: str, start: Array, by: Array) -> Array:
    return quat_multiply(start, quat_exp(by)) if name == "quaternion" else start + by


@np.errstate(over="ignore", invalid="ignore")  # a model that ran away is no evidence that is a number
def _share(apart: Array, missed: Array, ended: NDArray[np.int64], step_s: float, horizon_s: float) -> Array:
    """The weight k of the model in each window, (k,): of those that ended before it starts, and of one that is normal
    about 1 before any has (ridge regression: Hoerl and Kennard 1970). Windows that overlap tell the same.

    A model that moves too much is weighed by sizes of errors, not by their squares: a few wild moments, in which it is
    right, say nothing about the many quiet ones. The less it is worth, the more of its standard error is taken off:
    constant velocity is the simpler guess.
    """
    products = [np.sum(a * b, axis=1) for a, b in ((apart, missed), (apart, apart), (missed, missed))]
    told = np.isfinite(products).all(axis=0)
    rows = np.stack([np.where(told, each, 0.0) for each in (*products, np.ones(len(apart)))], axis=1)
    sums = _forgetting(rows, step_s)
    usual = np.divide(sums[:, 2], sums[:, 3], out=np.ones(len(sums)), where=sums[:, 2] > 0.0)
    by_size = rows / np.sqrt(1.0 + rows[:, 2] / usual)[:, None]
    overlap = max(horizon_s / step_s, 1.0)
    share, std = _ridge(sums, ended, overlap)
    modest, unsure = _ridge(_forgetting(by_size, step_s), ended, overlap)
    modest = modest - unsure * np.clip(1.0 - modest, 0.0, 1.0)
    return np.clip(np.where(share > 1.0, np.maximum(share - std, 1.0), np.minimum(modest, 1.0)), 0.0, MOST)


def _forgetting(rows: Array, step_s: float) -> Array:
    """Sums of rows that forget with MEMORY_S."""
    return first_order((1.0, 0.0), -float(np.exp(-step_s / MEMORY_S)), rows)


def _ridge(sums: Array, ended: NDArray[np.int64], overlap: float) -> tuple[Array, Array]:
    """Weight and its standard error from sums of d e, d d, e e and 1 at the windows that ended."""
    crossed, squared, all_missed, count = np.concatenate([sums, np.zeros((1, 4))])[ended].T  # nothing ended at -1
    best = np.divide(crossed, squared, out=np.ones(len(ended)), where=squared > 0.0)
    left = np.divide(all_missed - best * crossed, count, out=np.zeros(len(ended)), where=count > 0.0)
    noise = np.maximum(left, 0.0) * overlap
    told_by = squared + noise / WEIGHT_STD**2
    share = np.divide(crossed + noise / WEIGHT_STD**2, told_by, out=np.ones(len(ended)), where=told_by > 0.0)
    return share, np.sqrt(np.divide(noise, told_by, out=np.zeros(len(ended)), where=told_by > 0.0))
