"""What evidence is made of: a candidate, its columns, and what a joint estimate or a contest of candidates says."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import count

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.effect import Effect, Settings

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Candidate:
    """An effect in one setting, e.g. the weak rotor number 3."""

    effect: Effect
    settings: Settings

    @property
    def identifier(self) -> str:
        """Of the effect."""
        return self.effect.identifier


Pair = tuple[Array, Array]


class Recent:
    """The columns that were used last, up to a number of bytes; older ones are made anew where they are asked for.

    A flight of a minute has a hundred megabytes of them, and keeps them all; an hour of it has six gigabytes.
    """

    def __init__(self, most: int):
        self._most, self._size = most, 0
        self._held: OrderedDict[int, Pair] = OrderedDict()

    def hold(self, number: int, pair: Pair) -> Pair:
        """Keep a pair, and let go of the ones that were not used for longest."""
        self._held[number] = pair
        self._size += _bytes(pair)
        while self._size > self._most and len(self._held) > 1:
            _, old = self._held.popitem(last=False)
            self._size -= _bytes(old)
        return pair

    def pair(self, number: int, anew: Callable[[], Pair]) -> Pair:
        """A pair that was held, or made anew."""
        if number not in self._held:
            return self.hold(number, anew())
        self._held.move_to_end(number)
        return self._held[number]


def _bytes(pair: Pair) -> int:
    return pair[0].nbytes + (0 if pair[1] is pair[0] else pair[1].nbytes)


@dataclass(frozen=True, slots=True)
class Columns:
    """Whitened sensitivities to a candidate's parameters and their instruments, (rows, p) each; RMS of its wrench per
    unit.

    ``number`` tells one from another where products of pairs are remembered.
    """

    pair: Callable[[], Pair]
    wrench_rms: Array
    number: int = field(default_factory=count().__next__)

    @classmethod
    def of(cls, sensitivity: Array, instrument: Array, wrench_rms: Array) -> Columns:
        """Columns that stay."""
        return cls(lambda: (sensitivity, instrument), wrench_rms)

    @property
    def sensitivity(self) -> Array:
        """To the parameters, (rows, p)."""
        return self.pair()[0]

    @property
    def instrument(self) -> Array:
        """Of the parameters, (rows, p)."""
        return self.pair()[1]

    def recent(self, recent: Recent, anew: Callable[[], Columns | None]) -> Columns:
        """The same, held for as long as there is room, and else made anew."""
        number = self.number
        recent.hold(number, self.pair())

        def again() -> Pair:
            found = anew()
            if found is None:
                raise RuntimeError("columns that were there are not any more")
            return found.pair()

        return Columns(lambda: recent.pair(number, again), self.wrench_rms, number)


@dataclass(frozen=True, slots=True)
class Solution:
    """A joint estimate: base parameters first, then the candidates' in order."""

    theta: Array
    covariance: Array
    base: int

    def part(self, first: int, count: int) -> tuple[Array, Array]:
        """Values and covariance of ``count`` parameters after the base, from ``first``."""
        index = slice(self.base + first, self.base + first + count)
        return self.theta[index], self.covariance[index, index]

    def wald(self, first: int, members: Sequence[int]) -> float:
        """theta^T cov^-1 theta of some of the parameters from ``first``."""
        index = self.base + first + np.asarray(members)
        values, covariance = self.theta[index], self.covariance[np.ix_(index, index)]
        try:
            return float(values @ np.linalg.solve(covariance, values))
        except np.linalg.LinAlgError:  # columns of which the flight holds nothing: their directions say nothing
            return float(values @ np.linalg.pinv(covariance, hermitian=True) @ values)


@dataclass(frozen=True, slots=True)
class Contest:
    """Sets of explanations, compared through instruments common to all.

    Attributes:
        falls: of the instrumented squared residual, that each set brings to the base alone.
        misfit: what the best of them leaves, per degree of freedom; one where noise alone is left, and never less.
    """

    falls: list[float]
    misfit: float
