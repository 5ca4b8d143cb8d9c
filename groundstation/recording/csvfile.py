"""Columns of numbers and texts from a CSV file and back: fast where a file is well formed, exact about where it is
not.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.recording.part import Part

Array = NDArray[np.float64]
_EXACT_INTEGER = 2.0**53
_BLOCK = 1 << 21
_WRITTEN = 1 << 14


@dataclass(frozen=True, slots=True)
class Columns:
    """Columns of a file: numbers by name, shape (k,), and texts by name."""

    names: tuple[str, ...]
    numbers: dict[str, Array]
    texts: dict[str, tuple[str, ...]]
    notes: tuple[str, ...] = ()


def parse_csv(
    data: bytes, source: str, required: frozenset[str] = frozenset(), texts: frozenset[str] = frozenset()
) -> Columns:
    """Parse a CSV file with a header line. An empty cell is a missing value, NaN.

    Args:
        data: the file.
        source: its path, for messages.
        required: columns that must hold numbers. Any other may hold texts, and is taken for texts also where it holds
            whole numbers beyond what a double holds exactly.
        texts: columns that are texts whatever they look like.

    Raises:
        BadInput: names file, line and column of what is wrong.
    """
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadInput(f"{source}: is not UTF-8 text (byte {error.start}); save it as plain CSV.") from None
    text = with_commas(text, source)
    head, _, body = text.partition("\n")
    names = tuple(name.strip().strip('"') for name in head.strip().split(","))
    _check_header(names, source)
    matrix = None if texts else _fast(body, len(names))
    if matrix is not None:
        extras = [i for i, name in enumerate(names) if name not in required]
        if not len(matrix) or not np.any(np.abs(matrix[:, extras]) >= _EXACT_INTEGER):
            return Columns(names, {name: matrix[:, i] for i, name in enumerate(names)}, {})
    return _careful(body, names, source, required, texts)


def columns_in(path: Path, required: frozenset[str], part: Part) -> Columns | None:
    """Columns of a large file, block by block, and of a part of its time alone; None where :func:`parse_csv` must look
    at it: it has texts, other separators, or whole numbers beyond what a double holds.
    """
    with path.open("rb") as file:
        first = file.readline()
        if separator_of(first.decode("utf-8-sig", "replace")) != ",":
            return None
        names = header(first)
        _check_header(names, str(path))
        if "t_s" not in names:
            return None
        at, last, kept = names.index("t_s"), -np.inf, []
        extras = [i for i, name in enumerate(names) if name not in required]
        while lines := file.readlines(_BLOCK):
            matrix = _fast(b"".join(lines).decode("ascii", "replace"), len(names))
            if matrix is None or (len(matrix) and np.any(np.abs(matrix[:, extras]) >= _EXACT_INTEGER)):
                return None
            mask, last = part.of(matrix[:, at], last)
            kept.append(matrix[mask])
    whole = np.concatenate(kept) if kept else np.empty((0, len(names)))
    return Columns(names, {name: whole[:, i].copy() for i, name in enumerate(names)}, {})


def header(data: bytes) -> tuple[str, ...]:
    """The names in a file's first line, whatever separates them."""
    first = data.split(b"\n", 1)[0].decode("utf-8-sig", "replace").strip()
    return tuple(name.strip().strip('"') for name in first.split(separator_of(first)))


def separator_of(first_line: str) -> str:
    """Comma, unless the first line has none and splits by semicolons or tabs."""
    return next((c for c in ",;\t" if c in first_line), ",")


def with_commas(text: str, source: str) -> str:
    """A table of semicolons or tabs, with decimal points or commas, as one of commas and points.

    Safe because the first line decides: it has no comma, so that commas below it can only be decimal.

    Raises:
        BadInput: cells hold both points and commas, which may be thousands.
    """
    separator = separator_of(text.partition("\n")[0])
    if separator == ",":
        return text
    reader = csv.reader(io.StringIO(text), delimiter=separator)
    try:
        rows = list(reader)
    except csv.Error as error:
        raise BadInput(f"{source}: line {reader.line_num + 1} is not CSV ({error}); correct it.") from None
    for number, row in enumerate(rows[1:], start=2):
        for index, cell in enumerate(row):
            if "," in cell and is_number(cell.replace(",", "").replace(".", "")):
                if "." in cell or cell.count(",") > 1:
                    raise BadInput(
                        f"{source}: line {number}: '{cell[:40]}' may be thousands or decimals; write numbers as "
                        "1234.5, or save the table with commas between the cells."
                    )
                row[index] = cell.replace(",", ".")
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()


def _check_header(names: tuple[str, ...], source: str) -> None:
    if names == ("",):
        raise BadInput(f"{source}: is empty; its first line must name the columns.")
    other = next((c for c in "| " if c in names[0]), None)
    if len(names) == 1 and other is not None:
        raise BadInput(
            f"{source}: line 1 names its columns with {'spaces' if other == ' ' else repr(other)} between; save the "
            "table with commas, semicolons or tabs."
        )
    try:
        float(names[0])
    except ValueError:
        pass
    else:
        raise BadInput(f"{source}: line 1 holds numbers; its first line must name the columns.")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise BadInput(
            f"{source}: column {twice[0] or '(without a name)'} stands twice in line 1; rename or remove one."
        )


def _fast(body: str, width: int) -> Array | None:
    """All cells as numbers, shape (k, width), or None where any is not one."""
    if not body.strip():
        return np.empty((0, width))
    try:
        matrix = np.loadtxt(io.StringIO(body), delimiter=",", ndmin=2, comments=None, dtype=float)
    except ValueError:
        return None
    return matrix if matrix.shape[1] == width else None


def _careful(
    body: str, names: tuple[str, ...], source: str, required: frozenset[str], as_texts: frozenset[str]
) -> Columns:
    """Cell by cell: tells line and column of what is no number, keeps texts, leaves out a last line that was cut
    off.
    """
    rows: list[list[str]] = []
    lines: list[int] = []
    reader = csv.reader(io.StringIO(body))
    notes: tuple[str, ...] = ()
    try:
        for row in reader:
            if row:
                rows.append(row)
                lines.append(reader.line_num + 1)
    except csv.Error as error:
        raise BadInput(f"{source}: line {reader.line_num + 1} is not CSV ({error}); correct it.") from None
    if rows and len(rows[-1]) < len(names) and not body.endswith("\n"):
        notes = (f"{source}: the last line was cut off and is left out.",)
        rows.pop()
    for line, row in zip(lines, rows, strict=False):
        if len(row) != len(names):
            raise BadInput(
                f"{source}: line {line} has {len(row)} cells where line 1 names {len(names)} columns; correct that "
                "line."
            )
    numbers: dict[str, Array] = {}
    texts: dict[str, tuple[str, ...]] = {}
    for index, name in enumerate(names):
        cells = [row[index] if name in as_texts else row[index].strip() for row in rows]
        column = None if name in as_texts else _numbers(cells, exact=name not in required)
        if column is not None:
            numbers[name] = column
        elif name in required:
            line = next(line for line, cell in zip(lines, cells, strict=False) if not is_number(cell))
            cell = cells[lines.index(line)]
            raise BadInput(f"{source}: line {line}, column {name}: '{cell[:40]}' is not a number; correct that cell.")
        else:
            texts[name] = tuple(cells)
    return Columns(names, numbers, texts, notes)


def is_number(cell: str) -> bool:
    """Whether a cell is a number, or empty."""
    try:
        float(cell or "nan")
    except ValueError:
        return False
    return "_" not in cell


def _numbers(cells: list[str], *, exact: bool) -> Array | None:
    """The cells as doubles; None where one is no number or, if ``exact``, would lose digits of a whole number."""
    if not all(map(is_number, cells)):
        return None
    column = np.array([float(cell or "nan") for cell in cells], dtype=float)
    return None if exact and np.any(np.abs(column) >= _EXACT_INTEGER) else column


def write_csv(path: Path, names: tuple[str, ...], columns: list[Array | tuple[str, ...]]) -> None:
    """Write columns under their names; a double is written with the digits that give it back exactly."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        words = any(isinstance(column, tuple) for column in columns)
        if words:
            writer.writerow(names)
        else:
            file.write(",".join(names) + "\n")
        for first in range(0, len(columns[0]) if columns else 0, _WRITTEN):
            part = [column[first : first + _WRITTEN] for column in columns]
            cells = [cells if isinstance(cells, tuple) else list(map(repr, cells.tolist())) for cells in part]
            if words:
                writer.writerows(zip(*cells, strict=True))
            else:
                file.writelines(",".join(row) + "\n" for row in zip(*cells, strict=True))
