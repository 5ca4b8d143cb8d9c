r"""The program behind a plan, with exact derivatives: unknowns within limits, a criterion as small as it gets.

Every iterate starts and ends at rest, because the unknowns live in the null space of the rest conditions. A smallest
eigenvalue is not smooth where eigenvalues meet, and at an optimum they do; it is therefore a matrix inequality. With a
few further variables every criterion is smooth (M of each vehicle over a common scale):

* ``condition``: minimise :math:`\log\lambda_{max}(M) - u` subject to :math:`e^u I \preceq M`; the largest eigenvalue,
  mass, is simple,
* ``E``: minimise -u subject to :math:`e^u I \preceq M`,
* ``A``: minimise v subject to :math:`v \ge \log \operatorname{tr} M^{-1}`,
* ``D``: minimise v subject to :math:`v \ge -\log \det M`.

Several vehicles share u or v, so that the worst of them counts. How it is solved is in ``interior``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.planning.interior import minimise
from groundstation.planning.problem import Problem
from groundstation.planning.samples import LimitGroup
from groundstation.planning.terms import HeldLimit, Information

Array = NDArray[np.float64]

GAP = 5e-5
"""Of the logarithm of the criterion at which a solution is good enough; an instant before the drawing in costs more."""
COLD, WARM, HOT = 0.1, 1e-3, 3e-5
"""Of the barrier at the beginning: for a random start, for a scaled solution, for a coarse solution."""
_BISECTIONS = 40
_FAR = 1e3


class Program:
    """A program ready to be solved from many starting points.

    Args:
        problem: what to optimise.
        groups: limit groups of each vehicle.
        phases: for each vehicle and limit group the phases of the base frequency at which it is held.
        watch: called with the unknowns of each iterate; KeyboardInterrupt raised in it ends the solver.
    """

    def __init__(
        self,
        problem: Problem,
        groups: Sequence[Mapping[str, LimitGroup]],
        phases: Sequence[Mapping[str, Array]],
        *,
        watch: Callable[[Array], None] = lambda unknowns: None,
    ) -> None:
        self.problem, self._watch = problem, watch
        vehicles = problem.vehicles[:1] if problem.criterion == "condition" else problem.vehicles
        self.information = [Information(problem, vehicle, 8 * problem.harmonics) for vehicle in vehicles]
        self._held = [
            HeldLimit(problem, each[name], phase)
            for each, at in zip(groups, phases, strict=True)
            for name, phase in at.items()
            if len(phase)
        ]
        self._count = problem.unknowns
        self._matrices = problem.criterion in ("condition", "E")
        self._sign = -1.0 if self._matrices else 1.0
        self._scale, self._middle, self._reach = 1.0, np.zeros(self._count), _FAR

    def _m(self, y: Array) -> list[Array]:
        return [each.value(y[: self._count]) / self._scale for each in self.information]

    def cost(self, y: Array) -> float:
        """What is made small."""
        largest = np.log(np.linalg.eigvalsh(self._m(y)[0])[-1]) if self.problem.criterion == "condition" else 0.0
        return float(largest + self._sign * y[-1])

    def settled(self, y: Array, mu: float) -> Array:
        """The point with u or v where the barrier function is least for its unknowns: bisection of its slope."""
        ms = self._m(y)
        if self._matrices:
            values = np.concatenate([np.linalg.eigvalsh(m) for m in ms])
            low, high = 0.0, max(float(values.min()), 1e-12)
        else:
            values = np.array([self._measure(m) for m in ms])
            low, high = 0.0, mu * len(values)
        middle = high
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            slope = middle / (values - middle) if self._matrices else 1.0 / (middle + values.max() - values)
            low, high = (middle, high) if (mu * slope.sum() < 1.0) == self._matrices else (low, middle)
        return np.append(y[:-1], np.log(middle) if self._matrices else values.max() + middle)

    def values(self, y: Array) -> tuple[Array, list[Array]]:
        """Limits and, for A and D, the criterion's inequalities; the matrix inequalities of the others."""
        ms, identity = self._m(y), np.eye(self.information[0].size)
        moved = y[: self._count] - self._middle
        h = [*(held.room(y[: self._count]) for held in self._held), self._reach - moved, self._reach + moved]
        if not self._matrices:
            return np.concatenate(h), [np.array([[y[-1] - self._measure(m)]]) for m in ms]
        return np.concatenate(h), [m - np.exp(y[-1]) * identity for m in ms]

    def _measure(self, m: Array) -> float:
        eigenvalues = np.linalg.eigvalsh(m)
        if eigenvalues[0] <= 0.0:
            return np.inf
        logarithms = np.log(eigenvalues)
        return float(-logarithms.sum() if self.problem.criterion == "D" else np.log(np.sum(1.0 / eigenvalues)))

    def slopes(self, y: Array) -> tuple[Array, Array, list[Array]]:
        """Derivatives of :meth:`cost` and :meth:`values` by y."""
        x, n, size = y[: self._count], len(y), self.information[0].size
        self._watch(x)
        rows = [*(held.slope(x) for held in self._held), -np.eye(self._count), np.eye(self._count)]
        limits = np.zeros((sum(len(row) for row in rows), n))
        np.concatenate(rows, out=limits[:, : self._count])
        gradients = [each.gradient(x) / self._scale for each in self.information]
        cost = np.zeros(n)
        cost[-1] = self._sign
        if not self._matrices:
            measures = np.zeros((len(gradients), 1, 1, n))
            measures[..., -1] = 1.0
            for row, m, gradient in zip(measures, self._m(y), gradients, strict=True):
                row[0, 0, : self._count] = -np.einsum("ab,abi->i", self._weight(m), gradient)
            return cost, limits, list(measures)
        out = [np.zeros((size, size, n)) for _ in gradients]
        for g, gradient in zip(out, gradients, strict=True):
            g[:, :, : self._count] = gradient
            g[range(size), range(size), -1] = -np.exp(y[-1])
        if self.problem.criterion == "condition":
            cost[: self._count] = self._largest(y, gradients[0])[0]
        return cost, limits, out

    def _largest(self, y: Array, gradient: Array) -> tuple[Array, Array, Array]:
        """Slope of the logarithm of M's largest eigenvalue, its curvature as if M were linear, and its weight on M."""
        values, vectors = np.linalg.eigh(self._m(y)[0])
        turned = np.einsum("ak,abi,b->ki", vectors, gradient, vectors[:, -1], optimize=True)
        slope, others = turned[-1] / values[-1], turned[:-1]
        bend = 2.0 * (others.T / (values[-1] - values[:-1])) @ others / values[-1] - np.outer(slope, slope)
        return slope, bend, np.outer(vectors[:, -1], vectors[:, -1]) / values[-1]

    def _weight(self, m: Array) -> Array:
        """Derivative of the measure by M."""
        inverse = np.linalg.inv(m)
        return np.asarray(
            -inverse if self.problem.criterion == "D" else -inverse @ inverse / np.trace(inverse), dtype=float
        )

    def curvature(self, y: Array, z: Array, multipliers: list[Array]) -> tuple[Array, Array]:
        """Second derivative of the constraints' weighted sum less the cost: that of M, which is nearly convex, and the
        rest.
        """
        x, n = y[: self._count], len(y)
        total, row = np.zeros((n, n)), 0
        convex = np.zeros((n, n))
        bent = convex[: self._count, : self._count]
        inner = total[: self._count, : self._count]
        for held in self._held:
            inner += held.bend(x, z[row : row + held.size])
            row += held.size
        if not self._matrices:
            for information, m, multiplier in zip(self.information, self._m(y), multipliers, strict=True):
                inner -= multiplier[0, 0] * self._measure_curvature(information, x, m)
                bent -= multiplier[0, 0] * information.hessian(x, self._weight(m) / self._scale)
            return convex, total
        weights = [multiplier / self._scale for multiplier in multipliers]
        total[-1, -1] -= np.exp(y[-1]) * sum(np.trace(each) for each in multipliers)
        if self.problem.criterion == "condition":
            _, bend, weight = self._largest(y, self.information[0].gradient(x) / self._scale)
            inner -= bend
            weights[0] = weights[0] - weight / self._scale
        for information, weight in zip(self.information, weights, strict=True):
            bent += information.hessian(x, weight)
        return convex, total

    def _measure_curvature(self, information: Information, x: Array, m: Array) -> Array:
        """Second derivative of -log det M, or of log tr M^-1, by the unknowns, as if M were linear in them."""
        inverse, gradient = np.linalg.inv(m), information.gradient(x) / self._scale
        size, n = len(m), gradient.shape[2]
        turned = np.tensordot(inverse, gradient, 1)
        right = turned.transpose(1, 0, 2).reshape(size * size, n)
        if self.problem.criterion == "D":
            return turned.reshape(size * size, n).T @ right
        trace = np.trace(inverse)
        twice = np.einsum("abi,bc->aci", turned, inverse).reshape(size * size, n)
        slope = np.einsum("ab,abi->i", self._weight(m), gradient)
        mixed = twice.T @ np.einsum("abi->bai", turned).reshape(size * size, n)
        return (mixed + mixed.T) / trace - np.outer(slope, slope)

    def inside(self, unknowns: Array, inner: Array, share: float) -> Array:
        """The unknowns drawn toward those of an inner motion by a share, and further until every limit held is kept."""
        keep = 1.0 - share
        while True:
            drawn = inner + keep * (unknowns - inner)
            if keep < 1e-3 or all((held.room(drawn) > 0.0).all() for held in self._held):
                return drawn
            keep *= 1.0 - share
            share *= 1.5

    def solve(self, unknowns: Array, *, mu: float = COLD, gap: float = GAP, reach: float = _FAR) -> Array:
        """Unknowns at a local optimum within the limits that are held.

        Args:
            unknowns: where to start, strictly within them (see :meth:`inside`).
            mu: COLD, or less for a start that nearly solves the program.
            gap: of the criterion's logarithm at which to stop.
            reach: how far each unknown may move (m/s, rad/s; m, rad for the start).
        """
        self._middle, self._reach = unknowns, reach
        matrices = [information.value(unknowns) for information in self.information]
        self._scale = min(float(np.linalg.eigvalsh(m)[0]) for m in matrices)
        if self.problem.criterion in ("A", "D"):
            self._scale = float(np.exp(np.mean([np.linalg.slogdet(m)[1] / len(m) for m in matrices])))
        near = 0.6 if mu >= COLD else 0.99
        ms = [m / self._scale for m in matrices]
        if self._matrices:
            extra = np.log(near * min(np.linalg.eigvalsh(m)[0] for m in ms))
        else:
            extra = max(self._measure(m) for m in ms) - np.log(near)
        start = np.append(unknowns, extra)
        return minimise(self, start, mu=mu, gap=gap)[: self._count]
