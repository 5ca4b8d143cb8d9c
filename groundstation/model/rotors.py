"""Rotor thrusts over time from what a flight recorded of its motors: commands through a lag, or measured speeds.

A command holds until the next one; a measured speed is interpolated linearly (it is a sample of something continuous).
The lag x' = (1 + s (u/u_h - 1)) (u - x)/tau, with tau by the sign of u - x, is solved exactly over each step of a fine
grid. A first-order lag has s = 0. The torque of a motor falls in proportion to its speed and its propeller's drag grows
with the square, so small changes about a speed fade at the rate (a + b u), which is linearised about hover's command
u_h: s is the propeller's share of the damping there (Bangura and Mahony 2014, Thrust control for multirotor aerial
vehicles, for the torques).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numba import njit
from numpy.typing import NDArray

from groundstation.flightdata import resampled
from groundstation.model.rotor_kernel import LANES, NEARLY_INSTANT_S, SLOWEST, block_means, gain
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

FINE_STEP_S = 0.001

Lag = tuple[float, float, float]
"""Of rising and falling rotors, s, and its slope."""


@njit(cache=True, nogil=True, error_model="numpy")
def _lagged(value: Array, up: float, down: float, step: float, slope: float, hover: float) -> Array:
    """Each column of a piecewise constant input behind the lag, shape kept.

    What a step moves a rotor depends on the command alone, so it is worked out where that changes: the rotor waits for
    one product.
    """
    count, columns = value.shape
    out = np.empty_like(value)
    step_up, step_down = step / max(up, NEARLY_INSTANT_S), step / max(down, NEARLY_INSTANT_S)
    still, more = 1.0 - slope, slope / hover
    x, rising, falling = value[0].copy(), np.empty(columns), np.empty(columns)
    for i in range(count):  # columns side by side: each only waits for itself
        for j in range(columns):
            if i == 0 or (slope != 0.0 and value[i, j] != value[i - 1, j]):
                pace = max(still + more * value[i, j], SLOWEST)
                rising[j], falling[j] = gain(pace * step_up), gain(pace * step_down)
            out[i, j] = x[j]
            error = value[i, j] - x[j]
            x[j] += (rising[j] if error > 0.0 else falling[j]) * error
    return out


@dataclass(frozen=True, slots=True)
class MotorInput:
    """Recorded motor values on a fine uniform grid of the motors' clock.

    Attributes:
        start_s, step_s: the grid.
        value: speeds, commands or wrench components, shape (k, n).
        measured: the values are measured speeds (no lag between them and the thrust).
        hover: value at which a rotor carries its share of the weight.
        held_s: for how long a value holds, as a rule; zero where it is measured.
    """

    start_s: float
    step_s: float
    value: Array
    measured: bool
    hover: float = 1.0
    held_s: float = 0.0

    @property
    def t_s(self) -> Array:
        """Grid times, shape (k,)."""
        return np.asarray(self.start_s + self.step_s * np.arange(len(self.value)), dtype=float)

    def lagged(self, up_s: float, down_s: float, slope: float = 0.0) -> Array:
        """Values after the lag, shape (k, n). A zero lag passes the values through."""
        if up_s <= NEARLY_INSTANT_S and down_s <= NEARLY_INSTANT_S:
            return self.value
        return _lagged(self.value, up_s, down_s, self.step_s, slope, self.hover)


def motor_input(
    t_s: Annotated[Array, "m"],
    values: Annotated[Array, "m n"],
    *,
    measured: bool,
    step_s: float = FINE_STEP_S,
    hover: float = 1.0,
) -> MotorInput:
    """Put recorded motor values on a uniform grid: commands held and averaged over each step, measured speeds
    interpolated.

    A command that is stamped within a step holds from there: taken for the whole step, or left out of it, it would act
    up to a step early or late, at random where stamps that lie on the grid jitter.

    Args:
        t_s: strictly increasing stamps, shape (m,).
        values: shape (m, n).
        measured: interpolate instead of holding.
        step_s: spacing of the grid.
        hover: value at which a rotor carries its share of the weight.
    """
    t_s = np.asarray(t_s, dtype=float)
    grid: Array = t_s[0] + step_s * np.arange(int(np.floor((t_s[-1] - t_s[0]) / step_s)) + 1)
    if measured:
        value = resampled(grid, t_s, values)
    else:
        value = _held(grid, step_s, t_s, np.asarray(values, dtype=float))
    held_s = 0.0 if measured or len(t_s) < 2 else float(np.median(np.diff(t_s)))
    return MotorInput(float(t_s[0]), step_s, np.ascontiguousarray(value, dtype=float), measured, hover, held_s)


def _held(grid: Array, step_s: float, t_s: Array, values: Array) -> Array:
    """Mean over each step of the grid of values that hold from stamp to stamp, (k, n)."""
    first, last = (np.searchsorted(t_s, grid + end, side="right") - 1 for end in (1e-9, step_s - 1e-9))
    out: Array = values[first]
    within = np.flatnonzero(last > first)
    done: Array = np.zeros_like(values)
    np.cumsum(np.diff(t_s)[:, None] * values[:-1], axis=0, out=done[1:])

    def until(index: NDArray[np.int64], t: Array) -> Array:
        return done[index] + values[index] * (t - t_s[index])[:, None]

    begin = grid[within]
    out[within] = (until(last[within], begin + step_s) - until(first[within], begin)) / step_s
    return out


@njit(cache=True, nogil=True)
def _cumulative(values: Array, step: float, held: bool) -> Array:
    out = np.empty(values.shape)
    total = np.zeros(values.shape[1])
    for j in range(values.shape[1]):
        out[0, j] = 0.0
    for i in range(1, values.shape[0]):
        for j in range(values.shape[1]):
            total[j] += values[i - 1, j] if held else 0.5 * (values[i, j] + values[i - 1, j])
            out[i, j] = total[j] * step
    return out


def cumulative(values: Annotated[Array, "k n"], step_s: float, *, held: bool) -> Annotated[Array, "k n"]:
    """Running integral from the first grid point, shape as ``values``; left sums for held values, else trapezoids."""
    return _cumulative(np.ascontiguousarray(values, dtype=float), step_s, held)


def interpolate_columns(
    query_s: Annotated[Array, "q"], start_s: float, step_s: float, values: Annotated[Array, "k n"]
) -> Annotated[Array, "q n"]:
    """Linear interpolation of all columns of a uniform grid at query times, held at the ends, shape (q, n)."""
    position = np.clip((query_s - start_s) / step_s, 0.0, len(values) - 1.000001)
    index = position.astype(np.int64)
    weight = (position - index)[:, None]
    return values[index] * (1.0 - weight) + values[index + 1] * weight


def hover_value(vehicle: Vehicle) -> float:
    """Motor value at which a rotor carries its share of the declared weight; one where none does (a wrench as
    input).
    """
    if vehicle.rotors.input == "wrench":
        return 1.0
    share = vehicle.mass_kg * vehicle.gravity_m_s2 / vehicle.rotors.count
    return float(vehicle.motor_for_thrust(share)) or 1.0


def declared_thrust(vehicle: Vehicle, lagged: Annotated[Array, "k n"]) -> Annotated[Array, "k n"]:
    """Thrust of each rotor by the declared constants from (lagged) motor values; the wrench passes through."""
    return lagged if vehicle.rotors.input == "wrench" else vehicle.thrust(lagged)


def thrust_polynomial(vehicle: Vehicle) -> Annotated[Array, "3"]:
    """Coefficients of :func:`declared_thrust` by powers of a motor value, (3,)."""
    if vehicle.rotors.input == "wrench":
        return np.array([0.0, 1.0, 0.0])
    if vehicle.rotors.input == "command" and vehicle.rotors.thrust_curve is not None:
        return np.array(vehicle.rotors.thrust_curve, dtype=float)
    per_unit = (vehicle.rotors.speed_max_rad_s or 0.0) if vehicle.rotors.input == "command" else 1.0
    return np.array([0.0, 0.0, (vehicle.rotors.thrust_coefficient_n_s2 or 0.0) * per_unit**2])


def mean_thrusts(
    vehicle: Vehicle, motors: MotorInput, wanted: Sequence[tuple[Lag, float]], blocks: tuple[Array, NDArray[np.int64]]
) -> list[Array]:
    """Block means of :func:`declared_thrust` behind each lag and dead time, and of its running integral, (blocks, 2, n)
    each.

    Args:
        blocks: stamps of the samples (k,), and the samples of each block (blocks, size).
    """
    rotors = motors.value.shape[1]
    grid = (motors.start_s, motors.step_s, float(motors.hover), motors.measured)
    lags, together = list(dict.fromkeys(lag for lag, _ in wanted)), LANES // rotors
    found: dict[tuple[Lag, float], Array] = {}
    for first in range(0, len(lags), together):
        some = lags[first : first + together]
        asked = {delay: [n for n, lag in enumerate(some) if (lag, delay) in wanted] for _, delay in wanted}
        asked = {delay: places for delay, places in asked.items() if places}
        lanes = np.array([(places[0] * rotors, (places[-1] + 1 - places[0]) * rotors) for places in asked.values()])
        delays = np.array(list(asked), dtype=float)
        curve = thrust_polynomial(vehicle)
        means = block_means(motors.value, grid, np.array(some, dtype=float), (delays, lanes), curve, blocks)
        ends = 2 * len(blocks[1]) * np.cumsum(lanes[:, 1])
        for part, width, (delay, places) in zip(np.split(means, ends[:-1]), lanes[:, 1], asked.items(), strict=True):
            mean = part.reshape(-1, 2, width)
            for n in places:
                at = (n - places[0]) * rotors
                found[some[n], delay] = mean[:, :, at : at + rotors]
    return [found[each] for each in wanted]


def wrench_matrix(vehicle: Vehicle) -> Annotated[Array, "6 n"]:
    """Map what :func:`declared_thrust` gives to body force and torque about the declared origin, shape (6, n)."""
    return np.eye(6)[:, 2:] if vehicle.rotors.input == "wrench" else vehicle.six_row_allocation()


def thrusts_for(vehicle: Vehicle) -> Annotated[Array, "n 4"]:
    """Map [F_z, tau_x, tau_y, tau_z] to what :func:`declared_thrust` gives, shape (n, 4)."""
    return np.eye(4) if vehicle.rotors.input == "wrench" else vehicle.mixing()
