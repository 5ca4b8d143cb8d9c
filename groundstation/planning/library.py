r"""Plans that were solved before, as starts for a new task.

Lengths in :math:`g/\omega^2`, times in :math:`1/\omega` (base frequency :math:`\omega`): in these units the motion of a
plan, its tilt and its criterion "condition" depend neither on gravity nor on the base frequency, and a room is a few
numbers. A new task takes the solved ones with as many harmonics whose rooms are most like its own, each channel
stretched to its limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.json_types import Document, JsonObject
from groundstation.planning.problem import Problem
from groundstation.trajectory import FourierSeries

Array = NDArray[np.float64]

LIMITS = ("x_max_m", "y_max_m", "height", "speed_max_m_s", "tilt_max_rad", "yaw_rate_max_rad_s")
"""What a room is in units of g and the base frequency."""
_WIDE = 1e3
"""A limit that is not there."""
_OTHER_CRITERION = 1.0
"""By how much a plan made for another criterion seems further away (a limit that differs by a factor e is 1 away)."""


@dataclass(frozen=True, slots=True)
class Solved:
    """A plan in units of g and its base frequency.

    Attributes:
        criterion: it was made for.
        room: LIMITS of its task.
        a, b: coefficients of x, y, z over g/w, of yaw over w, shape (4, N).
    """

    criterion: str
    room: Array
    a: Array
    b: Array

    def to_dict(self) -> JsonObject:
        """As JSON; four digits are enough for a start."""

        def rounded(values: Array) -> list[Any]:
            return np.array([float(f"{v:.4g}") for v in values.ravel()]).reshape(values.shape).tolist()

        return {"criterion": self.criterion, **{name: rounded(getattr(self, name)) for name in ("room", "a", "b")}}

    @classmethod
    def from_dict(cls, document: Document) -> Solved:
        """What :meth:`to_dict` gave."""
        room, a, b = (np.array(document[name], dtype=float) for name in ("room", "a", "b"))
        return cls(str(document["criterion"]), room, a, b)


def room_of(problem: Problem) -> Array:
    """LIMITS of a task in units of g and the base frequency, the tightest of its vehicles."""
    envelope = problem.envelopes[0]
    frequency, gravity = problem.base_frequency_rad_s, envelope.gravity_m_s2
    low, high = problem.room[2]
    limits = [each.limits for each in problem.envelopes]

    def least(name: str) -> float:
        known = [value for each in limits if (value := getattr(each, name)) is not None]
        return min(known, default=np.inf)

    length, pace = frequency**2 / gravity, frequency / gravity
    room = np.array(
        [
            least("x_max_m") * length,
            least("y_max_m") * length,
            (high - low) * length,
            least("speed_max_m_s") * pace,
            least("tilt_max_rad"),
            least("yaw_rate_max_rad_s") / frequency,
        ]
    )
    return np.clip(room, 0.0, _WIDE)


def solved(series: FourierSeries, problem: Problem) -> Solved:
    """A plan of a task for the library."""
    frequency, gravity = series.base_frequency_rad_s, problem.envelopes[0].gravity_m_s2
    scale = np.array([frequency / gravity] * 3 + [1.0 / frequency])[:, None]
    return Solved(problem.criterion, room_of(problem), series.a * scale, series.b * scale)


def scaled_starts(library: Sequence[Solved], problem: Problem, most: int = 2) -> list[Array]:
    """Unknowns of the nearest solved plans, stretched to a task; the caller draws them in where they leave its
    limits.
    """
    room = room_of(problem)
    fitting = [each for each in library if each.a.shape[1] == problem.harmonics]
    fitting.sort(key=lambda each: _distance(each, room, problem.criterion))
    return [_stretched(each, room, problem) for each in fitting[:most]]


def _distance(each: Solved, room: Array, criterion: str) -> float:
    other = 0.0 if each.criterion == criterion else _OTHER_CRITERION
    return other + float(np.linalg.norm(np.log(room + 1e-6) - np.log(each.room + 1e-6)))


def _stretched(each: Solved, room: Array, problem: Problem) -> Array:
    """Channels x and y by what they have in common of tilt and room, z by its height, yaw by its rate; each within a
    factor 3.
    """
    ratio = np.clip((room + 1e-6) / (each.room + 1e-6), 1.0 / 3.0, 3.0)
    x, y, height, _, tilt, yaw = ratio
    factor = np.array([min(x, tilt) if x < 1.0 else tilt, min(y, tilt) if y < 1.0 else tilt, height, yaw])[:, None]
    frequency, gravity = problem.base_frequency_rad_s, problem.envelopes[0].gravity_m_s2
    scale = factor * np.array([gravity / frequency] * 3 + [frequency])[:, None]
    a, b = each.a * scale, each.b * scale
    at = np.zeros(4) if problem.start is None else np.array(problem.start)
    if problem.start is None:
        at = np.array(
            [
                float(np.mean(edges)) if np.isfinite(edges).all() else 1.0 * (k == 2)
                for k, edges in enumerate(problem.room)
            ]
        )
    below = (b / (frequency * np.arange(1, int(a.shape[1]) + 1))).sum(axis=1)
    return problem.unknowns_of(FourierSeries(a, b, at + below, frequency))
