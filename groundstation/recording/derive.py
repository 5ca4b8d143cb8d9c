"""Quantities that a log lacks, from those it has."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.frames import quat_conjugate, quat_continuous, quat_log, quat_multiply, quat_normalise

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
    return quat_log(delta) / (t_s[after] - t_s[before])[:, None]
