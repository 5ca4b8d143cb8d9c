"""The air's own motion."""

from __future__ import annotations

from math import sqrt
from typing import Annotated, NamedTuple

from pydantic import Field

from sim.algebra import Vector, norm
from sim.compiled import compiled
from sim.lanes import select


class Wind(NamedTuple):
    """Steady wind with Dryden turbulence (MIL-F-8785C) carried past by it; felt through whatever drag is on.

    Attributes:
        velocity_m_s: steady wind in the world.
        gust_m_s: RMS of each component of the turbulence.
        scale_m: its length scale.
    """

    velocity_m_s: tuple[float, float, float] = (2.0, 0.0, 0.0)
    gust_m_s: Annotated[float, Field(ge=0.0)] = 0.3
    scale_m: Annotated[float, Field(gt=0.0)] = 3.0
    on: bool = True


@compiled
def gust_step(p: Wind, state, noise, dt: float) -> Vector:
    """Advance the turbulence and return the wind in the world.

    Along the wind sigma sqrt(2 T)/(1 + T s), across it sigma sqrt(T) (1 + sqrt(3) T s)/(1 + T s)^2 with T = L/V. With p
    a unit first-order process and r = p/(1 + T s), the latter is (sqrt(3) p + (1 - sqrt(3)) r)/sqrt(2).

    Args:
        p: parameters.
        state: first-order processes (unit variance) and their lagged copies, shape (2, 3); changed in place.
        noise: three standard normal numbers.
        dt: time step, s.
    """
    speed = max(norm(p.velocity_m_s), 0.5)
    tau = p.scale_m / speed
    h = dt / tau
    for i in range(3):
        state[1, i] += h * (state[0, i] - state[1, i])
        state[0, i] += -h * state[0, i] + sqrt(2.0 * h) * noise[i]
    x, y = p.velocity_m_s[0] / speed, p.velocity_m_s[1] / speed
    flat = sqrt(x * x + y * y)
    x, y = select(flat > 1e-9, x / flat, 1.0), select(flat > 1e-9, y / flat, 0.0)
    along = p.gust_m_s * state[0, 0]
    across = p.gust_m_s * (sqrt(3.0) * state[0, 1] + (1.0 - sqrt(3.0)) * state[1, 1]) / sqrt(2.0)
    up = p.gust_m_s * (sqrt(3.0) * state[0, 2] + (1.0 - sqrt(3.0)) * state[1, 2]) / sqrt(2.0)
    w = p.velocity_m_s
    return (w[0] + along * x - across * y, w[1] + along * y + across * x, w[2] + up)
