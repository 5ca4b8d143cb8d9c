"""Compiled loop of :mod:`closed_loop`, in scalars, which compile fast.

Import where it is used: numba takes time to load.
"""

from __future__ import annotations

from math import atan, cos, exp, inf, sin, tan
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Plant(NamedTuple):
    """The rigid body that flies: mass, tensor about the centre of mass (3, 3), and the tensor's inverse."""

    mass_kg: float
    inertia: Array
    inverse: Array


class Law(NamedTuple):
    """The controller, its sampling and its rotors.

    Attributes:
        declared: mass, gravity, bandwidth of the derivative filter.
        gains: rows position p, i, d and attitude p, i, d, shape (6, 3).
        limits: thrust, torque, thrust of one rotor (inf: not limited).
        allocation: thrusts to body force and torque, shape (6, n).
        mixing: thrusts for [F_z, tau], shape (n, 4).
        rates_hz: of position and yaw, of roll and pitch.
        step_s: of the loop.
    """

    declared: Array
    gains: Array
    limits: Array
    allocation: Array
    mixing: Array
    rates_hz: Array
    step_s: float


@njit(cache=True)
def _clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@njit(cache=True)
def _slope(x: Array, forces: tuple[Array, Array, Array], plant: Plant, gravity: float, out: Array) -> None:
    """Time derivative of [p, v, eta, omega] (seed eq. 1-4), written into ``out``.

    Args:
        forces: the rotors' wrench [F_z, tau], their sideways force (2,), a further force and torque (6,).
    """
    (wrench, side, push), (mass, inertia, inverse) = forces, plant
    u, v, w, p, q, r = x[3], x[4], x[5], x[9], x[10], x[11]
    sp, cp, st, ct = sin(x[6]), cos(x[6]), sin(x[7]), cos(x[7])
    sy, cy, tt = sin(x[8]), cos(x[8]), tan(x[7])
    out[0] = ct * cy * u + (st * cy * sp - sy * cp) * v + (st * cy * cp + sy * sp) * w
    out[1] = ct * sy * u + (st * sy * sp + cy * cp) * v + (st * sy * cp - cy * sp) * w
    out[2] = -st * u + ct * sp * v + ct * cp * w
    out[3] = r * v - q * w + gravity * st + (side[0] + push[0]) / mass
    out[4] = p * w - r * u - gravity * ct * sp + (side[1] + push[1]) / mass
    out[5] = q * u - p * v - gravity * ct * cp + (wrench[0] + push[2]) / mass
    turning = sp * q + cp * r
    out[6] = p + tt * turning
    out[7] = cp * q - sp * r
    out[8] = turning / ct
    hx = inertia[0, 0] * p + inertia[0, 1] * q + inertia[0, 2] * r
    hy = inertia[1, 0] * p + inertia[1, 1] * q + inertia[1, 2] * r
    hz = inertia[2, 0] * p + inertia[2, 1] * q + inertia[2, 2] * r
    mx = wrench[1] + push[3] - (q * hz - r * hy)
    my = wrench[2] + push[4] - (r * hx - p * hz)
    mz = wrench[3] + push[5] - (p * hy - q * hx)
    for i in range(3):
        out[9 + i] = inverse[i, 0] * mx + inverse[i, 1] * my + inverse[i, 2] * mz


@njit(cache=True)
def _ticks(t: float, step: float, rate_hz: float) -> bool:
    """Whether a sampler of this rate fires at t."""
    return int(t * rate_hz + 1e-6) != int((t - step) * rate_hz + 1e-6) or t == 0.0


@njit(cache=True)
def _sample(x: Array, held: Array, poses: bool, tilts: bool) -> None:
    """Zero-order holds: position (0-2), world velocity (3-5), angles (6-8), their rates (9-11)."""
    sp, cp, st, ct, tt = sin(x[6]), cos(x[6]), sin(x[7]), cos(x[7]), tan(x[7])
    sy, cy = sin(x[8]), cos(x[8])
    u, v, w = x[3], x[4], x[5]
    turning = sp * x[10] + cp * x[11]
    if poses:
        for i in range(3):
            held[i] = x[i]
        held[3] = ct * cy * u + (st * cy * sp - sy * cp) * v + (st * cy * cp + sy * sp) * w
        held[4] = ct * sy * u + (st * sy * sp + cy * cp) * v + (st * sy * cp - cy * sp) * w
        held[5] = -st * u + ct * sp * v + ct * cp * w
        held[8] = x[8]
        held[11] = turning / ct
    if tilts:
        held[6], held[7] = x[6], x[7]
        held[9] = x[9] + tt * turning
        held[10] = cp * x[10] - sp * x[11]


@njit(cache=True)
def _control(wanted: Array, held: Array, memory: Array, law: Law, first: bool, wrench: Array) -> None:
    """PID (28)-(32) on held measurements; memory: position sums (0-2), angle sums (3-5), filtered roll and pitch
    (6-7).
    """
    declared, gains, limits, step = law.declared, law.gains, law.limits, law.step_s
    force = np.empty(3)
    weight = declared[0] * declared[1]
    for i in range(3):
        error = wanted[i] - held[i]
        force[i] = declared[0] * wanted[6 + i] + gains[0, i] * error + gains[1, i] * memory[i]
        force[i] += gains[2, i] * (wanted[3 + i] - held[3 + i])
        memory[i] += step * error
    force[2] = max(force[2] + weight, 0.1 * weight)
    sy, cy = sin(wanted[9]), cos(wanted[9])
    pitch = atan((force[0] * cy + force[1] * sy) / force[2])
    roll = atan(cos(pitch) * (force[0] * sy - force[1] * cy) / force[2])
    if first:
        memory[6], memory[7] = roll, pitch
    share = 1.0 - exp(-declared[2] * step)
    u = np.empty(3)
    for i in range(3):
        target = roll if i == 0 else (pitch if i == 1 else wanted[9])
        slope = wanted[10]
        if i < 2:
            slope = declared[2] * (target - memory[6 + i])
            memory[6 + i] += share * (target - memory[6 + i])
        error = target - held[6 + i]
        u[i] = gains[3, i] * error + gains[4, i] * memory[3 + i] + gains[5, i] * (slope - held[9 + i])
        memory[3 + i] += step * error
    sp, cp, tt, ct = sin(held[6]), cos(held[6]), tan(held[7]), cos(held[7])
    wrench[0] = _clip(force[2] / (cp * ct), 0.0, limits[0])
    wrench[1] = _clip(u[0], -limits[1], limits[1])
    wrench[2] = _clip(sp * tt * u[0] + cp * u[1] + sp / ct * u[2], -limits[1], limits[1])
    wrench[3] = _clip(cp * tt * u[0] - sp * u[1] + cp / ct * u[2], -limits[1], limits[1])


@njit(cache=True)
def _by_rotors(wrench: Array, side: Array, allocation: Array, mixing: Array, largest: float) -> None:
    """What the rotors make of a wrench: their sideways force, and where they are limited to [0, largest] the wrench as
    well.
    """
    thrusts = np.empty(allocation.shape[1])
    for rotor in range(len(thrusts)):
        thrusts[rotor] = 0.0
        for i in range(4):
            thrusts[rotor] += mixing[rotor, i] * wrench[i]
        if largest < inf:
            thrusts[rotor] = _clip(thrusts[rotor], 0.0, largest)
    for i in range(2):
        side[i] = 0.0
        for rotor in range(len(thrusts)):
            side[i] += allocation[i, rotor] * thrusts[rotor]
    if largest == inf:
        return
    for i in range(4):
        wrench[i] = 0.0
        for rotor in range(len(thrusts)):
            wrench[i] += allocation[2 + i, rotor] * thrusts[rotor]


@njit(cache=True)
def fly(wanted: Array, start: Array, push: Array, law: Law, plant: Plant) -> tuple[Array, Array]:
    """Integrate the closed loop with fourth-order Runge-Kutta, the wrench held over each step.

    Args:
        wanted: desired position, velocity, acceleration, yaw, yaw rate per step, shape (k, 11).
        start: state at the start, shape (12,).
        push: body force and torque besides the rotors' per step, shape (k, 6).
        law: the controller.
        plant: what it flies.

    Returns:
        States (k, 12) and wrenches (k, 4).
    """
    k, step, rates_hz, gravity = len(wanted), law.step_s, law.rates_hz, law.declared[1]
    states, wrenches = np.empty((k, 12)), np.empty((k, 4))
    x, held, memory, wrench, side = start.copy(), np.zeros(12), np.zeros(8), np.zeros(4), np.zeros(2)
    stages, probe = np.empty((4, 12)), np.empty(12)
    for i in range(k):
        t = i * step
        _sample(x, held, _ticks(t, step, rates_hz[0]), _ticks(t, step, rates_hz[1]))
        _control(wanted[i], held, memory, law, i == 0, wrench)
        _by_rotors(wrench, side, law.allocation, law.mixing, law.limits[2])
        for j in range(12):
            states[i, j] = x[j]
        for j in range(4):
            wrenches[i, j] = wrench[j]
        for stage in range(4):
            share = 0.0 if stage == 0 else (step if stage == 3 else 0.5 * step)
            for j in range(12):
                probe[j] = x[j] + (share * stages[stage - 1, j] if stage > 0 else 0.0)
            _slope(probe, (wrench, side, push[i]), plant, gravity, stages[stage])
        for j in range(12):
            x[j] += step / 6.0 * (stages[0, j] + 2.0 * stages[1, j] + 2.0 * stages[2, j] + stages[3, j])
    return states, wrenches
