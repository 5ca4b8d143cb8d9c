"""Signals to draw while a flight goes on: those that views derive, and every recorded one. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from groundstation.flight.messages import CoreStatus
from groundstation.reporting.units import label, split_unit

DERIVED: Mapping[str, Callable[[CoreStatus], float]] = {
    "off plan, cm": lambda s: 100.0 * s.tracking_error_m,
    "height, m": lambda s: s.position_m[2],
    "roll, °": lambda s: math.degrees(s.euler_rad[0]),
    "pitch, °": lambda s: math.degrees(s.euler_rad[1]),
    "yaw, °": lambda s: math.degrees(s.euler_rad[2]),
}
MOST = 3
"""Signals in one chart: a line, crosses and dots."""


def offered(status: CoreStatus | None) -> list[str]:
    """Signals that can be drawn: the derived ones, then every recorded one by its column."""
    return [*DERIVED, *sorted(status.signals if status else ())]


def words(name: str) -> str:
    """A signal with its unit: "imu/gyro_x_rad_s" is "imu gyro x, rad/s"."""
    if name in DERIVED:
        return name
    stream, _, column = name.partition("/")
    unit = split_unit(column)[1]
    return f"{stream.replace('_', ' ')} {label(column)}{f', {unit}' if unit else ''}"


def values(name: str, seen: Sequence[CoreStatus]) -> list[float]:
    """The signal over the statuses; NaN where it was not there."""
    if name in DERIVED:
        return [DERIVED[name](status) for status in seen]
    return [status.signals.get(name, math.nan) for status in seen]
