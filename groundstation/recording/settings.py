"""Settings belong to times: every value a parameter had in a log, and from when it held."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Settings:
    """Parameter histories: per name (from_s, value) in order of time; the first value holds before it too."""

    histories: Mapping[str, Sequence[tuple[float, float]]] = field(default_factory=dict)

    def __contains__(self, name: str) -> bool:
        return name in self.histories

    def names(self) -> Iterable[str]:
        """All parameters the log names."""
        return self.histories.keys()

    def at(self, name: str, t_s: Array, default: float | None = None) -> Array:
        """The value in force at each time, shape as ``t_s``; the default where the log lacks the parameter.

        Raises:
            KeyError: it lacks the parameter and no default is given.
        """
        history = self.histories.get(name)
        if not history:
            if default is None:
                raise KeyError(name)
            return np.full(np.shape(t_s), default)
        since = np.array([moment for moment, _ in history])
        values = np.array([value for _, value in history])
        return values[np.clip(np.searchsorted(since, t_s, side="right") - 1, 0, None)]

    def first(self, names: Iterable[str]) -> str | None:
        """The first of these names that the log has: a parameter that was renamed between versions."""
        return next((name for name in names if name in self.histories), None)

    def value(self, name: str, at_s: float, default: float) -> float:
        """The value in force at one time."""
        return float(self.at(name, np.array([at_s]), default)[0])

    def changes(self, name: str, start_s: float, end_s: float) -> list[tuple[float, float, float]]:
        """(time, value before, value after) of each change within a stretch of time."""
        history = list(self.histories.get(name, ()))
        return [
            (after[0], before[1], after[1])
            for before, after in itertools.pairwise(history)
            if after[1] != before[1] and start_s < after[0] <= end_s
        ]

    def told(self, names: Iterable[str], start_s: float, end_s: float) -> list[str]:
        """A sentence on each change of these parameters while the motors ran, and one on those that were told later."""
        used = list(dict.fromkeys(names))
        late = [name for name in used if name in self.histories and self.histories[name][0][0] > end_s]
        said = (
            [f"settings: {', '.join(late)}: told only after the motors ran; taken to have held before."] if late else []
        )
        for name in used:
            said += [
                f"settings: {name} changed from {before:g} to {after:g} at {moment:.2f} s, with the motors on; each "
                "value is used for its own time."
                for moment, before, after in self.changes(name, start_s, end_s)
            ]
        return said


def settings_of(changes: Iterable[tuple[str, float, float]]) -> Settings:
    """Settings from (name, from_s, value) in the order of a log; a repetition of the same value is no change."""
    histories: dict[str, list[tuple[float, float]]] = {}
    for name, since_s, value in changes:
        history = histories.setdefault(name, [])
        if not history or history[-1][1] != value:
            history.append((max(since_s, history[-1][0]) if history else since_s, value))
    return Settings(histories)
