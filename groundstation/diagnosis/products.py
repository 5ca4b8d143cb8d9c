"""Sums of products of whitened columns, each worked out once: all that a selection asks for is small matrices of them.

Columns stand in batches, many side by side in one matrix. One product of a matrix with all of a batch costs little more
than one with a single column, since what takes the time is to read the rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.columns import Columns
from groundstation.identification.record_model import CHANNELS

Array = NDArray[np.float64]


FEW_ROWS = 2**18
"""Of all channels: a quarter of an hour at the evidence's rate."""


@dataclass(frozen=True, slots=True)
class Pair:
    """Z_a^T W X_b, Z_a^T W Z_b, X_a^T W X_b and X_a^T W Z_b of two members."""

    zx: Array
    zz: Array
    xx: Array
    xz: Array

    def turned(self) -> Pair:
        """Of the second and the first."""
        return Pair(self.xz.T, self.zz.T, self.xx.T, self.zx.T)


@dataclass(frozen=True, slots=True)
class Member:
    """Where the sensitivities and instruments of some columns stand in a batch."""

    number: int
    sensitivity: slice
    instrument: slice

    def part(self, number: int, own: slice) -> Member:
        """Of some of the parameters."""
        first, last = self.sensitivity.start, self.instrument.start
        return Member(number, *(slice(at + own.start, at + own.stop) for at in (first, last)))


@dataclass(slots=True)
class _Held:
    """A batch: its matrix, who stands in it, and the products of columns, instruments first, with all of it."""

    white: Callable[[], Array]
    members: list[Member]
    across: dict[int, Array] = field(default_factory=dict[int, Array])


class Table:
    """Products over all rows.

    Args:
        base: what every joint estimate holds. output: what is explained; it has no instruments.
        weight: of each row. channels: of each row, of which those of a channel of a flight stand together.
    """

    def __init__(self, base: Columns, output: Columns, weight: Array, channels: NDArray[np.int64]):
        self._base, self._output, self._weight = base, output, weight
        self._count = base.instrument.shape[1]
        edges = np.r_[0, np.flatnonzero(np.diff(channels)) + 1, len(channels)]
        self._stretches = [(int(channels[a]), slice(a, b)) for a, b in pairwise(edges)]
        self._pairs: dict[tuple[int, int], Pair] = {}
        self._inside: dict[int, tuple[Array, Array]] = {}
        self._held: dict[int, tuple[_Held, Member]] = {}

    def _left(self, rows: slice) -> Array:
        """Weighted instruments and sensitivities of the base and the output, (2 base + 1, rows)."""
        x, z = self._base.pair()
        left = np.concatenate([z[rows], x[rows], self._output.sensitivity[rows]], axis=1)
        return np.ascontiguousarray((left * self._weight[rows, None]).T)

    def add(self, white: Callable[[], Array], members: Sequence[Member]) -> None:
        """A batch."""
        held = _Held(white, list(members))
        self._held |= {member.number: (held, member) for member in members}

    def add_part(self, of: int, number: int, own: slice) -> None:
        """Some of the parameters of columns that stand in a batch."""
        held, member = self._held[of]
        if self._base.number in held.across:  # what is new has none of it yet
            held = _Held(held.white, [])
        held.members.append(member.part(number, own))
        self._held[number] = held, held.members[-1]

    def pair(self, a: Columns, b: Columns) -> Pair:
        """Of two members."""
        if b.number < a.number:
            return self.pair(b, a).turned()
        key = a.number, b.number
        if key not in self._pairs:
            own = a.number in (self._base.number, self._output.number)
            self._pairs[key] = self._crossed(a, b) if self._is_across(a, b, own) else self._pair(a, b)
        return self._pairs[key]

    def _pair(self, a: Columns, b: Columns) -> Pair:
        if a is b and a.number in self._held:
            self._fill(self._held[a.number][0])
            return self._pairs[a.number, a.number]
        if self._is_across(b, a, False):
            return self._crossed(b, a).turned()
        return product(a, b, self._weight)

    def _is_across(self, a: Columns, b: Columns, own: bool) -> bool:
        return b.number in self._held and (own or a.number in self._held[b.number][0].across)

    def _crossed(self, a: Columns, b: Columns) -> Pair:
        """The same, from the products of the first with all of the second's batch."""
        held, member = self._held[b.number]
        self._cross(a, held)
        row, n = held.across[a.number], a.instrument.shape[1]
        x, z = row[:, member.sensitivity], row[:, member.instrument]
        return Pair(x[:n], z[:n], x[n:], z[n:])

    def with_each(self, a: Columns, some: Sequence[Columns]) -> Pair:
        """Products of columns (n parameters) with each of several of p parameters, (several, n, p)."""
        n, places = a.instrument.shape[1], list[tuple[list[int], Array, Array]]()
        for index in self._batches_of(some).values():
            members = [self._held[some[i].number][1] for i in index]
            batch = self._held[some[index[0]].number][0]
            self._cross(a, batch)
            row = batch.across[a.number]
            x = np.concatenate([row[:, member.sensitivity] for member in members], axis=1)
            z = np.concatenate([row[:, member.instrument] for member in members], axis=1)
            places.append((index, x, z))
        width = len(some[0].wrench_rms[0])
        out = [np.empty((len(some), rows, width)) for rows in (n, n, len(places[0][1]) - n, len(places[0][1]) - n)]
        for index, x, z in places:
            for target, part in zip(out, (x[:n], z[:n], x[n:], z[n:]), strict=True):
                target[index] = part.reshape(len(part), len(index), width).transpose(1, 0, 2)
        return Pair(*out)

    def _batches_of(self, some: Sequence[Columns]) -> dict[int, list[int]]:
        found: dict[int, list[int]] = {}
        for index, columns in enumerate(some):
            found.setdefault(id(self._held[columns.number][0]), []).append(index)
        return found

    def by_channel(self, columns: Columns) -> tuple[Array, Array]:
        """Products of the base's instruments with those of columns, (6, base, p), and of these with themselves, (6, p,
        p), over the rows of each channel.
        """
        if columns.number in self._held:
            self._fill(self._held[columns.number][0])
        if columns.number not in self._inside:
            own = columns.instrument
            across = self._of_channels(lambda rows: self._left(rows)[: self._count], own)
            self._inside[columns.number] = across, self._squares(own)
        return self._inside[columns.number]

    def of_base(self) -> Array:
        """Products of the base's instruments with themselves over the rows of each channel, (6, base, base)."""
        return self._of_channels(lambda rows: self._left(rows)[: self._count], self._base.instrument)

    def _with_base(self, right: Array) -> Array:
        """Of the base's instruments, its sensitivities and the output with columns, (6, 2 base + 1, p): of many rows
        the columns are weighted, which are fewer.
        """
        if len(right) <= FEW_ROWS:
            return self._of_channels(self._left, right)
        x, z = self._base.pair()
        out = np.zeros((len(CHANNELS), 2 * self._count + 1, right.shape[1]))
        for channel, rows in self._stretches:
            weighted = right[rows] * self._weight[rows, None]
            members = (z, x, self._output.sensitivity)
            out[channel] += np.concatenate([member[rows].T @ weighted for member in members])
        return out

    def _of_channels(self, left: Callable[[slice], Array], right: Array) -> Array:
        found = [(channel, left(rows) @ right[rows]) for channel, rows in self._stretches]
        out = np.zeros((len(CHANNELS), *found[0][1].shape))
        for channel, products in found:
            out[channel] += products
        return out

    def _squares(self, own: Array) -> Array:
        def left(rows: slice) -> Array:
            return np.ascontiguousarray((own[rows] * self._weight[rows, None]).T)

        return self._of_channels(left, own)

    def fill(self, member: Member) -> None:
        """Work out the products of the batch that a member stands in with base, output and each of its members."""
        self._fill(self._held[member.number][0])

    def _fill(self, held: _Held) -> None:
        """Products of a batch with base and output, and of each of its members with itself."""
        if self._base.number in held.across:
            return
        white, n = held.white(), self._count
        parts = self._with_base(white)
        total = parts.sum(axis=0)
        held.across[self._base.number], held.across[self._output.number] = total[:-1], total[-1:]
        for member in held.members:
            alike = member.sensitivity == member.instrument
            own = white[:, member.instrument]
            squares = self._squares(own if alike else np.concatenate([own, white[:, member.sensitivity]], axis=1))
            count = own.shape[1]
            self._inside[member.number] = parts[:, :n, member.instrument], squares[:, :count, :count]
            both = squares.sum(axis=0)
            first, second = slice(0, count), slice(0 if alike else count, None)
            self._pairs[member.number, member.number] = Pair(
                both[first, second], both[first, first], both[second, second], both[second, first]
            )

    def _cross(self, columns: Columns, held: _Held) -> None:
        """Products of columns with all of a batch."""
        self._fill(held)
        if columns.number not in held.across:
            x, z = columns.pair()
            left = np.ascontiguousarray((np.concatenate([z, x], axis=1) * self._weight[:, None]).T)
            held.across[columns.number] = left @ held.white()


def product(a: Columns, b: Columns, weight: Array) -> Pair:
    """Of two members with these weights of the rows."""
    w = weight[:, None]
    z, x = (a.instrument * w).T, (a.sensitivity * w).T
    return Pair(z @ b.sensitivity, z @ b.instrument, x @ b.sensitivity, x @ b.instrument)
