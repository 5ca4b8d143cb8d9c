r"""The vehicle as nature has it: rigid body with full tensor, rotors that lag, battery, floor, and the effects switched
on.

Newton and Euler about the centre of mass c, which may lie away from the declared origin o (seed paper eq. 1-4, written
for a body whose rotors carry angular momentum h):

.. math::
    m \dot v_c = R f + m g, \qquad I \dot\omega + \omega\times(I\omega + h) + \dot h = \tau_o - c\times f, \qquad
    \dot v_o = \dot v_c - R(\dot\omega\times c + \omega\times(\omega\times c)).

Integrated is the motion of the origin, which stays continuous when the mass changes. The state vector is laid out by
the slices below; rotors are in the units of the motor values (rad/s, command, or newton for a wrench vehicle).
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from sim.algebra import (
    Symmetric,
    Vector,
    add,
    chosen,
    copy,
    cross,
    multiply,
    scale,
    subtract,
    times,
    to_body,
    to_world,
)
from sim.compiled import compiled
from sim.effects import Effects, bodily_wrench
from sim.effects.actuation import motor_slope
from sim.effects.attachments import NOTHING, attachment_velocity, cable, tether
from sim.effects.bodily import Moving
from sim.effects.rotor_aerodynamics import ground_factor, hub_drag, hub_moment, inflow_factor
from sim.effects.rotor_faults import loss_of, power_law
from sim.effects.surroundings import constant_force, magnet, wall
from sim.lanes import any_of, negate, select

POSITION, VELOCITY, ATTITUDE, RATE, LOAD, LOAD_VELOCITY, ROTOR = 0, 3, 6, 10, 13, 16, 19
"""First index of: origin in the world (3), its velocity in the world (3), quaternion (4), body rate (3), slung load's
position and velocity in the world (3, 3), rotors (n)."""


class Body(NamedTuple):
    """Mass (kg), centre of mass in the body (m), tensor about it (kg m^2) and its inverse."""

    mass: float
    com: Vector
    inertia: Symmetric
    inverse: Symmetric


class Rotors(NamedTuple):
    """True rotor constants; thrust is c0 + c1 x + c2 x^2 of the motor value x.

    Attributes:
        position: hubs in the body, shape (n, 3), m.
        spin: +1 counter-clockwise from above, shape (n,).
        axis: unit vector of each rotor's thrust in the body, shape (n, 3).
        curve: c0, c1, c2.
        torque_ratio: |Q|/T, m.
        radius: m.
        speed_coefficient: k of T = k Omega^2, which gives the speed where motor values are no speeds.
        lag_up, lag_down: first-order time constants, s.
        value_max: largest motor value.
        thrust_min: 0, or minus infinity for a wrench vehicle.
        hover_thrust: one rotor's share of the weight, N.
        hover_value: motor value at that thrust.
        hover_speed: rotor speed at that thrust, rad/s.
        hover_inflow: induced velocity at that thrust, m/s.
    """

    position: np.ndarray
    spin: np.ndarray
    axis: np.ndarray
    curve: Vector
    torque_ratio: float
    radius: float
    speed_coefficient: float
    lag_up: float
    lag_down: float
    value_max: float
    thrust_min: float
    hover_thrust: float
    hover_value: float
    hover_speed: float
    hover_inflow: float


class Plant(NamedTuple):
    """Everything constant about nature.

    ``before`` and ``after`` differ when a payload changes at ``change_s`` of flight.
    """

    before: Body
    after: Body
    change_s: float
    rotors: Rotors
    effects: Effects
    gravity: float
    air_density: float
    wall_direction: Vector


class Surroundings(NamedTuple):
    """What acts on the plant during one step, held over it.

    Attributes:
        wind: of the air in the world, m/s.
        force: disturbance in the world, N.
        torque: disturbance in the body, N m.
        flight_s: seconds since take-off; negative on the ground.
        powered: whether the rotors turn.
        standing: whether the floor holds the vehicle.
    """

    wind: Vector
    force: Vector
    torque: Vector
    flight_s: float
    powered: bool
    standing: bool


@compiled
def thrust_of(rotors: Rotors, value: float) -> float:
    """Declared-law thrust of one rotor, N."""
    c = rotors.curve
    return max(c[0] + (c[1] + c[2] * value) * value, rotors.thrust_min)


@compiled
def rotor_wrench(
    x, slope, memory, rotors: Rotors, effects: Effects, flight_s: float, u: Vector
) -> tuple[Vector, Vector, Vector, Vector]:
    """Sum of the rotors in the body about the origin.

    Args:
        x: state vector.
        slope: its derivative so far, of which the rotors' part is read.
        memory: memory of each rotor's thrust (effect ``thrust_memory``), shape (n,).
        rotors: constants.
        effects: those switched on.
        flight_s: seconds since take-off.
        u: velocity relative to the air in the body, m/s.

    Returns:
        Force (N), torque (N m), angular momentum h and its derivative in the body.
    """
    n = len(rotors.spin)
    force, torque = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    momentum, momentum_slope = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    q = (x[ATTITUDE], x[ATTITUDE + 1], x[ATTITUDE + 2], x[ATTITUDE + 3])
    inflow = inflow_factor(effects.translational_lift, effects.climb_inflow, u, rotors.hover_inflow)
    for i in range(n):
        value = x[ROTOR + i]
        ideal = thrust_of(rotors, value)
        speed, speed_ratio = 0.0, 0.0
        if effects.rotor_drag.on or effects.flapping_moment.on or effects.rotor_gyroscopic.on:
            speed = sqrt(max(ideal, 0.0) / rotors.speed_coefficient)
            speed_ratio = speed / rotors.hover_speed
        axis = (rotors.axis[i, 0], rotors.axis[i, 1], rotors.axis[i, 2])
        hub = (rotors.position[i, 0], rotors.position[i, 1], rotors.position[i, 2])
        thrust = power_law(effects.thrust_curve, ideal, rotors.hover_thrust)
        if effects.thrust_memory.on:
            thrust += effects.thrust_memory.gain * (memory[i] - thrust)
        if effects.thrust_scale.on:
            thrust *= effects.thrust_scale.density_ratio
        left = loss_of(effects.weak_rotor, effects.rotor_degradation, i, flight_s)
        reaction = -rotors.spin[i] * rotors.torque_ratio * thrust
        if any_of(left != 1.0):
            thrust *= left
            reaction *= left**1.25  # similarity of cut propellers: T ~ D^4, Q ~ D^5
        if effects.torque_scale.on:
            reaction *= effects.torque_scale.ratio
        near_floor = 1.0
        if effects.ground_effect.on:
            near_floor = ground_factor(effects.ground_effect, x[POSITION + 2] + to_world(q, hub)[2], rotors.radius)
        thrust *= inflow * near_floor
        pull = scale(thrust, axis)
        if effects.rotor_drag.on:
            blown = add(u, cross((x[RATE], x[RATE + 1], x[RATE + 2]), hub))
            pull = add(pull, hub_drag(effects.rotor_drag, blown, speed_ratio, rotors.hover_inflow, n))
        force = add(force, pull)
        torque = add(torque, cross(hub, pull))
        torque = add(torque, scale(reaction, axis))
        if effects.flapping_moment.on:
            torque = add(torque, hub_moment(effects.flapping_moment, u, speed_ratio, n))
        if effects.rotor_gyroscopic.on:
            spin_inertia = rotors.spin[i] * effects.rotor_gyroscopic.inertia_kg_m2
            momentum = add(momentum, scale(spin_inertia * speed, axis))
            # dOmega/dt = (dT/dx)(dx/dt) / (2 k Omega)
            thrust_slope = (rotors.curve[1] + 2.0 * rotors.curve[2] * value) * slope[ROTOR + i]
            faster = select(ideal > 0.0, thrust_slope / (2.0 * rotors.speed_coefficient * speed), 0.0)
            momentum_slope = add(momentum_slope, scale(spin_inertia * faster, axis))
    return force, torque, momentum, momentum_slope


@compiled
def attached_wrench(x, slope, effects: Effects, wall_direction: Vector, gravity: float) -> tuple[Vector, Vector]:
    """Forces that act at points of the body from the room and from what hangs on it; moves the slung load.

    Returns:
        Force in the world (N) and torque about the origin in the body (N m).
    """
    position = (x[0], x[1], x[2])
    q = (x[ATTITUDE], x[ATTITUDE + 1], x[ATTITUDE + 2], x[ATTITUDE + 3])
    force, torque = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    if effects.constant_wrench.on:
        force = add(force, constant_force(effects.constant_wrench, q))
        torque = add(torque, effects.constant_wrench.torque_body_nm)
    if effects.tether.on:
        pull = tether(effects.tether, position, q)
        force = add(force, pull)
        torque = add(torque, cross(effects.tether.attachment_m, to_body(q, pull)))
    if effects.attracting_wall.on:
        force = add(force, wall(effects.attracting_wall, position, wall_direction))
    if effects.magnet.on:
        pull, twist = magnet(effects.magnet, position, q)
        force = add(force, pull)
        torque = add(torque, twist)
    if effects.slung_load.on:
        p = effects.slung_load
        w = (x[RATE], x[RATE + 1], x[RATE + 2])
        tied = add(position, to_world(q, p.attachment_m))
        tied_velocity = attachment_velocity((x[3], x[4], x[5]), q, w, p.attachment_m)
        load = (x[LOAD], x[LOAD + 1], x[LOAD + 2])
        load_velocity = (x[LOAD_VELOCITY], x[LOAD_VELOCITY + 1], x[LOAD_VELOCITY + 2])
        pull, load_acceleration = cable(p, tied, tied_velocity, load, load_velocity, gravity)
        force = add(force, pull)
        torque = add(torque, cross(p.attachment_m, to_body(q, pull)))
        for i in range(3):
            slope[LOAD + i] = load_velocity[i]
            slope[LOAD_VELOCITY + i] = load_acceleration[i]
    return force, torque


@compiled
def either(condition: bool, a: Symmetric, b: Symmetric) -> Symmetric:
    """``a`` where the condition holds, else ``b``."""
    x, y = chosen(condition, a[:3], b[:3]), chosen(condition, a[3:], b[3:])
    return (x[0], x[1], x[2], y[0], y[1], y[2])


@compiled
def body_of(condition, a: Body, b: Body) -> Body:
    """``a`` where the condition holds, else ``b``."""
    return Body(
        select(condition, a.mass, b.mass),
        chosen(condition, a.com, b.com),
        either(condition, a.inertia, b.inertia),
        either(condition, a.inverse, b.inverse),
    )


@compiled
def derivative(x, slope, target, memory, plant: Plant, now: Surroundings) -> None:
    """Time derivative of the state, written into ``slope``.

    Args:
        x: state vector.
        slope: output, same shape.
        target: motor values asked for, shape (n,).
        memory: thrust memory of each rotor, shape (n,).
        plant: constants.
        now: surroundings, held over the step.
    """
    rotors, effects = plant.rotors, plant.effects
    for i in range(LOAD, ROTOR):
        slope[i] = 0.0
    for i in range(len(rotors.spin)):
        value = x[ROTOR + i]
        lag = select(target[i] >= value, rotors.lag_up, rotors.lag_down)
        if effects.motor_lag.on:
            slope[ROTOR + i] = motor_slope(effects.motor_lag, value, target[i], rotors.hover_value)
        else:
            slope[ROTOR + i] = select(lag > 0.0, (target[i] - value) / lag, 0.0)
    q = (x[ATTITUDE], x[ATTITUDE + 1], x[ATTITUDE + 2], x[ATTITUDE + 3])
    w = (x[RATE], x[RATE + 1], x[RATE + 2])
    velocity = (x[VELOCITY], x[VELOCITY + 1], x[VELOCITY + 2])
    u = to_body(q, subtract(velocity, now.wind))

    force, torque = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    momentum, momentum_slope = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    if any_of(now.powered):
        force, torque, momentum, momentum_slope = rotor_wrench(x, slope, memory, rotors, effects, now.flight_s, u)
        force, torque = chosen(now.powered, force, NOTHING), chosen(now.powered, torque, NOTHING)
        momentum, momentum_slope = (
            chosen(now.powered, momentum, NOTHING),
            chosen(now.powered, momentum_slope, NOTHING),
        )
    at = Moving((x[0], x[1], x[2]), velocity, q, w, u, plant.air_density, now.flight_s)
    force, torque = bodily_wrench(effects, at, force, torque)
    room_force, room_torque = attached_wrench(x, slope, effects, plant.wall_direction, plant.gravity)
    force = add(force, to_body(q, add(room_force, now.force)))
    torque = add(torque, add(room_torque, now.torque))

    body = plant.after
    if effects.payload_change.on:
        body = body_of(now.flight_s >= plant.change_s, plant.after, plant.before)
    spin = add(times(body.inertia, w), momentum)
    moment = subtract(subtract(torque, cross(body.com, force)), cross(w, spin))
    turn = times(body.inverse, subtract(moment, momentum_slope))
    lever = add(cross(turn, body.com), cross(w, cross(w, body.com)))
    push = to_world(q, subtract(scale(1.0 / body.mass, force), lever))
    rise = push[2] - plant.gravity
    held = now.standing & ((rise <= 0.0) | negate(now.powered))
    q_slope = multiply(q, (0.0, w[0], w[1], w[2]))
    for i in range(3):
        slope[POSITION + i] = select(held, 0.0, x[VELOCITY + i])
        slope[VELOCITY + i] = select(held, 0.0, push[i] if i < 2 else rise)
        slope[RATE + i] = select(held, 0.0, turn[i])
    for i in range(4):
        slope[ATTITUDE + i] = select(held, 0.0, 0.5 * q_slope[i])


@compiled
def rk4_step(x, work, target, memory, plant: Plant, now: Surroundings, dt: float) -> None:
    """Advance the state by one step of the classical fourth-order Runge-Kutta method.

    Args:
        x: state vector, changed in place; the quaternion is scaled to unit length.
        work: shape (5, len(x)); afterwards rows 0 and 3 hold the derivatives at the start and (nearly) at the end.
        target: motor values asked for.
        memory: thrust memory of each rotor.
        plant: constants.
        now: surroundings, held over the step.
        dt: step, s.
    """
    size = len(x)
    if not plant.effects.motor_lag.on:
        for i in range(len(plant.rotors.spin)):
            x[ROTOR + i] = select(plant.rotors.lag_up > 0.0, x[ROTOR + i], target[i])
    copy(x, work[4])
    for stage in range(4):
        derivative(work[4], work[stage], target, memory, plant, now)
        h = dt if stage == 2 else 0.5 * dt
        for i in range(size):
            work[4, i] = x[i] + h * work[stage, i]
    for i in range(size):
        x[i] += dt / 6.0 * (work[0, i] + 2.0 * work[1, i] + 2.0 * work[2, i] + work[3, i])
    length = sqrt(x[6] * x[6] + x[7] * x[7] + x[8] * x[8] + x[9] * x[9])
    for i in range(ATTITUDE, ATTITUDE + 4):
        x[i] /= length


@compiled
def specific_force(acceleration: Vector, turn: Vector, w: Vector, q, lever: Vector, gravity: float) -> Vector:
    """What an accelerometer at ``lever`` in the body feels: R^T(a_o - g) + dw/dt x r + w x (w x r)."""
    felt = to_body(q, (acceleration[0], acceleration[1], acceleration[2] + gravity))
    return add(felt, add(cross(turn, lever), cross(w, cross(w, lever))))


@compiled
def mechanical_power(x, rotors: Rotors, density: float) -> float:
    """Power of the rotors by momentum theory, sum T^1.5 / sqrt(2 rho A), W."""
    disc = 3.141592653589793 * rotors.radius * rotors.radius
    total = 0.0
    for i in range(len(rotors.spin)):
        thrust = max(thrust_of(rotors, x[ROTOR + i]), 0.0)
        total += thrust * sqrt(thrust / (2.0 * density * disc))
    return total
