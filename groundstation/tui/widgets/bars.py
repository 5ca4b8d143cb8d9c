"""The two lines at the top of every screen: the seven screens, and the flight with abort and kill."""

from __future__ import annotations

from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.widgets import Button, Static

from groundstation.flight.messages import CoreStatus
from groundstation.flight.sequence import IN_FLIGHT
from groundstation.texts import shown
from groundstation.tui.model import owner
from groundstation.tui.text import PHASES

REFRESH_S = 1.0 / 6.0
SCREENS = {
    "station": "Station",
    "plan": "Plan",
    "fly": "Fly",
    "identify": "Identify",
    "diagnose": "Diagnose",
    "flights": "Flights",
    "campaign": "Campaign",
}
"""Modes of the application, in the order of their number keys, and their titles."""


class Tabs(Horizontal):
    """The seven screens by number; a click opens one."""

    def __init__(self, current: str):
        super().__init__(id="tabs")
        self._current = current

    def compose(self) -> ComposeResult:
        """One label per screen."""
        for number, (mode, title) in enumerate(SCREENS.items(), 1):
            here = mode == self._current
            text = f"[{number} {title}]" if here else f" {number} {title} "
            yield Tab(text, mode, classes="here" if here else "")


class Tab(Static):
    """A label that opens a screen."""

    def __init__(self, text: str, mode: str, classes: str):
        super().__init__(text, classes=f"tab {classes}", markup=False)
        self._mode = mode

    def on_click(self) -> None:
        """Open it."""
        self.app.switch_mode(self._mode)


class FlightBar(Horizontal):
    """What flies and how it does; abort and kill for the mouse, with their keys."""

    def compose(self) -> ComposeResult:
        """The line and the two buttons."""
        yield Static("nothing flies", id="flight-line", markup=False)
        yield Button("ABORT + LAND ^g", id="abort", classes="order", compact=True)
        yield Button("KILL ^o", id="kill", classes="order", compact=True)

    def on_mount(self) -> None:
        """Follow the flight; the buttons never take the focus from what the keyboard is used for."""
        for button in self.query(Button):
            button.can_focus = False
        self._refresh_line()
        self.set_interval(REFRESH_S, self._refresh_line)

    async def on_button_pressed(self, event: Button.Pressed) -> None:
        """The same as the keys."""
        event.stop()
        await self.app.run_action("abort" if event.button.id == "abort" else "kill")

    def _refresh_line(self) -> None:
        """As of the newest status."""
        station = owner(self.app).station
        watch = station.core
        status = watch.newest if watch else None
        text = flight_line(
            status,
            operator=watch.operator if watch else True,
            silent_s=watch.silent_s if watch else 0.0,
            fault=station.trouble or (watch.fault if watch else ""),
        )
        self.set_class(status is not None and status.phase in IN_FLIGHT, "airborne")
        text = shown(f"{watch.place} · {text}" if watch and watch.place else text)
        line = self.query_one("#flight-line", Static)
        if line.content != text:
            line.update(text)


def flight_line(status: CoreStatus | None, *, operator: bool, silent_s: float, fault: str) -> str:
    """The flight in one line; what is wrong comes first."""
    if fault:
        return f"! {fault}"
    if status is None:
        return "nothing flies"
    line = f"{status.vehicle} · {PHASES.get(status.phase, status.phase)}"
    if silent_s:
        return f"! the core is silent for {silent_s:.0f} s; the vehicle completes its plan · {line}"
    if status.phase in IN_FLIGHT:
        line = f"{status.phase.upper()} {status.time_left_s:.0f} s left · {status.vehicle}"
    if status.reason:
        line = f"{line} · {status.reason}"
    if status.lease and not operator:
        line += " · watching, another is the operator (o takes over)"
    return line
