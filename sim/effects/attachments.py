"""What hangs on the vehicle, sits in it where nobody declared it, or leaves it in flight."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from pydantic import Field

from sim.algebra import Quaternion, Vector, add, chosen, cross, dot, norm, scale, subtract, to_world
from sim.compiled import compiled
from sim.lanes import select

NonNegative = Annotated[float, Field(ge=0.0)]


class ComOffset(NamedTuple):
    """The centre of mass is not at the origin; the tensor stays the one about the centre of mass.

    Attributes:
        offset_m: from the origin, in the body.
    """

    offset_m: tuple[float, float, float] = (0.005, 0.0, 0.0)
    on: bool = True


class PayloadChange(NamedTuple):
    """A point mass is let go (or caught, when negative) in flight; the flight begins with it on board.

    The vehicle's own mass and tensor are the true ones; the point mass adds by the parallel-axis theorem.

    Attributes:
        mass_kg: of the load that is let go.
        time_s: seconds after take-off.
        position_m: where it was, in the body.
    """

    mass_kg: float = 0.1
    time_s: float = 20.0
    position_m: tuple[float, float, float] = (0.0, 0.0, -0.03)
    on: bool = True


class SlungLoad(NamedTuple):
    """A point mass on a cable, a body of its own in space: taut, the cable is a stiff damped spring; slack, nothing.

    Attributes:
        mass_kg: of the load.
        length_m: of the cable.
        attachment_m: where it is tied, in the body.
        damping_1_s: drag of the load against the air, per mass.
    """

    mass_kg: Annotated[float, Field(gt=0.0)] = 0.05
    length_m: Annotated[float, Field(gt=0.05)] = 0.5
    attachment_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    damping_1_s: NonNegative = 0.1
    on: bool = True


class Tether(NamedTuple):
    """A cable to a fixed point: an elastic that is slack below its length, and a steady pull from a reel.

    Attributes:
        anchor_m: the fixed point in the world.
        length_m: below this distance the elastic is slack.
        stiffness_n_m: of the elastic.
        pull_n: of the reel.
        attachment_m: in the body.
    """

    anchor_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    length_m: NonNegative = 0.0
    stiffness_n_m: NonNegative = 0.3
    pull_n: float = 0.0
    attachment_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    on: bool = True


_CABLE_RAD_S = 60.0  # natural frequency of the load on its stretching cable: 2.7 mm of stretch under its own weight
_CABLE_DAMPING = 0.3
NOTHING: Vector = (0.0, 0.0, 0.0)


@compiled
def cable(
    p: SlungLoad, position: Vector, velocity: Vector, load_position: Vector, load_velocity: Vector, gravity: float
) -> tuple[Vector, Vector]:
    """Pull on the vehicle (world) and acceleration of the load.

    Args:
        p: parameters.
        position: of the attachment in the world.
        velocity: of the attachment.
        load_position: of the load.
        load_velocity: of the load.
        gravity: m/s^2.
    """
    along = subtract(load_position, position)
    distance = norm(along)
    weight = (0.0, 0.0, -gravity)
    air = scale(-p.damping_1_s, load_velocity)
    lies = load_position[2] < 0.0  # on the floor: carried, and dragged along with friction
    lift = -400.0 * load_position[2] - 20.0 * load_velocity[2]
    floor = (
        select(lies, -10.0 * load_velocity[0], 0.0),
        select(lies, -10.0 * load_velocity[1], 0.0),
        select(lies, max(lift, 0.0), 0.0),
    )
    free = add(add(weight, air), floor)
    unit = scale(1.0 / distance, along)
    stretch_rate = dot(subtract(load_velocity, velocity), unit)
    stretch = distance - p.length_m
    tension = p.mass_kg * (_CABLE_RAD_S**2 * stretch + 2.0 * _CABLE_DAMPING * _CABLE_RAD_S * stretch_rate)
    tension = max(tension, 0.0)
    slack = distance <= p.length_m
    return chosen(slack, NOTHING, scale(tension, unit)), chosen(
        slack, free, add(free, scale(-tension / p.mass_kg, unit))
    )


@compiled
def tether(p: Tether, position: Vector, q: Quaternion) -> Vector:
    """Force in the world on the attachment."""
    along = subtract(p.anchor_m, add(position, to_world(q, p.attachment_m)))
    distance = norm(along)
    pull = p.pull_n + p.stiffness_n_m * max(distance - p.length_m, 0.0)
    return chosen(distance < 1e-6, NOTHING, scale(pull / distance, along))


@compiled
def attachment_velocity(velocity: Vector, q: Quaternion, w: Vector, attachment: Vector) -> Vector:
    """Velocity in the world of a point fixed in the body."""
    return add(velocity, to_world(q, cross(w, attachment)))
