"""Compiled kernels of the prediction model: rotor signals, the observer that tells the start, windows side by side.

State: position and velocity in the world, attitude, body rates. Accelerations are those of :mod:`.predictive`, whose numbers come
as one vector in the order of its ``NAMES``. Rotor signals are rows (specific thrust, three angular accelerations, specific forces along x and y)
on a uniform grid.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

THRUST, DRAG, LIFT, TORQUE, DAMPING, FLAPPING, TRIM = 0, 1, 4, 5, 8, 11, 13
DELAY, LEAD, SLOW_SHARE, SLOW_TIME, OBSERVER, MEASURED, FORCE_BANDWIDTH, FORCE_TIME = 16, 17, 18, 19, 20, 26, 27, 28
"""Where each group of numbers begins in the vector. The observer has bandwidth, gain and time of roll and pitch, then of yaw."""


@njit(cache=True)
def integrated(u: Array, step_s: float, p: Array) -> Array:
    """Running integral of the rotor signals as the model takes them, shape (k, 6).

    The torque's slow part (first-order low-pass) counts by its share only; all are led by ``lead * du/dt``.
    """
    out = np.empty_like(u)
    keep, share, lead = np.exp(-step_s / p[SLOW_TIME]), p[SLOW_SHARE], p[LEAD]
    slow = u[0, 1:4].copy()
    total = np.zeros(6)
    for k in range(len(u)):
        before, after = max(k - 1, 0), min(k + 1, len(u) - 1)
        for c in range(6):
            value = u[k, c]
            if after > before:
                value += lead * (u[after, c] - u[before, c]) / ((after - before) * step_s)
            if 0 < c < 4:
                slow[c - 1] = keep * slow[c - 1] + (1.0 - keep) * u[k, c]
                value -= (1.0 - share) * slow[c - 1]
            out[k, c] = total[c]
            total[c] += value * step_s
    return out


@njit(cache=True)
def _mean(integral: Array, start_s: float, step_s: float, begin: float, end: float, out: Array) -> None:
    """Mean rotor signals from ``begin`` to ``end``, held before and after the record."""
    last = len(integral) - 1.000001
    a = min(max((begin - start_s) / step_s, 0.0), last)
    b = min(max((end - start_s) / step_s, 0.0), last)
    if b - a < 1e-3:  # outside the record: its nearest value
        a = min(a, last - 1.0)
        b = a + 1.0
    i, j = int(a), int(b)
    for c in range(6):
        low = integral[i, c] + (a - i) * (integral[i + 1, c] - integral[i, c])
        high = integral[j, c] + (b - j) * (integral[j + 1, c] - integral[j, c])
        out[c] = (high - low) / ((b - a) * step_s)


@njit(cache=True)
def _rotation(q: Array, r: Array) -> None:
    w, x, y, z = q[0], q[1], q[2], q[3]
    r[0, 0], r[0, 1], r[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    r[1, 0], r[1, 1], r[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    r[2, 0], r[2, 1], r[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@njit(cache=True)
def _turned(q: Array, w: Array, h: float, out: Array) -> None:
    """Attitude after turning at w for h, normalised."""
    angle = 0.5 * h * np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    c = np.cos(angle)
    s = 0.5 * h * (1.0 - angle * angle / 6.0 if angle < 1e-3 else np.sin(angle) / angle)
    x, y, z = w[0] * s, w[1] * s, w[2] * s
    a = q[0] * c - q[1] * x - q[2] * y - q[3] * z
    b = q[0] * x + q[1] * c + q[2] * z - q[3] * y
    d = q[0] * y - q[1] * z + q[2] * c + q[3] * x
    e = q[0] * z + q[1] * y - q[2] * x + q[3] * c
    n = 1.0 / np.sqrt(a * a + b * b + d * d + e * e)
    out[0], out[1], out[2], out[3] = a * n, b * n, d * n, e * n


@njit(cache=True)
def _accelerations(
    v: Array, q: Array, w: Array, u: Array, extra: Array, p: Array, tensor: Array, inverse: Array, g: float,
    r: Array, linear: Array, turning: Array,
) -> None:  # fmt: skip
    """Accelerations in the world and of the rates; ``extra`` is the disturbance, specific force then angular acceleration."""
    _rotation(q, r)
    b0 = r[0, 0] * v[0] + r[1, 0] * v[1] + r[2, 0] * v[2]
    b1 = r[0, 1] * v[0] + r[1, 1] * v[1] + r[2, 1] * v[2]
    b2 = r[0, 2] * v[0] + r[1, 2] * v[1] + r[2, 2] * v[2]
    f0 = extra[0] - p[DRAG] * b0 + p[THRUST] * u[4]
    f1 = extra[1] - p[DRAG + 1] * b1 + p[THRUST] * u[5]
    f2 = extra[2] - p[DRAG + 2] * b2 + p[THRUST] * u[0] * (1.0 + p[LIFT] * (b0 * b0 + b1 * b1))
    for i in range(3):
        linear[i] = r[i, 0] * f0 + r[i, 1] * f1 + r[i, 2] * f2
    linear[2] -= g
    m0 = tensor[0, 0] * w[0] + tensor[0, 1] * w[1] + tensor[0, 2] * w[2]
    m1 = tensor[1, 0] * w[0] + tensor[1, 1] * w[1] + tensor[1, 2] * w[2]
    m2 = tensor[2, 0] * w[0] + tensor[2, 1] * w[1] + tensor[2, 2] * w[2]
    c0, c1, c2 = w[1] * m2 - w[2] * m1, w[2] * m0 - w[0] * m2, w[0] * m1 - w[1] * m0
    for i in range(3):
        turning[i] = (
            p[TORQUE + i] * u[1 + i]
            - p[DAMPING + i] * w[i]
            + p[TRIM + i]
            + extra[3 + i]
            - (inverse[i, 0] * c0 + inverse[i, 1] * c1 + inverse[i, 2] * c2)
        )
    turning[0] += p[FLAPPING] * b1
    turning[1] -= p[FLAPPING + 1] * b0


@njit(cache=True)
def _decay(p: Array, h: float, out: Array) -> None:
    """Share of the disturbance that is left after h."""
    out[:3] = np.exp(-h / p[FORCE_TIME])
    out[3:5] = np.exp(-h / p[OBSERVER + 2])
    out[5] = np.exp(-h / p[OBSERVER + 5])


@njit(cache=True)
def observed(
    t: Array, v: Array, q: Array, w: Array, integral: Array, start_s: float, step_s: float, p: Array,
    tensor: Array, inverse: Array, g: float, pose: bool,
) -> tuple[Array, Array]:  # fmt: skip
    """Rates (k, 3) and disturbances (k, 6) at each stamp from the past alone: an observer of constant gains."""
    rates, extras = np.empty((len(t), 3)), np.zeros((len(t), 6))
    rate, extra = w[0].copy(), np.zeros(6)
    u, r, linear, turning, left = np.empty(6), np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(6)
    for k in range(len(t)):
        h = t[k] - t[k - 1] if k > 0 else 0.0
        if h > 0.5:  # nothing was seen for long: begin again
            rate, extra = w[k].copy(), np.zeros(6)
        elif h > 0.0:
            _mean(integral, start_s, step_s, t[k - 1] - p[DELAY], t[k] - p[DELAY], u)
            _accelerations(v[k - 1], q[k - 1], w[k - 1], u, extra, p, tensor, inverse, g, r, linear, turning)
            _decay(p, h, left)
            extra *= left
            if pose:
                new = 1.0 - np.exp(-p[FORCE_BANDWIDTH] * h)
                for i in range(3):  # the specific force that the model lacked since the last stamp, in the body
                    lacked = 0.0
                    for j in range(3):
                        lacked += r[j, i] * ((v[k, j] - v[k - 1, j]) / h - linear[j])
                    if np.isfinite(lacked):
                        extra[i] += new * lacked
            for i in range(3):
                first = OBSERVER if i < 2 else OBSERVER + 3
                rate[i] += h * turning[i]
                lacked = w[k, i] - rate[i]
                if np.isfinite(lacked):
                    new = 1.0 - np.exp(-p[first] * h)
                    rate[i] += new * lacked
                    extra[3 + i] += new * p[first + 1] * p[first] * lacked
                elif not np.isfinite(rate[i]):
                    rate[i] = w[k, i]
        extras[k] = extra
        for i in range(3):
            rates[k, i] = rate[i] + p[MEASURED] * (w[k, i] - rate[i])
    return rates, extras


@njit(cache=True)
def simulated(
    start: Array, p0: Array, v0: Array, q0: Array, w0: Array, extra0: Array, integral: Array, start_s: float,
    step_s: float, p: Array, tensor: Array, inverse: Array, g: float, h: float, marks: NDArray[np.int64],
) -> Array:  # fmt: skip
    """States (position, velocity, attitude, rates) after each number of steps of h in ``marks`` (ascending), (m, k, 13).

    The midpoint rule; thrusts are averaged over each step.
    """
    out = np.empty((len(marks), len(start), 13))
    u, r, a, b, left = np.empty(6), np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(6)
    qm, wm, vm, q = np.empty(4), np.empty(3), np.empty(3), np.empty(4)
    _decay(p, h, left)
    for k in range(len(start)):
        x, v, w, extra = p0[k].copy(), v0[k].copy(), w0[k].copy(), extra0[k].copy()
        q[:] = q0[k]
        m = 0
        for s in range(marks[-1]):
            now = start[k] + s * h - p[DELAY]
            _mean(integral, start_s, step_s, now, now + h, u)
            _accelerations(v, q, w, u, extra, p, tensor, inverse, g, r, a, b)
            for i in range(3):
                wm[i] = w[i] + 0.5 * h * b[i]
                vm[i] = v[i] + 0.5 * h * a[i]
            _turned(q, w, 0.5 * h, qm)
            _accelerations(vm, qm, wm, u, extra, p, tensor, inverse, g, r, a, b)
            _turned(q, wm, h, qm)
            q[:] = qm
            for i in range(3):
                x[i] += h * vm[i]
                v[i] += h * a[i]
                w[i] += h * b[i]
            extra *= left
            if s + 1 == marks[m]:
                out[m, k, :3], out[m, k, 3:6], out[m, k, 6:10], out[m, k, 10:] = x, v, q, w
                m += 1
    return out
