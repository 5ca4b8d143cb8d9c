"""Rotations between the world (right-handed, z up) and the body (x forward, y left, z up).

Quaternions are scalar first, unit length, and rotate body vectors into the world. Every function takes arrays with any
leading shape: quaternions ``(..., 4)``, vectors ``(..., 3)``, matrices ``(..., 3, 3)``. Angles are radians.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def skew(vector: ArrayLike) -> Array:
    """Return S(v) with S(v) u = v x u (seed paper, after eq. 4), shape (..., 3, 3)."""
    x, y, z = np.moveaxis(np.asarray(vector, dtype=float), -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3)


def quat_multiply(left: ArrayLike, right: ArrayLike) -> Array:
    """Hamilton product; rotating by the result is rotating by ``right`` first, then by ``left``."""
    a0, a1, a2, a3 = np.moveaxis(np.asarray(left, dtype=float), -1, 0)
    b0, b1, b2, b3 = np.moveaxis(np.asarray(right, dtype=float), -1, 0)
    return np.stack(
        [
            a0 * b0 - a1 * b1 - a2 * b2 - a3 * b3,
            a0 * b1 + a1 * b0 + a2 * b3 - a3 * b2,
            a0 * b2 - a1 * b3 + a2 * b0 + a3 * b1,
            a0 * b3 + a1 * b2 - a2 * b1 + a3 * b0,
        ],
        axis=-1,
    )


def quat_conjugate(quaternion: ArrayLike) -> Array:
    """The inverse rotation."""
    return np.asarray(quaternion, dtype=float) * np.array([1.0, -1.0, -1.0, -1.0])


def quat_normalise(quaternion: ArrayLike) -> Array:
    """Scale to unit length."""
    q = np.asarray(quaternion, dtype=float)
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def quat_continuous(quaternion: Annotated[ArrayLike, "k 4"]) -> Annotated[Array, "k 4"]:
    """Flip signs along the first axis so that neighbours lie in the same hemisphere."""
    q = np.array(quaternion, dtype=float)
    dots = np.einsum("ij,ij->i", q[1:], q[:-1])
    signs = np.concatenate([[1.0], np.cumprod(np.where(dots < 0.0, -1.0, 1.0))])
    return q * signs[:, None]


def quat_rotate(quaternion: ArrayLike, vector: ArrayLike) -> Array:
    """Rotate body vectors into the world."""
    q = np.asarray(quaternion, dtype=float)
    v = np.asarray(vector, dtype=float)
    w, x, y, z = (q[..., i] for i in range(4))
    a, b, c = (v[..., i] for i in range(3))
    tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    out = np.empty((*np.broadcast_shapes(q.shape[:-1], v.shape[:-1]), 3))
    out[..., 0] = a + w * tx + (y * tz - z * ty)
    out[..., 1] = b + w * ty + (z * tx - x * tz)
    out[..., 2] = c + w * tz + (x * ty - y * tx)
    return out


def quat_rotate_inverse(quaternion: ArrayLike, vector: ArrayLike) -> Array:
    """Rotate world vectors into the body."""
    return quat_rotate(quat_conjugate(quaternion), vector)


def quat_exp(rotation_vector: ArrayLike) -> Array:
    """Quaternion of a rotation vector (axis times angle, rad)."""
    r = np.asarray(rotation_vector, dtype=float)
    half = 0.5 * np.linalg.norm(r, axis=-1, keepdims=True)
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * r], axis=-1)


def quat_log(quaternion: ArrayLike) -> Array:
    """Rotation vector (axis times angle, rad, at most pi long) of a unit quaternion."""
    q = np.asarray(quaternion, dtype=float)
    q = np.where(q[..., :1] < 0.0, -q, q)
    norm = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(norm, q[..., :1])
    scale = np.where(norm > 1e-12, angle / np.where(norm > 1e-12, norm, 1.0), 2.0)
    return scale * q[..., 1:]


def slerp(
    at_s: Annotated[ArrayLike, "q"], stamps_s: Annotated[ArrayLike, "k"], quaternion: Annotated[ArrayLike, "k 4"]
) -> Annotated[Array, "q 4"]:
    """Unit quaternions (n, 4) at other times, along the great circle between neighbours, held at the ends, shape (k,
    4).

    Signs are continuous.
    """
    at, stamps = np.asarray(at_s, dtype=float), np.asarray(stamps_s, dtype=float)
    q = quat_continuous(quaternion)
    left = np.clip(np.searchsorted(stamps, at, side="right") - 1, 0, len(stamps) - 2)
    share = np.clip((at - stamps[left]) / (stamps[left + 1] - stamps[left]), 0.0, 1.0)
    turn = quat_log(quat_multiply(quat_conjugate(q[left]), q[left + 1]))
    return quat_continuous(quat_multiply(q[left], quat_exp(share[:, None] * turn)))


def lever_arm(rate: ArrayLike, rate_derivative: ArrayLike, position_m: ArrayLike) -> Array:
    """dw/dt x r + w x (w x r): what an accelerometer at r feels beyond the origin, body axes, m/s^2."""
    w, derivative, r = (np.asarray(each, dtype=float) for each in (rate, rate_derivative, position_m))
    return np.cross(derivative, r) + np.cross(w, np.cross(w, r))


def matrix_from_quat(quaternion: ArrayLike) -> Array:
    """Rotation matrix, body to world."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion, dtype=float), -1, 0)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return np.stack(rows, axis=-1).reshape(*w.shape, 3, 3)


def quat_from_matrix(matrix: ArrayLike) -> Array:
    """Quaternion of a rotation matrix (Shepperd's method: divides by the largest component)."""
    m = np.asarray(matrix, dtype=float)
    flat = m.reshape(-1, 3, 3)
    trace = np.einsum("nii->n", flat)
    squares = np.stack(
        [1 + trace, *(1 + 2 * flat[:, i, i] - trace for i in range(3))], axis=-1
    )  # four times the squared components
    largest = np.argmax(squares, axis=-1)
    root = np.sqrt(np.take_along_axis(squares, largest[:, None], axis=-1))[:, 0]
    d = [flat[:, 2, 1] - flat[:, 1, 2], flat[:, 0, 2] - flat[:, 2, 0], flat[:, 1, 0] - flat[:, 0, 1]]
    s = [flat[:, 1, 0] + flat[:, 0, 1], flat[:, 0, 2] + flat[:, 2, 0], flat[:, 2, 1] + flat[:, 1, 2]]
    candidates = np.stack(
        [
            np.stack([root**2, d[0], d[1], d[2]], axis=-1),
            np.stack([d[0], root**2, s[0], s[1]], axis=-1),
            np.stack([d[1], s[0], root**2, s[2]], axis=-1),
            np.stack([d[2], s[1], s[2], root**2], axis=-1),
        ],
        axis=1,
    )
    chosen = candidates[np.arange(len(flat)), largest] / (2.0 * root[:, None])
    return chosen.reshape(*m.shape[:-2], 4)


def quat_from_euler(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> Array:
    """Quaternion of ZYX Euler angles (seed paper, R(eta))."""
    roll, pitch, yaw = np.broadcast_arrays(*(np.asarray(a, dtype=float) for a in (roll, pitch, yaw)))
    cr, sr = np.cos(roll / 2), np.sin(roll / 2)
    cp, sp = np.cos(pitch / 2), np.sin(pitch / 2)
    cy, sy = np.cos(yaw / 2), np.sin(yaw / 2)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )


def euler_from_quat(quaternion: ArrayLike) -> Array:
    """ZYX Euler angles (roll, pitch, yaw), shape (..., 3)."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion, dtype=float), -1, 0)
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=-1)
