"""Block means of samples' running integrals, in one pass over the samples and without arrays of their length."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True)
def integral_means(values: Array, step: Array, members: NDArray[np.int64]) -> Array:
    """Block means of the running integral by the trapezoidal rule of columns (k, n), with ``step`` before each sample,
    (blocks, n).
    """
    count = values.shape[1]
    blocks, size = members.shape
    out = np.zeros((blocks, count))
    impulse = np.zeros(count)
    at = 0
    for b in range(blocks):
        for m in range(size):
            while at < members[b, m]:
                at += 1
                for j in range(count):
                    impulse[j] += 0.5 * (values[at, j] + values[at - 1, j]) * step[at]
            for j in range(count):
                out[b, j] += impulse[j]
        for j in range(count):
            out[b, j] /= size
    return out


@njit(cache=True)
def wrench_means(wrench: Array, step: Array, members: NDArray[np.int64]) -> Array:
    """Block means of the running integral of torques and of forces, torques first, (blocks, 6 p).

    Args:
        wrench: forces, then torques, p of each component side by side, (k, 6 p).
        step: time before each sample, (k,). members: samples of each block, (blocks, size).
    """
    half = wrench.shape[1] // 2
    blocks, size = members.shape
    out = np.zeros((blocks, 2 * half))
    impulse = np.zeros(half)
    at = 0
    for b in range(blocks):
        mean = out[b]
        for m in range(size):
            while at < members[b, m]:
                at += 1
                now, before, share = wrench[at], wrench[at - 1], 0.5 * step[at]
                for j in range(half):
                    impulse[j] += (now[half + j] + before[half + j]) * share
            now = wrench[at]
            for j in range(half):
                mean[j] += impulse[j]
                mean[half + j] += now[j]
        for j in range(2 * half):
            mean[j] /= size
    return out
