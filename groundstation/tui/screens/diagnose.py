"""Diagnose: what the declared vehicle lacks, and what to fly next."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

from textual.binding import Binding
from textual.widgets import DataTable, Static

from groundstation.tui.documents import error_rows, finding_text, suspect_rows
from groundstation.tui.model import owner
from groundstation.tui.results import FlightResults
from groundstation.tui.screens.base import StationScreen, fill


class Diagnose(StationScreen):
    """Findings and residuals of one flight."""

    MODE = "diagnose"
    HELP_TEXT = """\
The findings in sentences with their confidence; what is left unexplained, and what it varies with; the error of the
prediction by channel on the part of the flight that was held out: with nominal values, with identified ones, and with
the findings. The suspects are the effects that were tried, with the evidence for them. n plans the next flight."""
    BINDINGS: ClassVar = [
        Binding("n", "next_flight", "Plan the next flight"),
        Binding("e", "report", "Report"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self.results: FlightResults | None = None

    def body(self) -> Iterable:
        """Findings, errors, suspects."""
        yield Static(
            "no flight is diagnosed yet; fly one (3), or choose one on Flights (6)",
            id="findings",
            classes="panel",
            markup=False,
        )
        yield DataTable(id="errors", show_cursor=False)
        yield DataTable(id="suspects", show_cursor=False)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Only what can be done now is offered."""
        results = self.station.results
        if action == "report":
            return results is not None and results.report is not None
        return action != "next_flight" or results is not None

    def show_results(self, results: FlightResults) -> None:
        """The diagnosis of a flight, or why there is none."""
        document = results.diagnosis
        errors, suspects = self.query_one("#errors", DataTable), self.query_one("#suspects", DataTable)
        fill(errors, ("error of", "nominal", "identified", "with findings", "change"), error_rows(document))
        fill(suspects, ("suspect", "settings", "evidence"), suspect_rows(document))
        if not document:
            self.say("#findings", results.refusal or f"{results.folder.name} has no diagnosis")
            return
        self.say("#findings", f"{results.folder.name}\n{finding_text(document)}")

    def action_next_flight(self) -> None:
        """Plan a flight of the same vehicle."""
        owner(self.app).plan_next()

    def action_report(self) -> None:
        """Open the report."""
        self.station.open_report()
