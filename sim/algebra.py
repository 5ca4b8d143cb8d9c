"""Vectors of three and unit quaternions as tuples, for compiled code.

World z up, quaternion scalar first, body to world.
"""

from __future__ import annotations

from math import cos, sin, sqrt

from sim.compiled import compiled
from sim.lanes import any_of, negate, select

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Symmetric = tuple[float, float, float, float, float, float]  # xx, xy, xz, yy, yz, zz


@compiled
def add(a: Vector, b: Vector) -> Vector:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@compiled
def subtract(a: Vector, b: Vector) -> Vector:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@compiled
def scale(s: float, a: Vector) -> Vector:
    return (s * a[0], s * a[1], s * a[2])


@compiled
def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def chosen(condition: bool, a: Vector, b: Vector) -> Vector:
    """``a`` where the condition holds, else ``b``."""
    return (select(condition, a[0], b[0]), select(condition, a[1], b[1]), select(condition, a[2], b[2]))


@compiled
def norm(a: Vector) -> float:
    return sqrt(dot(a, a))


@compiled
def cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@compiled
def times(s: Symmetric, v: Vector) -> Vector:
    """Symmetric matrix times vector."""
    return (
        s[0] * v[0] + s[1] * v[1] + s[2] * v[2],
        s[1] * v[0] + s[3] * v[1] + s[4] * v[2],
        s[2] * v[0] + s[4] * v[1] + s[5] * v[2],
    )


@compiled
def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@compiled
def conjugate(q: Quaternion) -> Quaternion:
    return (q[0], -q[1], -q[2], -q[3])


@compiled
def normalise(q: Quaternion) -> Quaternion:
    n = 1.0 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return (n * q[0], n * q[1], n * q[2], n * q[3])


@compiled
def to_world(q: Quaternion, v: Vector) -> Vector:
    """Rotate a body vector into the world: v + 2 w (u x v) + 2 u x (u x v)."""
    u = (q[1], q[2], q[3])
    t = scale(2.0, cross(u, v))
    return add(add(v, scale(q[0], t)), cross(u, t))


@compiled
def to_body(q: Quaternion, v: Vector) -> Vector:
    """Rotate a world vector into the body."""
    return to_world(conjugate(q), v)


@compiled
def exponential(r: Vector) -> Quaternion:
    """Quaternion of a rotation vector."""
    angle = norm(r)
    tiny = angle < 1e-8
    near = normalise((1.0, 0.5 * r[0], 0.5 * r[1], 0.5 * r[2]))
    if not any_of(negate(tiny)):
        return near
    s = sin(0.5 * angle) / angle
    return (
        select(tiny, near[0], cos(0.5 * angle)),
        select(tiny, near[1], s * r[0]),
        select(tiny, near[2], s * r[1]),
        select(tiny, near[3], s * r[2]),
    )


@compiled
def copy(source, target) -> None:
    """Copy the first numbers of an array into a shorter (or equally long) one; compiles faster than slices do."""
    for i in range(len(target)):
        target[i] = source[i]
