"""Identify: how far the analysis is, then the parameters."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

from textual.binding import Binding
from textual.containers import Grid, Horizontal
from textual.widgets import DataTable, ProgressBar, Static

from groundstation.flight.messages import CoreStatus
from groundstation.flight.sequence import Phase
from groundstation.reporting.card import landing_card
from groundstation.reporting.units import label, scale_for, split_unit
from groundstation.tui.documents import identification_notes, live_rows, method_table, validation_rows
from groundstation.tui.results import FlightResults
from groundstation.tui.screens.base import WIDE, StationScreen, fill
from groundstation.tui.widgets.plots import Line, Plot

EVOLVING = ("mass_kg", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")


class Identify(StationScreen):
    """Parameters by method."""

    MODE = "identify"
    HELP_TEXT = """\
Comes up after landing. First the analysis and its preliminary estimates, then the table: each parameter by method
with its 95 % half width, the best method first, beside what the vehicle file declares. Below, why that method is the
best, the clocks' offset, what the flight does not reveal, and the errors with the nominal and with the identified
vehicle. The drawings show how the live estimates moved while it flew, between their 95 % intervals. e opens the
report in the browser. Choose another flight on the Flights screen (6)."""
    BINDINGS: ClassVar = [Binding("e", "report", "Report")]

    def __init__(self) -> None:
        super().__init__()
        self.results: FlightResults | None = None

    def body(self) -> Iterable:
        """Progress, tables, notes."""
        yield Static("no flight is identified yet; fly one (3), or choose one on Flights (6)", id="of", markup=False)
        yield ProgressBar(total=1.0, show_eta=False, id="analysis-progress")
        yield Static("", id="card", classes="panel", markup=False)
        yield DataTable(id="parameters", show_cursor=False)
        yield Static("", id="notes", classes="panel", markup=False)
        with Horizontal(classes="columns"):
            with Grid(id="evolution"):
                for name in EVOLVING:
                    yield Plot("", id=f"evolution-{name}")
            yield DataTable(id="validation", show_cursor=False)

    def show_status(self, status: CoreStatus) -> None:
        """While the analysis runs: how far it is, and its newest estimates."""
        running = status.phase in (Phase.LANDED, Phase.IDENTIFYING)
        bar = self.query_one(ProgressBar)
        bar.display = running
        if not running:
            return
        self.query_one("#card").display = False
        bar.update(progress=status.progress)
        self.say("#of", f"{status.flight}: {status.text or 'the analysis starts'}")
        self.say("#notes", "\n".join(status.notes[-3:]))
        fill(self.query_one("#validation", DataTable), (), ())
        if status.table:
            header = ("parameter", "nominal", "preliminary", "unit")
            fill(self.query_one("#parameters", DataTable), header, live_rows(status.table))

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Only what can be done now is offered."""
        results = self.station.results
        return action != "report" or (results is not None and results.report is not None)

    def show_results(self, results: FlightResults) -> None:
        """The results of a flight that was analysed, or why there are none."""
        document = results.identification
        self.query_one(ProgressBar).display = False
        self.say("#of", results.folder.name)
        planned = "next_flight.toml" if results.next_flight is not None else ""
        card = landing_card(document, results.diagnosis, results.declared, results.refusal, planned)
        self.query_one("#card").display = True
        self.say("#card", "\n".join(card))
        parameters, validation = self.query_one("#parameters", DataTable), self.query_one("#validation", DataTable)
        if not document:
            fill(parameters, (), ())
            fill(validation, (), ())
            self.query_one("#evolution").display = False
            self.say("#notes", "")
            return
        narrow = self.app.size.width < WIDE
        fill(parameters, *method_table(document, results.declared, 2 if narrow else len(document["methods"])))
        more = (
            f"{len(document['methods']) - 2} more methods: from {WIDE} columns on, and in the report (e)\n"
            if narrow
            else ""
        )
        self.say("#notes", more + identification_notes(document))
        fill(validation, ("check", "signal", "nominal", "identified", "change"), validation_rows(document))
        self._draw_evolution(results)

    def on_resize(self) -> None:
        """Show as many methods as there is room for."""
        if self.results is not None:
            self.show_results(self.results)

    def _draw_evolution(self, results: FlightResults) -> None:
        """Each parameter's live estimate over the flight, and its 95 % interval."""
        told = results.evolution.get("parameters", {})
        self.query_one("#evolution").display = any(column["t_s"] for column in told.values())
        for name in EVOLVING:
            plot, column = self.query_one(f"#evolution-{name}", Plot), told.get(name, {})
            plot.display = bool(column.get("t_s"))
            if plot.display:
                unit = scale_for(split_unit(name)[1], column["value"])
                lines = [
                    Line(column["t_s"], [unit.factor * v for v in column[key]]) for key in ("value", "low", "high")
                ]
                plot.border_title = f"{label(name)}, {unit.unit}, over s"
                plot.draw_interval(*lines)

    def action_report(self) -> None:
        """Open the report."""
        self.station.open_report()
