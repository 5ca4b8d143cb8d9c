"""Tables of numbers as people export them: encodings, comments, units below the names, empty cells, times of day.

A flight bundle is read strictly (:mod:`groundstation.recording.csvfile`). A table that a map explains may be
anybody's, so what can be told without a guess is read, and the rest is named.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.recording.csvfile import is_number, parse_csv, separator_of

Array = NDArray[np.float64]

_MISSING = frozenset({"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "<na>", "nat"})
_COMMENT = ("#", "%", "//")
_CLOCK = re.compile(
    r"(?:.*[ T])?(\d{1,2}):(\d{2}):(\d{2}(?:[.,]\d+)?)\s*([AaPp])?\.?(?:[Mm]\.?)?(?:Z|[+-]\d{2}:?\d{2})?"
)
_SPAN = re.compile(r"([-+]?\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?)\s*(us|µs|ms|s|sec|secs|seconds|min|hr)")
_SPANS = {"us": 1e-6, "µs": 1e-6, "ms": 1e-3, "min": 60.0, "hr": 3600.0}
_HALF_DAY_S = 43_200.0


@dataclass(frozen=True, slots=True)
class TableFile:
    """Columns of numbers by name, and the unit that a line below the names gives for each."""

    columns: dict[str, Array]
    units: dict[str, str]


def read_table(data: bytes, source: str) -> TableFile:
    """Columns of numbers; those of words are left out, and those of times become seconds.

    Raises:
        BadInput: there is no line of names, or a line has another number of cells.
    """
    text, units = _arranged(decoded(data))
    parsed = parse_csv(text.encode(), source)
    columns = dict(parsed.numbers)
    for name, cells in parsed.texts.items():
        found = _numbers(cells)
        if found is not None:
            columns[name] = found
    if not columns:
        raise BadInput(f"{source}: has no columns of numbers; its first line must name the columns, numbers follow.")
    return TableFile({name: columns[name] for name in parsed.names if name in columns}, units)


def read_columns(path: Path, wanted: Collection[str]) -> TableFile:
    """The columns of these names (all where none is named) of a file, a long one block by block.

    Raises:
        BadInput: as :func:`read_table`.
    """
    if path.stat().st_size >= _LARGE_BYTES and wanted:
        try:
            found = _in_blocks(path, wanted)
        except BadInput:
            found = None  # a fault is told of the whole file, with its line there
        if found is not None:
            return found
    return read_table(path.read_bytes(), str(path))


def _in_blocks(path: Path, wanted: Collection[str]) -> TableFile | None:
    """The wanted columns of a file block by block; None where only the whole file tells what it is.

    Of a file that lacks one, all columns of its first block: whoever asked is told what there is.
    """
    numbers: dict[str, list[Array]] = {name: [] for name in wanted}
    texts: dict[str, list[tuple[str, ...]]] = {name: [] for name in wanted}
    names, units = "", {}
    with path.open("rb") as file:
        while lines := file.readlines(_BLOCK):
            data = b"".join(lines)
            if not names and data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
                return None
            if not names:
                text, units = _arranged(decoded(data))
                names = text.partition("\n")[0]
            else:
                text = f"{names}\n{_with_newlines(decoded(data))}"
            block = parse_csv(text.encode(), str(path))
            if not {*block.numbers, *block.texts} >= set(wanted):
                return TableFile(block.numbers, units) if block.numbers else None
            for name in wanted:
                numbers[name].append(block.numbers[name].copy() if name in block.numbers else np.empty(0))
                texts[name].append(block.texts.get(name, ()))
    columns = {name: _column(numbers.pop(name), texts.pop(name)) for name in wanted}
    found = {name: column for name, column in columns.items() if column is not None}
    return TableFile(found, {name: units[name] for name in found if name in units}) if found else None


def _column(numbers: list[Array], texts: list[tuple[str, ...]]) -> Array | None:
    """A column of blocks that are numbers, or words that may be: times, or words for what is missing."""
    if not any(texts):
        return np.concatenate(numbers)
    cells = [cells or tuple(map(repr, values.tolist())) for values, cells in zip(numbers, texts, strict=True)]
    return _numbers(tuple(cell for block in cells for cell in block))


_LARGE_BYTES, _BLOCK = 1 << 22, 1 << 22


def decoded(data: bytes) -> str:
    """Text in UTF-8, UTF-16 (what Excel calls Unicode) or Windows' Western encoding, which a degree sign tells."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if error.start >= len(data) - 3:  # the beginning of a file, cut within a character
            return data[: error.start].decode("utf-8-sig")
        return data.decode("cp1252", "replace")


def _arranged(text: str) -> tuple[str, dict[str, str]]:
    """The text with its line of names first, and the units below it; other lines are blank and keep their number."""
    lines = _with_newlines(text).split("\n")
    first = next((i for i, line in enumerate(lines) if line.strip() and not line.lstrip().startswith(_COMMENT)), 0)
    names = lines[first]
    if _is_data(names):  # the names stand in a comment, as NumPy writes them
        above = next((lines[i] for i in range(first - 1, -1, -1) if lines[i].strip()), "")
        told = above.lstrip("".join(_COMMENT) + " ")
        if len(_cells(told)) != len(_cells(names)) or len(_cells(told)) < 2:
            return text, {}
        return "\n".join([told, *[""] * (first - 1), *lines[first:]]), {}
    units: dict[str, str] = {}
    below = next((i for i in range(first + 1, len(lines)) if lines[i].strip()), None)
    if below is not None and _is_units(lines, below, names):
        units = {
            n: u.strip("[]() ") for n, u in zip(_cells(names), _cells(lines[below]), strict=True) if u.strip("[]() ")
        }
        lines[below] = ""
    return "\n".join([names, *[""] * first, *lines[first + 1 :]]), units


def _with_newlines(text: str) -> str:
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _cells(line: str) -> list[str]:
    return [cell.strip().strip('"') for cell in line.split(separator_of(line))]


def _is_data(line: str) -> bool:
    cells = _cells(line)
    return len(cells) > 1 and is_number(cells[0]) and cells[0] != ""


def _is_units(lines: list[str], below: int, names: str) -> bool:
    """A line as wide as the names without a number or a time, above a line with some."""
    after = next((lines[i] for i in range(below + 1, len(lines)) if lines[i].strip()), "")
    words = _cells(lines[below])
    bare = not any(_value(cell) is not None for cell in words if cell.lower() not in _MISSING)
    return bare and len(words) == len(_cells(names)) and any(_value(c) is not None for c in _cells(after))


def _value(cell: str) -> float | None:
    """A cell as a number: plain, a time of day, or a span of time with its unit."""
    if cell and is_number(cell):
        return float(cell)
    if clock := _CLOCK.fullmatch(cell):
        return _of_day(clock)
    if span := _SPAN.fullmatch(cell):
        return float(span[1].replace(",", ".")) * _SPANS.get(span[2], 1.0)
    return None


def _of_day(clock: re.Match[str]) -> float:
    hour = float(clock[1])
    if clock[4]:
        hour = hour % 12.0 + (12.0 if clock[4] in "Pp" else 0.0)
    return hour * 3600.0 + float(clock[2]) * 60.0 + float(clock[3].replace(",", "."))


def _numbers(cells: tuple[str, ...]) -> Array | None:
    """Cells as numbers, words for missing ones as NaN; None where one is something else.

    Times of day go on over midnight, and over noon and midnight where a clock of twelve hours does not say which half
    it is.
    """
    stripped = [cell.strip() for cell in cells]
    kept = [cell for cell in stripped if cell.lower() not in _MISSING]
    values = [_value(cell) for cell in kept]
    if not kept or any(value is None for value in values):
        return None
    out = np.full(len(cells), np.nan)
    known = np.array([cell.lower() not in _MISSING for cell in stripped])
    found = np.array(values, dtype=float)
    if _CLOCK.fullmatch(kept[0]):
        halves = (
            not any(clock[4] for cell in kept if (clock := _CLOCK.fullmatch(cell))) and float(found.max()) < 46_800.0
        )
        back = np.diff(found, prepend=found[:1]) < -0.5 * _HALF_DAY_S
        found = found + np.cumsum(back) * (_HALF_DAY_S if halves else 2.0 * _HALF_DAY_S)
    out[known] = found
    return out
