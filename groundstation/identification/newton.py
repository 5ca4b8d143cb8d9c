"""The minimum of a smooth function of a few unknowns whose value at several points costs as much as at one.

Gradient and curvature are differences over points around the present one, so that a step is Newton's; its length is the
best of several. A noise's likelihood in logarithms is such a function: from a previous fit it takes one or two steps
(Dennis and Schnabel 1983, section 5.5 for the curvature made positive).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from typing import Annotated

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Costs = Callable[[Array], Array]

DIFFERENCE = 0.01
"""Between the points, in units of the unknowns: logarithms of noises are known to a percent at best."""
LONGEST = 2.0
"""Step of one unknown: a factor of seven in a logarithm."""
LENGTHS = np.array([1.0, 0.5, 0.25, 0.125, 1.5, 2.0, 0.03, 0.004])
"""Of a step that are tried at once."""
ENOUGH = 1e-3
"""Fall of the cost, in nats, below which a step is not worth another look: a standard deviation costs half of one."""


def minimum(
    costs: Costs, start: Annotated[Array, "d"], floor: Annotated[Array, "d"], ceiling: Annotated[Array, "d"], most: int
) -> tuple[Annotated[Array, "d"], float]:
    """The point of least cost within a box, and the cost.

    Args:
        costs: of points (n, d), shape (n,).
        start: where to begin, (d,). floor, ceiling: the box, (d,), wider than twice DIFFERENCE.
        most: steps.
    """
    x, lowest = np.clip(start, floor + DIFFERENCE, ceiling - DIFFERENCE), np.inf
    for _ in range(most):
        centre = np.clip(x, floor + DIFFERENCE, ceiling - DIFFERENCE)
        here, gradient, curvature = _expanded(costs, centre)
        step = _step(gradient, curvature, centre - floor <= DIFFERENCE, ceiling - centre <= DIFFERENCE)
        if lowest > here:
            x, lowest = centre, here
        if -0.5 * float(gradient @ step) < ENOUGH:
            break
        trials = np.clip(centre + LENGTHS[:, None] * step, floor, ceiling)
        found = costs(trials)
        best = int(np.argmin(found))
        fall = lowest - float(found[best])
        if fall > 0.0:
            x, lowest = trials[best], float(found[best])
        if not fall > ENOUGH:
            break
    return x, lowest


def _expanded(costs: Costs, centre: Array) -> tuple[float, Array, Array]:
    """Cost, gradient and curvature at a point."""
    count = len(centre)
    shifts = DIFFERENCE * np.eye(count)
    pairs = list(combinations(range(count), 2))
    both = np.array([shifts[i] + shifts[j] for i, j in pairs]).reshape(-1, count)
    found = costs(centre + np.concatenate([np.zeros((1, count)), shifts, -shifts, both]))
    here, up, down, mixed = found[0], found[1 : count + 1], found[count + 1 : 2 * count + 1], found[2 * count + 1 :]
    curvature = np.diag(up + down - 2.0 * here)
    for (i, j), value in zip(pairs, mixed, strict=True):
        curvature[i, j] = curvature[j, i] = value - up[i] - up[j] + here
    return float(here), (up - down) / (2.0 * DIFFERENCE), curvature / DIFFERENCE**2


def _step(gradient: Array, curvature: Array, low: NDArray[np.bool_], high: NDArray[np.bool_]) -> Array:
    """Newton's step of what no wall of the box holds, the curvature made positive, none longer than LONGEST."""
    free = ~((low & (gradient > 0.0)) | (high & (gradient < 0.0)))
    step = np.zeros_like(gradient)
    if not free.any() or not np.isfinite(curvature).all():
        return step
    values, vectors = np.linalg.eigh(curvature[np.ix_(free, free)])
    size = np.maximum(np.abs(values), 1e-6 * np.abs(values).max() + 1e-9)
    step[free] = -vectors @ ((vectors.T @ gradient[free]) / size)
    return step * min(1.0, LONGEST / max(float(np.abs(step).max()), 1e-12))


@dataclass(frozen=True, slots=True)
class Expansion:
    """A function about a point: its value, its gradient (d,), and a curvature (d, d) that is never indefinite."""

    cost: float
    gradient: Array
    curvature: Array


MOST = 40
"""Steps of :func:`scored`; ten are usual."""
NEAR = 1e-4
"""Fall of the cost, in nats, that the quadratic model promises at a minimum: a standard deviation costs half of one, so
what is found lies within a seventieth of one, wherever the search began.
"""
FAR = 20.0
"""Nats that a first step may promise before a coarse look is worth its while."""
FLAT = 0.01
"""Curvature, in nats per squared unit, that every direction is given: one that the data tell nothing of stays."""
FIRMER = 0.3
"""Damping after a step that did not lower the cost."""


def scored(
    expanded: Callable[[Array], Expansion],
    start: Annotated[Array, "d"],
    floor: Annotated[Array, "d"],
    ceiling: Annotated[Array, "d"],
    far: Callable[[Array], Array] | None = None,
) -> tuple[Annotated[Array, "d"], float]:
    """The minimum of a likelihood within a box by Fisher's scoring, damped where a step does not lower the cost
    (Levenberg and Marquardt), and the cost there.

    What gradients show of the curvature beyond the information is added to it (a symmetric update of rank one: Nocedal
    and Wright 2006, Numerical Optimization, sections 6.2 and 10.3): along a flat valley the two differ by factors.
    Each step asks once for the function about a point.

    Args:
        expanded: of a point (d,). start: (d,). floor, ceiling: the box, (d,).
        far: gives a better start where the first step promises more than FAR.
    """
    x = np.clip(start, floor, ceiling)
    here, damping, more = expanded(x), 0.0, np.zeros((len(start), len(start)))
    for count in range(MOST):
        box = np.maximum(floor - x, -LONGEST), np.minimum(ceiling - x, LONGEST)
        step, promise = _damped(here, _positive(here.curvature, more), box, damping)
        if count == 0 and far is not None and promise > FAR:
            x = far(x)
            here = expanded(x)
            continue
        if promise < NEAR:
            break
        there = expanded(x + step)
        more = _learnt(more, there.curvature, step, there.gradient - here.gradient)
        if there.cost < here.cost:
            x, here, damping = x + step, there, 0.1 * damping if damping > 0.01 else 0.0
        else:
            damping = max(6.0 * damping, FIRMER)
    return x, here.cost


SWEEPS = 20
"""Over the parts of a step that meet walls."""


def _learnt(more: Array, information: Array, step: Array, change: Array) -> Array:
    """The curvature beyond the information after a step that changed the gradient."""
    missing = change - (information + more) @ step
    along = float(missing @ step)
    if abs(along) <= 1e-6 * float(np.linalg.norm(missing) * np.linalg.norm(step)):
        return more
    return more + np.outer(missing, missing) / along


def _positive(information: Array, more: Array) -> Array:
    """Both, or the information alone where they are no curvature of a minimum."""
    both = information + more
    return both if np.linalg.eigvalsh(both)[0] > 0.0 else information


def _damped(here: Expansion, curvature: Array, box: tuple[Array, Array], damping: float) -> tuple[Array, float]:
    """The step within a box that the quadratic model, damped, likes best, and what it promises, in nats."""
    curvature = curvature + np.diag(damping * np.diag(curvature) + FLAT)
    if not np.isfinite(here.gradient).all():
        return np.zeros_like(here.gradient), 0.0
    step: Array = -np.asarray(np.linalg.solve(curvature, here.gradient), dtype=float)
    if np.any((step < box[0]) | (step > box[1])):
        step = _within(curvature, here.gradient, box)
    return step, -float(here.gradient @ step + 0.5 * step @ curvature @ step) * (1.0 + damping)


@njit(cache=True)
def _within(curvature: Array, gradient: Array, box: tuple[Array, Array]) -> Array:
    """The least of a quadratic model in a box that holds zero: part by part, each the best beside the others."""
    low, high = box
    step = np.zeros_like(gradient)
    for _ in range(SWEEPS):
        for i in range(len(step)):
            slope = gradient[i]
            for j in range(len(step)):
                slope += curvature[i, j] * step[j]
            step[i] = min(max(step[i] - slope / curvature[i, i], low[i]), high[i])
    return step
