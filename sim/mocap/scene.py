"""What the emulated cameras see: bodies by name, and where they are at a time."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, pi, sin
from typing import Protocol

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Seen:
    """One body as the cameras have it: metres, scalar-first quaternion, body to world; None while it is hidden."""

    name: str
    number: int
    pose: tuple[Vector3, Quaternion] | None
    residual_m: float = 0.0004


class Scene(Protocol):
    """Where every body is."""

    def at(self, time_s: float) -> list[Seen]:
        """All bodies, hidden ones included, in the order of their numbers."""
        ...


class Figure:
    """A vehicle on a Lissajous figure that turns, and a wand that stands still. Names can be hidden and swapped.

    Args:
        names: of vehicle and wand.
    """

    def __init__(self, names: Sequence[str] = ("drone", "wand")):
        self.names = tuple(names)
        self.hidden: set[str] = set()

    def at(self, time_s: float) -> list[Seen]:
        """See :class:`Scene`."""
        yaw, roll = 0.4 * sin(0.9 * time_s), 0.3 * sin(2.1 * time_s)
        position = (0.8 * sin(time_s), 0.6 * sin(2.0 * time_s), 1.2 + 0.3 * cos(1.5 * time_s))
        cy, sy, cr, sr = cos(yaw / 2), sin(yaw / 2), cos(roll / 2), sin(roll / 2)
        vehicle = (position, (cy * cr, cy * sr, sy * sr, sy * cr))
        wand = ((-1.0, 0.5, 0.2), (cos(pi / 8), 0.0, 0.0, sin(pi / 8)))
        poses = (vehicle, wand)
        return [
            Seen(name, index + 1, None if name in self.hidden else pose)
            for index, (name, pose) in enumerate(zip(self.names, poses, strict=False))
        ]


WITHIN_S, FRESH_S = 1e-4, 0.05
"""A frame shows the pose of its own time; where the record has none for so long, the body was not seen."""


class Replay:
    """Poses of a recorded flight, each as it was, at its time.

    Args:
        times_s: increasing.
        poses: one of each time.
        name: of the body.
    """

    def __init__(self, times_s: Sequence[float], poses: Sequence[tuple[Vector3, Quaternion]], name: str = "drone"):
        self.times_s, self.poses, self.name = list(times_s), list(poses), name

    def at(self, time_s: float) -> list[Seen]:
        """The newest pose at that time; see :class:`Scene`."""
        index = bisect_right(self.times_s, time_s + WITHIN_S) - 1
        inside = index >= 0 and time_s - self.times_s[index] < FRESH_S
        return [Seen(self.name, 1, self.poses[index] if inside else None)]
