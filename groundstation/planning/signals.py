"""Excitations beside the optimised series: multisines, sweeps, and multisines of attitude around hover.

All are finite Fourier series of the flat outputs, rest at both ends, and are sized to the same limits, so that they can
be flown and judged like any plan. Near hover, roll and pitch are accelerations over gravity: a multisine of attitude is
one of acceleration, at frequencies where positions hardly move.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.planning.limits import excesses
from groundstation.planning.optimiser import inner_motion, repair
from groundstation.planning.problem import Problem
from groundstation.trajectory import FlatState, FourierSeries, rigid_motion

Array = NDArray[np.float64]

ATTITUDE_BAND_HZ = (0.5, 3.0)
"""Multisines of attitude: from where the position loop ends to where an attitude loop usually does."""


@dataclass(frozen=True, slots=True)
class Family:
    """A kind of excitation: its name, what a pilot should know about it, and its band in hertz."""

    name: str
    text: str
    band_hz: tuple[float, float]


def families(frequency_max_hz: float) -> tuple[Family, ...]:
    """The families, those of position up to a highest frequency."""
    slow = (0.2 * frequency_max_hz, frequency_max_hz)
    return (
        Family("multisine", "orthogonal multisines, phases for low peaks", slow),
        Family("sweep", "logarithmic frequency sweeps, one channel after the other", slow),
        Family("attitude", "multisines of attitude; needs a vehicle that takes attitude setpoints", ATTITUDE_BAND_HZ),
    )


def family_series(family: Family, problem: Problem) -> FourierSeries:
    """One period of a family's excitation, as large as the problem's limits allow.

    Args:
        family: which.
        problem: vehicle, limits, duration and start; criterion, harmonics and base frequency are not used. A start on
            the edge of the room is replaced by the room's middle, since these signals move to both sides.

    Raises:
        BadInput: the duration is too short for the family's band.
    """
    sweep = family.name == "sweep"
    count = 1 if sweep else max(round(problem.duration_s / 20.0), 1)
    base = 2.0 * np.pi * count / problem.duration_s
    low, high = (2.0 * np.pi * edge / base for edge in family.band_hz)
    lowest, highest = max(int(np.ceil(low - 1e-9)), 1), int(np.floor(high + 1e-9))
    if highest - lowest < 11:
        needed = problem.duration_s * 12.0 / max(highest - lowest + 1, 1)
        raise BadInput(
            f"{problem.duration_s:g} s are too short for a {family.name} from {family.band_hz[0]:g} to "
            f"{family.band_hz[1]:g} Hz; fly it for about {needed:.0f} s or leave it out."
        )
    task = replace(problem, base_frequency_rad_s=base, harmonics=highest, start=roomy_start(problem))
    waves = _sweeps(task, lowest) if sweep else _multisines(lowest, highest)
    return fill(waves, task)


def roomy_start(problem: Problem) -> tuple[float, float, float, float]:
    """The problem's start where it has room to all sides, else the middle of the room."""
    middle = [0.0, 0.0, 1.0, 0.0]
    low, high = problem.room[2]
    if np.isfinite(low) or np.isfinite(high):
        middle[2] = float(np.mean([edge for edge in (low, high) if np.isfinite(edge)]))
    start = problem.start or middle
    free = all(a < at < b for at, (a, b) in zip(start, problem.room, strict=True))
    x, y, z, yaw = start if free else middle
    return (x, y, z, yaw)


def _multisines(lowest: int, highest: int) -> Array:
    """[a, b] of four channels with flat acceleration (rate for yaw) on interleaved harmonics, shape (4, 2, highest).

    No two channels share a harmonic, so that their regressors are orthogonal over a period (Morelli 2003). Phases start
    as Schroeder's and are improved by clipping (van der Ouderaa, Schoukens and Renneboog 1988).
    """
    waves = np.zeros((4, 2, highest))
    for channel in range(4):
        used = np.arange(lowest + channel, highest + 1, 4)
        order = np.arange(1, len(used) + 1)
        phase = -np.pi * order * (order - 1) / len(used)
        flat = np.exp(1j * _low_peak_phases(used, phase))
        size = 1.0 if channel == 3 else 1.0 / used
        waves[channel, 0, used - 1] = size * np.real(flat)
        waves[channel, 1, used - 1] = -size * np.imag(flat)
        waves[channel] = resting(waves[channel], used)
    return waves


def _low_peak_phases(harmonics: NDArray[np.intp], phase: Array, rounds: int = 200) -> Array:
    """Phases of equal cosines with low peaks: clip the signal a little, keep the clipped signal's phases, repeat."""
    count = 16 * int(harmonics[-1])
    basis = np.exp(2j * np.pi * np.outer(np.arange(count), harmonics) / count)
    for share in np.linspace(0.75, 0.98, rounds):
        signal = np.real(basis @ np.exp(1j * phase))
        top = share * np.abs(signal).max()
        phase = np.angle(basis.conj().T @ np.clip(signal, -top, top))
    return phase


def resting(wave: Array, used: NDArray[np.intp]) -> Array:
    """The nearest [a, b] on the same harmonics that starts and ends at rest, shape (2, n)."""
    conditions = np.zeros((2, 2 * len(used)))
    conditions[0, : len(used)], conditions[1, len(used) :] = 1.0, used
    inside = wave[:, used - 1].ravel()
    inside = inside - np.linalg.pinv(conditions) @ (conditions @ inside)
    result = np.zeros_like(wave)
    result[:, used - 1] = inside.reshape(2, -1)
    return result


def _sweeps(problem: Problem, lowest: int) -> Array:
    """[a, b] of logarithmic sweeps of acceleration (rate for yaw) in x, y, z and yaw one after the other."""
    highest = problem.harmonics
    count = 32 * highest
    time = np.arange(count) / count
    waves = np.zeros((4, 2, highest))
    used = np.arange(lowest, highest + 1)
    ratio = highest / lowest
    for channel in range(4):
        local = np.clip(4.0 * time - channel, 0.0, 1.0)
        turns = lowest / 4.0 * (ratio**local - 1.0) / np.log(ratio)
        taper = np.sin(np.pi * np.clip(np.minimum(local, 1.0 - local) / 0.1, 0.0, 1.0) / 2.0) ** 2
        spectrum = 2.0 * np.fft.rfft(taper * np.sin(2.0 * np.pi * turns))[used] / count
        # Rate is Re(sum (a - i b) e^{ilt}); acceleration is its derivative.
        rate = np.asarray(spectrum if channel == 3 else spectrum / (1j * used), dtype=np.complex128)
        waves[channel, 0, used - 1], waves[channel, 1, used - 1] = rate.real, -rate.imag
        waves[channel] = resting(waves[channel], used)
    return waves


def fill(waves: Array, problem: Problem) -> FourierSeries:
    """Each channel as large as its limits allow by itself, then all together drawn in until every limit is kept."""
    start = np.array(problem.start)
    inner = inner_motion(problem, start)
    grid = np.arange(24 * problem.harmonics) * (2.0 * np.pi / (24 * problem.harmonics * problem.base_frequency_rad_s))

    def at(sizes: Array) -> FourierSeries:
        a, b = (sizes[:, None] * waves[:, k] for k in range(2))
        harmonic = problem.base_frequency_rad_s * np.arange(1, problem.harmonics + 1)
        return FourierSeries(a, b, start + (b / harmonic).sum(axis=1), problem.base_frequency_rad_s)

    unit = at(np.ones(4)).derivatives(grid, 4)
    unit[0] -= start

    def kept(sizes: Array) -> bool:
        d = unit * sizes
        d[0] += start
        flat = FlatState(d[:, :, :3], d[:3, :, 3])
        return all(max(excesses(rigid_motion(flat, e.gravity_m_s2), e).values()) <= 0.0 for e in problem.envelopes)

    sizes = np.zeros(4)
    for channel in range(4):
        only = np.eye(4)[channel]
        low, high = 0.0, 1e-3
        while high < 1e3 and kept(high * only):
            low, high = high, 2.0 * high
        for _ in range(12):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if kept(middle * only) else (low, middle)
        sizes[channel] = low
    factor = 1.0
    while not kept(factor * sizes):
        factor *= 0.97
    return repair(at(factor * sizes), problem, inner, step=1e-3)
