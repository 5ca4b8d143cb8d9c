"""Fly: the checks, the flight as it goes, and the first estimates."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import ClassVar

from textual.binding import Binding
from textual.containers import Horizontal, Vertical
from textual.widgets import DataTable, Static

from groundstation.flight.messages import CoreStatus
from groundstation.flight.sequence import IN_FLIGHT, Phase
from groundstation.tui.checks import checklist
from groundstation.tui.documents import live_rows, motor_lines
from groundstation.tui.screens.base import WIDE, StationScreen, fill
from groundstation.tui.text import PHASES, margin_lines, state_lines
from groundstation.tui.widgets.plots import Line, Plot

WAITING = "No flight is prepared.\n\nr prepares one of the vehicle chosen on the Station screen (1), with the plan of the Plan screen (2)."
POINTS = 300


class Fly(StationScreen):
    """One flight."""

    MODE = "fly"
    HELP_TEXT = """\
r prepares a flight: the vehicle's process starts, takes the plan, and everything is checked; each check says what was
seen, what to do where it failed, and why it is looked at. s starts it; on a real
vehicle only after FLY is typed. b lands early and uses what was recorded. ^g aborts and lands; everyone may, from
everywhere. Closing or killing this program does not end a flight: the plan is completed and the vehicle lands, and the
program started again finds it. o takes the operator's lease from another."""
    BINDINGS: ClassVar = [
        Binding("s", "start", "Start"),
        Binding("b", "land", "Land early"),
        Binding("r", "rehearse", "Prepare"),
        Binding("o", "operate", "Take the lease", show=False),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._motors_top = 0.0

    def body(self) -> Iterable:
        """State and checks beside the plots."""
        yield Static("no flight", id="big-state", markup=False)
        with Horizontal(id="fly-columns"):
            with Vertical(id="fly-left"):
                yield Static(WAITING, id="checks", classes="panel", markup=False)
                yield Static("", id="fly-state", classes="panel", markup=False)
                yield Static("", id="margins", classes="panel", markup=False)
                yield Static("", id="motors", classes="panel", markup=False)
            with Vertical(id="fly-right"):
                yield DataTable(id="live", show_cursor=False)
                yield Plot("y over x, m: line planned, + flown", id="xy-plot", span=(0.2, 0.2))
                yield Plot("off the plan, cm, over s", id="error-plot", span=(2.0, 1.0))
                yield Plot("° over s: line roll, + pitch", id="attitude-plot", span=(2.0, 1.0))

    def show_status(self, status: CoreStatus) -> None:
        """Everything of the newest status, and the plots of those before."""
        flying = status.phase in IN_FLIGHT
        left = f"   {status.time_left_s:.0f} s left" if flying else ""
        self.say("#big-state", f"{status.phase.upper()}{left}   {PHASES.get(status.phase, '')}")
        self.say("#checks", checklist(status))
        started = status.flight_s > 0.0 or flying
        self.query_one("#checks").display = not flying
        for selector in ("#fly-state", "#motors", "#margins", "#fly-right"):
            self.query_one(selector).display = started
        if started:
            self._motors_top = max([self._motors_top, *status.motors])
            self.say("#fly-state", state_lines(status))
            self.say("#margins", margin_lines(status, *self.station.limits()))
            self.say("#motors", motor_lines(status.motors, self._motors_top))
            self._draw()
        live = self.query_one("#live", DataTable)
        live.display = bool(status.table)
        if status.table:
            rows = live_rows(status.table)
            if self.app.size.width < WIDE:
                fill(live, ("so far", "estimate, 95 %", "unit"), [(row[0], *row[2:]) for row in rows])
            else:
                fill(live, ("so far", "nominal", "estimate, 95 %", "unit"), rows)

    def _draw(self) -> None:
        watch = self.station.core
        if watch is None:
            return
        seen = [s for s in list(watch.history) if s.flight_s > 0.0 and s.phase in IN_FLIGHT]
        seen = seen[:: max(1, len(seen) // POINTS)]
        if len(seen) < 2:
            return
        t_s = [s.flight_s for s in seen]
        self.query_one("#error-plot", Plot).draw([Line(t_s, [100.0 * s.tracking_error_m for s in seen])])
        self.query_one("#xy-plot", Plot).draw(
            [
                Line([s.setpoint_m[0] for s in seen], [s.setpoint_m[1] for s in seen]),
                Line([s.position_m[0] for s in seen], [s.position_m[1] for s in seen]),
            ]
        )
        angles = [[math.degrees(s.euler_rad[axis]) for s in seen] for axis in (0, 1)]
        self.query_one("#attitude-plot", Plot).draw([Line(t_s, angles[0]), Line(t_s, angles[1])])

    def action_start(self) -> None:
        """Start as soon as everything is checked."""
        self.station.start_flight()

    def action_land(self) -> None:
        """Land, and use what was recorded."""
        self.station.order("land", "landing early")

    def action_rehearse(self) -> None:
        """Prepare a flight of what is chosen."""
        self.station.prepare_flight()

    def action_operate(self) -> None:
        """Become the operator."""
        self.station.take_lease()

    @property
    def ready(self) -> bool:
        """The flight waits for its start."""
        status = self.station.core.newest if self.station.core else None
        return status is not None and status.phase == Phase.CHECKED
