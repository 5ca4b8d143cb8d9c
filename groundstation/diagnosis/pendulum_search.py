"""Which pendulums the residual sideways force of a flight may be the pull of: a scan, and Gauss-Newton from its peaks.

A load that swings for half a minute is in step with a pendulum of another length for a few swings only, so that the
likelihood has many narrow peaks. What stands is judged elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.effect import from_thrust
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.frames import quat_rotate
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Pull = Callable[[Array], Array]
"""Of length (m), damping (1/s) and depth of the hook (m) of at most LANES pendulums, (n, 3): their pulls per mass at
the instants, in the world, (k, 3, n).
"""

LANES = 8
"""Pendulums that are worked out at once: the doubles of the widest vector registers."""
LENGTHS_M = tuple(np.geomspace(0.15, 4.0, 110).tolist())
DAMPINGS_1_S = (0.1, 0.3)
DEPTHS_ARM = (0.0, 0.15, 0.3, 0.45)
"""Of the scan; depths as shares of the rotors' arm."""
MIDDLE, LOOKED_AT = (0.2, 0.2), 30
"""Damping and depth at which all lengths are tried, and how many of them are tried at the others."""
NEAR = 1 / 3
"""Share of what a pendulum has to explain that its nearest neighbour in the scan explains: half a step of the scan is a
fifth of a turn after thirty swings.
"""
SCANNED = len(LENGTHS_M) * len(DAMPINGS_1_S) * len(DEPTHS_ARM)
POLISHED, GIVEN = 16, 3
"""Peaks that are looked at closely, and those that are given."""
APART = 0.025
"""Share of the length by which two peaks differ."""
STEPS, ROUNDS = np.array([0.01, 0.02, 0.002]), 8
"""Differences of the logarithm of the length, damping and depth; steps of Gauss and Newton."""
LEAST, MOST = np.array([np.log(0.1), 0.005, -0.5]), np.array([np.log(6.0), 3.0, 1.0])
"""Of the logarithm of the length, damping, and depth as a share of the arm."""
PARTS = 4
"""Of a flight, in each of which a pendulum has to show the same load."""
BLOCK = 3
"""Instants that are averaged into one."""


def likely_pendulums(
    signals: Signals, keep: NDArray[np.bool_], at: Index, vehicle: Vehicle, pull: Pull
) -> list[tuple[float, float, float]]:
    """Length, damping and depth of the hook of the likeliest few; none where accelerations or thrusts are unknown, or
    where no pendulum keeps in step.

    Args:
        keep: samples in use, (k,).
        at: instants that the swing is worked out at.
        pull: of a pendulum at these instants.
    """
    found = _residual(signals, keep, at, vehicle)
    if found is None:
        return []
    left, basis, used = found

    def shown(points: Sequence[Array]) -> Array:
        """Columns (2 n, points) of what at most LANES pendulums of these places do to the residual."""
        pulls = pull(np.array([[np.exp(x[0]), x[1], x[2]] for x in points]))[:, :2]
        blocks = _blocks(pulls.reshape(len(pulls), -1))[used]
        values = blocks.reshape(len(blocks), 2, -1).transpose(1, 0, 2).reshape(2 * len(blocks), -1)
        return values - basis @ (basis.T @ values)

    def falls(points: Sequence[Array]) -> list[float]:
        groups = [shown(points[i : i + LANES]) for i in range(0, len(points), LANES)]
        return [_fall(column, left) for columns in groups for column in columns.T]

    arm = vehicle.arm_m()
    middle = [np.array([np.log(n), MIDDLE[0], MIDDLE[1] * arm]) for n in LENGTHS_M]
    likeliest: list[int] = np.argsort(falls(middle))[: -LOOKED_AT - 1 : -1].tolist()
    lengths = [float(middle[i][0]) for i in likeliest]
    scanned = [np.array([n, c, d * arm]) for n, c, d in product(lengths, DAMPINGS_1_S, DEPTHS_ARM)]
    near, least = falls(scanned), THRESHOLDS.pendulum_share * float(left @ left)
    if max(near) < NEAR * least:
        return []
    peaks = _distinct(scanned, near, POLISHED)
    polished = [_polished(x, shown, left, arm) for x in peaks]
    best = _distinct(polished, falls(polished), GIVEN)
    columns = shown(best).T if best else ()
    return [
        (float(np.exp(x[0])), float(x[1]), float(x[2]))
        for x, column in zip(best, columns, strict=True)
        if _fall(column, left) > least and _keeps_step(column, left)
    ]


def _residual(
    signals: Signals, keep: NDArray[np.bool_], at: Index, vehicle: Vehicle
) -> tuple[Array, Array, NDArray[np.bool_]] | None:
    """Sideways force in the world that all that hangs on the thrust, taken as one mass, leaves, (2 n,); an orthonormal
    basis of what is none of a load (its mass, drag, a tilt); and the blocks in use.
    """
    some = signals.at(at)
    t_s = some.t_s
    if len(t_s) < 200 or not np.isfinite(some.velocity_world_m_s).all():
        return None
    force = np.gradient(some.velocity_world_m_s, t_s, axis=0)
    force[:, 2] += vehicle.gravity_m_s2
    lift = quat_rotate(some.quaternion, from_thrust(vehicle, some.thrust_n)[:, :3])
    used = _blocks(keep[at].astype(float)[:, None])[:, 0] == 1.0
    force, lift, velocity = (_blocks(x)[used] for x in (force, lift, some.velocity_world_m_s))
    if used.sum() < 100 or not np.isfinite(lift).all():
        return None
    mass = float(lift[:, 2].sum() / force[:, 2].sum())
    left = (mass * force - lift)[:, :2].T.ravel()
    each = np.kron(np.eye(2), np.ones((len(force), 1)))
    columns = np.column_stack([force[:, :2].T.ravel(), velocity[:, :2].T.ravel(), each])
    basis = np.linalg.qr(columns)[0]
    return left - basis @ (basis.T @ left), basis, used


def _blocks(values: Array) -> Array:
    count = len(values) // BLOCK
    return values[: count * BLOCK].reshape(count, BLOCK, -1).mean(axis=1)


def _fall(column: Array, left: Array) -> float:
    """Of the squared residual by a load of this swing; none where its mass would be below zero."""
    crossed, size = float(column @ left), float(column @ column)
    return crossed**2 / size if crossed > 0.0 and np.isfinite(size) and size > 0.0 else 0.0


def _keeps_step(column: Array, left: Array) -> bool:
    """Whether the load is the same all flight long: a pendulum that falls out of step pulls where nothing does.

    The flight is cut where each part of the column has as much power, so that each tells the load as well.
    """
    power = np.cumsum(np.sum(column.reshape(2, -1) ** 2, axis=0))
    part = np.tile(np.minimum(PARTS * power / power[-1], PARTS - 1).astype(int), 2)
    crossed, size = (np.bincount(part, column * other, PARTS) for other in (left, column))
    if (size == 0.0).any():
        return False
    away = crossed / size / (crossed.sum() / size.sum()) - 1.0
    return bool(np.all(np.abs(away) < THRESHOLDS.pendulum_uneven))


def _distinct(points: Sequence[Array], falls: Sequence[float], most: int) -> list[Array]:
    """The best of each length, best first."""
    out: list[Array] = []
    order: list[int] = np.argsort(falls)[::-1].tolist()
    for index in order:
        if falls[index] > 0.0 and all(abs(points[index][0] - other[0]) > APART for other in out):
            out.append(points[index])
        if len(out) == most:
            break
    return out


def _polished(x: Array, shown: Callable[[Sequence[Array]], Array], left: Array, arm_m: float) -> Array:
    """The peak that Gauss and Newton lead to, steps halved where they lead down (variable projection: Golub and Pereyra
    1973).
    """
    least, most = (ends * [1.0, 1.0, arm_m] for ends in (LEAST, MOST))
    seen = shown([x, *(x + np.diag(STEPS))])
    column, fall = seen[:, 0], _fall(seen[:, 0], left)
    for _ in range(ROUNDS):
        load = float(column @ left) / float(column @ column)
        columns = np.column_stack([column, load * (seen[:, 1:] - column[:, None]) / STEPS])
        if not np.isfinite(columns).all():
            return x
        step = np.clip(np.linalg.lstsq(columns, left, rcond=1e-8)[0][1:], [-0.1, -0.3, -0.05], [0.1, 0.3, 0.05])
        trials = [np.clip(x + share * step, least, most) for share in (1.0, 0.5, 0.25)]
        tried = shown(trials)
        number = next((n for n in range(len(trials)) if _fall(tried[:, n], left) > fall), None)
        if number is None:
            return x
        x, column = trials[number], tried[:, number]
        gain, fall = _fall(column, left) / max(fall, 1e-300), _fall(column, left)
        if gain < 1.0 + 1e-4:
            return x
        seen = shown([x, *(x + np.diag(STEPS))])
    return x
