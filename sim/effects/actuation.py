"""Between a command and a rotor's speed, and the rotors' own inertia."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from pydantic import Field

from sim.compiled import compiled
from sim.lanes import select

NonNegative = Annotated[float, Field(ge=0.0)]


class MotorLag(NamedTuple):
    """A brushless motor on an open-loop controller (Franklin, Powell & Emami-Naeini, sec. 2.3; Bangura & Mahony 2014).

    J dOmega/dt = K (V - K Omega)/R - c Omega^2, with V chosen so that the command is the steady state:
    dOmega/dt = (Omega_c - Omega)(1/tau + beta (Omega_c + Omega)). Without regenerative braking only part of the
    negative current is available, so it slows down more slowly than it speeds up.

    Attributes:
        hover_s: time constant of small changes at hover.
        propeller_share: share of that damping that comes from the propeller's drag.
        braking_share: share of the motor's braking torque that the controller uses.
    """

    hover_s: Annotated[float, Field(gt=0.002)] = 0.05
    propeller_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.4
    braking_share: Annotated[float, Field(gt=0.0, le=1.0)] = 0.6
    on: bool = True


class InputDelay(NamedTuple):
    """A pure delay between the command and the motor controllers.

    Attributes:
        delay_s: at most 0.5.
    """

    delay_s: Annotated[float, Field(ge=0.0, le=0.5)] = 0.02
    on: bool = True


class BatterySag(NamedTuple):
    """Open-loop motor controllers: a command gives a speed in proportion to the battery's terminal voltage.

    The voltage is the battery model's: open-circuit voltage by charge, less internal resistance times current.

    Attributes:
        strength: 1 is full proportionality, 0 a perfectly regulated speed.
    """

    strength: Annotated[float, Field(ge=0.0, le=1.5)] = 1.0
    on: bool = True


class RotorGyroscopic(NamedTuple):
    """The rotors' own angular momentum h = J sum s_i Omega_i e_z turns with the body and takes up torque when it
    changes.

    Where neither ``truth.lag`` nor ``motor_lag`` is on, speeds jump and take up none: only what turns with the body is
    left.

    Attributes:
        inertia_kg_m2: J of one rotor with its motor's bell.
    """

    inertia_kg_m2: NonNegative = 6e-5
    on: bool = True


@compiled
def motor_slope(p: MotorLag, value: float, target: float, hover_value: float) -> float:
    """d/dt of a rotor's speed (or command in its units); at hover the slope is -1/hover_s."""
    electric = (1.0 - p.propeller_share) / p.hover_s
    beta = 0.5 * p.propeller_share / (p.hover_s * hover_value)
    drive = (target - value) * electric + beta * (target * target - value * value)
    coast = -beta * value * value  # what the propeller's drag alone does
    return select(drive < coast, coast + p.braking_share * (drive - coast), drive)
