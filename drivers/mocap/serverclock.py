r"""A motion-capture server's clock on ours: offset, drift, an error bar that holds, and steps. Pure.

With o = host time - server time, a message sent at server time s that arrives at host time h has h - s = o + transit,
so every arrival bounds o from above. A question asked at h0 and answered with the server's time s bounds it from below:
o >= h0 - s. Where a system only echoes, a round trip of r bounds the transit of the fastest message by r.
Bounds of one second each are kept over a window. Their slope is that of the line under all upper bounds that lies
closest to them: the edge of their lower convex hull above the window's middle (Moon, Skelly and Towsley, "Estimation
and removal of clock skew from network delay measurements", INFOCOM 1999). Offset and error are middle and half of what
is left between both sides.

A step is told by what no transit explains: bounds that contradict each other, arrivals before they were sent, stamps
that run backwards, or arrivals that stay late by the same amount.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise
from math import inf, isfinite

WINDOW_S = 40.0
BIN_S = 1.0
SLOPE_AFTER_S = 8.0
"""Shorter windows take both clocks for equally fast: the transits' scatter would tell a slope that is not there."""
FASTEST = 5e-4
"""Slope of the worst clock: 100 ppm of a quartz, and the 500 ppm at most by which NTP slews."""
QUARTZ = 1e-4
UNTOLD_TRANSIT_S = 1e-3
"""Taken for the fastest message's transit where no round trip is known: a busy switch and both network stacks."""
STEP_S = 2e-3
"""Contradictions below are scheduling; an NTP step is 128 ms and more, a restarted server's clock is anywhere."""
LATE_STEP_S = 2.5
"""Arrivals that all stay late for so long are a step: congestion lets at least one packet through in time."""
BACKWARDS_S = 0.1
"""Stamps that run back by less are datagrams that overtook each other."""


@dataclass(frozen=True, slots=True)
class ServerTime:
    """The server's clock as known now.

    Attributes:
        offset_s: host minus server at ``at_s``.
        at_s: host time of that.
        drift: host seconds gained per server second, minus one.
        error_s: half of the interval that the offset lies in.
        method: "two-way", "round trip" or "arrival": what bounds it from below.
        steps: how often the server's clock stepped.
    """

    offset_s: float
    at_s: float
    drift: float
    error_s: float
    method: str
    steps: int

    def host_s(self, server_s: float) -> float:
        """Host time of a server stamp."""
        there = server_s + self.offset_s
        return there + self.drift * (there - self.at_s)


@dataclass(slots=True)
class _Bin:
    at_s: float
    upper_s: float = inf
    upper_at_s: float = 0.0
    lower_s: float = -inf
    lower_at_s: float = 0.0


class ServerClock:
    """Collects evidence and maps stamps.

    Args:
        settling_s: after which an early arrival is a step, and no better packet than those before.

    Attributes:
        steps: how often the server's clock stepped; what was known before is dropped each time.
    """

    def __init__(self, settling_s: float = 2.0) -> None:
        self.steps = 0
        self._settling_s = settling_s
        self._forget()

    def _forget(self) -> None:
        self._bins: deque[_Bin] = deque()
        self._trip_s = inf
        self._newest_s = -inf
        self._late_since_s: float | None = None
        self._now: ServerTime | None = None
        self._first_s: float | None = None

    @property
    def now(self) -> ServerTime | None:
        """The map; None before anything arrived."""
        return self._now

    def arrival(self, server_s: float, host_s: float) -> bool:
        """A message of the server's time ``server_s`` arrived. True if its clock stepped."""
        if not (isfinite(server_s) and abs(server_s) < 1e12):
            return False
        if server_s < self._newest_s - BACKWARDS_S or self._contradicts(server_s, host_s):
            self._step()
        stepped = self._first_s is None and self.steps > 0
        self._newest_s = max(self._newest_s, server_s)
        self._bound(host_s, upper_s=host_s - server_s)
        return stepped

    def exchange(self, sent_s: float, server_s: float, received_s: float) -> bool:
        """A question was answered with the server's time. True if its clock stepped."""
        if not (isfinite(server_s) and 0.0 <= received_s - sent_s < 2.0):
            return False
        now, stepped = self._now, False
        middle_s = 0.5 * (sent_s + received_s)
        if now is not None:
            expected_s = now.offset_s + now.drift * (middle_s - now.at_s)
            slack_s = STEP_S + now.error_s + 2.0 * FASTEST * abs(middle_s - now.at_s)
            if sent_s - server_s > expected_s + slack_s or received_s - server_s < expected_s - slack_s:
                self._step()
                stepped = True
        self._trip_s = min(self._trip_s, received_s - sent_s)
        self._bound(received_s, upper_s=received_s - server_s, lower_s=sent_s - server_s)
        return stepped

    def round_trip(self, seconds: float) -> None:
        """A question was answered without a time."""
        if 0.0 <= seconds < 2.0:
            self._trip_s = min(self._trip_s, seconds)

    def host_s(self, server_s: float, received_s: float) -> float:
        """Host time of a server stamp; never later than its arrival."""
        return received_s if self._now is None else min(self._now.host_s(server_s), received_s)

    def _step(self) -> None:
        self._forget()
        self.steps += 1

    def _contradicts(self, server_s: float, host_s: float) -> bool:
        """It arrived before it was sent, or arrivals stay late."""
        now = self._now
        if now is None or self._first_s is None or host_s - self._first_s < self._settling_s:
            return False
        early_s = now.host_s(server_s) - now.error_s - host_s
        slack_s = STEP_S + 2.0 * FASTEST * abs(host_s - now.at_s)
        if early_s > slack_s:
            return True
        late_s = -early_s - 2.0 * now.error_s
        if late_s < slack_s:
            self._late_since_s = None
            return False
        self._late_since_s = host_s if self._late_since_s is None else self._late_since_s
        return host_s - self._late_since_s > LATE_STEP_S

    def _bound(self, host_s: float, upper_s: float, lower_s: float = -inf) -> None:
        self._first_s = host_s if self._first_s is None else self._first_s
        fresh = not self._bins or host_s - self._bins[-1].at_s >= BIN_S
        if fresh:
            self._bins.append(_Bin(host_s))
            while host_s - self._bins[0].at_s > WINDOW_S:
                self._bins.popleft()
        last = self._bins[-1]
        better = upper_s < last.upper_s or lower_s > last.lower_s
        if upper_s < last.upper_s:
            last.upper_s, last.upper_at_s = upper_s, host_s
        if lower_s > last.lower_s:
            last.lower_s, last.lower_at_s = lower_s, host_s
        if fresh or better:
            self._fit(host_s)

    def _fit(self, now_s: float) -> None:
        uppers = [(b.upper_at_s - now_s, b.upper_s) for b in self._bins if b.upper_s < inf]
        lowers = [(b.lower_at_s - now_s, b.lower_s) for b in self._bins if b.lower_s > -inf]
        reference = uppers[-1][1]
        uppers = [(t, u - reference) for t, u in uppers]
        lowers = [(t, v - reference) for t, v in lowers]
        span_s = uppers[-1][0] - uppers[0][0]
        slope = hull_slope(uppers) if span_s >= SLOPE_AFTER_S else 0.0
        doubt_s = 0.0 if span_s >= SLOPE_AFTER_S else 0.5 * QUARTZ * span_s
        upper = min(u - slope * t for t, u in uppers)
        if lowers:
            lower, method = max(v - slope * t for t, v in lowers), "two-way"
        elif self._trip_s < inf:
            lower, method = upper - self._trip_s, "round trip"
        else:
            lower, method = upper - UNTOLD_TRANSIT_S, "arrival"
        error_s = 0.5 * abs(upper - lower) + doubt_s
        self._now = ServerTime(reference + 0.5 * (upper + lower), now_s, slope, error_s, method, self.steps)


def hull_slope(points: list[tuple[float, float]]) -> float:
    """Slope of the lower convex hull's edge above the middle of the points (sorted by time), within the fastest
    clock's.
    """
    hull: list[tuple[float, float]] = []
    for t, u in points:
        while len(hull) > 1 and _turns_right(hull[-2], hull[-1], (t, u)):
            hull.pop()
        hull.append((t, u))
    middle = sum(t for t, _ in points) / len(points)
    for (t0, u0), (t1, u1) in pairwise(hull):
        if t0 <= middle <= t1 and t1 > t0:
            return max(-FASTEST, min(FASTEST, (u1 - u0) / (t1 - t0)))
    return 0.0


def _turns_right(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) <= 0.0
