"""What the seven screens share: the bars, the footer, and how a status reaches them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import VerticalScroll
from textual.coordinate import Coordinate
from textual.screen import Screen
from textual.widgets import DataTable, Footer, Static

from groundstation.flight.messages import CoreStatus
from groundstation.texts import shown
from groundstation.tui.model import Station, owner
from groundstation.tui.widgets.bars import FlightBar, Tabs

WIDE = 120
"""Columns from which things stand side by side."""
MOST = 100_000
"""Characters of one text."""


class StationScreen(Screen[None]):
    """A screen of the ground station."""

    AUTO_FOCUS = ""  # no field takes the screens' keys before it is chosen
    MODE: ClassVar[str]
    HELP_TEXT: ClassVar[str]
    HORIZONTAL_BREAKPOINTS: ClassVar = [(0, "-narrow"), (WIDE, "-wide")]
    BINDINGS: ClassVar = [
        Binding("escape", "leave_field", "Leave the field", show=False),
        Binding("pagedown,space", "scroll_body(1)", "Further down", show=False),
        Binding("pageup", "scroll_body(-1)", "Further up", show=False),
    ]

    @property
    def station(self) -> Station:
        """What is chosen and what flies; the application owns it."""
        return owner(self.app).station

    def compose(self) -> ComposeResult:
        """Bars, body, footer."""
        yield Tabs(self.MODE)
        yield FlightBar()
        with VerticalScroll(id="body", can_focus=False):
            yield from self.body()
        yield Footer()

    def body(self) -> Iterable:
        """The widgets between the bars and the footer."""
        raise NotImplementedError

    def show_status(self, status: CoreStatus) -> None:
        """Show a flight as of its newest status."""

    def action_leave_field(self) -> None:
        """Give the keys back to the screen."""
        self.set_focus(None)

    def action_scroll_body(self, pages: int) -> None:
        """A page up or down; a screen that is just being opened has no body yet."""
        for body in self.query("#body").results(VerticalScroll):
            body.scroll_relative(y=pages * max(1, body.size.height - 2), animate=False)

    def say(self, selector: str, text: str) -> None:
        """Replace a text; one that is there already is not drawn again."""
        text = shown(text, limit=MOST, lines=True)
        widget = self.query_one(selector, Static)
        if widget.content != text:
            widget.update(text)


def fill(table: DataTable, header: Sequence[str], rows: Iterable[Sequence[str]], words: int = 1) -> None:
    """Replace a table's content; cells are text, never markup. An empty table takes no room.

    The first ``words`` columns hold words and align left, the others hold numbers and align right.
    Where only cells differ, only those are replaced: the table does not flicker.
    """
    rows = [tuple(shown(cell) for cell in row) for row in rows]
    header = tuple(shown(cell) for cell in header)
    same = [str(column.label) for column in table.ordered_columns] == list(header) and table.row_count == len(rows)
    if same:
        for index, row in enumerate(rows):
            for column, cell in enumerate(row):
                if str(table.get_cell_at(Coordinate(index, column))) != cell:
                    align = "left" if column < words else "right"
                    table.update_cell_at(Coordinate(index, column), Text(cell, justify=align), update_width=True)
        return

    def cells(row: Sequence[str]) -> list[Text]:
        return [Text(cell, justify="left" if index < words else "right") for index, cell in enumerate(row)]

    table.clear(columns=True)
    table.add_columns(*cells(header))
    for row in rows:
        table.add_row(*cells(row))
    table.display = table.row_count > 0
