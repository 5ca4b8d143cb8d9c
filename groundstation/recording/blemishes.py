"""Where a stream is blemished: pure functions from samples to masks. Nothing here changes a sample.

Every threshold is a bound on what flying vehicles do (stated beside it) or a multiple of the stream's own local noise,
so that fast flight, vibration and high rates are no blemishes.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from groundstation.frames import quat_conjugate, quat_continuous, quat_log, quat_multiply

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_NOISE_FACTOR = 12.0  # times the local noise: a normal sample in 10^32 lies beyond
_LOCAL = 20  # samples on each side, of which the noisier one sets the local noise: a vibration may begin anywhere
_ACCELERATION = 50.0  # m/s^2, 5 g: the most a vehicle's velocity changes
_ANGULAR_ACCELERATION = 300.0  # rad/s^2: above what the smallest racing quadrotors reach for more than an instant
_REST_M_S, _REST_RAD_S = 0.02, 0.05  # a repeated pose that is left as slowly as this may be a vehicle at rest
_ROTOR_LAG_S = 0.021  # of the quickest rotors that fly: half of it is a step of 10 ms
_FALL_S = 1.0  # without thrust a vehicle falls 5 m: rotors that stand for longer stand on the ground
_GROUND_M = 0.02  # a repeated pose this close to the lowest one may be a vehicle that has landed


def runs_backwards(t_s: Array) -> bool:
    """Whether time decreases throughout: more than half of all steps."""
    steps = np.diff(t_s[np.isfinite(t_s)])
    return len(steps) > 0 and float(np.mean(steps < 0.0)) > 0.5


def increasing(t_s: Array) -> Mask:
    """The largest set of samples whose stamps increase strictly, without strays beyond the rest of the stream.

    A longest increasing subsequence (patience sorting): a single stamp that leaps ahead is dropped, not all that follow
    it.
    """
    keep = np.isfinite(t_s)
    if np.any(np.diff(t_s[keep]) <= 0.0):
        index = np.flatnonzero(keep)
        keep = np.zeros(len(t_s), bool)
        keep[index[_longest_increasing(t_s[index].tolist())]] = True
    return _without_strays(t_s, keep)


def _longest_increasing(values: list[float]) -> list[int]:
    tails: list[float] = []
    tail_index: list[int] = []
    previous = [-1] * len(values)
    for index, value in enumerate(values):
        place = bisect_left(tails, value)
        previous[index] = tail_index[place - 1] if place else -1
        if place == len(tails):
            tails.append(value)
            tail_index.append(index)
        else:
            tails[place] = value
            tail_index[place] = index
    chain, index = [], tail_index[-1] if tail_index else -1
    while index >= 0:
        chain.append(index)
        index = previous[index]
    return chain[::-1]


def _without_strays(t_s: Array, keep: Mask) -> Mask:
    """Drop up to 1 % of samples at either end that lie farther from the rest than the rest is long."""
    index = np.flatnonzero(keep)
    few = max(3, len(index) // 100)
    for at_the_end in (False, True):
        if len(index) <= 2 * few + 2:
            break
        steps = np.diff(t_s[index])
        first = len(steps) - few if at_the_end else 0
        at = first + int(np.argmax(steps[first : first + few]))
        body = index[: at + 1] if at_the_end else index[at + 1 :]
        if steps[at] > t_s[body[-1]] - t_s[body[0]]:
            keep = keep.copy()
            keep[np.setdiff1d(index, body)] = False
            index = body
    return keep


def typical_step_s(t_s: Array) -> float:
    """Median step between stamps; infinite for fewer than two samples."""
    return float(np.median(np.diff(t_s))) if len(t_s) > 1 else float("inf")


def _running_median5(values: Array) -> Array:
    """Median over five neighbours along the first axis; at the ends over those there are, mirrored."""
    padded = np.pad(values, [(2, 2), *[(0, 0)] * (values.ndim - 1)], mode="reflect")
    return np.median(np.stack([padded[i : i + len(values)] for i in range(5)]), axis=0)


def _beyond_noise(deviation: Array, floor: float) -> Mask:
    """Where a deviation exceeds both a floor and twelve times its local robust level."""
    out = np.zeros(len(deviation), bool)
    for at in np.flatnonzero(deviation > floor):
        sides = deviation[max(at - _LOCAL, 0) : at], deviation[at + 1 : at + 1 + _LOCAL]
        level = max(float(np.median(side)) for side in sides if len(side))
        out[at] = deviation[at] > _NOISE_FACTOR * 1.4826 * level
    return out


def spikes(values: Array, floor: float) -> Mask:
    """Samples of one channel that stand out for at most two samples.

    Args:
        values: finite samples, shape (k,).
        floor: the least deviation from the median of five neighbours that counts, in the channel's unit.
    """
    if len(values) < 5:
        return np.zeros(len(values), bool)
    return _beyond_noise(np.abs(values - _running_median5(values)), floor)


def too_slow(t_s: Array, speeds: Array) -> Mask:
    """Measured rotor speeds far below what carries a vehicle, reached in flight by a leap that no rotor makes, shape
    (k, n).

    A rotor below a third of its usual speed gives a ninth of its thrust. A manoeuvre takes it there along its lag of 20
    ms and more; telemetry that failed leaps there and back, by over half its usual speed within a step of that lag's
    half. All rotors together for a second or more stand on the ground.
    """
    low = np.zeros(speeds.shape, bool)
    if not np.any(speeds > 0.0):
        return low
    usual = np.nanquantile(np.where(speeds > 0.0, speeds, np.nan), 0.75, axis=0)
    slow = np.asarray(np.nan_to_num(speeds, nan=np.inf) < usual / 3.0)
    grounded = np.zeros(len(t_s), bool)
    for first, last in _runs(np.all(slow, axis=1)):
        grounded[first : last + 1] = t_s[last] - t_s[first] >= _FALL_S
    quick = np.diff(t_s, prepend=-np.inf) <= 0.5 * _ROTOR_LAG_S
    leap = np.abs(np.diff(speeds, axis=0, prepend=np.nan)) > 0.5 * usual
    for column in range(speeds.shape[1]):
        for first, last in _runs(slow[:, column] & ~grounded):
            there = first > 0 and quick[first] and leap[first, column]
            back = last + 1 < len(t_s) and quick[last + 1] and leap[last + 1, column]
            low[first : last + 1, column] = there and back
    return low


def _runs(mask: Mask) -> list[tuple[int, int]]:
    """First and last index of each run of marked samples."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return list(zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True))


def curvature_floor(base: float, second_derivative: float, step_s: float) -> float:
    """What a smooth signal of bounded second derivative may deviate from its neighbours two samples away, plus a
    base.
    """
    return base + 0.5 * second_derivative * (2.0 * step_s) ** 2


def pose_spikes(t_s: Array, position_m: Array, quaternion: Array) -> Mask:
    """Poses that leave the path for at most two samples and return to it."""
    if len(t_s) < 5:
        return np.zeros(len(t_s), bool)
    step = typical_step_s(t_s)
    distance = np.linalg.norm(position_m - _running_median5(position_m), axis=1)
    q = _hemisphere(quaternion)
    centre = _running_median5(q)
    centre /= np.maximum(np.linalg.norm(centre, axis=1, keepdims=True), 1e-9)
    angle = np.linalg.norm(quat_log(quat_multiply(quat_conjugate(centre), q)), axis=1)
    return _beyond_noise(distance, curvature_floor(0.05, _ACCELERATION, step)) | _beyond_noise(
        angle, curvature_floor(0.2, _ANGULAR_ACCELERATION, step)
    )


def _hemisphere(quaternion: Array) -> Array:
    return quat_continuous(quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True))


def frozen(t_s: Array, position_m: Array, quaternion: Array, *, leap_m: float = 0.0, leap_rad: float = 0.0) -> Mask:
    """Poses that repeat their predecessor bit for bit while the vehicle moves.

    Measured poses carry noise, so that a repeated one is an old one, and when the tracker finds the vehicle again the
    pose leaps. Repeats are kept where the pose creeps away from them, or rests on the ground to the end: there a pose
    without noise is of a vehicle at rest.

    Args:
        t_s: increasing stamps, shape (k,).
        position_m: shape (k, 3).
        quaternion: shape (k, 4).
        leap_m: mark only repeats that end with a leap of this length,
        leap_rad: or of this angle.
    """
    pose = np.hstack([position_m, quaternion])
    repeats = np.concatenate([[False], np.all(pose[1:] == pose[:-1], axis=1)])
    if not repeats.any() or repeats[1:].all():
        return repeats
    starts = np.flatnonzero(~repeats)  # the first sample of each run of equal poses
    ends = np.append(starts[1:], len(t_s)) - 1
    q = _hemisphere(quaternion)
    steps = np.linalg.norm(np.diff(position_m[starts], axis=0), axis=1)
    turns = np.linalg.norm(quat_log(quat_multiply(quat_conjugate(q[starts[:-1]]), q[starts[1:]])), axis=1)
    pause = t_s[starts[1:]] - t_s[ends[:-1]]
    slow = (steps < np.maximum(_REST_M_S * pause, leap_m)) & (turns < np.maximum(_REST_RAD_S * pause, leap_rad))
    landed = position_m[-1, 2] <= float(np.min(position_m[:, 2])) + _GROUND_M
    resting = np.append(slow, landed)
    run = np.cumsum(~repeats) - 1
    return repeats & ~resting[run]


def jumps(t_s: Array, position_m: Array, quaternion: Array) -> Mask:
    """Poses that do not join the longest stretch of the path: it leapt there, as when a tracker swaps markers.

    The path is cut where a step differs from the velocities on its two sides by more than any vehicle accelerates.
    Starting from the longest piece, pieces that join on are kept, before and after; the others are marked.
    """
    count = len(t_s)
    if count < 12:
        return np.zeros(count, bool)
    q = _hemisphere(quaternion)
    dt = np.diff(t_s)
    velocity = np.diff(position_m, axis=0) / dt[:, None]
    rate = quat_log(quat_multiply(quat_conjugate(q[:-1]), q[1:])) / dt[:, None]
    speed_noise = 1.4826 * float(np.median(np.linalg.norm(np.diff(velocity, axis=0), axis=1)))
    rate_noise = 1.4826 * float(np.median(np.linalg.norm(np.diff(rate, axis=0), axis=1)))
    step = typical_step_s(t_s)
    allow_m = 0.1 + _NOISE_FACTOR * speed_noise * step
    allow_rad = 0.3 + _NOISE_FACTOR * rate_noise * step

    def joins(left: int, right: int) -> bool:
        """Whether sample ``right`` may follow sample ``left``."""
        pause = float(t_s[right] - t_s[left])
        before, after = slice(max(left - 5, 0), left), slice(right, right + 5)
        # Two samples may turn into noise what is a mean of few; the allowance counts that noise.
        v = [np.median(velocity[part], axis=0) for part in (before, after) if len(velocity[part])]
        w = [np.median(rate[part], axis=0) for part in (before, after) if len(rate[part])]
        leap = position_m[right] - position_m[left] - pause * np.mean(v, axis=0)
        turn = quat_log(quat_multiply(quat_conjugate(q[left]), q[right])) - pause * np.mean(w, axis=0)
        return bool(
            np.linalg.norm(leap) < allow_m + 0.5 * _ACCELERATION * pause**2
            and np.linalg.norm(turn) < allow_rad + 0.5 * _ANGULAR_ACCELERATION * pause**2
        )

    leaps = np.linalg.norm(np.diff(velocity, axis=0), axis=1) * dt[1:] > 0.5 * allow_m
    turns = np.linalg.norm(np.diff(rate, axis=0), axis=1) * dt[1:] > 0.5 * allow_rad
    suspects = np.flatnonzero(np.concatenate([[False], leaps]) | np.append(leaps, False) | np.append(turns, False))
    cuts = [int(at) for at in suspects if not joins(int(at), int(at) + 1)]
    return _apart(list(pairwise([0, *[cut + 1 for cut in cuts], count])), joins)


def _apart(pieces: list[tuple[int, int]], joins: Callable[[int, int], bool]) -> Mask:
    """Which samples lie in pieces that do not join on to the longest one, before or after it."""
    longest = max(range(len(pieces)), key=lambda i: pieces[i][1] - pieces[i][0])
    bad = np.ones(pieces[-1][1], bool)
    bad[slice(*pieces[longest])] = False
    first, last = pieces[longest][0], pieces[longest][1] - 1
    for begin, end in pieces[longest + 1 :]:
        if joins(last, begin):
            bad[begin:end] = False
            last = end - 1
    for begin, end in reversed(pieces[:longest]):
        if joins(end - 1, first):
            bad[begin:end] = False
            first = begin
    return bad


def gaps(t_s: Array) -> list[tuple[float, float]]:
    """Start and length of each pause of more than ten typical steps and a tenth of a second, in seconds."""
    if len(t_s) < 3:
        return []
    steps = np.diff(t_s)
    wide = np.flatnonzero(steps > max(10.0 * float(np.median(steps)), 0.1))
    return [(float(t_s[i]), float(steps[i])) for i in wide]
