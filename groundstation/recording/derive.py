"""Quantities that a log lacks, from those it has."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.frames import quat_conjugate, quat_continuous, quat_multiply, quat_normalise

Array = NDArray[np.float64]


def body_rates(t_s: Array, quaternion: Array) -> Array:
    r"""Body rates from attitude by central differences, one-sided at the ends.

    :math:`\omega = 2 \log(q_{k-1}^{-1} q_{k+1}) / (t_{k+1} - t_{k-1})`: exact for a constant rate.

    Args:
        t_s: increasing times, shape (k,), k >= 2.
        quaternion: body to world, shape (k, 4).

    Returns:
        rates in rad/s, shape (k, 3).
    """
    q = quat_continuous(quat_normalise(quaternion))
    before = np.maximum(np.arange(len(t_s)) - 1, 0)
    after = np.minimum(np.arange(len(t_s)) + 1, len(t_s) - 1)
    delta = quat_multiply(quat_conjugate(q[before]), q[after])
    return rotation_vector(delta) / (t_s[after] - t_s[before])[:, None]


def rotation_vector(quaternion: Array) -> Array:
    """Rotation vector of unit quaternions, the short way round, shape (..., 3)."""
    q = np.where(quaternion[..., :1] < 0.0, -quaternion, quaternion)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., :1])
    return q[..., 1:] * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0)


def slerp(t_s: Array, quaternion: Array, at_s: Array) -> Array:
    """Attitude at other times within the samples', along the great circle between neighbours, shape (m, 4)."""
    q = quat_continuous(quat_normalise(quaternion))
    right = np.clip(np.searchsorted(t_s, at_s, side="right"), 1, len(t_s) - 1)
    left = right - 1
    fraction = ((at_s - t_s[left]) / (t_s[right] - t_s[left]))[:, None]
    step = rotation_vector(quat_multiply(quat_conjugate(q[left]), q[right])) * fraction
    angle = np.linalg.norm(step, axis=-1, keepdims=True)
    axis = np.where(angle > 1e-12, np.sin(angle / 2) / np.maximum(angle, 1e-12), 0.5) * step
    return quat_multiply(q[left], np.hstack([np.cos(angle / 2), axis]))
