"""Flights: what lies in the logs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, ClassVar

from textual.binding import Binding
from textual.widgets import DataTable, Input, Static

from groundstation.tui.screens.base import StationScreen, fill
from groundstation.tui.text import comparison, flight_row

COLUMNS = ("UTC", "flight", "vehicle", "state", "verdict", "mass")


class Flights(StationScreen):
    """The catalogue."""

    MODE = "flights"
    HELP_TEXT = """\
Enter shows a flight on Identify and Diagnose; e opens its report in the browser. m marks a flight, and m on a second one
compares the two. t sorts by the next column, / filters: only flights whose line holds what is typed are shown."""
    BINDINGS: ClassVar = [
        Binding("m", "mark", "Mark / compare"),
        Binding("t", "sort", "Sort"),
        Binding("slash", "filter", "Filter"),
        Binding("e", "report", "Report"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._rows: list[dict[str, Any]] = []
        self._shown: list[dict[str, Any]] = []
        self._marked: dict[str, Any] | None = None
        self._sort = 0

    def body(self) -> Iterable:
        """Filter, table, comparison."""
        yield Input(placeholder="/ filter", id="filter", compact=True)
        yield DataTable(id="catalogue", cursor_type="row")
        yield Static("", id="flights-text", markup=False)
        yield DataTable(id="comparison", show_cursor=False)

    def on_screen_resume(self) -> None:
        """Read the logs again, on a thread."""
        self.run_worker(self._read, thread=True, exclusive=True, group="catalogue")

    def _read(self) -> None:
        from groundstation.fleet.catalogue import Catalogue

        rows = Catalogue(self.station.logs).rows()
        self.station.call_from_thread(self._fill, rows)

    def _fill(self, rows: list[dict[str, Any]]) -> None:
        self._rows = rows
        self._list()
        if not self.query_one("#filter", Input).has_focus:
            self.query_one("#catalogue", DataTable).focus()

    def _list(self) -> None:
        wanted = self.query_one("#filter", Input).value.strip().lower()
        told = [(flight_row(row), row) for row in self._rows]
        told = [(cells, row) for cells, row in told if wanted in " ".join(cells).lower()]
        if self._sort == 0:
            told.sort(key=lambda pair: pair[1]["date"], reverse=True)
        else:
            told.sort(key=lambda pair: pair[0][self._sort])
        self._shown = [row for _, row in told]
        fill(self.query_one("#catalogue", DataTable), COLUMNS, [cells for cells, _ in told], words=5)
        nothing = (
            "no flight matches" if self._rows else f"no flights in {self.station.logs} yet; r on Station makes one"
        )
        self.say("#flights-text", f"sorted by {COLUMNS[self._sort]}" if told else nothing)

    def on_input_changed(self) -> None:
        """Filter as one types."""
        self._list()

    def on_input_submitted(self) -> None:
        """Back to the table."""
        self.query_one("#catalogue", DataTable).focus()

    def on_data_table_row_selected(self) -> None:
        """Show the flight on Identify."""
        if row := self._current():
            self.station.show_flight(Path(row["folder"]))
            self.station.switch_mode("identify")

    def action_sort(self) -> None:
        """By the next column."""
        self._sort = (self._sort + 1) % len(COLUMNS)
        self._list()

    def action_filter(self) -> None:
        """Type a filter."""
        self.query_one("#filter", Input).focus()

    def action_mark(self) -> None:
        """Mark one, or compare with the marked one."""
        row = self._current()
        if row is None:
            return
        if self._marked is None or self._marked is row:
            self._marked = row
            self.say("#flights-text", f"marked {row['flight']}; m on another compares")
            return
        first, self._marked = self._marked, None
        header = ("parameter", "unit", first["flight"], row["flight"], "change")
        fill(self.query_one("#comparison", DataTable), header, comparison(first, row))
        self.say("#flights-text", f"{first['flight']} against {row['flight']}")

    def action_report(self) -> None:
        """Open the report of the flight under the cursor."""
        if row := self._current():
            self.station.open_report(Path(row["folder"]))

    def _current(self) -> dict[str, Any] | None:
        index = self.query_one("#catalogue", DataTable).cursor_row
        return self._shown[index] if 0 <= index < len(self._shown) else None
