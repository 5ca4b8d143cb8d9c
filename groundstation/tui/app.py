"""The terminal UI: seven screens over the core process. It computes nothing, and no flight depends on it.

Keys that work everywhere, from inside every field and in front of every question (priority bindings): ``ctrl+g`` or F8
aborts and lands, ``ctrl+o`` or F9 asks whether to stop the rotors. Neither a terminal, tmux nor an input field takes
them.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, cast

from textual.app import App, SystemCommand
from textual.binding import Binding
from textual.css.query import NoMatches
from textual.events import Event, Key
from textual.screen import Screen

from groundstation.commands.common import LOGS
from groundstation.flight.journal import NAME as JOURNAL
from groundstation.flight.journal import read_journal
from groundstation.flight.sequence import IN_FLIGHT
from groundstation.texts import shown
from groundstation.tui.model import Severity, Station
from groundstation.tui.screens.base import StationScreen
from groundstation.tui.text import CONFIRM, KEYS, KILL
from groundstation.tui.widgets.bars import REFRESH_S, SCREENS
from groundstation.tui.widgets.dialogs import Question, TextPage, TypedQuestion

if TYPE_CHECKING:
    from groundstation.trajectory import Plan
    from groundstation.tui.remote import StationWatch
    from groundstation.tui.results import FlightResults
    from groundstation.tui.screens.diagnose import Diagnose
    from groundstation.tui.screens.identify import Identify
    from groundstation.tui.screens.plan import Planner
    from groundstation.tui.watch import CoreWatch


def _screen(mode: str, name: str) -> Callable[[], StationScreen]:
    """Makes a screen; its module is imported when the screen is first opened: plots and tables need numerics."""

    def make() -> StationScreen:
        return getattr(importlib.import_module(f"groundstation.tui.screens.{mode}"), name)()

    return make


class GroundStation(App[int]):
    """The application.

    Args:
        logs: where flights are kept.
        analyse: identify, diagnose and report after landing.
        remote: the station on another machine that is shown instead of this one.

    Attributes:
        station: what is chosen and what flies; the screens show and change it.
    """

    TITLE = "groundstation"
    CSS_PATH = "groundstation.tcss"
    MODES: ClassVar = {
        "station": _screen("station", "Station"),
        "plan": _screen("plan", "Planner"),
        "fly": _screen("fly", "Fly"),
        "identify": _screen("identify", "Identify"),
        "diagnose": _screen("diagnose", "Diagnose"),
        "flights": _screen("flights", "Flights"),
        "campaign": _screen("campaign", "Campaign"),
    }
    DEFAULT_MODE = "station"
    BINDINGS: ClassVar = [
        Binding("ctrl+g,f8", "abort", "Abort + land", priority=True, show=False),
        Binding("ctrl+o,f9", "kill", "Kill", priority=True, show=False),
        *(Binding(str(n), f"switch_mode('{mode}')", SCREENS[mode], show=False) for n, mode in enumerate(SCREENS, 1)),
        Binding("l", "log", "Log"),
        Binding("t", "light", "Light / dark", show=False),
        Binding("question_mark,f1", "help", "Help", key_display="?"),
        Binding("q", "leave", "Quit"),
    ]

    def __init__(self, logs: Path = LOGS, *, analyse: bool = True, remote: StationWatch | None = None):
        super().__init__()
        self.station = Station(self, logs, analyse=analyse, remote=remote)
        self._offered: object = None
        self._left = False

    def on_mount(self) -> None:
        """Find a flight that goes on, and refresh from now on."""
        self.set_interval(REFRESH_S, self._refresh_view)
        self.station.find_flight()

    def on_unmount(self) -> None:
        """Stop following; the flight goes on."""
        self.station.leave()

    @property
    def core(self) -> CoreWatch | None:
        """The flight that is followed; None before the first."""
        return self.station.core

    @property
    def plan(self) -> Plan | None:
        """What the next flight flies; None takes the one that ships for the vehicle."""
        return self.station.plan

    @property
    def results(self) -> FlightResults | None:
        """Of the flight that Identify and Diagnose show."""
        return self.station.results

    def follow(self, core: CoreWatch, *, simulated: bool = False) -> None:
        """Show this flight from now on."""
        self.station.follow(core, simulated=simulated)

    # What the station asks for ----------------------------------------------------------------------------------------

    def notify(self, message: str, **options: Any) -> None:
        """A word to the operator; what a terminal would act on is left out of it."""
        super().notify(shown(message), **options)

    def tell(self, sentence: str, severity: Severity = "information", timeout_s: float | None = None) -> None:
        """A word to the operator that is no markup."""
        self.notify(sentence, severity=severity, timeout=timeout_s, markup=False)

    def open_screen(self, mode: str) -> None:
        """Show the screen of a mode."""
        self.switch_mode(mode)

    def ask_to_fly(self, answered: Callable[[bool | None], None]) -> None:
        """Ask for the typed word that starts a real vehicle."""
        self.push_screen(TypedQuestion(CONFIRM, "FLY"), answered)

    def in_background(self, job: Callable[[], None]) -> None:
        """Run it on a thread."""
        self.run_worker(job, thread=True)

    def in_front(self, call: Callable[[], None]) -> None:
        """Run it where the screens live, from a thread, and wait for it."""
        self.call_from_thread(call)

    # Abort and kill ---------------------------------------------------------------------------------------------------

    def action_abort(self) -> None:
        """Abort and land; open to everyone, from everywhere."""
        self.station.abort()

    def action_kill(self) -> None:
        """Stop the rotors, after a question."""
        if self.station.phase not in IN_FLIGHT:
            self.notify("nothing flies, so there is nothing to kill.")
        elif not isinstance(self.screen, Question):
            self.push_screen(Question(KILL), lambda yes: self.station.kill() if yes else None)

    # The view ---------------------------------------------------------------------------------------------------------

    def _refresh_view(self) -> None:
        """The newest status, if it is new, to the screen that is open."""
        station = self.station
        station.tend()
        screens = [screen for screen in self.screen_stack if isinstance(screen, StationScreen)]
        status = station.newest
        new = status is not None and status is not station.seen
        try:
            if status is not None and new:
                screens[-1].show_status(status)
            self._show_results(screens[-1])
            self._offer(screens[-1])
        except (IndexError, NoMatches):
            return  # the screen is coming up or being taken down; there is another time
        if status is not None and new:
            station.see(status)

    def _offer(self, screen: StationScreen) -> None:
        """The footer shows what can be done now."""
        station = self.station
        now = (
            screen,
            station.phase,
            station.preparing,
            station.plan is None,
            station.results is None,
            station.may_take_lease,
            station.may_agree,
        )
        if now != self._offered:
            self._offered = now
            screen.refresh_bindings()

    def _show_results(self, screen: StationScreen) -> None:
        if self.results is None or screen.MODE not in ("identify", "diagnose"):
            return
        shows = cast("Identify | Diagnose", screen)
        if shows.results is not self.results:
            shows.show_results(self.results)
            shows.results = self.results

    def plan_next(self) -> None:
        """Take the plan that the diagnosis proposes, or search one for the diagnosed vehicle where it proposes none."""
        results = self.results
        if results is None:
            self.notify("no flight is shown; choose one on Flights (6).")
            return
        self.switch_mode("plan")
        if results.next_flight is not None:
            self.station.plan = results.next_flight
            self.notify(
                f"this is the flight that the diagnosis of {results.folder.name} proposes; r on Fly prepares it",
                markup=False,
            )
            self._on_planner(lambda planner: planner.on_screen_resume())
            return
        vehicle = str(results.identification.get("vehicle", ""))
        self._on_planner(lambda planner: planner.plan_for(vehicle))

    def _on_planner(self, act: Callable[[Planner], None]) -> None:
        """On the Plan screen once it is drawn; nothing where another was opened meanwhile."""
        self.call_after_refresh(
            lambda: getattr(self.screen, "MODE", "") == "plan" and act(cast("Planner", self.screen))
        )

    # Keys -------------------------------------------------------------------------------------------------------------

    def get_system_commands(self, screen: Screen) -> Iterable[SystemCommand]:
        """The command palette: what the keys do now, by name."""
        for mode, title in SCREENS.items():
            yield SystemCommand(f"Open {title}", f"screen {title}", partial(self.switch_mode, mode))
        for active in screen.active_bindings.values():
            binding = active.binding
            if active.enabled and binding.description and (binding.show or active.node is screen):
                run = partial(self.run_action, binding.action, active.node)
                yield SystemCommand(binding.description, f"key {binding.key_display or binding.key}", run)
        yield SystemCommand("Abort and land", "key ^g", self.action_abort)
        yield SystemCommand("Stop the rotors", "key ^o; asks first", self.action_kill)
        yield SystemCommand("Light or dark", "key t", self.action_light)

    def action_help(self) -> None:
        """Keys and what the screen does."""
        screen = self.screen
        if isinstance(screen, StationScreen):
            keys = "\n".join(f"{b.key:<8}{b.description}" for b in screen.BINDINGS if isinstance(b, Binding))
            title = SCREENS[screen.MODE]
            self.push_screen(
                TextPage(title, f"{' '.join(screen.HELP_TEXT.split())}\n\n{title}\n{keys}\n\nEverywhere\n{KEYS}")
            )

    def action_log(self) -> None:
        """The run's log."""
        folder = self.core.folder if self.core else self.results.folder if self.results else None
        path = folder / JOURNAL if folder else None
        if path is None or not path.is_file():
            self.notify("there is no run yet whose log could be shown.")
            return
        entries = read_journal(path)
        start_s = float(entries[0]["monotonic_s"]) if entries else 0.0
        lines = [f"{float(e['monotonic_s']) - start_s:8.2f} s  {e['kind']:<10} {e['text']}" for e in entries]
        self.push_screen(TextPage(str(path), "\n".join(lines)))

    def action_light(self) -> None:
        """Light or dark."""
        self.theme = "textual-light" if self.theme == "textual-dark" else "textual-dark"

    def action_leave(self) -> None:
        """Close, after a question while something flies."""
        if self.station.phase in IN_FLIGHT:
            text = "The flight goes on without this program: the plan is completed and the vehicle lands.\nClose it?"
            self.push_screen(Question(text), lambda yes: self._leave() if yes else None)
        else:
            self._leave()

    def _leave(self) -> None:
        self._left = True
        self.exit(0)

    async def on_event(self, event: Event) -> None:
        """Take events; keys typed while it closes are the shell's."""
        if not (self._left and isinstance(event, Key)):
            await super().on_event(event)


def run(host: str | None = None) -> int:
    """Open it in this terminal, for this station or the one on another machine."""
    if host is None:
        return GroundStation().run() or 0
    from groundstation.tui.remote import watch_station

    return GroundStation(remote=watch_station(host)).run() or 0
