"""Which part of a log is read: a stretch of its time, whole, or thinned to see where something happens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_ENDLESS = 2**62


@dataclass(frozen=True, slots=True)
class Part:
    """Records whose stamps lie within a stretch, each kind's no closer than a step.

    Attributes:
        start_s, end_s: on the log's own clock.
        step_s: least time between two records of one kind and instance; 0 keeps all.
    """

    start_s: float = -np.inf
    end_s: float = np.inf
    step_s: float = 0.0

    def ticks(self, per_s: float) -> NDArray[np.int64]:
        """Start, end and step in ticks of a clock, for compiled scans."""
        bounds = np.clip(np.array([self.start_s, self.end_s, self.step_s]) * per_s, -_ENDLESS, _ENDLESS)
        return bounds.astype(np.int64)

    def of(self, t_s: NDArray[np.float64], last: float) -> tuple[NDArray[np.bool_], float]:
        """Which of these stamps are wanted, and the last interval of a step's length that had one (from before on)."""
        mask = ~((t_s < self.start_s) | (t_s > self.end_s))  # what is no number is left to whoever repairs
        if self.step_s <= 0.0 or not len(t_s):
            return mask, last
        interval = np.floor(t_s / self.step_s)
        return mask & (np.diff(interval, prepend=last) != 0.0), float(interval[-1])

    def later(self, by_s: float) -> Part:
        """The same on a clock that is ahead."""
        return Part(self.start_s + by_s, self.end_s + by_s, self.step_s)


WHOLE = Part()
