r"""Criteria of an information matrix as smooth programs.

A smallest eigenvalue is not smooth where eigenvalues meet, and at an optimum they do. It is therefore lifted: with a
lower triangular L,

.. math:: \max_{x, s, L} s \quad\text{subject to}\quad M(x) = s I + L L^T ,

is smooth and has the same solution. D- and A-optimality use the same lifting with s = 0. Every cost is a logarithm, so
that scales do not matter.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Lifting:
    """Cost of a criterion as a function of the lifted variables y = [L by rows, s], and the matrix they stand for.

    Args:
        criterion: "condition", "D", "A" or "E".
        size: of the information matrix.
    """

    def __init__(self, criterion: str, size: int) -> None:
        self.triangle = np.tril_indices(size)
        self._has_smallest = criterion in ("condition", "E")
        count = len(self.triangle[0])
        packed = ca.SX.sym("packed", count)
        lower = ca.SX(size, size)
        for k, (i, j) in enumerate(zip(*self.triangle, strict=True)):
            lower[int(i), int(j)] = packed[k]
        variables, smallest = packed, ca.SX(0.0)
        if self._has_smallest:
            smallest = ca.SX.sym("smallest")
            variables = ca.vertcat(packed, smallest)
        matrix = lower @ lower.T + smallest * ca.SX.eye(size)
        if criterion == "condition":
            cost = ca.log(_largest_eigenvalue(matrix)) - ca.log(smallest)
        elif criterion == "E":
            cost = -ca.log(smallest)
        elif criterion == "D":
            cost = -2.0 * sum(ca.log(lower[i, i]) for i in range(size))
        else:
            cost = ca.log(ca.sumsqr(_inverse(lower)))
        packed_matrix = ca.vertcat(*[matrix[int(i), int(j)] for i, j in zip(*self.triangle, strict=True)])
        weight, weights = ca.SX.sym("weight"), ca.SX.sym("weights", count)
        lagrangian = weight * cost + ca.dot(weights, packed_matrix)
        self.count = variables.numel()
        self.positive = (
            np.array([count]) if self._has_smallest else np.flatnonzero(self.triangle[0] == self.triangle[1])
        )
        self.pattern = np.array(ca.DM(ca.jacobian(packed_matrix, variables).sparsity(), 1.0)) != 0.0
        self._value = ca.Function("value", [variables], [cost, packed_matrix])
        self._first = ca.Function(
            "first",
            [variables],
            [ca.densify(ca.gradient(cost, variables)), ca.densify(ca.jacobian(packed_matrix, variables))],
        )
        self._second = ca.Function(
            "second", [variables, weight, weights], [ca.densify(ca.hessian(lagrangian, variables)[0])]
        )

    def start(self, information: Array, share: float) -> Array:
        """Variables that stand for a given matrix, s being a share of its smallest eigenvalue."""
        smallest = share * float(np.linalg.eigvalsh(information)[0]) if self._has_smallest else 0.0
        factor = np.linalg.cholesky(information - smallest * np.eye(len(information)))
        lower = np.asarray(factor[self.triangle], dtype=float)
        return np.append(lower, smallest) if self._has_smallest else lower

    def value(self, variables: Array) -> tuple[float, Array]:
        """Cost, and the matrix's lower triangle by rows."""
        cost, packed = self._value(variables)
        return float(cost), np.array(packed).ravel()

    def first(self, variables: Array) -> tuple[Array, Array]:
        """Gradient of the cost and Jacobian of the lower triangle."""
        gradient, jacobian = self._first(variables)
        return np.array(gradient).ravel(), np.array(jacobian)

    def second(self, variables: Array, weight: float, weights: Array) -> Array:
        """Hessian of weight * cost + weights . triangle."""
        return np.array(self._second(variables, weight, weights))


@lru_cache(maxsize=8)
def lifting_of(criterion: str, size: int) -> Lifting:
    """The lifting of a criterion, built once."""
    return Lifting(criterion, size)


def _largest_eigenvalue(matrix: ca.SX) -> ca.SX:
    """The 8-norm of the eigenvalues: exact to rounding where one dominates, as mass does, and above the largest else."""
    reference = ca.trace(matrix)
    power = matrix / reference
    for _ in range(3):
        power = power @ power
    return reference * ca.trace(power) ** 0.125


def _inverse(lower: ca.SX) -> ca.SX:
    """Inverse of a lower triangular matrix by forward substitution."""
    size = lower.shape[0]
    columns = []
    for j in range(size):
        column: list[ca.SX] = []
        for row in range(size):
            right = (1.0 if row == j else 0.0) - sum((lower[row, k] * column[k] for k in range(row)), ca.SX(0.0))
            column.append(right / lower[row, row])
        columns.append(ca.vertcat(*column))
    return ca.horzcat(*columns)
