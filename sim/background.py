"""What goes on in the background of a flight, in compiled code: the battery empties, the air is never quite still."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from sim.algebra import Vector
from sim.compiled import compiled
from sim.lanes import select


class Supply(NamedTuple):
    """Battery constants: full voltage, capacity (A s), resistance (ohm), power of the avionics (W), and efficiency of
    the drives.
    """

    full_v: float
    capacity: float
    resistance: float
    avionics_w: float
    efficiency: float


class Disturbance(NamedTuple):
    """Coloured force and torque: RMS sizes, correlation time (s), order 1 (Ornstein-Uhlenbeck) or 2."""

    force_n: float
    torque_nm: float
    correlation: float
    order: int


@compiled
def open_circuit_ratio(charge_left: float) -> float:
    """Open-circuit voltage of a lithium-polymer cell over that of the full one, by the share of charge left.

    Piecewise linear through typical discharge curves (4.20, 4.03, 3.94, 3.83, 3.75, 3.67, 3.58, 3.2 V).
    """
    left = min(max(charge_left, 0.0), 1.0)
    ratio = select(left > 0.1, 0.852 + (left - 0.1) * 0.22, 0.762 + left * 0.9)
    ratio = select(left > 0.2, 0.874 + (left - 0.2) * 0.095, ratio)
    ratio = select(left > 0.4, 0.893 + (left - 0.4) * 0.095, ratio)
    ratio = select(left > 0.6, 0.912 + (left - 0.6) * 0.13, ratio)
    ratio = select(left > 0.8, 0.938 + (left - 0.8) * 0.22, ratio)
    return select(left > 0.9, 0.96 + (left - 0.9) * 0.4, ratio)


@compiled
def drain(supply: Supply, battery, power: float, dt: float) -> float:
    """Terminal voltage now, from the last current; charge and current are carried over one step.

    Returns V over full V.
    """
    voltage = supply.full_v * open_circuit_ratio(1.0 - battery[0] / supply.capacity) - supply.resistance * battery[2]
    battery[1] = max(voltage, 0.3 * supply.full_v)
    battery[2] = power / battery[1]
    battery[0] += dt * battery[2]
    return battery[1] / supply.full_v


@compiled
def drift_step(p: Disturbance, state, noise, dt: float) -> tuple[Vector, Vector]:
    """Advance the coloured disturbance; returns force (world) and torque (body) held over the step.

    Order 1 is an Ornstein-Uhlenbeck process of the given correlation time; order 2 passes it once more through the same
    lag, which halves its variance.
    """
    keep = 1.0 - dt / p.correlation
    kick = sqrt(1.0 - keep * keep)
    for i in range(6):
        state[1, i] += dt / p.correlation * (state[0, i] - state[1, i])
        state[0, i] = keep * state[0, i] + kick * noise[i]
    row = state[0] if p.order == 1 else state[1]
    s = 1.0 if p.order == 1 else sqrt(2.0)
    f, t = s * p.force_n, s * p.torque_nm
    return (f * row[0], f * row[1], f * row[2]), (t * row[3], t * row[4], t * row[5])
