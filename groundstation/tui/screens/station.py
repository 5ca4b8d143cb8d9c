"""Station: what is connected, how its streams do, and what flies next."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

from textual.binding import Binding
from textual.containers import Grid
from textual.widgets import Checkbox, DataTable, Input, Label, Select, Static

from groundstation.flight.messages import CoreStatus
from groundstation.tui.screens.base import StationScreen, fill
from groundstation.tui.setup import SIMULATOR, Setup, links, shipped
from groundstation.tui.text import ELSEWHERE, state_lines, stream_notes, stream_rows

STREAMS = ("stream", "rate", "age", "gap", "samples", "latency", "state")
WELCOME = """\
Nothing is connected. Two keys fly a simulated drone:
    r   rehearse: plan, upload and checks on the simulator
    s   start, as soon as everything is checked
After landing come the parameters, the diagnosis and the report. To fly a real vehicle, choose its link below, then \
r."""


class Station(StationScreen):
    """Links, streams, vehicle; the choice of what flies."""

    MODE = "station"
    HELP_TEXT = """\
Choose vehicle and link, then r to prepare a flight of it. The simulator needs nothing else. A serial port or UDP
address speaks MAVLink to a PX4 or ArduPilot vehicle; write another address into the field, e.g. tcp://host:5760.
The table shows each stream as the core records it: rate over the last second, age of the newest sample, the longest gap
so far, and the latency from stamp to arrival (where device clocks began at another time than this computer's, against
the stream with the least). Below it stands what is wrong
with a stream and what to do, and, once the excitation has turned the vehicle, how far the clocks of motion capture and
IMU are apart. Batches lost on the way and payloads that did not decode are counted."""
    BINDINGS: ClassVar = [Binding("r", "rehearse", "Prepare a flight")]

    def body(self) -> Iterable:
        """Streams on top, choices below."""
        yield Static(
            WELCOME if self.station.remote is None else ELSEWHERE, id="station-state", classes="panel", markup=False
        )
        yield DataTable(id="streams", show_cursor=False)
        yield Static("", id="station-notes", classes="panel", markup=False)
        with Grid(id="setup", classes="panel form"):
            setup = self.station.setup
            yield Label("vehicle")
            yield Select(
                _options(shipped("vehicles")), value=setup.vehicle, allow_blank=False, id="vehicle", compact=True
            )
            yield Label("link")
            yield Select(_options(links()), value=SIMULATOR, allow_blank=False, id="link", compact=True)
            yield Label("other link")
            yield Input(placeholder="e.g. tcp://host:5760", id="address", compact=True)
            yield Label("scenario")
            yield Select(
                _options(shipped("scenarios")), value=setup.scenario, allow_blank=False, id="scenario", compact=True
            )
            yield Label("pace")
            yield Checkbox("simulated flight at the wall clock's pace", setup.real_time, id="real-time", compact=True)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Only what can be done now is offered."""
        return action != "rehearse" or self.station.may_prepare

    def show_status(self, status: CoreStatus) -> None:
        """Streams and vehicle."""
        fill(self.query_one(DataTable), STREAMS, stream_rows(status))
        self.say("#station-state", state_lines(status))
        self.say("#station-notes", stream_notes(status))

    def on_select_changed(self) -> None:
        """Keep the choice."""
        self._keep()

    def on_checkbox_changed(self) -> None:
        """Keep the choice."""
        self._keep()

    def on_input_changed(self) -> None:
        """Keep the choice."""
        self._keep()

    def _keep(self) -> None:
        address = self.query_one("#address", Input).value.strip()
        self.station.setup = Setup(
            vehicle=str(self.query_one("#vehicle", Select).value),
            link=address or str(self.query_one("#link", Select).value),
            scenario=str(self.query_one("#scenario", Select).value),
            real_time=self.query_one("#real-time", Checkbox).value,
        )

    def action_rehearse(self) -> None:
        """Prepare a flight of what is chosen."""
        self.station.prepare_flight()


def _options(names: list[str]) -> list[tuple[str, str]]:
    return [(name, name) for name in names]
