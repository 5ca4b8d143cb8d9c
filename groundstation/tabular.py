"""Results as tables: rows for pandas, and an HTML table where a notebook shows one."""

from __future__ import annotations

import html
import importlib
import math
from collections.abc import Mapping, Sequence
from typing import Any

Record = Mapping[str, str | float | None]
"""One row: column name -> text, number, or None where there is none."""


class Tabular:
    """A result with rows. A subclass gives :meth:`records`; the rest follows."""

    __slots__ = ()

    def records(self) -> Sequence[Record]:
        """One mapping per row; the first column names the row, and every row has the same keys."""
        raise NotImplementedError

    def __str__(self) -> str:
        """The title and the rows, aligned."""
        rows = self.records()
        columns = list(rows[0]) if rows else []
        cells = [columns, *([_cell(row[name]) for name in columns] for row in rows)]
        widths = [max(len(line[i]) for line in cells) for i in range(len(columns))]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in cells
        ]
        return "\n".join([self._title(), *lines[: 1 + len(rows)]]) if rows else self._title()

    def to_frame(self) -> Any:
        """The rows as a ``pandas.DataFrame``, indexed by the first column.

        Raises:
            ImportError: pandas is not installed; ``records()`` and ``to_dict()`` need nothing.
        """
        try:
            pandas: Any = importlib.import_module("pandas")
        except ModuleNotFoundError:
            raise ImportError(
                "to_frame() needs pandas: pip install 'groundstation[notebook]'. records() and to_dict() work without "
                "it."
            ) from None
        rows = [dict(row) for row in self.records()]
        frame = pandas.DataFrame(rows)
        return frame.set_index(frame.columns[0]) if rows else frame

    def _title(self) -> str:
        """What stands above the table."""
        return type(self).__name__

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        """What IPython prints."""
        printer.text(str(self))

    def _repr_html_(self) -> str:
        """The table that a notebook shows."""
        rows = self.records()
        columns = list(rows[0]) if rows else []
        head = "".join(f"<th>{html.escape(name)}</th>" for name in columns)
        body = "".join(
            "<tr>" + "".join(f"<td>{html.escape(_cell(row[name]))}</td>" for name in columns) + "</tr>" for row in rows
        )
        title = f"<p><b>{html.escape(self._title())}</b></p>"
        return f"{title}<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _cell(value: str | float | None) -> str:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    return value if isinstance(value, str) else f"{value:.5g}"
