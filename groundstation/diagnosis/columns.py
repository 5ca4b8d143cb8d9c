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
    """The batches of columns that were used last, up to a number of bytes; older ones are made anew where they are
    asked for.

    A flight of a minute has fifty megabytes of them, and keeps them all; an hour of it has three gigabytes.
    """

    def __init__(self, most: int):
        self._most, self._size = most, 0
        self._held: OrderedDict[int, Array] = OrderedDict()

    def hold(self, number: int, white: Array) -> Array:
        """Keep a batch, and let go of the ones that were not used for longest."""
        self._held[number] = white
        self._size += white.nbytes
        while self._size > self._most and len(self._held) > 1:
            _, old = self._held.popitem(last=False)
            self._size -= old.nbytes
        return white

    def batch(self, number: int, anew: Callable[[], Array]) -> Array:
        """A batch that was held, or made anew."""
        if number not in self._held:
            return self.hold(number, anew())
        self._held.move_to_end(number)
        return self._held[number]


_NUMBERS = count()


@dataclass(frozen=True, slots=True)
class Columns:
    """Whitened sensitivities to a candidate's parameters and their instruments, (rows, p) each; RMS of its wrench per
    unit.

    Attributes:
        energy: how that of each instrument lies over the channels and bands of the flights, (bands, p); None where it
            is still to be worked out.
        shown: whether each of the sensitivities is seen at all.
        number: tells one from another where products of pairs are remembered.
    """

    pair: Callable[[], Pair]
    wrench_rms: Array
    energy: Array | None = None
    shown: bool = True
    number: int = field(default_factory=_NUMBERS.__next__)

    @classmethod
    def of(cls, sensitivity: Array, instrument: Array, wrench_rms: Array, energy: Array | None = None) -> Columns:
        """Columns that stay."""
        return cls(lambda: (sensitivity, instrument), wrench_rms, energy)

    @property
    def sensitivity(self) -> Array:
        """To the parameters, (rows, p)."""
        return self.pair()[0]

    @property
    def instrument(self) -> Array:
        """Of the parameters, (rows, p)."""
        return self.pair()[1]


@dataclass(frozen=True, slots=True)
class Batch:
    """Whitened columns of many candidates side by side: the sensitivities of all of them, then the instruments of all.

    Attributes:
        white: (rows, 2 p), or (rows, p) where sensitivities are their own instruments.
        energy: of each column by channel and band, (bands, as many).
        wrench_rms: (6, p).
        known: of each candidate, whether its signals are; else its columns are zero.
    """

    white: Array
    energy: Array
    wrench_rms: Array
    known: tuple[bool, ...]

    @property
    def planned(self) -> bool:
        """Whether instruments are columns of their own."""
        return self.white.shape[1] > self.wrench_rms.shape[1]

    def with_instruments(self) -> Batch:
        """The same with instruments of their own, where there were none."""
        if self.planned:
            return self
        white, energy = (np.concatenate([array, array], axis=1) for array in (self.white, self.energy))
        return Batch(white, energy, self.wrench_rms, self.known)

    @classmethod
    def joined(cls, parts: Sequence[Batch], suspects: int) -> Batch:
        """Of several flights, those under suspicion first, as one."""
        if any(part.planned for part in parts):
            parts = [part.with_instruments() for part in parts]
        if len(parts) == 1:
            return parts[0]
        return cls(
            np.concatenate([part.white for part in parts]),
            np.concatenate([part.energy for part in parts]),
            np.sqrt(np.mean([part.wrench_rms**2 for part in parts[:suspects]], axis=0)),
            tuple(map(all, zip(*(part.known for part in parts), strict=True))),
        )


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
