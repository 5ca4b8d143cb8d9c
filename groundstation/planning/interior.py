r"""A feasible primal-dual interior point for small dense programs with matrix inequalities.

.. math:: \min_y f(y) \quad\text{subject to}\quad h(y) \ge 0,\; S_j(y) \succeq 0 .

Both kinds of constraint get the logarithmic barrier; multipliers z and Z_j are kept beside the point, so that Newton's
system is that of the perturbed optimality conditions :math:`z_i h_i = \mu`, :math:`S_j Z_j = \mu I` (Nocedal and
Wright, Numerical Optimization, 2nd ed., ch. 19; for matrices the direction of Helmberg, Rendl, Vanderbei and Wolkowicz
1996). Every iterate lies strictly inside the constraints. A constraint that curves away from the region it bounds
makes Newton's system indefinite; such a step is made as if it were straight (the convex-concave procedure of Yuille and
Rangarajan 2003: straight, it promises less than it holds), and what is still indefinite gets a larger diagonal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BOUNDARY = 0.995  # share of the way to a constraint's boundary that one step may go
_DECREASE = 1e-4  # Armijo's share of the predicted decrease
_SPREAD = 1e8  # by how much z h may differ from mu
_HALVINGS = 20
_SOLVED = 1.0  # a step that promises a decrease of so many mu or less: on to a smaller mu
_ACTIVE = 30.0  # constraints that hold a plan at its optimum, about: the gap is mu times as many
_FASTER = 0.15
_RAISED = (0.0, 1e-4, 1e-2)  # added to a diagonal of ones


class Constraints(Protocol):
    """Scalar and matrix constraints of a program with first and second derivatives."""

    def cost(self, y: Array) -> float:
        """The cost f."""
        ...

    def settled(self, y: Array, mu: float) -> Array:
        """The same with its last entry, a helper that only constraints tie, where the barrier function is least."""
        ...

    def values(self, y: Array) -> tuple[Array, list[Array]]:
        """Values h of shape (m,), and each S of shape (p, p)."""
        ...

    def slopes(self, y: Array) -> tuple[Array, Array, list[Array]]:
        """Gradient of f, shape (n,); Jacobian of h, shape (m, n), and of each S, shape (p, p, n)."""
        ...

    def curvature(self, y: Array, z: Array, multipliers: list[Array]) -> tuple[Array, Array]:
        """Second derivative of z . h + sum of <Z, S> - f, shape (n, n): what may be convex, and the rest."""
        ...


@dataclass(slots=True)
class _Point:
    y: Array
    h: Array
    matrices: list[Array]
    z: Array
    big: list[Array]


def minimise(program: Constraints, start: Array, *, mu: float, gap: float, iterations: int = 120) -> Array:
    """A local optimum, to a gap in the cost.

    Args:
        program: cost and constraints.
        start: a point strictly inside every constraint, shape (n,).
        mu: of the barrier at the beginning; small where the start is nearly optimal.
        gap: in the cost at which to stop.
        iterations: at most so many.

    Returns:
        The last point, strictly inside as well.

    Raises:
        ValueError: the start is not inside.
    """
    h, matrices = program.values(start)
    if not (h > 0.0).all() or not all(_positive(each) for each in matrices):
        raise ValueError("the start is not strictly inside every constraint")
    point = _Point(start, h, matrices, mu / h, [np.asarray(mu * np.linalg.inv(each), dtype=float) for each in matrices])
    least = gap / _ACTIVE
    for _ in range(iterations):
        decrement = _step(program, point, program.slopes(point.y), mu)
        if decrement < 0.0 or (mu == least and decrement < _SOLVED * mu):
            break
        if decrement <= _SOLVED * mu:
            mu = max(least, _FASTER * mu)
    return point.y


def _positive(matrix: Array) -> bool:
    return _factor(matrix) is not None


def _barrier(program: Constraints, y: Array, h: Array, matrices: list[Array], mu: float) -> float:
    logarithms = float(np.log(h).sum()) + sum(float(np.linalg.slogdet(each)[1]) for each in matrices)
    return program.cost(y) - mu * logarithms


def _step(program: Constraints, point: _Point, slopes: tuple[Array, Array, list[Array]], mu: float) -> float:
    """Move the point by one damped Newton step; the decrease it promised, negative where it could not."""
    gradient, jacobian, gradients = slopes
    inverses = [np.linalg.inv(each) for each in point.matrices]
    convex, rest = program.curvature(point.y, point.z, point.big)
    stiff = point.z / point.h
    system = jacobian.T @ (stiff[:, None] * jacobian) - rest
    slope = gradient - mu * (jacobian.T @ (1.0 / point.h))
    for g, inverse, big in zip(gradients, inverses, point.big, strict=True):
        n, p = g.shape[2], len(inverse)
        left = np.tensordot(inverse, g, 1).reshape(p * p, n)
        right = np.tensordot(big, g, 1).transpose(1, 0, 2).reshape(p * p, n)
        product = left.T @ right
        system += 0.5 * (product + product.T)
        slope -= mu * np.einsum("ab,abi->i", inverse, g)
    move = -_solved(system, convex, slope)
    dh, decrease = jacobian @ move, -float(slope @ move)
    dz = mu / point.h - point.z - stiff * dh
    bigs: list[Array] = []
    for inverse, big, g in zip(inverses, point.big, gradients, strict=True):
        product = inverse @ np.tensordot(g, move, 1) @ big
        bigs.append(mu * inverse - big - 0.5 * (product + product.T))
    if not _primal(program, point, move, dh, (mu, decrease)):
        return -1.0
    falling = dz < 0.0
    beta = min(1.0, _BOUNDARY * float(np.min(-point.z[falling] / dz[falling], initial=np.inf)))
    while beta > 1e-8 and not all(_positive(b + beta * m) for b, m in zip(point.big, bigs, strict=True)):
        beta *= 0.7
    point.z = np.clip(point.z + beta * dz, mu / (_SPREAD * point.h), _SPREAD * mu / point.h)
    point.big = [b + 0.99 * beta * m for b, m in zip(point.big, bigs, strict=True)]
    return max(decrease, 0.0)


def _primal(program: Constraints, point: _Point, move: Array, dh: Array, barrier: tuple[float, float]) -> bool:
    """Go as far as the constraints stay kept and the barrier function decreases; moves the point there."""
    mu, decrease = barrier
    falling = dh < 0.0
    alpha = min(1.0, _BOUNDARY * float(np.min(-point.h[falling] / dh[falling], initial=np.inf)))
    before = _barrier(program, point.y, point.h, point.matrices, mu)
    for _ in range(_HALVINGS):
        y = program.settled(point.y + alpha * move, mu)
        h, matrices = program.values(y)
        if (h > 0.1 * (1.0 - _BOUNDARY) * point.h).all() and all(_positive(each) for each in matrices):
            after = _barrier(program, y, h, matrices, mu)
            if after <= before - _DECREASE * alpha * max(decrease, 0.0) + 1e-10 * abs(before):
                point.y, point.h, point.matrices = y, h, matrices
                return True
        alpha *= 0.5
    return False


def _solved(system: Array, convex: Array, right: Array) -> Array:
    """Solution of Newton's system; its diagonal a little larger, or the convex constraints straight, where need be."""
    for each, raised in [(system - convex, r) for r in _RAISED] + [(system, r) for r in (0.0, *_RAISED)]:
        scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(each)), 1e-12))
        lower = _factor(scale[:, None] * each * scale + raised * np.eye(len(each)))
        if lower is not None:
            return scale * np.linalg.solve(lower.T, np.linalg.solve(lower, scale * right))
    return right / np.maximum(np.abs(np.diag(system)), 1e-12)


def _factor(matrix: Array) -> Array | None:
    try:
        return np.asarray(np.linalg.cholesky(matrix), dtype=float)
    except np.linalg.LinAlgError:
        return None
