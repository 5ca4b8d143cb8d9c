"""Campaign: flight after flight until it is known; the rounds, what each settled, and what is next."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from textual.binding import Binding
from textual.widgets import DataTable, Static

from groundstation.errors import BadInput, GroundStationError
from groundstation.tui.documents import round_row, rounds_text
from groundstation.tui.screens.base import StationScreen, fill

if TYPE_CHECKING:
    from groundstation.campaign.campaign import Campaign as Stand

COLUMNS = ("flight", "s", "verdict", "found", "farthest from its target", "rate error, unseen")
NONE = "no campaign yet; b begins one with the vehicle of the Station screen (1), c shows the one before"


class Campaign(StationScreen):
    """One campaign of those in the logs."""

    MODE = "campaign"
    HELP_TEXT = """\
A campaign flies until the targets are met, nothing is missing and the model predicts a flight that it has not seen.
Each row is a flight: what all flights so far show, how far the worst parameter is from its target, and the error of
the body rate on that flight before it was used, without and with the effects. n does what is next: it takes in the
flight that was flown, decides what to fly, and prepares it on Fly (3), where s starts it; on a real vehicle FLY is
typed for every flight, and a battery may be changed before. b begins a campaign, c shows the one before, e opens its
report. `groundstation campaign` does the same on the command line, and either goes on with the other's."""
    BINDINGS: ClassVar = [
        Binding("n", "next_flight", "Next flight"),
        Binding("b", "begin", "Begin"),
        Binding("c", "other", "Other"),
        Binding("e", "report", "Report"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._stand: Stand | None = None
        self._back = 0
        self._busy = False

    def body(self) -> Iterable:
        """How it stands, the rounds, and what is being done."""
        yield Static(NONE, id="campaign-text", classes="panel", markup=False)
        yield DataTable(id="rounds", show_cursor=False)
        yield Static("", id="campaign-said", markup=False)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Only what can be done now is offered."""
        if action == "next_flight":
            return self._stand is not None and not self._stand.outcome and not self._busy and not self.station.flying
        if action == "begin":
            return not self._busy
        if action == "report":
            return self._stand is not None and (self._stand.folder / "report.html").is_file()
        return True

    def on_screen_resume(self) -> None:
        """Read the newest campaign again."""
        self.run_worker(self._read, thread=True, exclusive=True, group="campaign-read")

    def _read(self) -> None:
        from groundstation.campaign.campaign import FILE, load_campaign

        folders = sorted((file.parent for file in self.station.logs.glob(f"*/{FILE}")), reverse=True)
        try:
            stand = load_campaign(folders[self._back % len(folders)]) if folders else None
        except BadInput as error:
            self.app.call_from_thread(self.say, "#campaign-said", str(error))
            return
        self.app.call_from_thread(self._show, stand)

    def _show(self, stand: Stand | None) -> None:
        self._stand = stand
        self.say("#campaign-text", NONE if stand is None else rounds_text(stand))
        rows = [] if stand is None else [round_row(number, done) for number, done in enumerate(stand.rounds, 1)]
        fill(self.query_one("#rounds", DataTable), COLUMNS, rows, words=1)
        self.refresh_bindings()

    def action_other(self) -> None:
        """Show the campaign before."""
        self._back += 1
        self.on_screen_resume()

    def action_begin(self) -> None:
        """Begin a campaign with the vehicle of the Station screen."""
        self._work(self._begin)

    def action_next_flight(self) -> None:
        """Take in what was flown, decide, prepare."""
        self._work(self._next)

    def action_report(self) -> None:
        """Open the campaign's page."""
        if self._stand is not None:
            self.station.open_page(self._stand.folder / "report.html")

    def _work(self, job: Any) -> None:
        if self._busy:
            return

        def guarded() -> None:
            self._busy = True
            try:
                job()
            except (GroundStationError, OSError) as error:
                self._report(str(error))
            finally:
                self._busy = False
                self.app.call_from_thread(self.on_screen_resume)

        self.run_worker(guarded, thread=True, group="campaign")

    def _report(self, text: str) -> None:
        self.app.call_from_thread(self.say, "#campaign-said", text)

    def _begin(self) -> None:
        from groundstation.campaign.campaign import begin
        from groundstation.targets import DEFAULT

        setup = self.station.setup
        self._back = 0
        stand = begin(self.station.logs, setup.vehicle, DEFAULT, seed=setup.seed)
        self._report(f"begun: {DEFAULT} within {stand.at_most} flights; n plans the first")

    def _next(self) -> None:
        from groundstation.campaign.campaign import advance, autopilot_limits, was_flown
        from groundstation.campaign.report import write_campaign_report
        from groundstation.trajectory import load_plan

        stand, setup = self._stand, self.station.setup
        assert stand is not None  # noqa: S101 - offered only then
        limits = {} if setup.simulated else autopilot_limits(stand.vehicle)
        stand = advance(stand, was_flown, say=self._report, limits=limits)
        write_campaign_report(stand.folder / "report.html", stand)
        if stand.outcome:
            self._report(stand.sentence)
            return
        self._report(f"next: {stand.pending['why']}")
        mine = replace(setup, vehicle=str(stand.folder / "vehicle.toml"), seed=setup.seed + len(stand.rounds))
        plan = load_plan(Path(stand.pending["plan"]))

        def begun(folder: Path) -> None:
            replace(stand, pending={**stand.pending, "folder": str(folder)}).save()

        self.app.call_from_thread(self.station.prepare_this, mine, plan, begun)
