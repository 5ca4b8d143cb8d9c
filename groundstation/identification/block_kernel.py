"""Block means of samples' running integrals, in one pass over the samples and without arrays of their length; a body's
outputs; and columns between the points of a grid.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def outputs(
    wrench: Array, impulse: Array, turned: Array, body: tuple[Array, Array, Array], trim: Array
) -> tuple[Array, Array]:
    """Rates J^-1 H and forces of a body, (blocks, 3) each.

    Args:
        wrench, impulse: of the rotors and its running integral, (blocks, 6). turned: integrals of the products of two
            rates, pp, pq, pr, qq, qr, rr, (blocks, 6), of which omega x J omega is made.
        body: the tensor's entries (6,), its inverse (3, 3), and c (3,), whose c x F is taken from the torque.
        trim: impulse about z that grows with time, (blocks,).
    """
    (xx, xy, xz, yy, yz, zz), inverse, c = body
    rate, force = np.empty((len(wrench), 3)), np.empty((len(wrench), 3))
    for b in range(len(wrench)):
        fx, fy, fz = impulse[b, 0], impulse[b, 1], impulse[b, 2]
        x, y, z = impulse[b, 3], impulse[b, 4], impulse[b, 5] + trim[b]
        pp, pq, pr, qq, qr, rr = turned[b, 0], turned[b, 1], turned[b, 2], turned[b, 3], turned[b, 4], turned[b, 5]
        x = x + pr * xy - pq * xz + qr * yy - (qq - rr) * yz - qr * zz
        y = y - pr * xx - qr * xy - (rr - pp) * xz + pq * yz + pr * zz
        z = z + pq * xx - (pp - qq) * xy + qr * xz - pq * yy - pr * yz
        x -= c[1] * fz - c[2] * fy
        y -= c[2] * fx - c[0] * fz
        z -= c[0] * fy - c[1] * fx
        for i in range(3):
            rate[b, i] = inverse[i, 0] * x + inverse[i, 1] * y + inverse[i, 2] * z
            force[b, i] = wrench[b, i]
    return rate, force


@njit(cache=True, nogil=True)
def residual(measured: tuple[Array, Array], rate: Array, force: Array, mass: float, bias: Array) -> Array:
    """Measured rates and specific forces less rates and forces of a body with biases, (blocks, 6).

    Args:
        measured: rates and specific forces, (blocks, 3) each. rate, force: predicted, (blocks, 3). bias: (3,).
    """
    out = np.empty((len(rate), 6))
    for b in range(len(rate)):
        for i in range(3):
            out[b, i] = measured[0][b, i] - rate[b, i]
            out[b, 3 + i] = measured[1][b, i] - (force[b, i] / mass + bias[i])
    return out


@njit(cache=True, nogil=True)
def cubic(values: Array, start_s: float, step_s: float, at_s: Array) -> Array:
    """Columns (k, n) of a uniform grid at other times inside it, by the cubic through the four points about each."""
    count, columns = values.shape
    out = np.empty((len(at_s), columns))
    for k in range(len(at_s)):
        position = (at_s[k] - start_s) / step_s
        i = min(max(int(position), 1), count - 3)
        u = position - i
        a, b = -u * (u - 1.0) * (u - 2.0) / 6.0, (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0
        c, d = -(u + 1.0) * u * (u - 2.0) / 2.0, (u + 1.0) * u * (u - 1.0) / 6.0
        for j in range(columns):
            out[k, j] = a * values[i - 1, j] + b * values[i, j] + c * values[i + 1, j] + d * values[i + 2, j]
    return out
