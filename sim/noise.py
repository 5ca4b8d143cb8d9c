"""When sensors sample, when samples arrive, and the noise on them: drawn in sequence, the same however time is cut."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sim.scenario import Clock

Array = NDArray[np.float64]


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
        draws = self.random.standard_normal((len(true_s), 2))
        stamps = true_s * (1.0 + 1e-6 * clock.drift_ppm) + clock.offset_s + clock.jitter_s * draws[:, 0]
        late = -np.log1p(-_uniform(draws[:, 1])) * clock.latency_jitter_s
        arrival = true_s + clock.latency_s + late
        if len(arrival):
            arrival[0] = max(arrival[0], self._last_arrival)
            arrival = np.maximum.accumulate(arrival)
            self._last_arrival = arrival[-1]
        return stamps, arrival


@dataclass
class Ticker:
    """Sampling instants of a device that samples every 1/rate of its *own* seconds: a fast clock samples faster.

    Attributes:
        clock: see :class:`sim.scenario.Clock`.
        rate_hz: samples per device second.
        random: the device's own generator.
    """

    clock: Clock
    rate_hz: float
    random: np.random.Generator
    _next: int = 0
    _phase: float = field(init=False)
    _stamper: Stamper = field(init=False)

    def __post_init__(self) -> None:
        phase = self.random.uniform() if self.clock.phase is None else self.clock.phase
        self._phase = phase / self.rate_hz
        self._stamper = Stamper(self.clock, self.random)

    @property
    def _period(self) -> float:
        return 1.0 / (self.rate_hz * (1.0 + 1e-6 * self.clock.drift_ppm))

    def count_until(self, end_s: float) -> int:
        """How many samples before ``end_s`` have not been given yet."""
        # A hair of tolerance keeps instants on the step grid in the stretch they belong to.
        return max(math.ceil((end_s - self._phase) / self._period - 1e-6) - self._next, 0)

    def until(self, end_s: float) -> tuple[Array, Array, Array]:
        """True times before ``end_s`` not given yet, the device's stamps of them, and arrivals at the host."""
        last = self._next + self.count_until(end_s)
        true = self._phase + self._period * np.arange(self._next, last, dtype=float)
        self._next = last
        return true, *self._stamper.stamp(true)


def _uniform(normal: Array) -> Array:
    """Uniform numbers in (0, 1) from standard normal ones, by a logistic approximation to the normal distribution."""
    return np.clip(1.0 / (1.0 + np.exp(-1.702 * normal)), 0.0, 1.0 - 1e-12)


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

    def draw(self, counts: Sequence[int]) -> Array:
        """The next rows, as many as the pieces have together.

        The bias is summed up piece by piece, so that its last bits do not depend on how many pieces are drawn at once.
        """
        normal = self.random.standard_normal((sum(counts), 2, len(self.white)))
        white, bias = normal[:, 0], normal[:, 1]
        white *= self.white
        bias *= self.walk
        begin = 0
        for count in counts:
            if count:
                piece = bias[begin : begin + count]
                np.cumsum(piece, axis=0, out=piece)
                piece += self._bias
                self._bias = piece[-1].copy()
            begin += count
        return bias + white


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
