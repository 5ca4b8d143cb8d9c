"""The terminal UI: seven screens over the core process. It computes nothing, and no flight depends on it.

Keys that work everywhere, from inside every field and in front of every question (priority bindings): ``ctrl+g`` or F8
aborts and lands, ``ctrl+o`` or F9 asks whether to stop the rotors. Neither a terminal, tmux nor an input field takes
them.
"""

from __future__ import annotations

import importlib
import webbrowser
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
from groundstation.errors import GroundStationError
from groundstation.flight.children import Child, last_line
from groundstation.flight.client.client import running_cores
from groundstation.flight.journal import NAME as JOURNAL
from groundstation.flight.journal import read_journal
from groundstation.flight.messages import CommandName, CoreStatus
from groundstation.flight.sequence import FINAL, IN_FLIGHT, Phase
from groundstation.texts import shown
from groundstation.tui.margins import Announcer, FlightLimits, margins
from groundstation.tui.results import FlightResults, read_results
from groundstation.tui.screens.base import StationScreen
from groundstation.tui.setup import Setup, begin_flight, flight_limits, plan_at_hand
from groundstation.tui.text import CONFIRM, ELSEWHERE, KEYS, KILL
from groundstation.tui.watch import CoreWatch
from groundstation.tui.widgets.bars import REFRESH_S, SCREENS
from groundstation.tui.widgets.dialogs import Question, TextPage, TypedQuestion

if TYPE_CHECKING:
    from groundstation.trajectory import Plan
    from groundstation.tui.remote import StationWatch
    from groundstation.tui.screens.diagnose import Diagnose
    from groundstation.tui.screens.identify import Identify
    from groundstation.tui.screens.plan import Planner

AFTER_LANDING = (Phase.LANDED, Phase.IDENTIFYING, Phase.DONE)
"""A view may see any of them first."""


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
        core: the flight that is followed; None before the first.
        plan: what the next flight flies; None takes the one that ships for the vehicle.
        results: of the flight that Identify and Diagnose show.
        limits: of the flight that is followed.
        trouble: what went wrong last with the flight, as a sentence.
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
        self.logs, self._analyse, self.remote = logs, analyse, remote
        self._flight = ""
        self.setup = Setup()
        self.core: CoreWatch | None = None
        self.plan: Plan | None = None
        self.results: FlightResults | None = None
        self.trouble = ""
        self.plan_worker_running = False
        self._child: Child | None = None
        self._shown: CoreStatus | None = None
        self._start_wanted = False
        self._preparing = False
        self._simulated = False
        self.limits = FlightLimits()
        self._announcer = Announcer()
        self._offered: object = None
        self._left = False

    def on_mount(self) -> None:
        """Find a flight that goes on, and refresh from now on."""
        self.set_interval(REFRESH_S, self._refresh_view)
        if self.remote is not None:
            self.core = self.remote
        else:
            self.run_worker(self._find_flight, thread=True)

    def on_unmount(self) -> None:
        """Stop following; the flight goes on."""
        if self.core is not None:
            self.core.stop()

    # The flight -------------------------------------------------------------------------------------------------------

    def follow(self, core: CoreWatch, *, simulated: bool = False) -> None:
        """Show this flight from now on; one that is not known to be simulated starts only after a typed word."""
        if self.core is not None and self.core is not core:
            self.core.stop()
        self.core, self._shown, self.trouble, self.results = core, None, "", None
        self._simulated = simulated
        guard = self.setup.station if self.remote is None else ""  # which file holds there is not known here
        self.limits = flight_limits(core.folder, guard, simulated=simulated)
        self._announcer = Announcer()
        self.switch_mode("fly")

    def _find_flight(self) -> None:
        """On a thread: a flight begun by another client is followed."""
        running = running_cores(self.logs, report=lambda text: self.call_from_thread(self._fail, text))
        for folder, endpoint in running[:1]:
            self.call_from_thread(self.follow, CoreWatch(endpoint, folder))

    @property
    def preparing(self) -> bool:
        """A core is being started."""
        return self._preparing

    @property
    def may_prepare(self) -> bool:
        """Nothing is prepared or flies here, and flights are prepared here."""
        return self.remote is None and not self.flying and not self._preparing

    @property
    def may_take_lease(self) -> bool:
        """This client is not the operator, and may be."""
        core = self.core
        return core is not None and core.newest is not None and core.may_operate and not core.operator

    @property
    def flying(self) -> bool:
        """A flight that was prepared has not landed yet."""
        status = self.core.newest if self.core else None
        return self.core is not None and self.core.following and (status is None or status.phase not in FINAL)

    def prepare_flight(self) -> None:
        """Start a core with what is chosen; it waits for the start."""
        self.prepare_this(self.setup, None)

    def prepare_this(
        self, setup: Setup, plan: Plan | None, begun: Callable[[Path], None] = lambda folder: None
    ) -> None:
        """Start a core with a plan, or the one at hand; ``begun`` is told the flight's folder, on a thread."""
        if not self.may_prepare:
            there = "a flight is prepared already; s on Fly starts it, ^g gives it up."
            self.notify(there if self.remote is None else ELSEWHERE)
            return
        self._preparing, self._start_wanted, self.trouble = True, False, ""
        self._simulated = setup.simulated
        self.switch_mode("fly")
        self.run_worker(lambda: self._prepare(setup, plan, begun), thread=True)

    def _prepare(self, setup: Setup, chosen: Plan | None, begun: Callable[[Path], None]) -> None:
        try:
            plan = chosen or plan_at_hand(setup, self.plan) or self._new_plan(setup)
            child, endpoint, folder = begin_flight(setup, plan, self.logs, analyse=self._analyse)
            begun(folder)
        except (GroundStationError, OSError) as error:
            self.call_from_thread(self._fail, str(error))
        else:
            self._child, self.plan = child, plan
            self.call_from_thread(self.follow, CoreWatch(endpoint, folder), simulated=setup.simulated)
        finally:
            self._preparing = False

    def _new_plan(self, setup: Setup) -> Plan:
        from groundstation import api

        return api.plan_excitation(setup.vehicle)

    def notify(self, message: str, **options: Any) -> None:
        """A word to the operator; what a terminal would act on is left out of it."""
        super().notify(shown(message), **options)

    def _fail(self, sentence: str) -> None:
        self.trouble = sentence
        self.notify(sentence, severity="error", markup=False, timeout=10)

    def start_flight(self) -> None:
        """Start once everything is checked; a real vehicle after a typed confirmation."""
        if not self.flying and not self._preparing:
            self.notify("no flight is prepared; r prepares one.")
        elif self._simulated:
            self._start_wanted = True
        elif self.phase != Phase.CHECKED:
            self.notify("not everything is checked yet; start when the state says CHECKED.")
        else:
            self.push_screen(TypedQuestion(CONFIRM, "FLY"), self._on_typed)

    def _on_typed(self, yes: bool | None) -> None:
        self._start_wanted = bool(yes)

    def order(self, name: CommandName, done: str) -> None:
        """Give an order on a thread, and say what came of it."""
        core = self.core
        if core is None or not core.following:
            self.notify(f"nothing flies, so there is nothing to {name}.")
            return

        def give() -> None:
            refusal = core.order(name)
            severity = "error" if refusal else "information"
            self.call_from_thread(self.notify, refusal or done, severity=severity, markup=False)

        self.run_worker(give, thread=True, group="orders")

    def take_lease(self) -> None:
        """Become the operator."""
        core = self.core
        if core is not None and core.following:
            self.run_worker(
                lambda: self.call_from_thread(self.notify, core.take_lease() or "you are the operator", markup=False),
                thread=True,
            )

    def action_abort(self) -> None:
        """Abort and land; open to everyone, from everywhere."""
        self._start_wanted = False
        self.order("abort", "abort: asked the vehicle to land")

    def action_kill(self) -> None:
        """Stop the rotors, after a question."""
        if self.phase not in IN_FLIGHT:
            self.notify("nothing flies, so there is nothing to kill.")
        elif not isinstance(self.screen, Question):
            self.push_screen(Question(KILL), self._on_kill)

    def _on_kill(self, yes: bool | None) -> None:
        if yes:
            self.order("kill", "kill: the rotors were told to stop")

    @property
    def phase(self) -> str:
        """Of the flight that is followed; empty without one."""
        return self.core.newest.phase if self.core and self.core.newest else ""

    # The view ---------------------------------------------------------------------------------------------------------

    def _refresh_view(self) -> None:
        """The newest status, if it is new, to the screen that is open."""
        core = self.core
        self._watch_child()
        if self.remote is not None and self.remote.flight != self._flight:
            self._flight = self.remote.flight
            self.follow(self.remote)
        screens = [screen for screen in self.screen_stack if isinstance(screen, StationScreen)]
        status = core.newest if core else None
        new = status is not None and status is not self._shown
        try:
            if status is not None and new:
                screens[-1].show_status(status)
            self._show_results(screens[-1])
            self._offer(screens[-1])
        except (IndexError, NoMatches):
            return  # the screen is coming up or being taken down; there is another time
        if core is None or status is None or not new:
            return
        before, self._shown = self._shown, status
        self._announce(status)
        if status.phase == Phase.CHECKED and self._start_wanted:
            self._start_wanted = False
            self.order("start", "started")
        self._on_phase(before.phase if before else "", status, core)

    def _on_phase(self, before: str, status: CoreStatus, core: CoreWatch) -> None:
        if before == status.phase:
            return
        if status.phase in AFTER_LANDING and before not in AFTER_LANDING and self._analyse:
            self.switch_mode("identify")
        if status.phase in FINAL:
            self.show_flight(core.folder)

    def _offer(self, screen: StationScreen) -> None:
        """The footer shows what can be done now."""
        status = self.core.newest if self.core else None
        proposed = status is not None and status.until is not None and bool(status.until.proposal)
        now = (
            screen,
            self.phase,
            self._preparing,
            self.plan is None,
            self.results is None,
            self.may_take_lease,
            proposed,
        )
        if now != self._offered:
            self._offered = now
            screen.refresh_bindings()

    def _announce(self, status: CoreStatus) -> None:
        """A bell and a line of words when a limit of the guard is approached."""
        if status.phase in IN_FLIGHT:
            for sentence in self._announcer.news(margins(status, self.limits)):
                self.bell()
                self.notify(sentence, severity="warning", markup=False, timeout=8)

    def _watch_child(self) -> None:
        """A core that ended before it could say why is told of."""
        child = self._child
        if child is not None and child.poll() is not None:
            self._child = None
            if self.phase not in FINAL and self.core is not None:
                said = last_line(self.core.folder / "core.log")
                self._fail(f"the core ended early{': ' + said if said else ''}; the recording opens as far as it goes.")

    def show_flight(self, folder: Path) -> None:
        """Read a flight's results on a thread; the screens show them when they are open."""

        def read() -> None:
            self.results = read_results(folder)

        self.run_worker(read, thread=True)

    def _show_results(self, screen: StationScreen) -> None:
        if self.results is None or screen.MODE not in ("identify", "diagnose"):
            return
        shows = cast("Identify | Diagnose", screen)
        if shows.results is not self.results:
            shows.show_results(self.results)
            shows.results = self.results

    def open_report(self, folder: Path | None = None) -> None:
        """Open a flight's report in the browser."""
        results = read_results(folder) if folder else self.results
        if results is None or results.report is None:
            self.notify("this flight has no report.")
        else:
            self.open_page(results.report)

    def open_page(self, path: Path) -> None:
        """Open a page in the browser."""
        if not webbrowser.open(path.resolve().as_uri()):
            self.notify(f"no browser here; the report is {path}", markup=False)

    def plan_next(self) -> None:
        """Take the plan that the diagnosis proposes, or search one for the diagnosed vehicle where it proposes none."""
        results = self.results
        if results is None:
            self.notify("no flight is shown; choose one on Flights (6).")
            return
        self.switch_mode("plan")
        if results.next_flight is not None:
            self.plan = results.next_flight
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
        if self.phase in IN_FLIGHT:
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
