"""How well one body is tracked: rate, latency, jitter, drop-outs. Pure."""

from __future__ import annotations

import re
from collections import deque
from dataclasses import dataclass
from itertools import pairwise
from math import nan, sqrt

from drivers.mocap.readings import Body
from drivers.mocap.serverclock import ServerTime
from drivers.mocap.session import Arrived

KEPT = 4000
GAP = 2.5
"""Frames further apart than this many periods have frames between them that did not come."""


@dataclass(frozen=True, slots=True)
class Summary:
    """Of the frames kept.

    Attributes:
        rate_hz: of stamps, by their median distance.
        latency_p50_s, latency_p99_s: arrival after the exposure (or the report).
        jitter_s: standard deviation of the stamps' distances.
        missing: frames that did not come, by the server's numbers or by gaps.
        unseen: share of frames without the body.
        longest_gap_s: longest time without a pose.
        residual_m: median of the markers' residual; NaN where it is not told.
    """

    rate_hz: float
    latency_p50_s: float
    latency_p99_s: float
    jitter_s: float
    missing: int
    unseen: float
    longest_gap_s: float
    residual_m: float


class Health:
    """Collects frames of one body.

    Attributes:
        seen: frames with the body, ever.
    """

    def __init__(self) -> None:
        self.seen = 0
        self._frames: deque[tuple[float, float, int | None, bool, float]] = deque(maxlen=KEPT)

    def take(self, arrived: Arrived, body: Body | None) -> None:
        """One frame, with the body or without."""
        self.seen += body is not None
        residual = nan if body is None or body.residual_m is None else body.residual_m
        number = arrived.frame.number
        self._frames.append((arrived.stamp_s, arrived.received_s, number, body is not None, residual))

    def summary(self, now_s: float, last_s: float = 10.0) -> Summary:
        """Of the last seconds."""
        frames = [f for f in self._frames if now_s - f[1] <= last_s]
        stamps = sorted(f[0] for f in frames)
        steps = [b - a for a, b in pairwise(stamps) if b > a]
        period = _quantile(steps, 0.5)
        latencies = [f[1] - f[0] for f in frames]
        posed = sorted(f[0] for f in frames if f[3])
        gaps = [b - a for a, b in pairwise(posed)]
        regular = [s for s in steps if s < GAP * period]
        mean = sum(regular) / len(regular) if regular else nan
        spread = sqrt(sum((s - mean) ** 2 for s in regular) / len(regular)) if regular else nan
        return Summary(
            1.0 / period if period > 0.0 else 0.0,
            _quantile(latencies, 0.5),
            _quantile(latencies, 0.99),
            spread,
            _missing([f[2] for f in frames], steps, period),
            1.0 - len(posed) / len(frames) if frames else 1.0,
            max(gaps, default=nan),
            _quantile([f[4] for f in frames if f[4] == f[4]], 0.5),
        )


def _missing(numbers: list[int | None], steps: list[float], period: float) -> int:
    counted = [n for n in numbers if n is not None]
    if len(counted) > 1 and len(counted) == len(numbers):
        return sum(b - a - 1 for a, b in pairwise(counted) if 1 < b - a < 10_000)
    return sum(round(s / period) - 1 for s in steps if s > GAP * period) if period > 0.0 else 0


def _quantile(values: list[float], share: float) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))] if ordered else nan


def clock_text(clock: ServerTime, error_s: float, summary: Summary) -> str:
    """One line of the recording: what the driver knows of the server's clock, and of the stream."""
    return (
        f"mocap: stamps known to {1e3 * error_s:.3f} ms ({clock.method}), drift {1e6 * clock.drift:+.1f} ppm, "
        f"{clock.steps} steps; {summary.rate_hz:.0f} Hz, latency {1e3 * summary.latency_p50_s:.2f} ms, "
        f"p99 {1e3 * summary.latency_p99_s:.2f} ms, {summary.missing} frames missing"
    )


def vehicle_clock_text(host_minus_vehicle_s: float, error_s: float) -> str:
    """What the link adds to that line: the vehicle's clock by TIMESYNC."""
    return f"; host minus vehicle {host_minus_vehicle_s:.6f} s within {1e3 * error_s:.3f} ms"


_VEHICLE = re.compile(r"; host minus vehicle (-?[\d.]+) s within ([\d.]+) ms$")
_TEXT = re.compile(r"mocap: stamps known to ([\d.]+) ms \(([a-z -]+)\), drift ([-+\d.]+) ppm, (\d+) steps")


@dataclass(frozen=True, slots=True)
class ReportedClock:
    """What :func:`clock_text` and :func:`vehicle_clock_text` told; the vehicle's is None without TIMESYNC."""

    error_s: float
    method: str
    drift: float
    steps: int
    host_minus_vehicle_s: float | None = None
    vehicle_error_s: float = 0.0


def reported_clock(text: str) -> ReportedClock | None:
    """Inverse of :func:`clock_text`; None of another text."""
    found = _TEXT.match(text)
    if found is None:
        return None
    vehicle = _VEHICLE.search(text)
    offset_s, error_s = (float(vehicle[1]), 1e-3 * float(vehicle[2])) if vehicle is not None else (None, 0.0)
    return ReportedClock(1e-3 * float(found[1]), found[2], 1e-6 * float(found[3]), int(found[4]), offset_s, error_s)
