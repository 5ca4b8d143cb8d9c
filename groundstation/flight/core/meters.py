"""What is counted of each stream while it is recorded: how much, how fast, and what is not as it should be."""

from __future__ import annotations

from collections import deque
from dataclasses import asdict, dataclass

import numpy as np

from groundstation.flight.messages import StreamStatus

RATE_WINDOW_S = 1.0
GAP_PERIODS = 1.75
"""An interval of more than so many mean ones is a gap: one missing sample makes two of it, and stamps that jitter by
half a period make none."""
SETTLED_AFTER = 10
"""Samples from which the mean interval, and the least delay, are known well enough to say so."""
JUMP_S = 0.1
"""A stamp that goes back by more is of a clock that was set, and so is one that is closer to its arrival, by more than
this, than any before: networks hold a datagram back for less, and none comes before it is sent. Smaller steps are found
after the flight, by arrival times."""


@dataclass(slots=True)
class StreamCounts:
    """One stream, as its samples arrived.

    Attributes:
        samples: all of them.
        gaps: intervals in which at least one sample is missing, and did not come late; ``longest_gap_s`` the longest
            interval.
        duplicates: stamps that repeat the one before.
        reordered: stamps before the newest, by no more than a network reorders.
        clock_jumps: steps of the device's clock.
    """

    samples: int = 0
    gaps: int = 0
    longest_gap_s: float = 0.0
    duplicates: int = 0
    reordered: int = 0
    clock_jumps: int = 0

    def document(self) -> dict[str, float]:
        """For the record."""
        return {**asdict(self), "longest_gap_s": round(self.longest_gap_s, 6)}


class StreamMeter:
    """Counts one stream. Rates come from device stamps, so that batches do not distort them."""

    def __init__(self) -> None:
        self.counts = StreamCounts()
        self.last_host_s = 0.0
        self._stamps: deque[float] = deque()
        self._delays: deque[float] = deque()
        self._since_jump, self._least_s = 0, 0.0
        self._gap = (0.0, 0.0)

    def add(self, device_s: float, host_s: float) -> None:
        """Take note of a sample."""
        counts, delay_s = self.counts, host_s - device_s
        counts.samples += 1
        self.last_host_s = host_s
        if self._stamps:
            step_s = device_s - self._stamps[-1]
            if step_s < -JUMP_S or (self._since_jump > SETTLED_AFTER and delay_s < self._least_s - JUMP_S):
                counts.clock_jumps += 1
                self._since_jump = 0
                self._stamps.clear()
                self._delays.clear()
            elif step_s < 0.0:
                counts.reordered += 1
                if self._gap[0] < device_s < self._gap[1]:
                    counts.gaps -= 1
                    self._gap = (0.0, 0.0)
                return
            elif step_s == 0.0:
                counts.duplicates += 1
                return
            else:
                self._interval(step_s)
        self._least_s = min(self._least_s, delay_s) if self._since_jump else delay_s
        self._since_jump += 1
        self._stamps.append(device_s)
        self._delays.append(delay_s)
        while device_s - self._stamps[0] > RATE_WINDOW_S:
            self._stamps.popleft()
            self._delays.popleft()

    def _interval(self, step_s: float) -> None:
        intervals = len(self._stamps) - 1
        if intervals >= SETTLED_AFTER and step_s * intervals > GAP_PERIODS * (self._stamps[-1] - self._stamps[0]):
            self.counts.gaps += 1
            self._gap = (self._stamps[-1], self._stamps[-1] + step_s)
        self.counts.longest_gap_s = max(self.counts.longest_gap_s, step_s)

    def status(self, host_s: float) -> StreamStatus:
        """As of host time."""
        span = self._stamps[-1] - self._stamps[0] if len(self._stamps) > 1 else 0.0
        rate = (len(self._stamps) - 1) / span if span > 0.0 else 0.0
        age = max(0.0, host_s - self.last_host_s)
        delays = np.array(self._delays or (0.0,))
        counts = self.counts
        return StreamStatus(counts.samples, rate, age, counts.longest_gap_s, float(delays.mean()), float(delays.std()))
