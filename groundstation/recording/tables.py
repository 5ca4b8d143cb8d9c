"""Records of one kind in a binary log: columns that are gathered from the file when they are asked for."""

from __future__ import annotations

import mmap
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]


class MissingField(LookupError):
    """A field that a log lacks: it is of another version, or it was not logged. That is no damage."""

    def __init__(self, table: str, name: str):
        super().__init__(f"{table} of this log has no field {name}")


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of one kind in the file's order.

    Attributes:
        name: of the topic, message or event.
        instance: which of several of that name.
        fields: offset in the record, type as numpy writes it, and factor of each field.
        data: the file.
        where: where each record begins, shape (k,).
        clock: field that holds the time, and its ticks per second.
        units: of fields, as far as a file tells them beside their names.
    """

    name: str
    instance: int
    fields: Mapping[str, tuple[int, str, float]]
    data: Bytes = field(repr=False)
    where: NDArray[np.int64] = field(repr=False)
    clock: tuple[str, float] = ("timestamp", 1e6)
    units: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.where)

    def __contains__(self, name: str) -> bool:
        return name in self.fields

    def raw(self, name: str) -> NDArray:
        """A column in its own type, shape (k,).

        Raises:
            MissingField: these records have no such field.
        """
        if name not in self.fields:
            raise MissingField(self.name, name)
        offset, kind, _ = self.fields[name]
        return gather(self.data, self.where, kind, offset)

    def column(self, name: str) -> Array:
        """A column as doubles in its own unit, shape (k,).

        Raises:
            MissingField: these records have no such field, or have texts there.
        """
        own = self.raw(name)
        if own.dtype.kind == "S":
            raise MissingField(self.name, f"{name} with numbers")
        with np.errstate(invalid="ignore"):  # damaged bytes may be any NaN
            values = own.astype(float)
        factor = self.fields[name][2]
        return values if factor == 1.0 else values * factor

    def columns(self, *names: str) -> Array:
        """Several columns, shape (k, len(names))."""
        out = np.empty((len(self), len(names)))
        for index, name in enumerate(names):
            out[:, index] = self.column(name)
        return out

    def array(self, name: str, count: int) -> Array:
        """The elements of an array field, shape (k, count)."""
        return self.columns(*(f"{name}[{i}]" for i in range(count)))

    def seconds(self) -> Array:
        """The stamp of each record, shape (k,)."""
        return self.column(self.clock[0]) / self.clock[1]

    def rate_hz(self) -> float:
        """Median rate; 0 for fewer than two records."""
        return 1.0 / max(float(np.median(np.diff(self.seconds()))), 1e-6) if len(self) > 1 else 0.0

    def select(self, mask: NDArray[np.bool_]) -> Table:
        """The records where the mask holds."""
        return replace(self, where=self.where[mask])

    def first_of(self, choices: tuple[tuple[str, ...], ...]) -> Array:
        """The first of these sets of names that the records have whole: names by version, the newest first.

        Raises:
            MissingField: they have none of them.
        """
        names = next((names for names in choices if all(name in self for name in names)), choices[0])
        return self.columns(*names)


def table_of(
    name: str, columns: Mapping[str, Array], clock: tuple[str, float], units: Mapping[str, str] | None = None
) -> Table:
    """Columns that are in memory already as a table, with the units that are told of them."""
    matrix = np.ascontiguousarray(np.column_stack(list(columns.values())), dtype="<f8")
    return table_of_rows(name, matrix, {field: i for i, field in enumerate(columns)}, clock, units)


def table_of_rows(
    name: str,
    matrix: Array,
    places: Mapping[str, int],
    clock: tuple[str, float],
    units: Mapping[str, str] | None = None,
) -> Table:
    """The same of rows, shape (k, c), contiguous, and the column that each field is: nothing is copied."""
    fields = {field: (8 * place, "<f8", 1.0) for field, place in places.items()}
    where = np.arange(len(matrix), dtype=np.int64) * 8 * matrix.shape[1]
    return Table(name, 0, fields, matrix.reshape(-1).view(np.uint8), where, clock, units or {})


_AT_ONCE = 1 << 18
"""Records that are gathered together: their places, eight bytes each, are what a column costs besides itself."""
_SPAN = 1 << 24
"""Bytes of a mapped file after which its pages are given back; a long log's are most of what it takes else."""


def gather(data: Bytes, where: NDArray[np.int64], kind: str | np.dtype, offset: int = 0) -> NDArray:
    """Values of a type that begin ``offset`` bytes after these places, which rise, shape (k,)."""
    dtype = np.dtype(kind)
    out = np.empty((len(where), dtype.itemsize), np.uint8)
    first, since = 0, int(where[0]) if len(where) else 0
    while first < len(where):
        end = min(first + _AT_ONCE, max(first + 1, int(np.searchsorted(where, where[first] + _SPAN))))
        places = where[first:end] + offset
        for byte in range(dtype.itemsize):
            out[first:end, byte] = data[places + byte]
        if where[end - 1] - since > _SPAN:
            forget_pages(data)
            since = int(where[end - 1])
        first = end
    return out.reshape(-1).view(dtype)


def forget_pages(data: Bytes) -> None:
    """Give back the memory that holds what was read of a mapped file; it is read again where it is asked for."""
    mapped = getattr(data, "_mmap", None)
    if isinstance(mapped, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        mapped.madvise(mmap.MADV_DONTNEED)
