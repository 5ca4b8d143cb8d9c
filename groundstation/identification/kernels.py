"""Compiled recursions. Import where they are used: numba takes a third of a second to load."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True)
def descend(gamma: Array, upsilon: Array, gain: Array, stops: NDArray[np.int64], theta: Array) -> Array:
    """Implicit gradient descent, one scalar row after the other.

    Args:
        gamma: shape (n, outputs, p).
        upsilon: shape (n, outputs).
        gain: T D of each parameter, shape (p,).
        stops: numbers of samples after which to note the estimate, ascending.
        theta: where it begins, (p,); then where it has come.

    Returns:
        Estimate at each stop, shape (len(stops), p).
    """
    samples, outputs, parameters = gamma.shape
    noted = np.empty((len(stops), parameters))
    at = 0
    for k in range(samples):
        for row in range(outputs):
            error = -upsilon[k, row]
            size = 1.0
            for j in range(parameters):
                error += gamma[k, row, j] * theta[j]
                size += gain[j] * gamma[k, row, j] ** 2
            for j in range(parameters):
                theta[j] -= gain[j] * gamma[k, row, j] * error / size
        while at < len(stops) and stops[at] == k + 1:
            noted[at] = theta
            at += 1
    return noted


@njit(cache=True)
def add_products(gamma: Array, upsilon: Array, stops: NDArray[np.int64], total: Array) -> Array:
    """Running sums of Gamma^T Gamma (p, p), and of Gamma^T Upsilon (p,) in a row below, after each number of samples.

    Args:
        gamma: shape (n, outputs, p). upsilon: (n, outputs). stops: numbers of samples, ascending.
        total: the sums before, (p + 1, p); then those of all.

    Returns:
        Shape (len(stops), p + 1, p).
    """
    samples, outputs, p = gamma.shape
    noted = np.empty((len(stops), p + 1, p))
    at = 0
    for k in range(samples):
        for row in range(outputs):
            for i in range(p):
                value = gamma[k, row, i]
                if value != 0.0:
                    for j in range(p):
                        total[i, j] += value * gamma[k, row, j]
                    total[p, i] += value * upsilon[k, row]
        while at < len(stops) and stops[at] == k + 1:
            noted[at] = total
            at += 1
    return noted


@njit(cache=True)
def descent_influence(gamma: Array, gain: Array, later: Array) -> Array:
    """H_k of the final estimate of :func:`descend`, (n, p, outputs).

    Going backward, M is the product of the later steps 1 - K Gamma; a row with K = gain Gamma^T/size enters by M K.

    Args:
        gamma: shape (n, outputs, p). gain: T D of each parameter, (p,).
        later: M of the samples after these, (p, p); then with these, too: what is left of an error before them.
    """
    samples, outputs, parameters = gamma.shape
    influence = np.zeros((samples, parameters, outputs))
    for k in range(samples - 1, -1, -1):
        for row in range(outputs - 1, -1, -1):
            size = 1.0
            for j in range(parameters):
                size += gain[j] * gamma[k, row, j] ** 2
            for i in range(parameters):
                entering = 0.0
                for j in range(parameters):
                    entering += later[i, j] * gain[j] * gamma[k, row, j]
                entering /= size
                influence[k, i, row] = entering
                for j in range(parameters):
                    later[i, j] -= entering * gamma[k, row, j]
    return influence


@njit(cache=True)
def fill_inertia(alpha: Array, products: Array, out: Array) -> None:
    """Columns of :func:`.regressors.inertia_columns` of every sample into ``out``, (k, 3, 6)."""
    for k in range(len(alpha)):
        a, b, c = alpha[k, 0], alpha[k, 1], alpha[k, 2]
        pp, pq, pr = products[k, 0], products[k, 1], products[k, 2]
        qq, qr, rr = products[k, 3], products[k, 4], products[k, 5]
        roll, pitch, yaw = out[k, 0], out[k, 1], out[k, 2]
        roll[0], roll[1], roll[2], roll[3], roll[4], roll[5] = a, b - pr, c + pq, -qr, qq - rr, qr
        pitch[0], pitch[1], pitch[2], pitch[3], pitch[4], pitch[5] = pr, a + qr, rr - pp, b, c - pq, -pr
        yaw[0], yaw[1], yaw[2], yaw[3], yaw[4], yaw[5] = -pq, pp - qq, a - qr, pq, b + pr, c
