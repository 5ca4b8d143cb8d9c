"""When sensors sample, when samples arrive, and the noise on them: drawn in sequence, the same however time is cut.

Normal numbers are drawn in compiled code: numba takes NumPy's generators, gives the same numbers, and takes a third of
the time. The exponential and the logarithm stay NumPy's, whose last bits are not those of the C library.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sim.compiled import compiled
from sim.scenario import Clock

Array = NDArray[np.float64]


@compiled
def _draw(random, flat) -> None:
    for i in range(len(flat)):
        flat[i] = random.standard_normal()


def normal(random: np.random.Generator, shape: tuple[int, int]) -> Array:
    """Standard normal numbers, those that ``random.standard_normal(shape)`` gives."""
    out = np.empty(shape)
    _draw(random, out.reshape(-1))
    return out


@compiled
def _add_where_positive(random, std: float, values, out) -> None:
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            noise = std * random.standard_normal()
            out[i, j] = values[i, j] + noise if values[i, j] > 0.0 else 0.0


def noisy_speeds(random: np.random.Generator, std: float, values: Array) -> Array:
    """Measured rotor speeds: with noise where the rotor turns, else zero; shape (k, n)."""
    out = np.empty(values.shape)
    _add_where_positive(random, std, values, out)
    return out


@compiled
def _draw_stamps(random, true_s, rate: float, offset_s: float, jitter_s: float, stamps, late) -> None:
    """Stamps, and ``late`` with the argument of the logistic function that lateness is drawn by."""
    for i in range(len(true_s)):
        stamps[i] = true_s[i] * rate + offset_s + jitter_s * random.standard_normal()
        late[i] = -1.702 * random.standard_normal()


@compiled
def _negative_uniform(late) -> None:
    """Exponentials of the logistic function's argument become numbers in (-1, 0), in place."""
    for i in range(len(late)):
        late[i] = -min(1.0 / (1.0 + late[i]), 1.0 - 1e-12)


@compiled
def _arrive(true_s, latency_s: float, jitter_s: float, late, latest: float) -> float:
    """Logarithms of uniform numbers become arrivals, in place; none before ``latest``, or before an earlier one."""
    for i in range(len(late)):
        latest = max(latest, true_s[i] + latency_s + -late[i] * jitter_s)
        late[i] = latest
    return latest


@dataclass
class Stamper:
    """A device's clock and link: stamps and arrivals of samples taken at true times.

    Attributes:
        clock: offset, drift, jitter, latency.
        random: the device's own generator.
    """

    clock: Clock
    random: np.random.Generator
    _last_arrival: float = -np.inf

    def stamp(self, true_s: Array) -> tuple[Array, Array]:
        """Stamps on the device's clock, and arrivals at the host, which never overtake each other."""
        clock = self.clock
        stamps, late = np.empty(len(true_s)), np.empty(len(true_s))
        if len(true_s):
            rate = 1.0 + 1e-6 * clock.drift_ppm
            _draw_stamps(self.random, true_s, rate, clock.offset_s, clock.jitter_s, stamps, late)
            if clock.latency_jitter_s > 0.0:
                # A uniform number from a normal one, by a logistic approximation to the normal distribution.
                np.exp(late, out=late)
                _negative_uniform(late)
                np.log1p(late, out=late)
            else:
                late.fill(0.0)
            self._last_arrival = _arrive(true_s, clock.latency_s, clock.latency_jitter_s, late, self._last_arrival)
        return stamps, late


@dataclass
class Ticker:
    """Sampling instants of a device that samples every 1/rate of its *own* seconds: a fast clock samples faster.

    Attributes:
        clock: see :class:`sim.scenario.Clock`.
        rate_hz: samples per device second.
        random: the device's own generator.
        stamper: of its samples.
    """

    clock: Clock
    rate_hz: float
    random: np.random.Generator
    _next: int = 0
    _phase: float = field(init=False)
    stamper: Stamper = field(init=False)

    def __post_init__(self) -> None:
        phase = self.random.uniform() if self.clock.phase is None else self.clock.phase
        self._phase = phase / self.rate_hz
        self.stamper = Stamper(self.clock, self.random)

    @property
    def _period(self) -> float:
        return 1.0 / (self.rate_hz * (1.0 + 1e-6 * self.clock.drift_ppm))

    def counts_until(self, ends_s: Array) -> NDArray[np.int64]:
        """How many samples before each time have not been given yet."""
        # A hair of tolerance keeps instants on the step grid in the stretch they belong to.
        number = np.ceil((ends_s - self._phase) / self._period - 1e-6).astype(np.int64)
        return np.maximum(number - self._next, 0)

    def until(self, end_s: float) -> tuple[Array, Array, Array]:
        """True times before ``end_s`` not given yet, the device's stamps of them, and arrivals at the host."""
        last = self._next + int(self.counts_until(np.array([end_s]))[0])
        true = self._phase + self._period * np.arange(self._next, last, dtype=float)
        self._next = last
        return true, *self.stamper.stamp(true)


@compiled
def _draw_biased(random, counts, white, walk, bias, out) -> None:
    """Rows of white noise on a bias that walks; the walk is summed up piece by piece."""
    walked, row = np.empty(len(bias)), 0
    for count in counts:
        walked.fill(0.0)
        for _ in range(count):
            for j in range(len(bias)):
                out[row, j] = white[j] * random.standard_normal()
            for j in range(len(bias)):
                walked[j] += walk[j] * random.standard_normal()
                out[row, j] += walked[j] + bias[j]
            row += 1
        for j in range(len(bias)):
            bias[j] += walked[j]


@dataclass
class BiasedNoise:
    """White noise on a random-walk bias with a drawn start; one row per sample.

    Attributes:
        white: standard deviation per column.
        start: standard deviation of the bias at the start per column.
        walk: standard deviation of the bias' step per sample and column.
        random: generator.
    """

    white: Array
    start: Array
    walk: Array
    random: np.random.Generator
    _bias: Array = field(init=False)

    def __post_init__(self) -> None:
        self._bias = self.start * self.random.standard_normal(len(self.start))

    def draw(self, counts: Sequence[int] | NDArray[np.int64]) -> Array:
        """The next rows, as many as the pieces have together.

        The bias is summed up piece by piece, so that its last bits do not depend on how many pieces are drawn at once.
        """
        out, self._bias = np.empty((sum(counts), len(self.white))), self._bias.copy()
        _draw_biased(self.random, np.array(counts, dtype=np.int64), self.white, self.walk, self._bias, out)
        return out


@dataclass
class Outages:
    """Random intervals (Poisson starts, exponential lengths) during which a device is out.

    Attributes:
        per_minute: mean number of starts.
        mean_s: mean length.
        random: generator.
    """

    per_minute: float
    mean_s: float
    random: np.random.Generator
    _start: float = field(init=False)
    _end: float = field(init=False)

    def __post_init__(self) -> None:
        self._start = self._end = 0.0
        self._draw()

    def _draw(self) -> None:
        gap, length = self.random.exponential(size=2)
        self._start = self._end + gap * 60.0 / self.per_minute if self.per_minute > 0.0 else np.inf
        self._end = self._start + length * self.mean_s

    def during(self, times_s: Array) -> NDArray[np.bool_]:
        """Which of the (increasing) times lie in an outage."""
        out = np.zeros(len(times_s), dtype=bool)
        done = 0
        while done < len(times_s):
            while times_s[done] >= self._end:
                self._draw()
            here = slice(done, int(np.searchsorted(times_s, self._end)))
            out[here] = times_s[here] >= self._start
            done = here.stop
        return out
