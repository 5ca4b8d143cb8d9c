"""One step of the rigid body in compiled code, for the windows of a prediction side by side."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Body = tuple[float, Array, Array, Array, Array, float, float, float]
"""Mass, tensor, its inverse, centre of mass, damping, yaw trim, climb damping, gravity."""


@njit(cache=True, error_model="numpy")
def _accelerations(v: Array, q: Array, w: Array, wrench: Array, body: Body, out: tuple[Array, Array]) -> None:
    """In the world, and of the rates, into ``out``, from force and torque about the declared origin in the body,
    (6,).
    """
    linear, turning = out
    mass, tensor, inverse, com, damping, trim, climbing, g = body
    a, x, y, z = q
    r = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - a * z), 2.0 * (x * z + a * y)),
        (2.0 * (x * y + a * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - a * x)),
        (2.0 * (x * z - a * y), 2.0 * (y * z + a * x), 1.0 - 2.0 * (x * x + y * y)),
    )
    climb = r[0][2] * v[0] + r[1][2] * v[1] + r[2][2] * v[2]
    f0, f1, f2 = wrench[0], wrench[1], wrench[2]
    if np.isfinite(climb):  # unknown without poses: rates are predicted all the same
        f2 -= climbing * climb
    for i in range(3):
        linear[i] = (r[i][0] * f0 + r[i][1] * f1 + r[i][2] * f2) / mass
    linear[2] -= g
    m0 = tensor[0, 0] * w[0] + tensor[0, 1] * w[1] + tensor[0, 2] * w[2]
    m1 = tensor[1, 0] * w[0] + tensor[1, 1] * w[1] + tensor[1, 2] * w[2]
    m2 = tensor[2, 0] * w[0] + tensor[2, 1] * w[1] + tensor[2, 2] * w[2]
    t0 = wrench[3] - damping[0] * w[0] - (com[1] * f2 - com[2] * f1) - (w[1] * m2 - w[2] * m1)
    t1 = wrench[4] - damping[1] * w[1] - (com[2] * f0 - com[0] * f2) - (w[2] * m0 - w[0] * m2)
    t2 = wrench[5] - damping[2] * w[2] + trim - (com[0] * f1 - com[1] * f0) - (w[0] * m1 - w[1] * m0)
    for i in range(3):
        turning[i] = inverse[i, 0] * t0 + inverse[i, 1] * t1 + inverse[i, 2] * t2


@njit(cache=True, error_model="numpy")
def turned(v: Array, q: Array, w: Array, wrench: Array, body: Body) -> Array:
    """Angular accelerations of states side by side, (k, 3)."""
    linear, turning = np.empty(3), np.empty((len(w), 3))
    for k in range(len(w)):
        _accelerations(v[k], q[k], w[k], wrench[k], body, (linear, turning[k]))
    return turning


@njit(cache=True, error_model="numpy")
def _turn(q: Array, w: Array, time_s: float, out: Array) -> None:
    """Attitude after turning at w."""
    half = 0.5 * time_s * np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    c = np.cos(half)
    s = 0.5 * time_s * (1.0 - half * half / 6.0 if half < 1e-4 else np.sin(half) / half)
    a, x, y, z = q[0], q[1], q[2], q[3]
    i, j, k = s * w[0], s * w[1], s * w[2]
    out[0], out[1] = a * c - x * i - y * j - z * k, a * i + x * c + y * k - z * j
    out[2], out[3] = a * j - x * k + y * c + z * i, a * k + x * j - y * i + z * c


@njit(cache=True, error_model="numpy")
def stepped(x: Array, wrench: Array, pushed: Array, body: Body, h: float) -> Array:
    """Advance states in place by the rule of Runge and Kutta under constant wrenches; mean angular accelerations, (k,
    3).

    Args:
        x: position, velocity, attitude and rates, (k, 13). wrench: in the body, (k, 6). pushed: angular disturbance,
            (k, 3).
    """
    turning = np.empty((len(x), 3))
    linear, angular, rates = np.empty((4, 3)), np.empty((4, 3)), np.empty((4, 3))
    v, q, w = np.empty(3), np.empty(4), np.empty(3)
    shares = (0.0, 0.5, 0.5, 1.0)
    for k in range(len(x)):
        v0, q0, w0 = x[k, 3:6], x[k, 6:10], x[k, 10:]
        for stage in range(4):
            part = shares[stage] * h
            before = max(stage - 1, 0)
            for i in range(3):
                v[i] = v0[i] + (part * linear[before, i] if stage else 0.0)
                w[i] = w0[i] + (part * angular[before, i] if stage else 0.0)
            if stage:
                _turn(q0, rates[before], part, q)
            else:
                q[:] = q0
            _accelerations(v, q, w, wrench[k], body, (linear[stage], angular[stage]))
            for i in range(3):
                angular[stage, i] += pushed[k, i]
                rates[stage, i] = w[i]
        for i in range(3):
            x[k, i] += h * v0[i] + h * h / 6.0 * (linear[0, i] + linear[1, i] + linear[2, i])
        for i in range(3):
            v0[i] += h / 6.0 * (linear[0, i] + 2.0 * linear[1, i] + 2.0 * linear[2, i] + linear[3, i])
            turning[k, i] = (angular[0, i] + 2.0 * angular[1, i] + 2.0 * angular[2, i] + angular[3, i]) / 6.0
            w[i] = (rates[0, i] + 2.0 * rates[1, i] + 2.0 * rates[2, i] + rates[3, i]) / 6.0
            w0[i] += h * turning[k, i]
        _turn(q0, w, h, q)
        q0[:] = q
    return turning
