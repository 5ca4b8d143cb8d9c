"""Rotor numbering and spin: under which order do differences of thrust turn the vehicle as it turned."""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.declarations.check import Check
from groundstation.identification.declarations.signals import (
    SHORTEST_S,
    STEP_S,
    Flown,
    apart,
    passed,
    similarities,
    similarity,
)
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

PLAIN = 0.35
"""Correlation from which an order explains turning at all: an eighth of the power, in a flight of hundreds of
independent samples.
"""
PLAIN_WITHOUT_GYRO = 0.75
"""The same where rates are slopes of an estimated attitude, which carries the estimator's own dynamics and the loop's.
"""
FAR = 0.6
"""A declared order this share as good as the best one or better is not contradicted: noise of telemetry takes that
much.
"""
T_FAR = 4.0
"""Student's t over twelve parts of a flight (eleven degrees of freedom): chance in one of a thousand."""
MOMENTUM_S = (0.0, 0.03, 0.1)
"""Momentum of a rotor over its drag torque, as far as a change of thrust goes."""
LAGS_S = (0.0, 0.03, 0.06, 0.1)
"""Of rotors and their drivers."""


def orders(count: int) -> list[tuple[int, ...]]:
    """Orders tried: all of up to five rotors, every swap, turn and mirror of more. The declared one first."""
    if count <= 5:
        return list(permutations(range(count)))
    one = tuple(range(count))
    found = {one: None}
    for turn in range(count):
        turned = one[turn:] + one[:turn]
        found |= {turned: None, turned[::-1]: None}
    for a, b in combinations(range(count), 2):
        swapped = list(one)
        swapped[a], swapped[b] = b, a
        found[tuple(swapped)] = None
    return list(found)


def rotor_checks(flown: Flown, vehicle: Vehicle) -> list[Check]:
    """Checks "rotor_order" and "rotor_spin"."""
    if flown.thrust is None or flown.rate is None or flown.used.sum() * STEP_S < SHORTEST_S:
        return []
    thrust = passed(flown.thrust)
    turning = passed(np.gradient(flown.rate, STEP_S, axis=0))
    plain = PLAIN if flown.force is not None else PLAIN_WITHOUT_GYRO
    check = _order(thrust, turning, vehicle, flown.used, plain)
    return [check, _spin(thrust, turning, vehicle, flown.used, plain)]


def _order(thrust: Array, turning: Array, vehicle: Vehicle, used: NDArray[np.bool_], plain: float) -> Check:
    """Roll and pitch acceleration against the torque of each order, each axis in units of its own size."""
    size = np.std(turning[used, :2], axis=0) + 1e-9
    measured = turning[used, :2] / size
    # A thrust behind its lag: the shift that suits the best order suits every one of one set of rotors.
    shifted = {lag: np.roll(thrust, round(lag / STEP_S), axis=0)[used] for lag in LAGS_S}
    arms = vehicle.allocation()[1:3]

    def made(order: tuple[int, ...], lag: float) -> Array:
        torque = shifted[lag] @ arms[:, list(order)].T
        return torque / (np.std(torque, axis=0) + 1e-12)

    tried = orders(vehicle.rotors.count)
    columns = arms[:, np.array(tried)].transpose(1, 2, 0)
    scores = {
        (order, lag): score
        for lag in LAGS_S
        for order, score in zip(tried, similarities(shifted[lag], columns, measured), strict=True)
    }
    best, lag = max(scores, key=scores.__getitem__)
    own = max(scores[tried[0], each] for each in LAGS_S)
    top = scores[best, lag]
    t = apart(made(best, lag), made(tried[0], lag), measured) if best != tried[0] else 0.0
    tested = "Roll and pitch acceleration against thrust differences in every order of the rotors"
    evidence = f"correlation {own:.2f} as declared, {top:.2f} at best, t = {t:.1f}"
    if top < plain:
        return Check("rotor_order", tested, evidence, "cannot tell")
    if best == tried[0] or own > FAR * top or t < T_FAR:
        return Check("rotor_order", tested, evidence, "agrees" if own > FAR * top else "cannot tell")
    places = [list(vehicle.rotors.position_m[i]) for i in best]
    says = (
        f"The rotors are in another order: motors 1 to {len(best)} sit where {', '.join(str(i + 1) for i in best)} are "
        "declared."
    )
    return Check("rotor_order", tested, evidence, "contradicted", says, f"position_m = {places}")


def _patterns(declared: Array) -> list[Array]:
    """The declared spins, their opposite, and of up to six rotors every pattern with as many of each."""
    patterns = [declared, -declared]
    if len(declared) <= 6:
        for up in combinations(range(len(declared)), int(np.sum(declared > 0))):
            pattern = -np.ones(len(declared))
            pattern[list(up)] = 1.0
            patterns.append(pattern)
    return patterns


def _spin(thrust: Array, turning: Array, vehicle: Vehicle, used: NDArray[np.bool_], plain: float) -> Check:
    """Yaw acceleration against the reaction torque and its change of each pattern of spins.

    Drag on a propeller and the momentum of a rotor that speeds up both turn the body against the spin, so both have one
    sign. Tilted rotors turn it by their levers besides.
    """
    axes, position = vehicle.rotors.axes(), np.asarray(vehicle.rotors.position_m, dtype=float)
    levers = np.cross(position, axes)[:, 2] / vehicle.rotors.torque_to_thrust_m
    declared = np.asarray(vehicle.rotors.spin, dtype=float)
    patterns = _patterns(declared)
    measured = turning[used, 2:3]
    slope = np.gradient(thrust, STEP_S, axis=0)

    ways = [(round(lag / STEP_S), mix) for lag in LAGS_S for mix in MOMENTUM_S]
    moved = {way: np.roll(thrust + way[1] * slope, way[0], axis=0)[used] for way in ways}
    scores = {
        (i, way): similarity(-(moved[way] @ (p * axes[:, 2] - levers))[:, None], measured)
        for i, p in enumerate(patterns)
        for way in ways
    }
    winner, way = max(scores, key=scores.__getitem__)
    own, top = max(scores[0, each] for each in ways), scores[winner, way]
    best, as_declared = (-(moved[way] @ (patterns[i] * axes[:, 2] - levers))[:, None] for i in (winner, 0))
    t = apart(best, as_declared, measured) if winner else 0.0
    tested = "Yaw acceleration against -sum(spin T) and its change for every pattern of spins"
    evidence = f"correlation {own:.2f} as declared, {top:.2f} at best, t = {t:.1f}"
    if top < plain:
        return Check("rotor_spin", tested, evidence, "cannot tell")
    if own > FAR * top:
        return Check("rotor_spin", tested, evidence, "agrees")
    if t < T_FAR:
        return Check("rotor_spin", tested, evidence, "cannot tell")
    spins = [int(s) for s in patterns[winner]]
    says = "The rotors turn the other way about than declared."
    if not np.array_equal(patterns[winner], -declared):
        says = "The rotors' spins are another pattern than declared."
    return Check("rotor_spin", tested, evidence, "contradicted", says, f"spin = {spins}")
