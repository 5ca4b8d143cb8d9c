"""Flights: what lies in the logs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from textual.binding import Binding
from textual.widgets import DataTable, Input, Static

from groundstation.json_types import JsonObject
from groundstation.tui.documents import comparison, flight_row
from groundstation.tui.screens.base import StationScreen, fill

COLUMNS = ("UTC", "flight", "vehicle", "state", "verdict", "mass")


class Flights(StationScreen):
    """The catalogue."""

    MODE = "flights"
    HELP_TEXT = """\
Enter shows a flight on Identify and Diagnose; e opens its report in the browser. m marks a flight, and m on a second
one compares the two; w writes that comparison as a page. t sorts by the next column, / filters: only flights whose
line holds what is typed are shown. i identifies the flight under the cursor, d diagnoses it, r does both and writes
its report; v shows how the vehicle's parameters moved over its flights. g edits the flight's tags, n its note. b
does identification, diagnosis and report of every recording here that has no results yet."""
    BINDINGS: ClassVar = [
        Binding("m", "mark", "Compare"),
        Binding("t", "sort", "Sort", show=False),
        Binding("slash", "filter", "Filter", show=False),
        Binding("w", "compared", "Write"),
        Binding("e", "report", "Report"),
        Binding("i", "analyse('identify')", "Identify"),
        Binding("d", "analyse('identify,diagnose')", "Diagnose", show=False),
        Binding("r", "analyse('identify,diagnose,report')", "Analyse"),
        Binding("v", "trend", "Trend", show=False),
        Binding("g", "annotate('tags')", "Tags"),
        Binding("n", "annotate('note')", "Note"),
        Binding("b", "batch", "Batch", show=False),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._rows: list[dict[str, Any]] = []
        self._shown: list[dict[str, Any]] = []
        self._marked: dict[str, Any] | None = None
        self._compared: tuple[Path, ...] = ()
        self._sort = 0
        self._annotated = ""

    def body(self) -> Iterable:
        """Filter, table, comparison."""
        yield Input(placeholder="/ filter", id="filter", compact=True)
        annotation = Input(id="annotation", compact=True)
        annotation.display = False
        yield annotation
        yield DataTable(id="catalogue", cursor_type="row")
        yield Static("", id="flights-text", markup=False)
        yield DataTable(id="comparison", show_cursor=False)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Only what can be done now, with the flight under the cursor, is offered."""
        row = self._current() if self._shown else None
        if action == "compared":
            return bool(self._compared)
        if action == "analyse":
            return row is not None and _recording(row) is not None and row["state"] == "recorded"
        if action == "report":
            return row is not None and (Path(row["folder"]) / "report.html").is_file()
        if action in ("mark", "annotate", "trend"):
            return row is not None
        return True

    def on_data_table_row_highlighted(self) -> None:
        """The footer follows the cursor."""
        self.refresh_bindings()

    def on_screen_resume(self) -> None:
        """Read the logs again, on a thread."""
        self.run_worker(self._read, thread=True, exclusive=True, group="catalogue")

    def _read(self) -> None:
        from groundstation.fleet.catalogue import Catalogue

        rows = Catalogue(self.station.logs).rows()
        self.app.call_from_thread(self._fill, rows)

    def _fill(self, rows: list[JsonObject]) -> None:
        self._rows = rows
        self._list()
        typed = self.query_one("#filter", Input)
        if not self._shown and not typed.value:
            self.set_focus(None)  # nothing to walk through: the screens' keys are not the filter's
        elif not typed.has_focus:
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

    def on_input_changed(self, event: Input.Changed) -> None:
        """Filter as one types."""
        if event.input.id == "filter":
            self._list()

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Keep an annotation; back to the table."""
        if event.input.id == "annotation":
            self._keep_annotation(event.value)
        self.query_one("#catalogue", DataTable).focus()

    def action_annotate(self, what: str) -> None:
        """Type the tags (words) or the note of the flight under the cursor; enter keeps them."""
        row = self._current()
        if row is None:
            return
        self._annotated = what
        field = self.query_one("#annotation", Input)
        field.placeholder = "tags, separated by spaces; Enter keeps them" if what == "tags" else "note; Enter keeps it"
        field.value = " ".join(row["tags"] or ()) if what == "tags" else row["note"] or ""
        field.display = True
        field.focus()

    def _keep_annotation(self, text: str) -> None:
        from groundstation.fleet.rows import set_notes

        self.query_one("#annotation", Input).display = False
        row = self._current()
        if row is None:
            return
        if self._annotated == "tags":
            before, now = tuple(row["tags"] or ()), tuple(text.split())
            set_notes(Path(row["folder"]), add=now, remove=tuple(tag for tag in before if tag not in now))
        else:
            set_notes(Path(row["folder"]), note=text.strip())
        self.on_screen_resume()

    def action_trend(self) -> None:
        """How the parameters of the vehicle under the cursor moved over its flights."""
        if (row := self._current()) and row["vehicle"]:
            self.say("#flights-text", f"looking at all flights of {row['vehicle']} …")
            self.run_worker(lambda: self._trend(row["vehicle"]), thread=True, exclusive=True, group="trend")

    def _trend(self, vehicle: str) -> None:
        from groundstation.fleet.catalogue import Catalogue
        from groundstation.fleet.report import trend_lines

        lines = trend_lines(Catalogue(self.station.logs), vehicle)
        self.app.call_from_thread(self.say, "#flights-text", "\n".join(lines))

    def action_analyse(self, steps: str) -> None:
        """Identify, diagnose or report the recording under the cursor, in a process of its own."""
        row = self._current()
        recording = _recording(row) if row else None
        if recording is None:
            self.say("#flights-text", "this flight has no recording here")
            return
        run = partial(self._work, [str(recording)], tuple(steps.split(",")))
        self.run_worker(run, thread=True, group="batch", exclusive=True)

    def action_compared(self) -> None:
        """Write the comparison of the two flights as a page."""
        self.run_worker(self._write_comparison, thread=True, group="compare", exclusive=True)

    def _write_comparison(self) -> None:
        from groundstation.errors import BadInput
        from groundstation.reporting.compare import write_comparison

        try:
            told = f"written: {write_comparison(self.station.logs / 'compare.html', self._compared)}"
        except BadInput as error:
            told = str(error)
        self.app.call_from_thread(self.say, "#flights-text", told)

    def action_batch(self) -> None:
        """Identify, diagnose and report what has no results yet, in processes of their own."""
        self.run_worker(self._batch, thread=True, group="batch", exclusive=True)

    def _batch(self) -> None:
        from groundstation.fleet import batch

        sources = [str(path) for row in self._rows if row["state"] == "recorded" and (path := _recording(row))]
        if sources:
            self._work(sources, batch.STEPS)
        else:
            self.app.call_from_thread(self.say, "#flights-text", "every recording here has results")

    def _work(self, sources: list[str], steps: Sequence[str]) -> None:
        """On a thread: these recordings through these steps, told as it goes."""
        from groundstation.errors import BadInput
        from groundstation.fleet import batch

        def say(text: str) -> None:
            self.app.call_from_thread(self.say, "#flights-text", text)

        wanted = batch.tasks(sources, str(self.station.logs), None, steps)
        say(f"{', '.join(steps)}: {len(wanted)} recording{'s' if len(wanted) > 1 else ''} …")
        bad = []
        try:
            for number, result in enumerate(batch.results(wanted, workers=1), 1):
                bad += [f"{result.source}: {result.sentence}"] if result.state in ("bad", "failed") else []
                say("\n".join([f"analysed {number} of {len(wanted)}", *bad]))
        except BadInput as error:
            say(str(error))
        self.app.call_from_thread(self.on_screen_resume)

    def on_data_table_row_selected(self) -> None:
        """Show the flight on Identify."""
        if row := self._current():
            self.station.show_flight(Path(row["folder"]))
            self.app.switch_mode("identify")

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
        self.say("#flights-text", f"{first['flight']} against {row['flight']}; w writes it as a page")
        self._compared = (Path(first["folder"]), Path(row["folder"]))
        self.refresh_bindings()

    def action_report(self) -> None:
        """Open the report of the flight under the cursor."""
        if row := self._current():
            self.station.open_report(Path(row["folder"]))

    def _current(self) -> JsonObject | None:
        index = self.query_one("#catalogue", DataTable).cursor_row
        return self._shown[index] if 0 <= index < len(self._shown) else None


def _recording(row: JsonObject) -> Path | None:
    """The recording of a row, where it lies in the flight's folder."""
    path = Path(row["folder"]) / "flight.mcap"
    return path if path.is_file() else None
