"""Messages of one ROS 2 type to columns of numbers, thousands at once: where each number stands, worked out once per
layout.

In plain CDR (OMG DDS-XTypes 1.3, 7.4.1; XCDR version 1, little endian) a message's layout depends on the lengths of its
strings and sequences alone. So the first message of a layout is walked field by field, and all others with the same
lengths at the same places are read through NumPy. ``rosbags`` gives the definitions.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Description: TypeAlias = "tuple[int, tuple[str | Description, int] | str]"
Definitions = Callable[[str], Sequence[tuple[str, Description]]]
"""Fields of a type by its name, as ``rosbags`` describes them: kind of node, and what it is of."""

_HEAD = 4  # encapsulation: representation and options; alignment counts from after it
_LITTLE = b"\0\1"
_BASE, _NAME, _ARRAY, _SEQUENCE = 1, 2, 3, 4
_TYPES = {
    **{"bool": "<u1", "byte": "<u1", "octet": "<u1", "char": "<u1", "int8": "<i1", "uint8": "<u1"},
    **{"int16": "<i2", "uint16": "<u2", "int32": "<i4", "uint32": "<u4", "int64": "<i8", "uint64": "<u8"},
    **{"float32": "<f4", "float64": "<f8"},
}
MOST_ELEMENTS = 64
"""Elements of an array up to which they are written out; longer ones are images, clouds or covariances of large
states.
"""
UNREAD = "covariance"
"""Fields with this in their name are left out: they are most of a message, and no stream has them."""


@dataclass(slots=True)
class Layout:
    """Where the numbers of messages of some lengths stand.

    Attributes:
        lengths: place and value of each length that decides the layout.
        fields: place and type of each number, by its path.
    """

    lengths: list[tuple[int, int]] = field(default_factory=list)
    fields: dict[str, tuple[int, str]] = field(default_factory=dict)


def layout_of(definitions: Definitions, kind: str, data: bytes) -> Layout:
    """The layout of a message.

    Raises:
        ValueError: it is of another encoding, has types that are no numbers or texts, or is cut off.
    """
    if data[:2] != _LITTLE:
        raise ValueError("the message is not plain CDR of little endian")
    walk = _Walk(definitions, data)
    walk.message(kind, "", True)
    if walk.at > len(data):
        raise ValueError("the message is cut off")
    return walk.layout


class _Walk:
    def __init__(self, definitions: Definitions, data: bytes) -> None:
        self._definitions, self._data = definitions, data
        self.layout, self.at = Layout(), _HEAD

    def _align(self, size: int) -> None:
        self.at += -(self.at - _HEAD) % size

    def _length(self) -> int:
        self._align(4)
        try:
            (value,) = struct.unpack_from("<I", self._data, self.at)
        except struct.error:
            raise ValueError("the message is cut off") from None
        if value > len(self._data):
            raise ValueError("a length is longer than its message")
        self.layout.lengths.append((self.at, value))
        self.at += 4
        return value

    def message(self, kind: str, prefix: str, shown: bool) -> None:
        for name, described in self._definitions(kind):
            self._node(described, prefix + name, shown and UNREAD not in name)

    def _node(self, described: Description, path: str, shown: bool) -> None:
        node, inside = int(described[0]), described[1]
        if node == _NAME:
            self.message(str(inside), f"{path}.", shown)
        elif node == _BASE:
            self._base(str(inside[0]), path, shown)
        else:
            of, count = inside[0], int(inside[1]) if node == _ARRAY else self._length()
            self._elements(of, count, path, shown and count <= MOST_ELEMENTS)  # type: ignore[arg-type]

    def _elements(self, of: Description, count: int, path: str, shown: bool) -> None:
        base = str(of[1][0]) if int(of[0]) == _BASE else ""
        if base in _TYPES and not shown:
            size = np.dtype(_TYPES[base]).itemsize
            if count:
                self._align(size)
            self.at += size * count
            return
        for index in range(count):
            self._node(of, f"{path}[{index}]", shown)
            if self.at > len(self._data):
                raise ValueError("the message is cut off")

    def _base(self, kind: str, path: str, shown: bool) -> None:
        if kind == "string":
            length = self._length()
            self.at += length
            return
        if kind not in _TYPES:
            raise ValueError(f"the type {kind} is not read")
        size = np.dtype(_TYPES[kind]).itemsize
        self._align(size)
        if shown:
            self.layout.fields[path] = (self.at, _TYPES[kind])
        self.at += size


class Columns:
    """The numbers of messages of one type as they come: each block of messages becomes rows of one array.

    Args:
        definitions: of the types.
        kind: the messages' type.
        flattened: the numbers of one message by their paths, for messages that no layout can be worked out of.
    """

    _BLOCK, _MOST_LAYOUTS = 2048, 16

    def __init__(self, definitions: Definitions, kind: str, flattened: Callable[[bytes], Mapping[str, float]]) -> None:
        self._definitions, self._kind, self._flattened = definitions, kind, flattened
        self._layouts: list[Layout] = []
        self._waiting: list[bytes] = []
        self._rows: list[Array] = []
        self.names: tuple[str, ...] | None = None

    def add(self, data: bytes) -> None:
        """A message."""
        self._waiting.append(data)
        if len(self._waiting) >= self._BLOCK:
            self._settle()

    def values(self, spare: int = 0) -> Array:
        """Give up all messages so far, shape (k, len(names) + spare); NaN where one lacks a field that the first one
        has, and in the spare columns behind.
        """
        self._settle()
        rows, self._rows = self._rows, []
        width = len(self.names or ())
        out = np.full((sum(map(len, rows)), width + spare), np.nan)
        first = 0
        for block in rows:
            out[first : first + len(block), :width] = block
            first += len(block)
        return out

    def _settle(self) -> None:
        waiting, self._waiting = self._waiting, []
        if not waiting:
            return
        if self.names is None:
            self.names = tuple(self._first_names(waiting[0]))
        out = np.full((len(waiting), len(self.names)), np.nan)
        by_size: dict[int, list[int]] = {}
        for index, data in enumerate(waiting):
            by_size.setdefault(len(data), []).append(index)
        for size, indices in by_size.items():
            block = np.frombuffer(b"".join(waiting[i] for i in indices), np.uint8).reshape(len(indices), size)
            self._fill(out, np.array(indices), block)
        self._rows.append(out)

    def _first_names(self, data: bytes) -> Sequence[str]:
        try:
            self._layouts.append(layout_of(self._definitions, self._kind, data))
            return list(self._layouts[0].fields)
        except ValueError:
            return list(self._flattened(data))

    def _fill(self, out: Array, rows: NDArray[np.int64], block: NDArray[np.uint8]) -> None:
        """Write the messages of one size into their rows."""
        left = np.arange(len(rows))
        for layout in self._layouts:
            left = self._by_layout(layout, out, rows, block, left)
        while len(left):
            data = block[left[0]].tobytes()
            try:
                layout = layout_of(self._definitions, self._kind, data)
            except ValueError:
                found = self._flattened(data)
                out[rows[left[0]]] = [found.get(name, np.nan) for name in self.names or ()]
                left = left[1:]
                continue
            if len(self._layouts) < self._MOST_LAYOUTS:
                self._layouts.append(layout)
            left = self._by_layout(layout, out, rows, block, left)

    def _by_layout(
        self, layout: Layout, out: Array, rows: NDArray[np.int64], block: NDArray[np.uint8], left: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Write those of the layout; the others are left."""
        if not len(left) or any(at + 4 > block.shape[1] for at, _ in layout.lengths):
            return left
        mine = np.all(block[left, :2] == np.frombuffer(_LITTLE, np.uint8), axis=1)
        for at, value in layout.lengths:
            mine &= _numbers(block, left, at, "<u4") == value
        these = left[mine]
        if len(these):
            for column, name in enumerate(self.names or ()):
                at, kind = layout.fields.get(name, (-1, ""))
                if kind:
                    out[rows[these], column] = _numbers(block, these, at, kind)
        return left[~mine]


def _numbers(block: NDArray[np.uint8], rows: NDArray[np.int64], at: int, kind: str) -> NDArray:
    return np.ascontiguousarray(block[rows, at : at + np.dtype(kind).itemsize]).view(kind)[:, 0]
