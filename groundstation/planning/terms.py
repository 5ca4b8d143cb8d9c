r"""Limits and information of a plan as functions of its unknowns, with first and second derivatives.

At a fixed base frequency every flat sample is linear in the unknowns, :math:`u_k = B_k x`. Limits, and the signals that
regressors are made of, are functions of single samples with curvature :math:`\sum_k B_k^T H_k B_k`. Information is
quadratic in the weighted Fourier coefficients X of the regressor, so for a symmetric multiplier :math:`\Lambda`

.. math:: \nabla^2 \langle\Lambda, X^T X\rangle = 2\,(\nabla X)^T \Lambda\, \nabla X
          + \sum_k B_k^T \Big(\sum_o \nu_{ko} \nabla^2 \Phi_{ko}\Big) B_k .
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.planning.information import Block, fisher_channels, gram_channels, parameters
from groundstation.planning.problem import Problem
from groundstation.planning.samples import LimitGroup, SampleFunction, signal_function
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]


_MOVED = 1e-6
"""A row of a limit that its unknowns move less than this share of the others is left out: a start on the floor."""


class HeldLimit:
    """What is left to the bounds of a limit group at some phases; rows that no unknown moves are left out."""

    def __init__(self, problem: Problem, group: LimitGroup, phase: Array) -> None:
        self._function: SampleFunction = group.function
        self._matrix, self._constant = problem.flat_basis(phase)
        self._active = self._matrix[group.function.active]
        self._rows = np.ones(group.function.size * len(phase), dtype=bool)
        lower, upper = np.tile(group.lower, len(phase)), np.tile(group.upper, len(phase))
        self._line: tuple[Array, Array] | None = None
        if group.function.linear:
            nowhere = np.zeros(problem.unknowns)
            slope, offset = self._jacobian(nowhere), self._function.value(self._samples(nowhere)).ravel(order="F")
            moved = np.abs(slope).max(axis=1)
            self._rows = moved > _MOVED * moved.max(initial=0.0)
            self._line = slope[self._rows], offset[self._rows]
        self._above = np.isfinite(upper[self._rows])
        self._below = np.isfinite(lower[self._rows])
        self._upper, self._lower = upper[self._rows][self._above], lower[self._rows][self._below]
        self.size = int(self._above.sum() + self._below.sum())

    def _samples(self, unknowns: Array) -> Array:
        return self._matrix @ unknowns + self._constant

    def room(self, unknowns: Array) -> Array:
        """Room to the upper bounds, then to the lower ones; negative beyond."""
        if self._line is not None:
            value = self._line[0] @ unknowns + self._line[1]
        else:
            value = self._function.value(self._samples(unknowns)).ravel(order="F")
        return np.concatenate([self._upper - value[self._above], value[self._below] - self._lower])

    def _jacobian(self, unknowns: Array) -> Array:
        inner = self._function.jacobian(self._samples(unknowns))
        return np.einsum("oak,akx->kox", inner, self._active, optimize=True).reshape(len(self._rows), -1)

    def slope(self, unknowns: Array) -> Array:
        """Derivative of the room, shape (size, unknowns)."""
        rows = self._jacobian(unknowns) if self._line is None else self._line[0]
        return np.concatenate([-rows[self._above], rows[self._below]])

    def bend(self, unknowns: Array, weights: Array) -> Array | float:
        """Second derivative of the weighted sum of the room."""
        if self._function.linear:
            return 0.0
        above = int(self._above.sum())
        weight = np.zeros(len(self._rows))
        weight[self._above] -= weights[:above]
        weight[self._below] += weights[above:]
        shaped = weight.reshape(self._function.size, -1, order="F")
        return congruence(self._function.hessian(self._samples(unknowns), shaped), self._active)


def congruence(blocks: Array, basis: Array) -> Array:
    """sum_k B_k^T H_k B_k for H of shape (i, i, k) and B of shape (i, k, n)."""
    right = np.einsum("ijk,jkx->ikx", blocks, basis, optimize=True)
    size = basis.shape[2]
    return basis.reshape(-1, size).T @ right.reshape(-1, size)


class Information:
    """Information matrix of one vehicle with derivatives by the unknowns; the last point evaluated is remembered."""

    def __init__(self, problem: Problem, vehicle: Vehicle, samples: int) -> None:
        phase = 2.0 * np.pi * np.arange(samples) / samples
        self._function = signal_function(vehicle.gravity_m_s2)
        self._matrix, self._constant = problem.flat_basis(phase)
        self._active = self._matrix[self._function.active]
        if problem.criterion == "condition":
            self.size, self._channels = 7, gram_channels(vehicle, samples)
        else:
            model = parameters(vehicle, problem.effects)
            self.size = len(model)
            timing = problem.base_frequency_rad_s, problem.duration_s, samples
            self._channels = fisher_channels(vehicle, model, problem.noise, *timing)
        self._point: Array | None = None

    def _evaluate(self, unknowns: Array) -> None:
        if self._point is not None and np.array_equal(self._point, unknowns):
            return
        self._point, self._gradients, self._gradient = unknowns.copy(), None, None
        self._samples = self._matrix @ unknowns + self._constant
        signals = self._function.value(self._samples).T
        self._x = [_columns(blocks, signals) for blocks in self._channels]

    def value(self, unknowns: Array) -> Array:
        """M, shape (p, p)."""
        self._evaluate(unknowns)
        total = np.zeros((self.size, self.size))
        for blocks, x in zip(self._channels, self._x, strict=True):
            index = _parameters(blocks)
            np.add.at(total, np.ix_(index, index), x.T @ x)
        return total

    def _column_gradients(self, unknowns: Array) -> list[Array]:
        """For each channel the gradient of X, shape (c, m, n)."""
        self._evaluate(unknowns)
        if self._gradients is None:
            inner = self._function.jacobian(self._samples)
            signals = np.einsum("oak,akx->okx", inner, self._active, optimize=True)
            self._gradients = [
                np.concatenate(
                    [np.matmul(block.operator, np.tensordot(block.mix.T, signals, 1)) for block in blocks], axis=0
                )
                for blocks in self._channels
            ]
        return self._gradients

    def gradient(self, unknowns: Array) -> Array:
        """Derivative of M, shape (p, p, n)."""
        self._evaluate(unknowns)
        if self._gradient is None:
            self._gradient = self._summed_gradient(unknowns)
        return self._gradient

    def _summed_gradient(self, unknowns: Array) -> Array:
        total = np.zeros((self.size, self.size, self._matrix.shape[2]))
        for blocks, z, x in zip(self._channels, self._column_gradients(unknowns), self._x, strict=True):
            part = np.einsum("mp,qmx->pqx", x, z, optimize=True)
            index = _parameters(blocks)
            np.add.at(total, np.ix_(index, index), part + part.transpose(1, 0, 2))
        return total

    def hessian(self, unknowns: Array, weights: Array) -> Array:
        """Second derivative of <weights, M> for symmetric weights, shape (n, n)."""
        gradients = self._column_gradients(unknowns)
        size = self._matrix.shape[2]
        total = np.zeros((size, size))
        by_signal = np.zeros((self._function.size, self._samples.shape[1]))
        for blocks, x, z in zip(self._channels, self._x, gradients, strict=True):
            index = _parameters(blocks)
            weight = weights[np.ix_(index, index)]
            mixed = np.tensordot(weight, z, 1)
            total += 2.0 * z.reshape(-1, size).T @ mixed.reshape(-1, size)
            pulled, column = 2.0 * x @ weight, 0
            for block in blocks:
                width = len(block.parameters)
                by_signal += block.mix @ (pulled[:, column : column + width].T @ block.operator)
                column += width
        return total + congruence(self._function.hessian(self._samples, by_signal), self._active)


def _columns(blocks: Sequence[Block], signals: Array) -> Array:
    return np.hstack([block.operator @ (signals @ block.mix) for block in blocks])


def _parameters(blocks: Sequence[Block]) -> NDArray[np.intp]:
    return np.concatenate([block.parameters for block in blocks])
