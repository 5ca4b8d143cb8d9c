"""What makes a rotor's thrust or torque another multiple of its speed squared than declared."""

from __future__ import annotations

from math import tanh
from typing import Annotated, NamedTuple

from pydantic import Field

from sim.compiled import compiled
from sim.lanes import select

RotorNumber = Annotated[int, Field(ge=1, le=16)]


class WeakRotor(NamedTuple):
    """A propeller cut shorter. By similarity thrust is proportional to D^4 and torque to D^5 (Leishman 2006, sec. 2.2).

    Attributes:
        rotor: its number, from 1.
        loss: share of thrust lost.
    """

    rotor: RotorNumber = 1
    loss: Annotated[float, Field(gt=-1.0, lt=1.0)] = 0.1
    on: bool = True


class RotorDegradation(NamedTuple):
    """A rotor that loses thrust during the flight, along a logistic curve; torque falls with D^5 as for a cut
    propeller.

    Attributes:
        rotor: its number, from 1.
        loss: share of thrust lost in the end.
        start_s: seconds after take-off at which half of it is lost.
        spread_s: time constant of the logistic curve.
    """

    rotor: RotorNumber = 1
    loss: Annotated[float, Field(gt=-1.0, lt=1.0)] = 0.1
    start_s: float = 20.0
    spread_s: Annotated[float, Field(gt=0.0)] = 0.3
    on: bool = True


class ThrustScale(NamedTuple):
    """Air of another density than the one the thrust constant was measured in (T and Q are proportional to rho).

    Attributes:
        density_ratio: density now over density then.
    """

    density_ratio: Annotated[float, Field(gt=0.0)] = 0.95
    on: bool = True


class TorqueScale(NamedTuple):
    """Propellers of another profile drag: the reaction torque alone differs.

    Attributes:
        ratio: true torque over declared torque.
    """

    ratio: Annotated[float, Field(gt=0.0)] = 1.1
    on: bool = True


class ThrustCurve(NamedTuple):
    """Thrust as a power of speed other than 2, from the fall of the profile's lift with Reynolds number.

    T = T_hover (Omega/Omega_hover)^exponent; the torque follows the thrust. Deters & Selig (AIAA 2014-2151) measure
    exponents above 2 on small propellers; blade flexing gives ones below.

    Attributes:
        exponent: 2 is the declared law.
    """

    exponent: Annotated[float, Field(gt=0.5, lt=4.0)] = 2.2
    on: bool = True


class ThrustMemory(NamedTuple):
    """Thrust that lags behind its own past without any rate: backlash (play operator). In no textbook on rotors.

    The memory m follows T only where |T - m| exceeds the half width; the thrust becomes T + gain (m - T).

    Attributes:
        width_share: half width as a share of a rotor's hover thrust.
        gain: how much of the memory shows.
    """

    width_share: Annotated[float, Field(gt=0.0)] = 0.05
    gain: Annotated[float, Field(ge=0.0, le=1.0)] = 1.0
    on: bool = True


@compiled
def loss_of(weak: WeakRotor, worn: RotorDegradation, rotor: int, flight_s: float) -> float:
    """Share of thrust that the rotor (from 0) has left."""
    left = 1.0
    if weak.on and weak.rotor == rotor + 1:
        left *= 1.0 - weak.loss
    if worn.on and worn.rotor == rotor + 1:
        x = (flight_s - worn.start_s) / worn.spread_s
        # A logistic curve by tanh, which does not overflow.
        left *= 1.0 - worn.loss * 0.5 * (1.0 + tanh(0.5 * x))
    return left


@compiled
def power_law(p: ThrustCurve, thrust: float, hover_thrust: float) -> float:
    """Thrust by the power law where the declared law gives ``thrust``."""
    if not p.on:
        return thrust
    return select(thrust <= 0.0, thrust, hover_thrust * (thrust / hover_thrust) ** (0.5 * p.exponent))


@compiled
def play(p: ThrustMemory, memory: float, thrust: float, hover_thrust: float) -> float:
    """The memory after the thrust has become ``thrust``."""
    width = p.width_share * hover_thrust
    return min(max(memory, thrust - width), thrust + width)
