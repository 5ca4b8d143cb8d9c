"""Joint estimates of many candidates at once, each beside the same others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.joint import Products, estimated
from groundstation.diagnosis.rivals import Entry, share_of
from groundstation.diagnosis.thresholds import THRESHOLDS

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Beside:
    """Candidates of as many parameters as each other, each in its own joint estimate with the same others.

    Attributes:
        index: which of those asked for. entries: these.
        values: (several, p). covariance: (several, p, p).
        telling: which parameters tell these effects.
    """

    index: tuple[int, ...]
    entries: tuple[Entry, ...]
    values: Array
    covariance: Array
    telling: tuple[int, ...]

    def walds(self) -> Array:
        """theta^T cov^-1 theta of the parameters that tell each effect, (several,)."""
        values = self.values[:, self.telling]
        covariance = self.covariance[:, self.telling][:, :, self.telling]
        try:
            return np.einsum("mi,mi->m", values, np.linalg.solve(covariance, values[:, :, None])[:, :, 0])
        except np.linalg.LinAlgError:  # columns of which the flight holds nothing: their directions say nothing
            return np.einsum("mi,mij,mj->m", values, np.linalg.pinv(covariance, hermitian=True), values)

    def plausible(self) -> NDArray[np.bool_]:
        """:func:`.rivals.plausible` of each, (several,)."""
        variances = np.diagonal(self.covariance, axis1=1, axis2=2)
        std = np.sqrt(np.where(variances >= 0.0, variances, np.nan))  # of one below zero nothing is plausible
        ranges = np.array([[p.plausible for p in candidate.effect.parameters] for candidate, _ in self.entries])
        margin = THRESHOLDS.plausible_margin_std * std
        inside = (ranges[:, :, 0] - margin <= self.values) & (self.values <= ranges[:, :, 1] + margin)
        return np.asarray(inside.all(axis=1))

    def material(self, scale: Array) -> NDArray[np.bool_]:
        """:func:`.rivals.material` of each, (several,)."""
        rms = np.stack([columns.wrench_rms for _, columns in self.entries])
        size = np.einsum("mcp,mp->mc", rms, np.abs(self.values))
        return np.asarray(share_of(size / scale) > THRESHOLDS.material_share)


def beside(evidence: Evidence, others: Sequence[Entry], entries: Sequence[Entry]) -> list[Beside]:
    """Each of several entries in the joint estimate with others."""
    alike: dict[tuple[int, tuple[int, ...]], list[int]] = {}
    for index, (candidate, _) in enumerate(entries):
        key = len(candidate.effect.parameters), tuple(candidate.effect.telling())
        alike.setdefault(key, []).append(index)
    before = evidence.products(others)
    out: list[Beside] = []
    for (count, telling), index in alike.items():
        own = tuple(entries[i] for i in index)
        theta, covariance = estimated(_each_with(evidence, before, others, own))
        out.append(Beside(tuple(index), own, theta[:, -count:], covariance[:, -count:, -count:], telling))
    return out


def _each_with(evidence: Evidence, before: Products, others: Sequence[Entry], entries: Sequence[Entry]) -> Products:
    """The products of each joint estimate, the entry last; ``before`` is of the others with their priors."""
    table, place = evidence.table, len(before.zy)
    columns = [each for _, each in entries]
    own = [table.pair(each, each) for each in columns]
    many, total = len(entries), place + len(own[0].zx)
    zx, zz, xx = np.empty((3, many, total, total))
    zy, xy = np.empty((2, many, total))
    sides = ((zx, before.zx), (zz, before.zz), (xx, before.xx))
    for target, known in sides:
        target[:, :place, :place] = known
    end = 0
    for member in (evidence.base, *(each for _, each in others)):
        start, end = end, end + member.instrument.shape[1]
        across = table.with_each(member, columns)
        zx[:, start:end, place:], zz[:, start:end, place:], xx[:, start:end, place:] = across.zx, across.zz, across.xx
        zx[:, place:, start:end] = across.xz.transpose(0, 2, 1)
        zz[:, place:, start:end], xx[:, place:, start:end] = (
            across.zz.transpose(0, 2, 1),
            across.xx.transpose(0, 2, 1),
        )
    output = table.with_each(evidence.output, columns)
    zy[:, :place], xy[:, :place] = before.zy, before.xy
    zy[:, place:], xy[:, place:] = output.xz[:, 0], output.xx[:, 0]
    prior = np.stack([np.diag(evidence.prior_of(candidate)) for candidate, _ in entries])
    for target, name in ((zx, "zx"), (zz, "zz"), (xx, "xx")):
        target[:, place:, place:] = np.stack([getattr(pair, name) for pair in own]) + prior
    return Products(zx, zz, xx, zy, xy, before.rows)
