"""Rotor speeds that are declared as measured and lead the motion: commands do, measured speeds do not.

A measured speed and the torque it makes are simultaneous; telemetry is late, if anything. A command leads by the
rotors' lag, 20 to 100 ms. Where commands are recorded beside the speeds, reading a flight compares the two; this check
needs the speeds alone.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.declarations.check import Check
from groundstation.identification.declarations.signals import PARTS, SHORTEST_S, STEP_S, Flown, passed, similarity
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

SHIFTS: NDArray[np.int64] = np.arange(-8, 16)
"""Grid steps by which the speeds may lead; a lag of 150 ms is a slow rotor's."""
PLAIN = 0.35
"""Correlation from which speeds explain turning at all, as in the check of the rotors' order."""
LEAD_S = 0.03
"""Lead that no measured speed has: gyro filters and half a sample make 10 ms, and measured speeds of which half are
corrupt led by 33 +- 3 ms (square_run1 of the nano-drone benchmark, seen while this was set). Rotors quicker than that
are not found out.
"""
T_LEAD = 5.0
"""Student's t over the parts of a flight (up to eleven degrees of freedom): chance in one of several thousand."""


def speed_checks(flown: Flown, vehicle: Vehicle) -> list[Check]:
    """Check "speed_source", where speeds are declared as telemetry and an IMU is recorded."""
    rotors = vehicle.rotors
    measured = rotors.measured
    if not measured or flown.thrust is None or flown.rate is None or flown.force is None:
        return []
    if flown.used.sum() * STEP_S < SHORTEST_S:
        return []
    position = np.asarray(rotors.position_m, dtype=float)
    torque = passed(flown.thrust) @ np.stack([position[:, 1], -position[:, 0]]).T
    turning = passed(np.gradient(flown.rate, STEP_S, axis=0))[:, :2]
    leads, top = _leads(torque, turning, flown.used)
    tested = "Roll and pitch acceleration against the torque of the rotor speeds, at leads of -80 to 150 ms"
    if top < PLAIN or len(leads) < 3:
        evidence = f"correlation {top:.2f} at best, under {PLAIN:.2f}"
        return [Check("speed_source", tested, evidence, "cannot tell", "The speeds do not show in the turning rate.")]
    lead, std = float(np.mean(leads)), float(np.std(leads, ddof=1) / np.sqrt(len(leads))) + 0.1 * STEP_S
    evidence = f"the speeds lead by {1e3 * lead:.0f} ± {1e3 * std:.0f} ms, correlation {top:.2f}"
    if lead < LEAD_S or (lead - LEAD_S) / std < T_LEAD:
        return [Check("speed_source", tested, evidence, "agrees")]
    says = (
        "The rotor speeds lead the motion as commands do, which a measured speed does not: nobody measured them, or "
        "the motors' stamps are early."
    )
    return [Check("speed_source", tested, evidence, "doubtful", says, 'speed_source = "command" under [rotors]')]


def _leads(torque: Array, turning: Array, used: NDArray[np.bool_]) -> tuple[Array, float]:
    """Lead of each part of the flight, s, and the correlation of the whole at its best one."""
    scale = np.std(turning[used], axis=0) + 1e-12
    measured = turning / scale
    moved = [np.roll(torque, shift, axis=0) for shift in SHIFTS]
    made = [each / (np.std(each[used], axis=0) + 1e-12) for each in moved]
    top = max(similarity(each[used], measured[used]) for each in made)
    power = np.cumsum(np.where(used, np.sum(measured**2, axis=1), 0.0))
    bounds = np.searchsorted(power, float(power[-1]) * np.arange(PARTS + 1) / PARTS)
    leads: list[float] = []
    for first, last in pairwise(bounds):
        rows = used[first:last]
        if rows.sum() < 50:
            continue
        scores = np.array([similarity(each[first:last][rows], measured[first:last][rows]) for each in made])
        leads.append(STEP_S * _peak(scores))
    return np.array(leads), top


def _peak(scores: Array) -> float:
    """Where a parabola through the best score and its neighbours has its top, in grid steps."""
    best = int(np.argmax(scores))
    if best in (0, len(scores) - 1):
        return float(SHIFTS[best])
    before, here, after = scores[best - 1 : best + 2]
    bend = before - 2.0 * here + after
    return float(SHIFTS[best]) + (0.5 * (before - after) / bend if bend < 0.0 else 0.0)
