r"""A point mass on a cable without mass whose upper end moves as it is told, compiled.

With s the unit vector along the cable, L its length, v and a velocity and acceleration of the upper end, and air that
resists the mass by c times its velocity, Newton's law for the mass and :math:`|s| = 1` give

.. math:: L \ddot s = (1 - s s^T) (g - a - c (v + L \dot s)) - L |\dot s|^2 s

and the pull on the upper end, per mass, :math:`s (L |\dot s|^2 + s^T (g - a - c (v + L \dot s)))` (Goldstein, Poole,
Safko 2002, Classical mechanics, ch. 1 and 2: constraint forces; Bisgaard 2008, thesis Aalborg, ch. 3, for a load below
a helicopter). Swings may be large. The cable does not go slack: a pull below zero is a push.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Pendulum(NamedTuple):
    """Gravity, m/s^2; length, m; damping by the air per mass, 1/s."""

    gravity: float
    length: float
    air: float


PART_RAD, MOST_PARTS = 0.25, 1000.0
"""Angle of one step of the integration at most, and how many steps lie between two samples, whatever they are."""


@njit(cache=True)
def _slopes(x: Array, v: Array, a: Array, of: Pendulum, out: Array) -> float:
    """Slopes of direction and its rate, (6,), into ``out``; returns the pull per mass."""
    gravity, length, air = of
    along, square = 0.0, 0.0
    for j in range(3):
        push = -a[j] - air * (v[j] + length * x[3 + j]) - (gravity if j == 2 else 0.0)
        out[3 + j] = push
        along += push * x[j]
        square += x[3 + j] * x[3 + j]
    for j in range(3):
        out[j] = x[3 + j]
        out[3 + j] = (out[3 + j] - along * x[j]) / length - square * x[j]
    return length * square + along


@njit(cache=True)
def _settle(x: Array) -> None:
    """Direction of length one, rate across it."""
    size = np.sqrt(x[0] ** 2 + x[1] ** 2 + x[2] ** 2)
    along = 0.0
    for j in range(3):
        x[j] /= size
        along += x[j] * x[3 + j]
    for j in range(3):
        x[3 + j] -= along * x[j]


@njit(cache=True)
def _stepped(x: Array, work: Array, acceleration: Array, step: float, of: Pendulum) -> None:
    """Direction and rate moved by a step of fourth-order Runge-Kutta.

    It starts from the velocity in the last row of ``work``, which moves along.
    """
    slopes, stage, v, start = work[:4], work[4], work[5], work[6]
    for number in range(4):
        share = 0.0 if number == 0 else (1.0 if number == 3 else 0.5)
        for j in range(3):
            v[j] = start[j] + share * step * acceleration[j]
        for j in range(6):
            stage[j] = x[j] + (share * step * slopes[number - 1, j] if number > 0 else 0.0)
        _slopes(stage, v, acceleration, of, slopes[number])
    for j in range(6):
        x[j] += step / 6.0 * (slopes[0, j] + 2.0 * slopes[1, j] + 2.0 * slopes[2, j] + slopes[3, j])
    for j in range(3):
        start[j] += step * acceleration[j]
    _settle(x)


@njit(cache=True)
def _advance(x: Array, work: Array, ends: tuple[Array, Array], step: float, of: Pendulum) -> None:
    """Direction and rate, (6,), over a step, in as many parts as keep the angle of each small.

    Args:
        work: of shape (7, 6).
        ends: velocity of the upper end where the step starts, and its acceleration over it, (3,) each.
    """
    velocity, acceleration = ends
    pushed, turning = 0.0, 0.0
    for j in range(3):
        work[6, j] = velocity[j]
        pushed += acceleration[j] * acceleration[j]
        turning += x[3 + j] * x[3 + j]
    pace = np.sqrt((of.gravity + np.sqrt(pushed)) / of.length + turning) + of.air
    parts = 1 + int(min(step * pace / PART_RAD, MOST_PARTS))
    for _ in range(parts):
        _stepped(x, work, acceleration, step / parts, of)


@njit(cache=True)
def pull_per_mass(t_s: Array, velocity: Array, gravity: float, length: float, air: float) -> tuple[Array, Array]:
    """Pull on the upper end at each instant, m/s^2 in the world (z up), (k, 3), and direction and its rate, (k, 6).

    The mass hangs at rest at first. Between the instants the acceleration is constant.

    Args:
        t_s: ascending, (k,).
        velocity: of the upper end in the world, m/s, (k, 3).
        gravity: m/s^2. length: m. air: 1/s.
    """
    of = Pendulum(gravity, length, air)
    k = len(t_s)
    out, states = np.empty((k, 3)), np.empty((k, 6))
    x, work = np.zeros(6), np.empty((7, 6))
    x[2] = -1.0
    before, after, middle = np.zeros(3), np.zeros(3), np.zeros(3)
    for i in range(k):
        step = 0.0
        if i + 1 < k:
            step = max(t_s[i + 1] - t_s[i], 1e-6)
            for j in range(3):
                after[j] = (velocity[i + 1, j] - velocity[i, j]) / step
        for j in range(3):
            middle[j] = 0.5 * (before[j] + after[j]) if 0 < i < k - 1 else (after[j] if i == 0 else before[j])
            before[j] = after[j]
        states[i] = x
        pull = _slopes(x, velocity[i], middle, of, work[0])
        for j in range(3):
            out[i, j] = pull * x[j]
        _advance(x, work, (velocity[i], after), step, of)
    return out, states


@njit(cache=True)
def pulls_moved(
    states: Array, velocity: tuple[Array, Array], step_s: Array, gravity: float, length: float, air: float
) -> Array:
    """Pulls per mass of many pendulums side by side, (k, 3), after each has moved by a step of its own.

    Args:
        states: direction and rate of each, (k, 6), changed in place.
        velocity: of the upper ends where the step starts and where it ends, (k, 3) each.
        step_s: (k,).
    """
    of, (old, new) = Pendulum(gravity, length, air), velocity
    out = np.empty((len(states), 3))
    work, acceleration = np.empty((7, 6)), np.zeros(3)
    for i in range(len(states)):
        step = max(step_s[i], 1e-6)
        for j in range(3):
            acceleration[j] = (new[i, j] - old[i, j]) / step
        _advance(states[i], work, (old[i], acceleration), step, of)
        pull = _slopes(states[i], new[i], acceleration, of, work[0])
        for j in range(3):
            out[i, j] = pull * states[i, j]
    return out
