"""Forces of the room: a steady one, and two that no library of flight knows."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from pydantic import Field

from sim.algebra import Quaternion, Vector, cross, dot, norm, scale, subtract, to_body, to_world
from sim.compiled import compiled


class ConstantWrench(NamedTuple):
    """A steady force and torque, such as a draught from a vent or a bent arm.

    Attributes:
        force_world_n: force that keeps its direction in the room.
        force_body_n: force that turns with the vehicle.
        torque_body_nm: torque in the body.
    """

    force_world_n: tuple[float, float, float] = (0.3, 0.0, 0.0)
    force_body_n: tuple[float, float, float] = (0.0, 0.0, 0.0)
    torque_body_nm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    on: bool = True


class AttractingWall(NamedTuple):
    """A wall that draws the vehicle in as the air between them speeds up: F = strength / (d + 0.5)^3 towards it.
    Invented.

    Attributes:
        distance_m: of the wall from the world's origin.
        azimuth_rad: direction from the origin to the wall.
        strength_n_m3: force times the cube of distance.
    """

    distance_m: float = 1.5
    azimuth_rad: float = 0.0
    strength_n_m3: float = 0.3
    on: bool = True


class Magnet(NamedTuple):
    """A magnet in the room and one on board, as point dipoles that attract: F ~ 1/r^4, and a torque that turns ours to
    it.

    Attributes:
        position_m: of the one in the room.
        strength_n_m4: force times distance to the fourth.
        moment_body: direction of ours in the body, unit length.
    """

    position_m: tuple[float, float, float] = (0.5, 0.0, 0.3)
    strength_n_m4: Annotated[float, Field(ge=0.0)] = 0.02
    moment_body: tuple[float, float, float] = (0.0, 0.0, 1.0)
    on: bool = True


@compiled
def wall(p: AttractingWall, position: Vector, direction: Vector) -> Vector:
    """Force in the world; ``direction`` is the unit vector to the wall."""
    distance = max(p.distance_m - dot(position, direction), 0.0)
    away = distance + 0.5
    return scale(p.strength_n_m3 / (away * (away * away)), direction)


@compiled
def magnet(p: Magnet, position: Vector, q: Quaternion) -> tuple[Vector, Vector]:
    """Force in the world and torque in the body; the distance counts from 0.2 m on, where the magnets would touch."""
    along = subtract(p.position_m, position)
    distance = max(norm(along), 0.2)
    unit = scale(1.0 / max(norm(along), 1e-9), along)
    square = distance * distance
    force = scale(p.strength_n_m4 / (square * square), unit)
    # A dipole's field falls as 1/r^3: the torque on ours per force is a third of the distance.
    field = scale(p.strength_n_m4 / (3.0 * (distance * square)), unit)
    return force, cross(p.moment_body, to_body(q, field))


@compiled
def constant_force(p: ConstantWrench, q: Quaternion) -> Vector:
    """Force in the world."""
    f = to_world(q, p.force_body_n)
    return (f[0] + p.force_world_n[0], f[1] + p.force_world_n[1], f[2] + p.force_world_n[2])
