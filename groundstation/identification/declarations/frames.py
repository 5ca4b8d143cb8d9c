"""Body and world frames and the order of quaternions: gyro against attitude, positions against the accelerometer."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from groundstation.flightdata import FlightData, Stream, resampled
from groundstation.frames import quat_conjugate, quat_exp, quat_multiply, quat_rotate, slerp
from groundstation.identification.clock import rates_from_attitude
from groundstation.identification.declarations.check import Check
from groundstation.identification.declarations.signals import (
    STEP_S,
    alike,
    correlations,
    in_words,
    long_enough,
    passed,
    signed_permutations,
)
from groundstation.linear_filters import correlation

Array = NDArray[np.float64]

PLAIN = 0.5
"""Similarity from which a reading explains the data: kinematics leave little beside noise."""
FAR = 0.6

READINGS: Mapping[str, tuple[tuple[int, ...], tuple[int, ...]]] = {
    "w x y z, body to world": ((0, 1, 2, 3), (1, 1, 1, 1)),
    "x y z w, body to world": ((3, 0, 1, 2), (1, 1, 1, 1)),
    "w x y z, world to body": ((0, 1, 2, 3), (1, -1, -1, -1)),
    "x y z w, world to body": ((3, 0, 1, 2), (1, -1, -1, -1)),
}
"""How four numbers may be meant: their order, and the sign of each."""


def read_as(quaternion: Array, reading: str) -> Array:
    """Quaternions as they would be declared, had they been meant so, (k, 4)."""
    order, signs = READINGS[reading]
    return quaternion[:, list(order)] * np.asarray(signs, dtype=float)


def frame_checks(flight: FlightData) -> list[Check]:
    """Checks of the pose stream ("quaternion", "body_frame", "world_frame", "position_unit") and of the state's
    velocity.
    """
    found: list[Check] = []
    pose, state, imu = (long_enough(stream) for stream in (flight.mocap, flight.state, flight.imu))
    if state is not None:
        found += _velocity(state)
        pose = pose or Stream(state.t_s, state.values[:, [0, 1, 2, 6, 7, 8, 9]], ())
    if pose is None or imu is None:
        return found
    mounting = quat_exp(np.asarray(flight.vehicle.mocap.rotation_rad))
    reading, offset, checks = _attitude(imu, pose, mounting)
    found += checks
    if offset is not None:
        quaternion = quat_multiply(read_as(pose.values[:, 3:7], reading), quat_conjugate(mounting))
        found += _world(imu, pose, quaternion, offset, flight.vehicle.gravity_m_s2)
    return found


def _rates(pose: Stream, quaternion: Array, grid: Array) -> Array:
    """Body rates of attitudes on a grid, in the band."""
    rate, middle = rates_from_attitude(pose.t_s, quaternion)
    limit = 8.0 * np.median(np.abs(rate), axis=0) + 1.0
    return passed(resampled(grid, middle, np.clip(rate, -limit, limit)), (0.3, 4.0))


def _best_shift(first: Array, second: Array) -> int:
    """By how many steps the second comes after the first, by the size of each, which no naming of axes changes."""
    sizes = [np.linalg.norm(x, axis=1) for x in (first, second)]
    a: Array
    b: Array
    a, b = (size - size.mean() for size in sizes)
    return int(np.argmax(correlation(b, a))) - (len(a) - 1)


def _overlap(first: Array, second: Array, shift: int) -> tuple[Array, Array]:
    """Rows of both that belong together where the second is ``shift`` steps late."""
    low, high = max(0, -shift), min(len(first), len(second) - shift)
    return first[low:high], second[low + shift : high + shift]


Naming = tuple[str, int, int]
"""Under which reading of the quaternions, which naming of the axes and which shift two rates are compared."""


def _similarities(imu: Stream, pose: Stream, mounting: Array) -> dict[Naming, float]:
    """How alike gyro and attitudes' rates are, for every reading, naming and shift near the best; empty if too
    short.
    """
    grid = np.arange(imu.t_s[0], imu.t_s[-1], STEP_S)
    when = np.arange(pose.t_s[0], pose.t_s[-1], STEP_S)
    gyro = passed(resampled(grid, imu.t_s, imu.values[:, :3]), (0.3, 4.0))
    names = np.stack(signed_permutations()).reshape(-1, 9)
    results: dict[Naming, float] = {}
    for reading in READINGS:
        quaternion = quat_multiply(read_as(pose.values[:, 3:7], reading), quat_conjugate(mounting))
        seen = _rates(pose, quaternion, when)
        coarse = _best_shift(gyro, seen)
        for shift in range(coarse - 10, coarse + 11):
            a, b = _overlap(gyro, seen, shift)
            if len(a) < 200:
                continue
            size = float(np.sqrt(np.sum(a**2) * np.sum(b**2))) + 1e-12
            cross = b.T @ a / size
            alike = (names @ cross.ravel()).tolist()
            results.update(((reading, number, shift), value) for number, value in enumerate(alike))
    return results


def _attitude(imu: Stream, pose: Stream, mounting: Array) -> tuple[str, float | None, list[Check]]:
    """Under which reading of quaternions and naming of axes gyro and attitudes agree."""
    declared = next(iter(READINGS))
    results = _similarities(imu, pose, mounting)
    if not results:
        return declared, None, []
    reading, number, shift = best = max(results, key=results.__getitem__)
    own = max((value for key, value in results.items() if key[:2] == (declared, 0)), default=0.0)
    top = results[best]
    # A wrong order of four numbers may come out as a wrong naming of axes: the declared naming goes first where it is
    # as good.
    plain = max((k for k in results if k[1] == 0), key=results.__getitem__)
    if results[plain] > 0.95 * top:
        reading, number, shift = plain
    offset = shift * STEP_S + float(pose.t_s[0] - imu.t_s[0])
    tested = "Gyro against the rate of the attitudes, for every reading of the quaternions and naming of the axes"
    evidence = f"similarity {own:.2f} as declared, {top:.2f} at best"
    if top < PLAIN:
        return declared, None, [Check("attitude", tested, evidence, "cannot tell")]
    if own > FAR * top or (reading, number) == (declared, 0):
        return declared, offset, [Check("attitude", tested, evidence, "agrees")]
    check = Check("attitude", tested, evidence, "contradicted", *_said_of(reading, declared, number))
    return reading, offset if number == 0 else None, [check]


def _said_of(reading: str, declared: str, number: int) -> tuple[str, str]:
    """What another reading or naming says, and the line that puts it right."""
    says: list[str] = []
    line: list[str] = []
    if reading != declared:
        says.append(f"The quaternions are {reading}, not {declared}")
        line.append(f"reorder qw, qx, qy, qz of the poses ({reading})")
    if number:
        matrix = signed_permutations()[number]
        says.append(f"attitudes turn as the gyro's axes {in_words(matrix)} do" + _frame_word(matrix))
        line.append(f"give gyro and accelerometer, or the attitudes, in FLU: axes {in_words(matrix)}")
    return "; ".join(says) + ".", "; ".join(line)


def _frame_word(matrix: Array) -> str:
    known = {"(x, -y, -z)": " (FRD against FLU)", "(y, x, -z)": " (NED against ENU)"}
    if np.linalg.det(matrix) < 0.0:
        return " (one axis is mirrored)"
    return known.get(in_words(matrix), "")


def _world(imu: Stream, pose: Stream, quaternion: Array, offset: float, gravity: float) -> list[Check]:
    """Acceleration of the positions against the specific force in the world, for every naming of the world's axes."""
    grid = np.arange(max(imu.t_s[0], pose.t_s[0] - offset), min(imu.t_s[-1], pose.t_s[-1] - offset), STEP_S)
    if len(grid) < 300:
        return []
    band = (0.3, min(3.0, 0.2 / float(np.median(np.diff(pose.t_s)))))
    if band[1] < 0.6:
        return []
    felt = quat_rotate(slerp(imu.t_s, pose.t_s - offset, quaternion), imu.values[:, 3:6])
    upward = np.median(felt, axis=0) / gravity
    felt = passed(resampled(grid, imu.t_s, felt - np.array([0.0, 0.0, gravity])), band)
    smooth = passed(resampled(grid, pose.t_s - offset, pose.values[:, :3]), band)
    seen = np.gradient(np.gradient(smooth, STEP_S, axis=0), STEP_S, axis=0)
    names = signed_permutations()
    late = [correlations(*_overlap(felt, seen, shift)) for shift in range(-15, 16, 3)]
    scores = [max(alike(found, matrix) for found in late) for matrix in names]
    winner, own = int(np.argmax(scores)), scores[0]
    top = scores[winner]
    tested = (
        "Acceleration of the positions against the accelerometer turned into the world, for every naming of its axes"
    )
    evidence = f"correlation {own:.2f} as declared, {top:.2f} at best; gravity at {upward[2]:+.2f} g on z"
    if top < PLAIN:
        return [Check("world_frame", tested, evidence, "cannot tell")]
    found: list[Check] = []
    if winner and own < FAR * top:
        words = in_words(names[winner])
        says = (
            "Positions are in another world than attitudes and accelerometer: they move as its axes "
            f"{words}{_world_word(names[winner])}."
        )
        line = f"give x_m, y_m, z_m and attitudes in one right-handed world with z up: positions are {words} of it"
        return [Check("world_frame", tested, evidence, "contradicted", says, line)]
    found.append(Check("world_frame", tested, evidence, "agrees"))
    gain = float(np.sqrt(np.sum(seen**2) / np.sum(felt**2)))
    unit = f"positions accelerate {gain:.3g} times what the accelerometer feels"
    if top > 0.7 and not 0.4 < gain < 2.5:
        says = f"Positions or specific force are in another unit: {unit}."
        found.append(Check("position_unit", tested, unit, "contradicted", says, "convert positions to metres"))
    return found


def _world_word(matrix: Array) -> str:
    if np.linalg.det(matrix) < 0.0:
        return " (one axis is mirrored)"
    known = {
        "(x, -y, -z)": " (z down)",
        "(y, x, -z)": " (NED against ENU)",
        "(x, z, -y)": " (y up)",
        "(x, -z, y)": " (y up)",
    }
    return known.get(in_words(matrix), "")


def _velocity(state: Stream) -> list[Check]:
    """The state's velocity against the change of its position."""
    grid = np.arange(state.t_s[0], state.t_s[-1], STEP_S)
    if len(grid) < 300:
        return []
    place = passed(resampled(grid, state.t_s, state.values[:, :3]), (0.1, 2.0))
    told = passed(resampled(grid, state.t_s, state.values[:, 3:6]), (0.1, 2.0))
    seen = np.gradient(place, STEP_S, axis=0)
    names = signed_permutations()
    found = correlations(told, seen)
    scores = [alike(found, matrix) for matrix in names]
    winner = int(np.argmax(scores))
    tested = "The state's velocity against the change of its position, for every naming of the axes"
    evidence = f"correlation {scores[0]:.2f} as declared, {scores[winner]:.2f} at best"
    if scores[winner] < PLAIN:
        return [Check("velocity_frame", tested, evidence, "cannot tell")]
    if winner == 0 or scores[0] > FAR * scores[winner]:
        return [Check("velocity_frame", tested, evidence, "agrees")]
    words = in_words(names[winner])
    says = f"The state's velocity is in another frame than its position, which moves as {words} of it."
    return [Check("velocity_frame", tested, evidence, "contradicted", says, f"give vx, vy, vz as {words}")]
