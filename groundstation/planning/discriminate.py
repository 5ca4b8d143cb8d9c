r"""The next flight when two explanations of the last one are left: the motion that tells them apart best.

Each candidate predicts the wrench that a motion takes. Under the first, the second is wrong by :math:`\delta(t)`; part of
that its free parameters absorb. What is left, weighed by the disturbance and sensor noise every flight has, is the
T-optimality of Atkinson and Fedorov (1975),

.. math:: \Delta = \min_\theta T \sum_r \sum_k |\delta_{r,k} - \Phi_{r,k}\theta|^2 / S_r(k\,\omega_f),

and the expected log odds in favour of the true one are :math:`\Delta/2` (Gaussian noise).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import Refused
from groundstation.planning.information import CHANNELS, DEFAULT_NOISE, Noise
from groundstation.planning.limits import envelope
from groundstation.planning.plan import FREQUENCY_MAX_HZ, describe
from groundstation.planning.problem import Problem
from groundstation.planning.signals import fill, resting, roomy_start
from groundstation.trajectory import FourierSeries, Plan, RigidMotion, rigid_motion
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Candidate:
    """A model in contention, as numbers along a motion of a period.

    Attributes:
        name: of the effect.
        wrench: body forces and torques it predicts beyond what all candidates share, shape (k, 6), at its fitted size.
        regressors: how the wrench depends on what is fitted anew on the next flight, shape (k, 6, p); the base parameters
            that all candidates fit belong here too.
    """

    name: str
    wrench: Callable[[RigidMotion], Array]
    regressors: Callable[[RigidMotion], Array]


@dataclass(frozen=True, slots=True)
class Separation:
    """What the chosen flight should settle.

    Attributes:
        plan: to be flown.
        log_odds: expected natural log odds for each pair of candidates, by the worse of both ways round.
        channels: share of the separation that lives in each channel, for the hardest pair.
    """

    plan: Plan
    log_odds: dict[tuple[str, str], float]
    channels: dict[str, float]

    @property
    def probability(self) -> float:
        """Expected posterior share of the true candidate against the hardest rival, from even odds."""
        return 1.0 / (1.0 + math.exp(-min(min(self.log_odds.values()), 700.0)))


def _whitened(values: Array, vehicle: Vehicle, noise: Noise, base_frequency_rad_s: float, duration_s: float) -> Array:
    """Weighted Fourier coefficients of samples over a period, real and imaginary, shape (2 h, 6, ...)."""
    coefficients = np.fft.rfft(values, axis=0) / len(values)
    harmonic = np.arange(len(coefficients))
    power = duration_s * np.where(harmonic == 0, 1.0, 2.0) / noise.spectra(vehicle, harmonic * base_frequency_rad_s)
    weighted = coefficients * np.sqrt(power.T).reshape(len(harmonic), 6, *[1] * (values.ndim - 2))
    return np.concatenate([weighted.real, weighted.imag])


def separation(
    truth: Candidate,
    rival: Candidate,
    series: FourierSeries,
    vehicle: Vehicle,
    noise: Noise = DEFAULT_NOISE,
) -> tuple[float, Array]:
    """Expected log odds for the true candidate after the flight, and how much of them each channel gives, shape (6,).

    Args:
        truth: the candidate that holds.
        rival: the one fitted to its data.
        series: the excitation, all its periods.
        vehicle: nominal vehicle.
        noise: what disturbs the flight.
    """
    count = max(128, 32 * series.a.shape[1])
    t = np.arange(count) * (series.period_s / count)
    motion = rigid_motion(series.sample(t), vehicle.gravity_m_s2)
    timing = series.base_frequency_rad_s, series.duration_s
    difference = _whitened(truth.wrench(motion) - rival.wrench(motion), vehicle, noise, *timing)
    columns = _whitened(rival.regressors(motion), vehicle, noise, *timing)
    flat = columns.reshape(-1, columns.shape[-1])
    flat = flat / np.maximum(np.linalg.norm(flat, axis=0), 1e-300)
    fitted = np.linalg.lstsq(flat, difference.ravel(), rcond=1e-10)[0]
    rest = (difference.ravel() - flat @ fitted).reshape(difference.shape)
    by_channel = 0.5 * np.sum(rest**2, axis=0)
    return float(by_channel.sum()), by_channel


def plan_discrimination(
    vehicle: Vehicle,
    candidates: Sequence[Candidate],
    *,
    harmonics: int = 5,
    periods: Sequence[int] = (2, 4, 8),
    duration_s: float = 40.0,
    frequency_max_hz: float = FREQUENCY_MAX_HZ,
    start: tuple[float, float, float, float] | None = None,
    noise: Noise = DEFAULT_NOISE,
    trials: int = 60,
    seed: int = 3,
    progress: Callable[[float, str], None] = lambda fraction, text: None,
    **limits: float,
) -> Separation:
    """The motion, within the vehicle's limits, whose hardest pair of candidates is told apart best.

    The candidates are functions, so the search takes no derivatives: random motions that keep every limit, the best of
    them improved by random steps that shrink when they fail ((1+1) evolution strategy, Rechenberg's fifth rule).

    Args:
        vehicle: nominal vehicle and its limits.
        candidates: two or more.
        harmonics: of the series.
        periods: how many periods the flight may consist of.
        duration_s: of the flight.
        frequency_max_hz: periods that would put a harmonic above it are left out.
        start: x, y, z, yaw at both ends; None, or on the edge of the room, for its middle.
        noise: what disturbs the flight.
        trials: motions tried; half of them random, half improvements.
        seed: of the search.
        progress: called with the share of the work that is done and a line of text.
        **limits: overrides of the vehicle's.

    Raises:
        BadInput: limits exclude hovering.
        Refused: no motion within the limits tells them apart.
    """
    bounds = envelope(vehicle, limits)
    fitting = [k for k in periods if k * harmonics / duration_s <= frequency_max_hz * (1 + 1e-9)] or [min(periods)]
    rng = np.random.default_rng(seed)
    used = np.arange(1, harmonics + 1)
    tasks = [
        Problem((vehicle,), (bounds,), "A", harmonics, 2.0 * math.pi * k / duration_s, duration_s, start, noise)
        for k in fitting
    ]
    tasks = [replace(task, start=roomy_start(task)) for task in tasks]
    best, best_waves, best_task, best_odds, reach = None, np.zeros((4, 2, harmonics)), tasks[0], -math.inf, 0.5
    for trial in range(trials):
        exploring = trial < trials // 2
        task = tasks[trial % len(tasks)] if exploring else best_task
        waves = rng.normal(size=(4, 2, harmonics)) / used
        if not exploring:
            waves = best_waves + reach * np.sqrt(np.mean(best_waves**2)) * waves
        waves = np.stack([resting(wave, used) for wave in waves])
        series = fill(waves, task)
        series = replace(series, periods=float(round(duration_s / series.period_s)))
        odds = min(_pairs(candidates, series, vehicle, noise).values())
        if odds > best_odds:
            size = np.hypot(series.a, series.b).max(axis=1) / np.maximum(
                np.hypot(*waves.swapaxes(0, 1)).max(axis=1), 1e-12
            )
            best, best_waves, best_task, best_odds = series, waves * size[:, None, None], task, odds
            reach *= 1.0 if exploring else 1.5
        elif not exploring:
            reach *= 1.5**-0.25
        progress((trial + 1) / trials, f"expected log odds {best_odds:.3g}")
    if best is None or best_odds < 1e-6:
        names = " and ".join(candidate.name for candidate in candidates)
        raise Refused(
            f"no motion within these limits tells {names} apart.",
            "Widen the limits, above all tilt and speed, or measure what distinguishes them directly.",
        )
    odds = _pairs(candidates, best, vehicle, noise)
    hardest = min(odds, key=lambda pair: odds[pair])
    by_name = {candidate.name: candidate for candidate in candidates}
    total, shares = separation(by_name[hardest[0]], by_name[hardest[1]], best, vehicle, noise)
    plan = describe(best, vehicle, (bounds,), criterion="T", noise=noise, note=f"tells {' from '.join(hardest)}")
    return Separation(plan, odds, dict(zip(CHANNELS, (shares / max(total, 1e-300)).tolist(), strict=True)))


def _pairs(
    candidates: Sequence[Candidate], series: FourierSeries, vehicle: Vehicle, noise: Noise
) -> dict[tuple[str, str], float]:
    """For each pair the log odds by the worse of both ways round."""
    return {
        (one.name, other.name): min(
            separation(one, other, series, vehicle, noise)[0], separation(other, one, series, vehicle, noise)[0]
        )
        for i, one in enumerate(candidates)
        for other in candidates[i + 1 :]
    }
