r"""A point mass on a cable without mass whose upper end moves as it is told, compiled.

With s the unit vector along the cable, L its length, v and a velocity and acceleration of the upper end, and air that
resists the mass by c times its velocity, Newton's law for the mass and :math:`|s| = 1` give

.. math:: L \ddot s = (1 - s s^T) (g - a - c (v + L \dot s)) - L |\dot s|^2 s

and the pull on the upper end, per mass, :math:`s (L |\dot s|^2 + s^T (g - a - c (v + L \dot s)))` (Goldstein, Poole,
Safko 2002, Classical mechanics, ch. 1 and 2: constraint forces; Bisgaard 2008, thesis Aalborg, ch. 3, for a load below
a helicopter). Swings may be large. The cable does not go slack: a pull below zero is a push.

Pendulums are worked out side by side, one in each lane of a vector register: all that they keep lies in one array, a
row of LANES for each quantity.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from groundstation.diagnosis.pendulum_search import LANES

Array = NDArray[np.float64]

PART_RAD, MOST_PARTS = 0.25, 1000.0
"""Angle of one step of the integration at most, and how many steps lie between two samples, whatever they are."""
STATE, STAGE, SLOPES, HOOK, BETWEEN, PUSH, LENGTH, AIR, DEPTH, STEP, PULL, ROWS = (
    LANES * row for row in (0, 6, 12, 36, 39, 42, 45, 46, 47, 48, 49, 50)
)
"""Where the rows begin: direction and its rate, those of a stage and its slopes; the upper end's velocity where a step
starts and within it, and its acceleration; what each pendulum is, its step, and its pull per mass.
"""


@njit(cache=True, error_model="numpy")
def _slopes(s: Array, gravity: float, at: int, hook: int, out: int) -> None:
    """Slopes of direction and rate in the rows from ``at``, with the upper end's velocity from ``hook`` on, into those
    from ``out``; and the pulls per mass.
    """
    for n in range(LANES):
        length, air = s[LENGTH + n], s[AIR + n]
        x0, x1, x2 = s[at + n], s[at + LANES + n], s[at + 2 * LANES + n]
        r0, r1, r2 = s[at + 3 * LANES + n], s[at + 4 * LANES + n], s[at + 5 * LANES + n]
        p0 = -s[PUSH + n] - air * (s[hook + n] + length * r0)
        p1 = -s[PUSH + LANES + n] - air * (s[hook + LANES + n] + length * r1)
        p2 = -s[PUSH + 2 * LANES + n] - air * (s[hook + 2 * LANES + n] + length * r2) - gravity
        along, square = p0 * x0 + p1 * x1 + p2 * x2, r0 * r0 + r1 * r1 + r2 * r2
        inverse = 1.0 / length
        s[out + n], s[out + LANES + n], s[out + 2 * LANES + n] = r0, r1, r2
        s[out + 3 * LANES + n] = (p0 - along * x0) * inverse - square * x0
        s[out + 4 * LANES + n] = (p1 - along * x1) * inverse - square * x1
        s[out + 5 * LANES + n] = (p2 - along * x2) * inverse - square * x2
        s[PULL + n] = length * square + along


@njit(cache=True, error_model="numpy")
def _settle(s: Array) -> None:
    """Directions of length one, rates across them."""
    for n in range(LANES):
        x0, x1, x2 = s[n], s[LANES + n], s[2 * LANES + n]
        r0, r1, r2 = s[3 * LANES + n], s[4 * LANES + n], s[5 * LANES + n]
        size = np.sqrt(x0 * x0 + x1 * x1 + x2 * x2)
        x0, x1, x2 = x0 / size, x1 / size, x2 / size
        along = x0 * r0 + x1 * r1 + x2 * r2
        s[n], s[LANES + n], s[2 * LANES + n] = x0, x1, x2
        s[3 * LANES + n], s[4 * LANES + n], s[5 * LANES + n] = r0 - along * x0, r1 - along * x1, r2 - along * x2


@njit(cache=True, error_model="numpy")
def _stepped(s: Array, gravity: float, part: float) -> None:
    """Directions, rates and the upper ends' velocities moved by a part of the step, fourth-order Runge-Kutta."""
    for number in range(4):
        share = 0.0 if number == 0 else (part if number == 3 else 0.5 * part)
        before = SLOPES + 6 * LANES * max(number - 1, 0)
        for row in range(0, 6 * LANES, LANES):
            for n in range(LANES):
                s[STAGE + row + n] = s[STATE + row + n] + share * s[STEP + n] * s[before + row + n]
        for row in range(0, 3 * LANES, LANES):
            for n in range(LANES):
                s[BETWEEN + row + n] = s[HOOK + row + n] + share * s[STEP + n] * s[PUSH + row + n]
        _slopes(s, gravity, STAGE, BETWEEN, SLOPES + 6 * LANES * number)
    for row in range(0, 6 * LANES, LANES):
        one, two = SLOPES + row, SLOPES + row + 6 * LANES
        three, four = SLOPES + row + 12 * LANES, SLOPES + row + 18 * LANES
        for n in range(LANES):
            slope = s[one + n] + 2.0 * s[two + n] + 2.0 * s[three + n] + s[four + n]
            s[STATE + row + n] += part * s[STEP + n] / 6.0 * slope
    for row in range(0, 3 * LANES, LANES):
        for n in range(LANES):
            s[HOOK + row + n] += part * s[STEP + n] * s[PUSH + row + n]
    _settle(s)


@njit(cache=True, error_model="numpy")
def _advance(s: Array, gravity: float) -> None:
    """Over a step, in as many parts as keep the angle of each small in every lane."""
    widest = 0.0
    for n in range(LANES):
        pushed, turning = 0.0, 0.0
        for row in range(0, 3 * LANES, LANES):
            pushed += s[PUSH + row + n] ** 2
            turning += s[STATE + 3 * LANES + row + n] ** 2
        pace = np.sqrt((gravity + np.sqrt(pushed)) / s[LENGTH + n] + turning) + s[AIR + n]
        widest = max(widest, s[STEP + n] * pace)
    parts = 1 + int(min(widest / PART_RAD, MOST_PARTS))
    for _ in range(parts):
        _stepped(s, gravity, 1.0 / parts)


@njit(cache=True, error_model="numpy")
def _begun(pendulums: Array) -> Array:
    """The array of pendulums (n, 3) that hang at rest, the last one in the lanes beyond them."""
    s = np.zeros(ROWS)
    for n in range(LANES):
        s[LENGTH + n], s[AIR + n], s[DEPTH + n] = pendulums[min(n, len(pendulums) - 1)]
        s[STATE + 2 * LANES + n] = -1.0
    return s


@njit(cache=True, nogil=True, error_model="numpy")
def pulls_per_mass(
    t_s: Array, velocity: tuple[Array, Array], gravity: float, pendulums: Array, keep: bool
) -> tuple[Array, Array]:
    """Pulls on the upper ends of at most LANES pendulums at each instant, m/s^2 in the world (z up), (k, 3, n), and
    directions and their rates, (k, 6, n), or none of these.

    The masses hang at rest at first. Between the instants the acceleration is constant.

    Args:
        t_s: ascending, (k,).
        velocity: in the world, m/s, of where the upper ends would be at no depth, and what each metre of depth adds,
            (k, 3) each.
        gravity: m/s^2.
        pendulums: length (m), damping by the air (1/s) and depth of the upper end (m) of each, (n, 3).
        keep: directions and rates.
    """
    k, count, (origin, by_depth) = len(t_s), len(pendulums), velocity
    out, states = np.empty((k, 3, count)), np.empty((k if keep else 0, 6, count))
    s = _begun(pendulums)
    after = np.zeros(3 * LANES)
    for i in range(k):
        step = 0.0
        before = after.copy()
        if i + 1 < k:
            step = max(t_s[i + 1] - t_s[i], 1e-6)
            for j in range(3):
                change, deeper = (origin[i + 1, j] - origin[i, j]) / step, (by_depth[i + 1, j] - by_depth[i, j]) / step
                for n in range(LANES):
                    after[j * LANES + n] = change + s[DEPTH + n] * deeper
        for j in range(3):
            for n in range(LANES):
                now, last = after[j * LANES + n], before[j * LANES + n]
                s[PUSH + j * LANES + n] = 0.5 * (last + now) if 0 < i < k - 1 else now
                s[HOOK + j * LANES + n] = origin[i, j] + s[DEPTH + n] * by_depth[i, j]
        _slopes(s, gravity, STATE, HOOK, SLOPES)
        for n in range(count):
            for j in range(3):
                out[i, j, n] = s[PULL + n] * s[j * LANES + n]
            if keep:
                for j in range(6):
                    states[i, j, n] = s[j * LANES + n]
        for n in range(LANES):
            s[STEP + n] = step
        s[PUSH : PUSH + 3 * LANES] = after
        _advance(s, gravity)
    return out, states


@njit(cache=True, nogil=True, error_model="numpy")
def pulls_moved(states: Array, velocity: tuple[Array, Array], step_s: Array, gravity: float, pendulum: Array) -> Array:
    """Pulls per mass of one pendulum in many windows side by side, (k, 3), after each has moved by a step of its own.

    Args:
        states: direction and rate of each, (k, 6), changed in place.
        velocity: of the upper ends where the step starts and where it ends, (k, 3) each.
        step_s: (k,). pendulum: length, damping and depth, (3,).
    """
    old, new = velocity
    k = len(states)
    out = np.empty((k, 3))
    s = _begun(pendulum.reshape(1, 3))
    for first in range(0, k, LANES):
        for n in range(LANES):
            i = min(first + n, k - 1)
            s[STEP + n] = max(step_s[i], 1e-6)
            for j in range(6):
                s[STATE + j * LANES + n] = states[i, j]
            for j in range(3):
                s[HOOK + j * LANES + n] = old[i, j]
                s[PUSH + j * LANES + n] = (new[i, j] - old[i, j]) / s[STEP + n]
        _advance(s, gravity)
        for n in range(min(LANES, k - first)):
            for j in range(3):
                s[HOOK + j * LANES + n] = new[first + n, j]
        _slopes(s, gravity, STATE, HOOK, SLOPES)
        for n in range(min(LANES, k - first)):
            for j in range(6):
                states[first + n, j] = s[STATE + j * LANES + n]
            for j in range(3):
                out[first + n, j] = s[PULL + n] * s[j * LANES + n]
    return out
