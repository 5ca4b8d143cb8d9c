"""What slows a body that turns."""

from __future__ import annotations

from typing import NamedTuple

from sim.algebra import Vector
from sim.compiled import compiled
from sim.effects.bodily import Moving


class AngularDamping(NamedTuple):
    """Moment against the body rate: linear from the rotors' inflow when their hubs rise and fall, quadratic from the
    arms.

    Attributes:
        damping_nms: about body x, y, z.
        quadratic_nm_s2: about body x, y, z.
    """

    damping_nms: tuple[float, float, float] = (0.01, 0.01, 0.005)
    quadratic_nm_s2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    on: bool = True


EFFECT = AngularDamping


@compiled
def wrench(p: AngularDamping, at: Moving) -> tuple[Vector, Vector]:
    """Torque against the rate, no force."""
    a, b, w = p.damping_nms, p.quadratic_nm_s2, at.rate
    torque = (
        -(a[0] + b[0] * abs(w[0])) * w[0],
        -(a[1] + b[1] * abs(w[1])) * w[1],
        -(a[2] + b[2] * abs(w[2])) * w[2],
    )
    return (0.0, 0.0, 0.0), torque
