"""How far a flight is from what ends it: the guard's limits, how near each is, and the word for the operator. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING

from rich.text import Text

from groundstation.flight.messages import CoreStatus
from groundstation.texts import shown

if TYPE_CHECKING:  # the first screen waits for no numerics
    import numpy as np
    from numpy.typing import NDArray

Range = tuple[float, float]

NEAR, AT = 0.75, 0.92
"""Shares of a limit from which it counts as near, and as reached: a flight as planned uses less, and at a walking pace
the quarter that is left is the second in which an operator can still act."""
AGAIN = 0.65
"""Share below which a limit has to fall before it is announced again."""
WALL_M = 0.4
"""Distance from a wall of the guard's box at which it is as near as three quarters of another limit."""
BATTERY_V = 0.6
"""Volts above empty that count as three quarters used: what a three-cell pack loses in its last minute."""
BAR = 8
STYLES = ("", "bold yellow", "bold red", "bold white on red")
WORDS = ("", "NEAR", "AT LIMIT", "PAST IT")


class Level(IntEnum):
    """How near a limit is."""

    FAR = 0
    NEAR = 1
    AT = 2
    PAST = 3


@dataclass(frozen=True, slots=True)
class FlightLimits:
    """What bounds a flight.

    Attributes:
        room: of the plan: ``x_max_m`` and so on.
        tracking_m, tilt_rad, speed_m_s: where the guard acts; None where it does not watch.
        box: the guard's, (lowest, highest) along x, y and z; None without one.
        empty_v: of the battery.
        path: the planned excitation, shape (k, 3); empty without a plan.
        station: name of the station file.
        watched: a guard flies along; a simulated drone has none, and is shown against the limits of a real one.
    """

    room: dict[str, float] = field(default_factory=dict)
    tracking_m: float | None = None
    tilt_rad: float | None = None
    speed_m_s: float | None = None
    box: tuple[Range, Range, Range] | None = None
    empty_v: float | None = None
    path: NDArray[np.float64] | Sequence[Sequence[float]] = ()
    station: str = ""
    watched: bool = False


@dataclass(frozen=True, slots=True)
class Margin:
    """One limit.

    Attributes:
        name: of what is limited, at most nine characters.
        value: what it is now, with its unit.
        limit: where the guard acts, with its unit.
        used: share of the limit; 1 is where the guard acts.
    """

    name: str
    value: str
    limit: str
    used: float

    @property
    def level(self) -> Level:
        """How near it is."""
        return Level.PAST if self.used > 1.0 else Level(int(self.used >= NEAR) + int(self.used >= AT))


def margins(status: CoreStatus, limits: FlightLimits) -> list[Margin]:
    """Each limit of the guard that can be seen from here, in the order in which a pilot looks."""
    roll, pitch, _ = status.euler_rad
    tilt = math.acos(max(-1.0, min(1.0, math.cos(roll) * math.cos(pitch))))
    found = []
    if limits.tracking_m:
        off = status.tracking_error_m
        found.append(Margin("off plan", f"{100 * off:.1f} cm", f"of {limits.tracking_m:g} m", off / limits.tracking_m))
    if limits.tilt_rad:
        top = math.degrees(limits.tilt_rad)
        found.append(Margin("tilt", f"{math.degrees(tilt):.1f}°", f"of {top:.0f}°", tilt / limits.tilt_rad))
    speed = [value for name, value in status.signals.items() if name.startswith("state/velocity_")]
    if limits.speed_m_s and len(speed) == 3:
        fast = math.hypot(*speed)
        found.append(Margin("speed", f"{fast:.2f} m/s", f"of {limits.speed_m_s:g} m/s", fast / limits.speed_m_s))
    if limits.box:
        left, side = min((room, side) for room, side in _walls(status.position_m, limits.box))
        found.append(Margin("wall", f"{left:.2f} m", side, _used(left, WALL_M)))
    if limits.empty_v and status.battery_v:
        left = status.battery_v - limits.empty_v
        found.append(
            Margin("battery", f"{status.battery_v:.2f} V", f"empty {limits.empty_v:g}", _used(left, BATTERY_V))
        )
    return found


def _used(left: float, near: float) -> float:
    """Of a distance that is left: 0.75 at ``near``, 1 where none is left, towards 0 far away."""
    return 1.0 - 0.25 * left / near if left < 4.0 * near else 0.0


def _walls(position: Sequence[float], box: Iterable[Range]) -> Iterable[tuple[float, str]]:
    for axis, at, (low, high) in zip("xyz", position, box, strict=True):
        yield high - at, f"to +{axis}" if axis != "z" else "above"
        if axis != "z" or low > 0.0:  # a box that begins below the ground leaves the landing alone
            yield at - low, f"to −{axis}" if axis != "z" else "below"


def margin_text(found: Sequence[Margin]) -> Text:
    """A line for each: value, a bar of what is used, where the guard acts, and a word where that is near."""
    text = Text()
    for margin in found:
        full = round(BAR * min(max(margin.used, 0.0), 1.0))
        word = WORDS[margin.level]
        line = f"{margin.name:<8} {margin.value:>9} {'█' * full}{'░' * (BAR - full)} {word or margin.limit}"
        text.append(("\n" if text else "") + line, style=STYLES[margin.level])
    return text


def health(status: CoreStatus) -> Text:
    """What arrives, in a line: all of it, or the first stream that does not."""
    wrong = [(name, stream.trouble) for name, stream in sorted(status.streams.items()) if stream.trouble]
    if wrong:
        name, trouble = wrong[0]
        return Text(shown(f"streams   ! {name}: {trouble}"), style=STYLES[Level.AT])
    lost = f", {status.lost} batches lost" if status.lost else ""
    count = len(status.streams)
    return Text(f"streams   {'one arrives' if count == 1 else f'all {count} arrive'}{lost}")


class Announcer:
    """Says once when a limit is approached, and again only after it was well away from it in between."""

    def __init__(self) -> None:
        self._reported: dict[str, Level] = {}

    def news(self, found: Sequence[Margin]) -> list[str]:
        """Sentences for limits that came nearer since the last call; each is worth a bell."""
        said = []
        for margin in found:
            if margin.used < AGAIN:
                self._reported[margin.name] = Level.FAR
            if margin.level > self._reported.get(margin.name, Level.FAR):
                self._reported[margin.name] = margin.level
                said.append(_sentence(margin))
        return said


def _sentence(margin: Margin) -> str:
    how = {
        Level.NEAR: "is near the guard's limit",
        Level.AT: "is at the guard's limit",
        Level.PAST: "is past the guard's limit, and the guard acts",
    }[margin.level]
    return f"{margin.name} {how}: {margin.value} {margin.limit}."
