"""Pressure drag of the frame."""

from __future__ import annotations

from typing import NamedTuple

from sim.algebra import Vector, norm
from sim.compiled import compiled
from sim.effects.bodily import Moving


class BodyDrag(NamedTuple):
    """Pressure drag of the frame as flat plates: F = -rho/2 |u| (A_x u_x, A_y u_y, A_z u_z) (Hoerner 1965).

    Attributes:
        area_m2: drag coefficient times area of each face.
    """

    area_m2: tuple[float, float, float] = (0.03, 0.03, 0.06)
    on: bool = True


EFFECT = BodyDrag


@compiled
def wrench(p: BodyDrag, at: Moving) -> tuple[Vector, Vector]:
    """Force against the air's velocity, no torque."""
    u, area = at.air, p.area_m2
    q = -0.5 * at.density * norm(u)
    return (q * area[0] * u[0], q * area[1] * u[1], q * area[2] * u[2]), (0.0, 0.0, 0.0)
