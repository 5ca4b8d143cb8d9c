"""Compiled kernels of the prediction model: rotor signals, the observer that tells the start, windows side by side.

State: position and velocity in the world, attitude, body rates. Accelerations are those of :mod:`.predictive`, whose
numbers come as one vector in the order of its ``NAMES``. Rotor signals are rows (specific thrust, three angular
accelerations, specific forces along x and y) on a uniform grid.
A fit runs these some thousand times. So what does not depend on the numbers is worked out once per flight
(:func:`seen`), and eight windows advance at once, one in each lane of a vector register.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Three = tuple[float, float, float]
Four = tuple[float, float, float, float]
Shape = tuple[
    Four,
    tuple[float, float, float, float, float],
    tuple[float, float, float, float, float, float],
    tuple[float, float, float, float, float, float],
    float,
]
Rotor = tuple[Array, float, float]
"""Running integral of the rotor signals (see :func:`integrated`), its start and its step."""
Body = tuple[Array, Array, float]
"""Tensor, its inverse, gravity."""

THRUST, DRAG, LIFT, TORQUE, DAMPING, FLAPPING, TRIM = 0, 1, 4, 5, 8, 11, 13
DELAY, LEAD, SLOW_SHARE, SLOW_TIME, OBSERVER, MEASURED, FORCE_BANDWIDTH, FORCE_TIME = 16, 17, 18, 19, 20, 26, 27, 28
"""Where each group of numbers begins in the vector.

The observer has bandwidth, gain and time of roll and pitch, then of yaw.
"""
LONGEST_S = 0.5
"""Between two stamps; beyond it the observer begins again."""
LANES = 8
"""Windows side by side: the doubles of the widest vector registers."""
POSITION, VELOCITY, ATTITUDE, RATE, PUSH, ROTOR, ROWS = (LANES * first for first in (0, 3, 6, 10, 13, 19, 25))
"""Where each quantity begins in the work array of :func:`simulated`, a row of lanes for each of its components."""


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
def _mean(rotor: Rotor, begin: float, end: float, out: Array, first: int) -> None:
    """Mean rotor signals from ``begin`` to ``end`` (s) into ``out[first]``, one lane apart; held before and after the
    record.
    """
    integral, start, step_s = rotor
    last = len(integral) - 1.000001
    a = min(max((begin - start) / step_s, 0.0), last)
    b = min(max((end - start) / step_s, 0.0), last)
    if b - a < 1e-3:  # outside the record: its nearest value
        a = min(a, last - 1.0)
        b = a + 1.0
    i, j = int(a), int(b)
    scale = 1.0 / ((b - a) * step_s)
    for c in range(6):
        low = integral[i, c] + (a - i) * (integral[i + 1, c] - integral[i, c])
        high = integral[j, c] + (b - j) * (integral[j + 1, c] - integral[j, c])
        out[first + c * LANES] = (high - low) * scale


@njit(cache=True)
def observer_means(t: Array, inputs: Array, rotor: Rotor, delay: float) -> Array:
    """Mean rotor signals since the last stamp, (k, 6); zero where the observer does not go on."""
    out, one = np.zeros((len(t), 6)), np.empty(5 * LANES + 1)
    for k in range(len(t)):
        if 0.0 < inputs[k, 0] <= LONGEST_S:
            _mean(rotor, t[k - 1] - delay, t[k] - delay, one, 0)
            for c in range(6):
                out[k, c] = one[c * LANES]
    return out


@njit(cache=True)
def window_means(start: Array, rotor: Rotor, delay: float, h: float, steps: int) -> Array:
    """Mean rotor signals over each step of windows, (groups, steps, 6 LANES); the last window in the lanes beyond."""
    groups = (len(start) + LANES - 1) // LANES
    out = np.empty((groups, steps, 6 * LANES))
    for group in range(groups):
        first = group * LANES
        count = min(LANES, len(start) - first)
        for step in range(steps):
            row = out[group, step]
            for n in range(count):
                now = start[first + n] + step * h - delay
                _mean(rotor, now, now + h, row, n)
            for n in range(count, LANES):
                for c in range(6):
                    row[c * LANES + n] = row[c * LANES + count - 1]
    return out


@njit(cache=True, error_model="numpy")
def seen(t: Array, v: Array, q: Array, w: Array, body: Body) -> Array:
    """What the observer needs of each stamp, whatever the numbers are, (k, 10).

    Time since the last stamp; velocity in the body and the angular acceleration of a free body there, at the last
    stamp; and the specific force in the body since then.
    """
    tensor, inverse, g = body
    out = np.zeros((len(t), 10))
    for k in range(1, len(t)):
        h = t[k] - t[k - 1]
        out[k, 0] = h
        if h <= 0.0:
            continue
        a, x, y, z = q[k - 1]
        r = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - a * z), 2 * (x * z + a * y)],
                [2 * (x * y + a * z), 1 - 2 * (x * x + z * z), 2 * (y * z - a * x)],
                [2 * (x * z - a * y), 2 * (y * z + a * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        p0, p1, p2 = w[k - 1]
        m = np.zeros(3)
        for i in range(3):
            m[i] = tensor[i, 0] * p0 + tensor[i, 1] * p1 + tensor[i, 2] * p2
        c0, c1, c2 = p1 * m[2] - p2 * m[1], p2 * m[0] - p0 * m[2], p0 * m[1] - p1 * m[0]
        for i in range(3):
            for j in range(3):
                out[k, 1 + i] += r[j, i] * v[k - 1, j]
                out[k, 7 + i] += r[j, i] * ((v[k, j] - v[k - 1, j]) / h + (g if j == 2 else 0.0))
            out[k, 4 + i] = -(inverse[i, 0] * c0 + inverse[i, 1] * c1 + inverse[i, 2] * c2)
    return out


@njit(cache=True)
def _shares(p: Array, h: float, left: Array, new: Array) -> None:
    """Shares of the disturbance that are left after h, force then turning, and of what is new that the observer takes
    over h.
    """
    left[0], new[0] = np.exp(-h / p[FORCE_TIME]), 1.0 - np.exp(-p[FORCE_BANDWIDTH] * h)
    left[1], new[1] = np.exp(-h / p[OBSERVER + 2]), 1.0 - np.exp(-p[OBSERVER] * h)
    left[2], new[2] = np.exp(-h / p[OBSERVER + 5]), 1.0 - np.exp(-p[OBSERVER + 3] * h)


@njit(cache=True, error_model="numpy")
def observed(w: Array, inputs: Array, means: Array, p: Array, pose: bool) -> tuple[Array, Array]:
    """Rates (k, 3) and disturbances (k, 6) at each stamp from the past alone: an observer of constant gains.

    Args:
        inputs: of :func:`seen`. means: of :func:`observer_means`.
    """
    rates, extras = np.empty((len(w), 3)), np.zeros((len(w), 6))
    rate, extra = w[0].copy(), np.zeros(6)
    left, new, force = np.empty(3), np.empty(3), np.empty(3)
    usual = -1.0
    for k in range(len(w)):
        h, u = inputs[k, 0], means[k]
        if h > LONGEST_S:  # nothing was seen for long: begin again
            rate[:] = w[k]
            extra[:] = 0.0
        elif h > 0.0:
            if abs(h - usual) > 1e-4 * usual:
                usual = h
                _shares(p, h, left, new)
            b0, b1, b2 = inputs[k, 1], inputs[k, 2], inputs[k, 3]
            force[0] = -p[DRAG] * b0 + p[THRUST] * u[4]
            force[1] = -p[DRAG + 1] * b1 + p[THRUST] * u[5]
            force[2] = -p[DRAG + 2] * b2 + p[THRUST] * u[0] * (1.0 + p[LIFT] * (b0 * b0 + b1 * b1))
            for i in range(3):
                turning = p[TORQUE + i] * u[1 + i] - p[DAMPING + i] * w[k - 1, i] + p[TRIM + i]
                turning += extra[3 + i] + inputs[k, 4 + i]
                if i == 0:
                    turning += p[FLAPPING] * b1
                elif i == 1:
                    turning -= p[FLAPPING + 1] * b0
                lacked = inputs[k, 7 + i] - force[i] - extra[i]
                extra[i] *= left[0]
                if pose and np.isfinite(lacked):
                    extra[i] += new[0] * lacked
                first = OBSERVER if i < 2 else OBSERVER + 3
                number = 1 if i < 2 else 2
                extra[3 + i] *= left[number]
                rate[i] += h * turning
                lacked = w[k, i] - rate[i]
                if np.isfinite(lacked):
                    rate[i] += new[number] * lacked
                    extra[3 + i] += new[number] * p[first + 1] * p[first] * lacked
                elif not np.isfinite(rate[i]):
                    rate[i] = w[k, i]
        for i in range(3):
            rates[k, i] = rate[i] + p[MEASURED] * (w[k, i] - rate[i])
            extras[k, i], extras[k, 3 + i] = extra[i], extra[3 + i]
    return rates, extras


@njit(inline="always")
def _turned(q: Four, w: Three, time_s: float) -> Four:
    """Attitude after turning at w, normalised: by the series of sine and cosine to the seventh power, right to 1e-9 up
    to 0.6 rad.
    """
    a, x, y, z = q
    half = 0.5 * time_s
    square = half * half * (w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    cosine = 1.0 - square * (0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0)))
    sine = half * (1.0 - square * (1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0))))
    i, j, k = sine * w[0], sine * w[1], sine * w[2]
    na, nx = a * cosine - x * i - y * j - z * k, a * i + x * cosine + y * k - z * j
    ny, nz = a * j - x * k + y * cosine + z * i, a * k + x * j - y * i + z * cosine
    size = 1.0 / np.sqrt(na * na + nx * nx + ny * ny + nz * nz)
    return na * size, nx * size, ny * size, nz * size


@njit(inline="always")
def _accelerations(
    q: Four, v: Three, w: Three, pushed: tuple[Three, Three, float], shape: Shape
) -> tuple[Three, Three]:
    """Accelerations in the world and of the rates.

    Args:
        pushed: specific force, angular acceleration by rotors and disturbance, and the thrust's specific force.
        shape: the numbers that scale them, tensor and its inverse, upper triangles, and gravity.
    """
    a, x, y, z = q
    (e0, e1, e2), (t0, t1, t2), push = pushed
    (d0, d1, d2, lift), (l0, l1, l2, g0, g1), (j00, j01, j02, j11, j12, j22), (i00, i01, i02, i11, i12, i22), g = shape
    r00, r01, r02 = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - a * z), 2.0 * (x * z + a * y)
    r10, r11, r12 = 2.0 * (x * y + a * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - a * x)
    r20, r21, r22 = 2.0 * (x * z - a * y), 2.0 * (y * z + a * x), 1.0 - 2.0 * (x * x + y * y)
    b0 = r00 * v[0] + r10 * v[1] + r20 * v[2]
    b1 = r01 * v[0] + r11 * v[1] + r21 * v[2]
    b2 = r02 * v[0] + r12 * v[1] + r22 * v[2]
    f0, f1 = e0 - d0 * b0, e1 - d1 * b1
    f2 = e2 - d2 * b2 + push * (1.0 + lift * (b0 * b0 + b1 * b1))
    linear = (
        r00 * f0 + r01 * f1 + r02 * f2,
        r10 * f0 + r11 * f1 + r12 * f2,
        r20 * f0 + r21 * f1 + r22 * f2 - g,
    )
    m0 = j00 * w[0] + j01 * w[1] + j02 * w[2]
    m1 = j01 * w[0] + j11 * w[1] + j12 * w[2]
    m2 = j02 * w[0] + j12 * w[1] + j22 * w[2]
    c0, c1, c2 = w[1] * m2 - w[2] * m1, w[2] * m0 - w[0] * m2, w[0] * m1 - w[1] * m0
    turning = (
        t0 - l0 * w[0] - (i00 * c0 + i01 * c1 + i02 * c2) + g0 * b1,
        t1 - l1 * w[1] - (i01 * c0 + i11 * c1 + i12 * c2) - g1 * b0,
        t2 - l2 * w[2] - (i02 * c0 + i12 * c1 + i22 * c2),
    )
    return linear, turning


@njit(inline="always")
def _moved(x: Three, slope: Three, time_s: float) -> Three:
    return x[0] + time_s * slope[0], x[1] + time_s * slope[1], x[2] + time_s * slope[2]


@njit(cache=True, error_model="numpy")
def _advance(s: Array, p: Array, tensor: Array, inverse: Array, g: float, h: float) -> None:
    """One step of the midpoint rule in every lane of the work array; thrusts are their mean over it."""
    shape = (
        (p[DRAG], p[DRAG + 1], p[DRAG + 2], p[LIFT]),
        (p[DAMPING], p[DAMPING + 1], p[DAMPING + 2], p[FLAPPING], p[FLAPPING + 1]),
        (tensor[0, 0], tensor[0, 1], tensor[0, 2], tensor[1, 1], tensor[1, 2], tensor[2, 2]),
        (inverse[0, 0], inverse[0, 1], inverse[0, 2], inverse[1, 1], inverse[1, 2], inverse[2, 2]),
        g,
    )
    thrust, (k0, k1, k2) = p[THRUST], (p[TORQUE], p[TORQUE + 1], p[TORQUE + 2])
    trim0, trim1, trim2 = p[TRIM], p[TRIM + 1], p[TRIM + 2]
    left_force, left_xy, left_z = np.exp(-h / p[FORCE_TIME]), np.exp(-h / p[OBSERVER + 2]), np.exp(-h / p[OBSERVER + 5])
    for n in range(LANES):  # every row lies a constant distance from the others, so that lanes go into vector registers
        x = s[n], s[n + LANES], s[n + 2 * LANES]
        v = s[n + VELOCITY], s[n + VELOCITY + LANES], s[n + VELOCITY + 2 * LANES]
        q = s[n + ATTITUDE], s[n + ATTITUDE + LANES], s[n + ATTITUDE + 2 * LANES], s[n + ATTITUDE + 3 * LANES]
        w = s[n + RATE], s[n + RATE + LANES], s[n + RATE + 2 * LANES]
        e = s[n + PUSH], s[n + PUSH + LANES], s[n + PUSH + 2 * LANES]
        t0, t1, t2 = s[n + PUSH + 3 * LANES], s[n + PUSH + 4 * LANES], s[n + PUSH + 5 * LANES]
        turn = (
            k0 * s[n + ROTOR + LANES] + trim0 + t0,
            k1 * s[n + ROTOR + 2 * LANES] + trim1 + t1,
            k2 * s[n + ROTOR + 3 * LANES] + trim2 + t2,
        )
        push = e[0] + thrust * s[n + ROTOR + 4 * LANES], e[1] + thrust * s[n + ROTOR + 5 * LANES], e[2]
        pushed = push, turn, thrust * s[n + ROTOR]
        linear, turning = _accelerations(q, v, w, pushed, shape)
        vm, wm = _moved(v, linear, 0.5 * h), _moved(w, turning, 0.5 * h)
        linear, turning = _accelerations(_turned(q, w, 0.5 * h), vm, wm, pushed, shape)
        x, v, w, q = _moved(x, vm, h), _moved(v, linear, h), _moved(w, turning, h), _turned(q, wm, h)
        s[n], s[n + LANES], s[n + 2 * LANES] = x
        s[n + VELOCITY], s[n + VELOCITY + LANES], s[n + VELOCITY + 2 * LANES] = v
        s[n + ATTITUDE], s[n + ATTITUDE + LANES], s[n + ATTITUDE + 2 * LANES], s[n + ATTITUDE + 3 * LANES] = q
        s[n + RATE], s[n + RATE + LANES], s[n + RATE + 2 * LANES] = w
        s[n + PUSH], s[n + PUSH + LANES], s[n + PUSH + 2 * LANES] = (
            e[0] * left_force,
            e[1] * left_force,
            e[2] * left_force,
        )
        s[n + PUSH + 3 * LANES] = t0 * left_xy
        s[n + PUSH + 4 * LANES] = t1 * left_xy
        s[n + PUSH + 5 * LANES] = t2 * left_z


@njit(cache=True)
def simulated(begin: tuple[Array, Array, Array], means: Array, p: Array, body: Body, h: float, marks: Index) -> Array:
    """States (position, velocity, attitude, rates) after each number of steps of h in ``marks`` (ascending), (m, k,
    13).

    Args:
        begin: of the windows' starts, positions, velocities and attitudes (k, 10), rates (k, 3) and disturbances
            (k, 6).
        means: of :func:`window_means`.
    """
    (pose, rates, extras), (tensor, inverse, g) = begin, body
    out = np.empty((len(marks), len(pose), 13))
    s = np.empty(ROWS)
    for first in range(0, len(pose), LANES):
        count = min(LANES, len(pose) - first)
        for n in range(LANES):
            k = first + min(n, count - 1)
            for c in range(10):
                s[c * LANES + n] = pose[k, c]
            for c in range(3):
                s[RATE + c * LANES + n] = rates[k, c]
            for c in range(6):
                s[PUSH + c * LANES + n] = extras[k, c]
        m = 0
        for step in range(marks[-1]):
            s[ROTOR:ROWS] = means[first // LANES, step]
            _advance(s, p, tensor, inverse, g, h)
            if step + 1 == marks[m]:
                for n in range(count):
                    for c in range(13):
                        out[m, first + n, c] = s[c * LANES + n]
                m += 1
    return out


@njit(cache=True, error_model="numpy")
def missed(found: Array, truth: Array, scale: Array, weight: Array, widest: float) -> Array:
    """Rows whose squares add up to the weighted sizes of position, velocity, attitude and rate errors, (m, k, 4, 3).

    Args:
        found, truth: states (m, k, 13).
        scale: size of an error of each quantity, (m, 4). weight: of each horizon, (m,).
        widest: largest component that counts, in these sizes; so much does one that is no number miss by.
    """
    out = np.empty((found.shape[0], found.shape[1], 4, 3))
    d = np.empty((4, 3))
    for m in range(found.shape[0]):
        for k in range(found.shape[1]):
            x, y = found[m, k], truth[m, k]
            for c in range(3):
                d[0, c], d[1, c], d[3, c] = x[c] - y[c], x[3 + c] - y[3 + c], x[10 + c] - y[10 + c]
            real = x[6] * y[6] + x[7] * y[7] + x[8] * y[8] + x[9] * y[9]
            d[2, 0] = y[6] * x[7] - y[7] * x[6] - y[8] * x[9] + y[9] * x[8]
            d[2, 1] = y[6] * x[8] + y[7] * x[9] - y[8] * x[6] - y[9] * x[7]
            d[2, 2] = y[6] * x[9] - y[7] * x[8] + y[8] * x[7] - y[9] * x[6]
            sine = np.sqrt(d[2, 0] ** 2 + d[2, 1] ** 2 + d[2, 2] ** 2)
            turn = 2.0 if sine < 1e-9 else 2.0 * np.arctan2(sine, abs(real)) / sine
            for c in range(3):
                d[2, c] *= turn if real >= 0.0 else -turn
            for i in range(4):
                square = 1e-4
                for c in range(3):
                    away = d[i, c] / scale[m, i]
                    if np.isnan(away):  # of an unknown pose nothing is missed; rates are always known
                        away = 0.0 if i < 3 else widest
                    d[i, c] = min(max(away, -widest), widest)
                    square += d[i, c] ** 2
                root = weight[m] / np.sqrt(np.sqrt(square))
                for c in range(3):
                    out[m, k, i, c] = d[i, c] * root
    return out
