"""Forces of rotors that move through air or near a floor: momentum theory with Glauert's induced velocity.

The induced velocity in hover is v_h = sqrt(T / (2 rho A)). With speed V across and W along the axis it solves
v_i = v_h^2 / sqrt(V^2 + (W + v_i)^2) (Glauert 1926; Leishman 2006, eq. 2.116). Pure edgewise and pure axial flight have
closed solutions, which are used here. Drag sees the velocity of its hub, which the body's turning is part of; all else
that of the vehicle's origin.
"""

from __future__ import annotations

from math import sqrt
from typing import Annotated, NamedTuple

from pydantic import Field

from sim.algebra import Vector
from sim.compiled import compiled

NonNegative = Annotated[float, Field(ge=0.0)]


class RotorDrag(NamedTuple):
    """H-force: profile drag of the blades, linear in speed, and induced drag, which fades as the inflow does.

    Each rotor pulls back with d_i (Omega/Omega_hover) ((1 - s) + s v_i(V)/v_h) u_xy (blade element theory, Bramwell
    2001, sec. 3.7: C_H = sigma C_d0 mu / 4 + sigma a mu lambda theta / ...; both parts are proportional to mu near
    hover).

    Attributes:
        drag_kg_s: force per air speed of the whole vehicle in hover, along body x and y.
        induced_share: s, share of the induced part at hover.
    """

    drag_kg_s: tuple[float, float] = (0.25, 0.25)
    induced_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.4
    on: bool = True


class FlappingMoment(NamedTuple):
    """Blades flap back by an angle proportional to the advance ratio; the hub's spring turns it into a moment, nose up.

    M = -k_beta a_1(mu) with a_1 proportional to mu = V/(Omega R) (Prouty 1990, ch. 7), hence to V/Omega.

    Attributes:
        k_nm_s_m: moment per air speed of the whole vehicle in hover, N m per m/s.
    """

    k_nm_s_m: float = 0.02
    on: bool = True


class TranslationalLift(NamedTuple):
    """Thrust at constant speed rises as forward flight thins the induced flow.

    T/T_0 = 1 + gain (1 - v_i(V)/v_h): blade element theory, in which thrust falls linearly with the inflow.

    Attributes:
        gain: lambda_h / (2 theta/3 - lambda_h) of the blade; 0.5 to 1 for usual propellers.
    """

    gain: NonNegative = 0.7
    on: bool = True


class ClimbInflow(NamedTuple):
    """Thrust at constant speed falls as the rotor climbs into its own inflow.

    T/T_0 = 1 - gain ((W + v_i(W))/v_h - 1) with v_i from axial momentum theory (Leishman 2006, eq. 2.84).

    Attributes:
        gain: as for translational lift.
    """

    gain: NonNegative = 0.7
    on: bool = True


class GroundEffect(NamedTuple):
    """Thrust rises near the floor as by an image source: T/T_0 = 1/(1 - k (R/(4 z))^2) (Cheeseman & Bennett, ARC R&M
    3021).

    Every rotor has its own height above the floor.

    Attributes:
        strength: k; 1 is the theory for one rotor, several side by side show more (Sanchez-Cuevas et al. 2017).
    """

    strength: NonNegative = 1.0
    on: bool = True


@compiled
def edgewise_inflow(speed_ratio: float) -> float:
    """v_i/v_h in edgewise flight at V/v_h: v_i^2 = -V^2/2 + sqrt(V^4/4 + v_h^4)."""
    square = speed_ratio * speed_ratio
    return sqrt(sqrt(0.25 * square * square + 1.0) - 0.5 * square)


@compiled
def axial_inflow(climb_ratio: float) -> float:
    """(W + v_i)/v_h in axial flight at W/v_h, the branch of normal working state."""
    half = 0.5 * climb_ratio
    return half + sqrt(half * half + 1.0)


@compiled
def inflow_factor(lift: TranslationalLift, climb: ClimbInflow, u: Vector, hover_inflow: float) -> float:
    """Thrust over that in still air, at air velocity u in the body."""
    factor = 1.0
    if lift.on:
        factor += lift.gain * (1.0 - edgewise_inflow(sqrt(u[0] * u[0] + u[1] * u[1]) / hover_inflow))
    if climb.on:
        factor -= climb.gain * (axial_inflow(u[2] / hover_inflow) - 1.0)
    return factor


@compiled
def ground_factor(p: GroundEffect, height: float, radius: float) -> float:
    """Thrust over that far from the floor; below half a radius the theory ends and its value there is kept."""
    ratio = radius / (4.0 * max(height, 0.5 * radius))
    return 1.0 / (1.0 - min(p.strength * ratio * ratio, 0.9))


@compiled
def hub_drag(p: RotorDrag, u: Vector, speed_ratio: float, hover_inflow: float, rotors: int) -> Vector:
    """H-force of one rotor in the body at Omega/Omega_hover, whose hub moves through the air at u in the body."""
    induced = edgewise_inflow(sqrt(u[0] * u[0] + u[1] * u[1]) / hover_inflow)
    share = -speed_ratio * (1.0 - p.induced_share + p.induced_share * induced) / rotors
    return (share * p.drag_kg_s[0] * u[0], share * p.drag_kg_s[1] * u[1], 0.0)


@compiled
def hub_moment(p: FlappingMoment, u: Vector, speed_ratio: float, rotors: int) -> Vector:
    """Moment of one hub in the body: -M e_z x u, which lifts the side that leads."""
    m = p.k_nm_s_m / (rotors * max(speed_ratio, 0.2))
    return (m * u[1], -m * u[0], 0.0)
