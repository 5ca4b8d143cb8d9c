"""What evidence is made of: a candidate, its columns, and what a joint estimate or a contest of candidates says."""

from __future__ import annotations

from collections.abc import Sequence
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


@dataclass(frozen=True, slots=True)
class Columns:
    """Whitened sensitivities to a candidate's parameters and their instruments, (rows, p) each; RMS of its wrench per
    unit.

    ``number`` tells one from another where products of pairs are remembered.
    """

    sensitivity: Array
    instrument: Array
    wrench_rms: Array
    number: int = field(default_factory=count().__next__)


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
