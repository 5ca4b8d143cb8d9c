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


WHOLE = Part()
