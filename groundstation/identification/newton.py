"""The minimum of a smooth function of a few unknowns whose value at several points costs as much as at one.

Gradient and curvature are differences over points around the present one, so that a step is Newton's; its length is the
best of several. A noise's likelihood in logarithms is such a function: from a previous fit it takes one or two steps
(Dennis and Schnabel 1983, section 5.5 for the curvature made positive).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import Annotated

import numpy as np
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
