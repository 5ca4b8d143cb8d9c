r"""The next flight when two explanations of the last one are left: the motion that tells them apart best.

Each candidate predicts the wrench that a motion takes. Under the first, the second is wrong by :math:`\delta(t)`; part
of that its free parameters absorb. What is left, weighed by the disturbance and sensor noise every flight has, is the
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
from groundstation.json_types import JsonObject
from groundstation.planning.information import CHANNELS, DEFAULT_NOISE, Noise
from groundstation.planning.limits import envelope
from groundstation.planning.plan import FREQUENCY_MAX_HZ, describe
from groundstation.planning.problem import Problem
from groundstation.planning.signals import fill, resting, roomy_start
from groundstation.tabular import Record, Tabular
from groundstation.trajectory import FourierSeries, Plan, RigidMotion, plan_to_dict, rigid_motion
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Candidate:
    """A model in contention, as functions of the instants t (k,) of a flight and the motion at them.

    Attributes:
        name: of the effect.
        wrench: body forces and torques it predicts beyond what all candidates share, shape (k, 6), at its fitted size;
            None where its size is unknown, which leaves it a rival only.
        explanations: what it can predict at any size, as pairs of an offset (k, 6) and columns (k, 6, p) for what is
            fitted anew on the next flight, the base parameters that all candidates fit among them; one pair for each of
            its settings.
    """

    name: str
    wrench: Callable[[Array, RigidMotion], Array] | None
    explanations: Callable[[Array, RigidMotion], Sequence[tuple[Array, Array]]]


@dataclass(frozen=True, slots=True)
class Separation(Tabular):
    """What the chosen flight should settle.

    Attributes:
        plan: to be flown.
        log_odds: expected natural log odds for each pair of candidates, by the worse of both ways round.
        channels: share of the separation that lives in each channel, for the hardest pair.
    """

    plan: Plan
    log_odds: dict[tuple[str, str], float]
    channels: dict[str, float]

    def to_dict(self) -> JsonObject:
        """The plan, the expected log odds of each pair, and the channels that tell the hardest pair apart."""
        odds = [{"pair": list(pair), "log_odds": value} for pair, value in self.log_odds.items()]
        return {**plan_to_dict(self.plan), "expected_log_odds": odds, "channels": dict(self.channels)}

    def records(self) -> list[Record]:
        """One row per pair of explanations."""
        return [{"pair": " or ".join(pair), "log_odds": value} for pair, value in self.log_odds.items()]

    @property
    def probability(self) -> float:
        """Expected posterior share of the true candidate against the hardest rival, from even odds."""
        return 1.0 / (1.0 + math.exp(-min(min(self.log_odds.values()), 700.0)))


@dataclass(frozen=True, slots=True)
class _Seen:
    """A candidate along one flight, weighed by the noise: rows are real and imaginary Fourier coefficients, (2 h, 6,
    ...).
    """

    wrench: Array | None
    explanations: tuple[tuple[Array, Array], ...]


def _whitened(values: Array, vehicle: Vehicle, noise: Noise, duration_s: float) -> Array:
    """Weighted Fourier coefficients of samples over a flight, real and imaginary, shape (2 h, 6, ...)."""
    coefficients = np.fft.rfft(values, axis=0) / len(values)
    harmonic = np.arange(len(coefficients))
    power = duration_s * np.where(harmonic == 0, 1.0, 2.0)
    power = power / noise.spectra(vehicle, harmonic * (2.0 * math.pi / duration_s))
    weighted = coefficients * np.sqrt(power.T).reshape(len(harmonic), 6, *[1] * (values.ndim - 2))
    return np.concatenate([weighted.real, weighted.imag])


def _seen(candidate: Candidate, series: FourierSeries, vehicle: Vehicle, noise: Noise) -> _Seen:
    """Everything a candidate predicts of a flight; the whole of it is sampled, for an effect may depend on time."""
    count = round(series.periods) * max(64, 16 * series.a.shape[1])
    t = np.asarray(np.arange(count) * (series.duration_s / count), dtype=float)
    motion = rigid_motion(series.sample(t), vehicle.gravity_m_s2)

    def white(values: Array) -> Array:
        return _whitened(values, vehicle, noise, series.duration_s)

    wrench = None if candidate.wrench is None else white(candidate.wrench(t, motion))
    pairs = tuple((white(offset), white(columns)) for offset, columns in candidate.explanations(t, motion))
    return _Seen(wrench, pairs)


def _odds(truth: _Seen, rival: _Seen) -> tuple[float, Array]:
    """Expected log odds for ``truth`` against the rival's best explanation, and the share of each channel."""
    if truth.wrench is None:
        return math.inf, np.zeros(6)
    found: list[Array] = []
    for offset, columns in rival.explanations:
        difference = truth.wrench - offset
        flat = columns.reshape(-1, columns.shape[-1])
        size: Array = np.maximum(np.linalg.norm(flat, axis=0), 1e-300)
        flat = flat / size
        fitted = np.linalg.pinv(flat.T @ flat, rcond=1e-10, hermitian=True) @ (flat.T @ difference.ravel())
        rest = difference - (flat @ fitted).reshape(difference.shape)
        found.append(0.5 * np.sum(rest**2, axis=0))
    least = min(found, key=np.sum)
    return float(least.sum()), least


def separation(
    truth: Candidate,
    rival: Candidate,
    series: FourierSeries,
    vehicle: Vehicle,
    noise: Noise = DEFAULT_NOISE,
) -> tuple[float, Array]:
    """Expected log odds for the true candidate after the flight, and how much of them each channel gives, shape (6,).

    Args:
        truth: the candidate that holds; infinite odds where its size is unknown.
        rival: the one fitted to its data, at the best of its settings.
        series: the excitation, all its (whole) periods.
        vehicle: nominal vehicle.
        noise: what disturbs the flight.
    """
    return _odds(_seen(truth, series, vehicle, noise), _seen(rival, series, vehicle, noise))


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
    one = Problem((vehicle,), (bounds,), "A", harmonics, 1.0, duration_s, start, noise)
    search = _Search(tuple(candidates), _tasks(one, periods, frequency_max_hz), np.random.default_rng(seed))
    for trial in range(trials):
        search.step(trial, exploring=trial < trials // 2)
        progress((trial + 1) / trials, f"expected log odds {search.odds:.3g}")
    best = search.best
    if best is None or search.odds < 1e-6:
        names = " and ".join(candidate.name for candidate in candidates)
        raise Refused(
            f"no motion within these limits tells {names} apart.",
            "Widen the limits, above all tilt and speed, or measure what distinguishes them directly.",
        )
    found = _pairs(candidates, best, vehicle, noise)
    hardest = min(found, key=lambda pair: found[pair][0])
    total, channels = found[hardest]
    plan = describe(best, replace(one, criterion="T"), note=f"tells {' from '.join(hardest)}")
    shares: dict[str, float] = dict(zip(CHANNELS, (channels / max(total, 1e-300)).tolist(), strict=True))
    return Separation(plan, {pair: odds for pair, (odds, _) in found.items()}, shares)


def _tasks(one: Problem, periods: Sequence[int], frequency_max_hz: float) -> tuple[Problem, ...]:
    """The problem at each number of periods whose harmonics stay below the highest frequency."""
    highest = frequency_max_hz * (1 + 1e-9)
    fitting = [k for k in periods if k * one.harmonics / one.duration_s <= highest] or [min(periods)]
    tasks = [replace(one, base_frequency_rad_s=2.0 * math.pi * k / one.duration_s) for k in fitting]
    return tuple(replace(task, start=roomy_start(task)) for task in tasks)


@dataclass(slots=True)
class _Search:
    """(1+1) evolution strategy: random motions, then steps about the best one whose reach follows their success."""

    candidates: tuple[Candidate, ...]
    tasks: tuple[Problem, ...]
    rng: np.random.Generator
    best: FourierSeries | None = None
    odds: float = -math.inf
    reach: float = 0.5
    _task: Problem | None = None
    _waves: Array | None = None

    def step(self, trial: int, *, exploring: bool) -> None:
        """Try one motion; keep it if its hardest pair is told apart better."""
        task = self.tasks[trial % len(self.tasks)] if exploring else (self._task or self.tasks[0])
        waves = self._drawn(task.harmonics, exploring)
        series = fill(waves, task)
        series = replace(series, periods=float(round(task.duration_s / series.period_s)))
        odds = min(each for each, _ in _pairs(self.candidates, series, task.vehicles[0], task.noise).values())
        if odds > self.odds:
            size = np.hypot(series.a, series.b).max(axis=1)
            size = size / np.maximum(np.hypot(*waves.swapaxes(0, 1)).max(axis=1), 1e-12)
            self.best, self._waves, self._task, self.odds = series, waves * size[:, None, None], task, odds
            self.reach *= 1.0 if exploring else 1.5
        elif not exploring:
            self.reach *= 1.5**-0.25

    def _drawn(self, harmonics: int, exploring: bool) -> Array:
        """Sines and cosines of each channel, at rest at both ends, shape (4, 2, harmonics)."""
        used = np.arange(1, harmonics + 1)
        waves = self.rng.normal(size=(4, 2, harmonics)) / used
        if not exploring:
            about = np.zeros((4, 2, harmonics)) if self._waves is None else self._waves
            waves = about + self.reach * np.sqrt(np.mean(about**2)) * waves
        return np.stack([resting(wave, used) for wave in waves])


def _pairs(
    candidates: Sequence[Candidate], series: FourierSeries, vehicle: Vehicle, noise: Noise
) -> dict[tuple[str, str], tuple[float, Array]]:
    """For each pair the log odds by the worse of both ways round, and what each channel gives of them."""
    seen = [_seen(candidate, series, vehicle, noise) for candidate in candidates]
    return {
        (one.name, candidates[j].name): min(_odds(seen[i], seen[j]), _odds(seen[j], seen[i]), key=lambda way: way[0])
        for i, one in enumerate(candidates)
        for j in range(i + 1, len(candidates))
    }
