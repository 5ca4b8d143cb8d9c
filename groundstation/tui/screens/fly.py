"""Fly: the checks and the plan before a flight, then the room, the distances to the guard's limits, and the first
estimates.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

import numpy as np
from rich.text import Text
from textual.binding import Binding
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.widgets import DataTable, Static

from groundstation.flight.messages import CoreStatus
from groundstation.flight.sequence import FINAL, IN_FLIGHT, Phase
from groundstation.tui.charts import offered, values, words
from groundstation.tui.checks import checklist
from groundstation.tui.documents import live_rows, motor_lines, plan_lines, until_lines
from groundstation.tui.margins import health, margin_text, margins
from groundstation.tui.screens.base import WIDE, StationScreen, fill
from groundstation.tui.text import ELSEWHERE, PHASES, state_lines
from groundstation.tui.widgets.dialogs import Choice
from groundstation.tui.widgets.plots import Line, Plot
from groundstation.tui.widgets.room import RoomView

WAITING = (
    "No flight is prepared.\n\nr prepares one of the vehicle chosen on the Station screen (1), with the plan of the "
    "Plan screen (2)."
)
POINTS = 300
HUGE = 180
"""Columns from which charts stand beside the room."""
BEFORE = (Phase.IDLE, Phase.PLANNED, Phase.UPLOADED, Phase.CHECKED)
FIXED_CHARTS = {"error-plot": ("off plan, cm",), "attitude-plot": ("roll, °", "pitch, °")}


class Fly(StationScreen):
    """One flight."""

    MODE = "fly"
    HORIZONTAL_BREAKPOINTS: ClassVar = [(0, "-narrow"), (WIDE, "-wide"), (HUGE, "-huge")]
    HELP_TEXT = """\
r prepares a flight: the vehicle's process starts, takes the plan, and everything is checked; each check says what
was seen, what to do where it failed, and why it is looked at. The plan that will be flown is drawn before. s starts
it; on a real vehicle only after FLY is typed. b lands early, ^g aborts and lands (everyone may, from everywhere);
both keep what was flown, and it is analysed. Where a flight lasts until something is known (station or vehicle file,
[until]), u agrees to what is proposed: to end at the next rest point, or to go on for a period, never past what was
checked. Closing or killing this program does not end a flight: the plan is completed and the vehicle lands, and the
program started again finds it. o takes the operator's lease from another. The bars show how much of each limit of
the guard is used; a word, a colour and the terminal's bell tell when one is near. The guard acts at the station
file's limits; a simulated drone has no guard, and is shown against the same limits. The room is to scale, from above
and from the side: grey the plan, blue what was flown, ◉ the vehicle, + where it should be; z goes between the plan's
room, the path close up, and all of the guard's box. c chooses signals for the chart: any that is recorded."""
    BINDINGS: ClassVar = [
        Binding("s", "start", "Start"),
        Binding("b", "land", "Land early"),
        Binding("u", "agree", "Agree"),
        Binding("r", "rehearse", "Prepare"),
        Binding("o", "operate", "Take the lease"),
        Binding("c", "charts", "Chart"),
        Binding("z", "whole", "Zoom"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._motors_top = 0.0
        self._charted: list[str] = []

    def body(self) -> Iterable:
        """State and checks beside the room and the charts."""
        yield Static("no flight", id="big-state", markup=False)
        with Horizontal(id="fly-columns"):
            with VerticalScroll(id="fly-left", can_focus=False):
                yield Static(
                    WAITING if self.station.remote is None else ELSEWHERE, id="checks", classes="panel", markup=False
                )
                yield Static("", id="margins", classes="panel", markup=False)
                yield DataTable(id="live", show_cursor=False)
                yield Static("", id="until", classes="panel", markup=False)
                yield Static("", id="motors", classes="panel", markup=False)
                yield Static("", id="fly-state", classes="panel", markup=False)
            with Vertical(id="fly-middle"):
                yield Static("", id="preview", classes="panel", markup=False)
                yield RoomView("room")
            with Vertical(id="fly-right"):
                for name, signals in FIXED_CHARTS.items():
                    yield Plot(" + ".join(signals), id=name, span=(2.0, 1.0))
                yield Plot("", id="chart", span=(2.0, 0.0))

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Only what can be done now is offered."""
        station, phase = self.station, self.station.phase
        if action == "start":
            return station.preparing or (station.flying and (not phase or phase in BEFORE))
        if action == "land":
            return phase in IN_FLIGHT
        if action == "rehearse":
            return station.may_prepare
        if action == "operate":
            return station.may_take_lease
        if action == "agree":
            return station.may_agree
        return True

    def show_status(self, status: CoreStatus) -> None:
        """Everything of the newest status, and the plots of those before."""
        flying = status.phase in IN_FLIGHT
        started = status.flight_s > 0.0 or flying
        before = not started and status.phase not in FINAL
        self.say("#big-state", f"{status.phase.upper()}   {PHASES.get(status.phase, '')}")
        self.query_one("#big-state").display = not flying
        self.say("#checks", checklist(status))
        self.query_one("#checks").display = not flying
        for selector in ("#margins", "#motors"):
            self.query_one(selector).display = started
        self.query_one("#fly-state").display = started and self.size.width >= WIDE
        self.query_one("#fly-right").display = started and self.size.width >= WIDE
        self.query_one("#preview").display = before
        self.query_one("#fly-middle").display = started or before
        if before and self.station.plan is not None:
            self.say("#preview", plan_lines(self.station.plan))
        if started:
            self._show_numbers(status)
        self._draw(status, flying)
        self._show_live(status)

    def _show_numbers(self, status: CoreStatus) -> None:
        self._motors_top = max([self._motors_top, *status.motors])
        limits = self.station.limits
        text = margin_text(margins(status, limits))
        text.append(f"\nheight   {status.position_m[2]:>7.2f} m\n")
        self.query_one("#margins", Static).update(Text.assemble(text, health(status)))
        self.say("#motors", motor_lines(status.motors, self._motors_top))
        self.say("#fly-state", state_lines(status))

    def _show_live(self, status: CoreStatus) -> None:
        live = self.query_one("#live", DataTable)
        live.display = bool(status.table)
        if status.table:
            rows = live_rows(status.table)
            if self.app.size.width < WIDE:
                fill(live, ("so far", "estimate, 95 %"), [(f"{row[0]}, {row[3]}", row[2]) for row in rows])
            else:
                fill(live, ("so far", "nominal", "estimate, 95 %", "unit"), rows)

        told = until_lines(status)
        self.query_one("#until").display = bool(told)
        self.say("#until", told)

    def _draw(self, status: CoreStatus, flying: bool) -> None:
        watch = self.station.core
        seen = [s for s in list(watch.history) if s.flight_s > 0.0 and s.phase in IN_FLIGHT] if watch else []
        seen = seen[:: max(1, len(seen) // POINTS)]
        flown = np.array([s.position_m for s in seen]).reshape(-1, 3)
        room = self.query_one("#room", RoomView)
        room.show(
            self.station.limits,
            flown,
            np.array(status.position_m) if flying else None,
            np.array(status.setpoint_m) if flying else None,
        )
        if len(seen) < 2:
            return
        for name, signals in FIXED_CHARTS.items():
            plot = self.query_one(f"#{name}", Plot)
            plot.display = self.size.width >= HUGE
            if plot.display:
                _chart(plot, signals, seen)
        _chart(self.query_one("#chart", Plot), self._charted or ["height, m"], seen)

    def action_start(self) -> None:
        """Start as soon as everything is checked."""
        self.station.start_flight()

    def action_land(self) -> None:
        """Land, and use what was recorded."""
        self.station.order("land", "landing early")

    def action_agree(self) -> None:
        """Take what a flight until known proposes."""
        self.station.order("agree", "agreed")

    def action_rehearse(self) -> None:
        """Prepare a flight of what is chosen."""
        self.station.prepare_flight()

    def action_operate(self) -> None:
        """Become the operator."""
        self.station.take_lease()

    def action_whole(self) -> None:
        """The plan's room, the path close up, or all of the guard's box."""
        self.query_one("#room", RoomView).next_zoom()
        self._again()

    def action_charts(self) -> None:
        """Choose what the chart shows."""
        newest = self.station.core.newest if self.station.core else None
        names = [(words(name), name) for name in offered(newest)]
        self.app.push_screen(Choice("Signals for the chart, up to three", names, self._charted), self._chosen)

    def _chosen(self, names: list[str] | None) -> None:
        if names is not None:
            self._charted = names
            self._again()

    def on_resize(self) -> None:
        """Show what there is room for."""
        self._again()

    def _again(self) -> None:
        if self.station.core is not None and self.station.core.newest is not None:
            self.show_status(self.station.core.newest)

    @property
    def ready(self) -> bool:
        """The flight waits for its start."""
        status = self.station.core.newest if self.station.core else None
        return status is not None and status.phase == Phase.CHECKED


def _chart(plot: Plot, signals: Iterable[str], seen: list[CoreStatus]) -> None:
    """Signals over the flight's time, the first as a line."""
    names = list(signals)
    t_s = np.array([s.flight_s for s in seen])
    lines = []
    for name in names:
        y = np.array(values(name, seen), dtype=float)
        known = np.isfinite(y)
        if known.any():
            lines.append(Line(t_s[known], y[known]))
    marks = ("line", "+", "×")
    title = "; ".join(f"{mark} {words(name)}" for mark, name in zip(marks, names, strict=False))
    plot.border_title = f"{title if len(names) > 1 else words(names[0])}, over s"
    if lines:
        plot.draw(lines)
