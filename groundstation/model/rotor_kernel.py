"""Block means of what rotors make behind a lag, for several lags and dead times at once.

Each rotor behind each lag has a lane of vector registers. The motors' grid is a millisecond, a fit's blocks are many:
what the rotors make on the grid is kept for a chunk at a time and gathered into the blocks from there, so that nothing
of the grid's length is written. All that the lanes keep lies in one array, a row of LANES for each quantity: rows lie a
constant distance apart, so the compiler knows that lanes do not touch each other.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Clock = tuple[Array, float, float, float, float]
"""Stamps (k,), a dead time, the grid's start, its step and its length."""

LANES = 16
"""Four lags of a quadrotor: two of the widest vector registers, which hide each other's latency."""
CHUNK = 256
"""Steps of the grid that are kept: 64 kB, which a core's own cache holds."""
SLOWEST = 0.1
"""Share of hover's rate that a lag keeps however small the command."""
NEARLY_INSTANT_S = 1e-6
"""A lag no longer than this passes its input through."""
INPUT, LAGGED, RISING, FALLING, THRUST, SUM, UP, DOWN, STILL, MORE, PASSES, BEFORE, NOW, ROWS = (
    LANES * row for row in range(14)
)
"""Where rows begin: signals; steps over lags, the rate's parts, whether the input passes, a running sum's weights."""
TWELFTH = 1.0 / 12.0


@njit(cache=True, error_model="numpy", inline="always")
def series(z: float) -> float:
    """1 - exp(-z) by the series of z / (1 - exp(-z)), right to 1e-12 up to 0.2."""
    square = z * z
    return z / (1.0 + 0.5 * z + square * (TWELFTH - square * (TWELFTH / 60.0 - square * (TWELFTH / 2520.0))))


@njit(cache=True, nogil=True, error_model="numpy")
def gain(z: float) -> float:
    """1 - exp(-z): by its series where z is small, which is faster."""
    return -np.expm1(-z) if z >= 0.2 else series(z)


@njit(cache=True, error_model="numpy")
def _prepared(lags: Array, rotors: int, step: float, hover: float, measured: bool) -> Array:
    """The array at the start, of lags (n, 3), the last one in the lanes beyond them."""
    s = np.zeros(ROWS)
    for lane in range(LANES):
        up, down, slope = lags[min(lane // rotors, len(lags) - 1)]
        s[UP + lane], s[DOWN + lane] = step / max(up, NEARLY_INSTANT_S), step / max(down, NEARLY_INSTANT_S)
        s[STILL + lane], s[MORE + lane] = 1.0 - slope, slope / hover
        passes = up <= NEARLY_INSTANT_S and down <= NEARLY_INSTANT_S
        held = passes and not measured
        s[PASSES + lane] = 1.0 if passes else 0.0
        s[BEFORE + lane], s[NOW + lane] = (1.0, 0.0) if held else (0.5, 0.5)
    return s


@njit(cache=True, error_model="numpy")
def _paced(s: Array) -> None:
    """Gains of the lags at the commands of now, where they are small."""
    for n in range(LANES):
        pace = max(s[STILL + n] + s[MORE + n] * s[INPUT + n], SLOWEST)
        s[RISING + n], s[FALLING + n] = series(pace * s[UP + n]), series(pace * s[DOWN + n])


@njit(cache=True, error_model="numpy")
def _paced_fast(s: Array, lanes: int) -> None:
    """The same of some lanes where some are large."""
    for n in range(lanes):
        pace = max(s[STILL + n] + s[MORE + n] * s[INPUT + n], SLOWEST)
        s[RISING + n], s[FALLING + n] = gain(pace * s[UP + n]), gain(pace * s[DOWN + n])


@njit(cache=True, error_model="numpy")
def _turned(s: Array, c0: float, c1: float, c2: float, counts: float) -> None:
    """Thrusts now, their running sums, and lagged values a step later; ``counts`` is zero at the grid's first point."""
    for n in range(LANES):
        u, held, rise, fall = s[INPUT + n], s[LAGGED + n], s[RISING + n], s[FALLING + n]
        x = u if s[PASSES + n] > 0.0 else held
        thrust = c0 + c1 * x + c2 * (x * x)
        s[SUM + n] += counts * (s[BEFORE + n] * s[THRUST + n] + s[NOW + n] * thrust)
        s[THRUST + n] = thrust
        error = u - x
        s[LAGGED + n] = x + (rise if error > 0.0 else fall) * error


@njit(cache=True, error_model="numpy")
def _keep(s: Array, row: Array) -> None:
    """Thrusts and running sums into a row of the chunk."""
    for n in range(len(row)):
        row[n] = s[THRUST + n]


@njit(cache=True, error_model="numpy")
def _averaged(chunk: tuple[Array, int, int], lanes: Index, clock: Clock, members: Index, at: int, out: Array) -> int:
    """Gather the samples that lie within the grid's steps of the chunk; how many are done then.

    Args:
        chunk: thrusts and sums of steps, (steps, 2 * LANES), the first of them and the one after the last.
        lanes: the first that counts, and how many do.
        at: samples done before.
        out: (blocks, 2, lanes), to add to.
    """
    (kept, first, last), (t, late, start, step, length) = chunk, clock
    size = members.shape[1]
    block = at // size
    member = at - block * size
    while block < len(members):
        position = min(max((t[members[block, member]] - late - start) / step, 0.0), length - 1.000001)
        i = int(position)
        if i + 1 >= last:
            break
        weight = position - i
        before = 1.0 - weight
        for row in range(2):
            place = row * LANES + lanes[0]
            now, later = kept[i - first, place : place + lanes[1]], kept[i + 1 - first, place : place + lanes[1]]
            mean = out[block, row]
            for n in range(len(now)):
                mean[n] += now[n] * before + later[n] * weight
        member += 1
        if member == size:
            block, member = block + 1, 0
    return block * size + member


@njit(cache=True, nogil=True, error_model="numpy")
def block_means(
    value: Array,
    grid: tuple[float, float, float, bool],
    lags: Array,
    delays: tuple[Array, Index],
    curve: Array,
    blocks: tuple[Array, Index],
) -> Array:
    """Means over blocks of rotors' thrusts and of their running integrals: one dead time after the other, (blocks, 2,
    its lanes) of each, in one array.

    Rotors of the first lag come first.

    Args:
        value: motor values on the grid, held over a step, (k, rotors).
        grid: its start and step, the value that hovers, and whether values were measured.
        lags: lag up, lag down and slope of each, (n, 3), n at most LANES // rotors.
        delays: dead times, (delays,), and of each the first lane that counts, and how many do, (delays, 2).
        curve: thrust by powers of a motor value, (3,).
        blocks: stamps of the samples (k,), and the samples of each block, (blocks, size).
    """
    (delays_s, lanes), (t_s, members) = delays, blocks
    start, step, hover, measured = grid
    length, rotors = value.shape
    s = _prepared(lags, rotors, step, hover, measured)
    most = 1.0 + np.max(np.abs(lags[:, 2])) * (1.0 + np.max(np.abs(value)) / hover)
    small = most * max(np.max(s[UP : UP + LANES]), np.max(s[DOWN : DOWN + LANES])) < 0.2
    sloped = np.any(lags[:, 2] != 0.0)
    kept = np.zeros((CHUNK + 1, 2 * LANES))
    ends = 2 * len(members) * np.cumsum(lanes[:, 1])
    out = np.zeros(ends[-1])
    done = np.zeros(len(delays_s), dtype=np.int64)
    for begin in range(0, length, CHUNK):
        end = min(begin + CHUNK, length)
        if begin > 0:  # the last row of the chunk before is the first of this one
            kept[0] = kept[CHUNK]
        for i in range(begin, end):
            changed = i == 0
            for j in range(rotors):
                changed |= value[i, j] != value[i - 1, j]
            if changed:
                for lane in range(0, len(lags) * rotors, rotors):
                    for j in range(rotors):
                        s[INPUT + lane + j] = value[i, j]
                if sloped or i == 0:
                    if small:
                        _paced(s)
                    else:
                        _paced_fast(s, len(lags) * rotors)
            if i == 0:
                s[LAGGED : LAGGED + LANES] = s[INPUT : INPUT + LANES]
            _turned(s, curve[0], curve[1], curve[2], 0.0 if i == 0 else 1.0)
            _keep(s, kept[i - begin + 1])
        for n in range(len(delays_s)):
            clock = (t_s, delays_s[n], start, step, float(length))
            means = _means_of(out, ends[n], len(members), lanes[n, 1])
            done[n] = _averaged((kept, begin - 1, end), lanes[n], clock, members, done[n], means)
    for n in range(len(delays_s)):
        _means_of(out, ends[n], len(members), lanes[n, 1])[:, 1] *= step
    out /= members.shape[1]
    return out


@njit(cache=True, error_model="numpy", inline="always")
def _means_of(out: Array, end: int, blocks: int, lanes: int) -> Array:
    """Of one dead time, (blocks, 2, lanes): a view."""
    return out[end - 2 * blocks * lanes : end].reshape(blocks, 2, lanes)
