"""The station as its screens know it: what is chosen, what flies, its results, the orders. It needs no terminal."""

from __future__ import annotations

import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol, cast

from groundstation.errors import GroundStationError
from groundstation.flight.children import Child, last_line
from groundstation.flight.client.client import running_cores
from groundstation.flight.messages import CommandName, CoreStatus
from groundstation.flight.sequence import FINAL, IN_FLIGHT, Phase
from groundstation.tui.margins import Announcer, FlightLimits, margins
from groundstation.tui.results import FlightResults, read_results
from groundstation.tui.setup import Setup, begin_flight, flight_limits, plan_at_hand
from groundstation.tui.text import ELSEWHERE
from groundstation.tui.watch import CoreWatch

if TYPE_CHECKING:
    from groundstation.trajectory import Plan
    from groundstation.tui.remote import StationWatch

AFTER_LANDING = (Phase.LANDED, Phase.IDENTIFYING, Phase.DONE)
"""A view may see any of them first."""

Severity = Literal["information", "warning", "error"]


class Shell(Protocol):
    """What the station asks of the program around it: an application with screens, or a test."""

    def tell(self, sentence: str, severity: Severity = "information", timeout_s: float | None = None) -> None:
        """A word to the operator."""
        ...

    def bell(self) -> None:
        """Ring."""
        ...

    def open_screen(self, mode: str) -> None:
        """Show the screen of a mode."""
        ...

    def ask_to_fly(self, answered: Callable[[bool | None], None]) -> None:
        """Ask for the typed word that starts a real vehicle."""
        ...

    def in_background(self, job: Callable[[], None]) -> None:
        """Run it on a thread."""
        ...

    def in_front(self, call: Callable[[], None]) -> None:
        """Run it where the screens live, from a thread, and wait for it."""
        ...


class Station:
    """What is chosen and what flies.

    Args:
        shell: the program around it.
        logs: where flights are kept.
        analyse: identify, diagnose and report after landing.
        remote: the station on another machine that is shown instead of this one.

    Attributes:
        setup: what flies next.
        core: the flight that is followed; None before the first.
        plan: what the next flight flies; None takes the one that ships for the vehicle.
        results: of the flight that Identify and Diagnose show.
        limits: of the flight that is followed.
        trouble: what went wrong last with the flight, as a sentence.
        preparing: a core is being started.
        plan_worker_running: the optimiser is searching a plan.
        seen: the last status that was acted upon.
    """

    def __init__(self, shell: Shell, logs: Path, *, analyse: bool = True, remote: StationWatch | None = None):
        self.logs, self.remote = logs, remote
        self.setup = Setup()
        self.core: CoreWatch | None = None
        self.plan: Plan | None = None
        self.results: FlightResults | None = None
        self.limits = FlightLimits()
        self.trouble = ""
        self.preparing = self.plan_worker_running = False
        self.seen: CoreStatus | None = None
        self._shell, self._analyse = shell, analyse
        self._announcer = Announcer()
        self._child: Child | None = None
        self._remote_flight = ""
        self._start_wanted = self._simulated = False

    # What is followed -------------------------------------------------------------------------------------------------

    def find_flight(self) -> None:
        """Follow the other machine's station, or, found on a thread, a flight begun here by another client."""
        if self.remote is not None:
            self.core = self.remote
        else:
            self._shell.in_background(self._find_flight)

    def _find_flight(self) -> None:
        running = running_cores(self.logs, report=lambda text: self._shell.in_front(lambda: self.fail(text)))
        for folder, endpoint in running[:1]:
            self._shell.in_front(lambda folder=folder, endpoint=endpoint: self.follow(CoreWatch(endpoint, folder)))

    def follow(self, core: CoreWatch, *, simulated: bool = False) -> None:
        """Show this flight from now on; one that is not known to be simulated starts only after a typed word."""
        if self.core is not None and self.core is not core:
            self.core.stop()
        self.core, self.seen, self.trouble, self.results = core, None, "", None
        self._simulated = simulated
        guard = self.setup.station if self.remote is None else ""  # which file holds there is not known here
        self.limits = flight_limits(core.folder, guard, simulated=simulated)
        self._announcer = Announcer()
        self._shell.open_screen("fly")

    def leave(self) -> None:
        """Stop following; the flight goes on."""
        if self.core is not None:
            self.core.stop()

    @property
    def newest(self) -> CoreStatus | None:
        """The newest status of the flight that is followed."""
        return self.core.newest if self.core else None

    @property
    def phase(self) -> str:
        """Of the flight that is followed; empty without one."""
        return self.newest.phase if self.newest else ""

    @property
    def flying(self) -> bool:
        """A flight that was prepared has not landed yet."""
        status = self.newest
        return self.core is not None and self.core.following and (status is None or status.phase not in FINAL)

    @property
    def may_prepare(self) -> bool:
        """Nothing is prepared or flies here, and flights are prepared here."""
        return self.remote is None and not self.flying and not self.preparing

    @property
    def may_take_lease(self) -> bool:
        """This client is not the operator, and may be."""
        core = self.core
        return core is not None and core.newest is not None and core.may_operate and not core.operator

    @property
    def may_agree(self) -> bool:
        """A flight until something is known proposes to end or to go on."""
        status = self.newest
        return status is not None and status.until is not None and bool(status.until.proposal)

    # Prepare, start, orders -------------------------------------------------------------------------------------------

    def prepare_flight(self) -> None:
        """Start a core with what is chosen; it waits for the start."""
        self.prepare_this(self.setup, None)

    def prepare_this(
        self, setup: Setup, plan: Plan | None, begun: Callable[[Path], None] = lambda folder: None
    ) -> None:
        """Start a core with a plan, or the one at hand; ``begun`` is told the flight's folder, on a thread."""
        if not self.may_prepare:
            there = "a flight is prepared already; s on Fly starts it, ^g gives it up."
            self._shell.tell(there if self.remote is None else ELSEWHERE)
            return
        self.preparing, self._start_wanted, self.trouble = True, False, ""
        self._simulated = setup.simulated
        self._shell.open_screen("fly")
        self._shell.in_background(lambda: self._prepare(setup, plan, begun))

    def _prepare(self, setup: Setup, chosen: Plan | None, begun: Callable[[Path], None]) -> None:
        try:
            plan = chosen or plan_at_hand(setup, self.plan) or self._new_plan(setup)
            child, endpoint, folder = begin_flight(setup, plan, self.logs, analyse=self._analyse)
            begun(folder)
        except (GroundStationError, OSError) as error:
            sentence = str(error)
            self._shell.in_front(lambda: self.fail(sentence))
        else:
            self._child, self.plan = child, plan
            self._shell.in_front(lambda: self.follow(CoreWatch(endpoint, folder), simulated=setup.simulated))
        finally:
            self.preparing = False

    def _new_plan(self, setup: Setup) -> Plan:
        from groundstation import api

        return api.plan_excitation(setup.vehicle)

    def fail(self, sentence: str) -> None:
        """The flight has a trouble: keep it, and tell of it."""
        self.trouble = sentence
        self._shell.tell(sentence, "error", 10)

    def start_flight(self) -> None:
        """Start once everything is checked; a real vehicle after a typed confirmation."""
        if not self.flying and not self.preparing:
            self._shell.tell("no flight is prepared; r prepares one.")
        elif self._simulated:
            self._start_wanted = True
        elif self.phase != Phase.CHECKED:
            self._shell.tell("not everything is checked yet; start when the state says CHECKED.")
        else:
            self._shell.ask_to_fly(self._on_typed)

    def _on_typed(self, yes: bool | None) -> None:
        self._start_wanted = bool(yes)

    def abort(self) -> None:
        """Abort and land; open to everyone."""
        self._start_wanted = False
        self.order("abort", "abort: asked the vehicle to land")

    def kill(self) -> None:
        """Stop the rotors."""
        self.order("kill", "kill: the rotors were told to stop")

    def order(self, name: CommandName, done: str) -> None:
        """Give an order on a thread, and say what came of it."""
        core = self.core
        if core is None or not core.following:
            self._shell.tell(f"nothing flies, so there is nothing to {name}.")
            return

        def give() -> None:
            refusal = core.order(name)
            self._shell.in_front(lambda: self._shell.tell(refusal or done, "error" if refusal else "information"))

        self._shell.in_background(give)

    def take_lease(self) -> None:
        """Become the operator."""
        core = self.core
        if core is None or not core.following:
            return

        def take() -> None:
            said = core.take_lease() or "you are the operator"
            self._shell.in_front(lambda: self._shell.tell(said))

        self._shell.in_background(take)

    # As time goes on --------------------------------------------------------------------------------------------------

    def tend(self) -> None:
        """Tell of a core that ended before it could say why; follow the other machine's next flight."""
        child = self._child
        if child is not None and child.poll() is not None:
            self._child = None
            if self.phase not in FINAL and self.core is not None:
                said = last_line(self.core.folder / "core.log")
                self.fail(f"the core ended early{': ' + said if said else ''}; the recording opens as far as it goes.")
        if self.remote is not None and self.remote.flight != self._remote_flight:
            self._remote_flight = self.remote.flight
            self.follow(self.remote)

    def see(self, status: CoreStatus) -> None:
        """Act upon a new status: bells, the start that was asked for, what comes after landing."""
        before, self.seen = self.seen, status
        if status.phase in IN_FLIGHT:
            for sentence in self._announcer.news(margins(status, self.limits)):
                self._shell.bell()
                self._shell.tell(sentence, "warning", 8)
        if status.phase == Phase.CHECKED and self._start_wanted:
            self._start_wanted = False
            self.order("start", "started")
        self._on_phase(before.phase if before else "", status.phase)

    def _on_phase(self, before: str, phase: str) -> None:
        if before == phase:
            return
        if phase in AFTER_LANDING and before not in AFTER_LANDING and self._analyse:
            self._shell.open_screen("identify")
        if phase in FINAL and self.core is not None:
            self.show_flight(self.core.folder)

    # Results ----------------------------------------------------------------------------------------------------------

    def show_flight(self, folder: Path) -> None:
        """Read a flight's results on a thread; the screens show them when they are open."""

        def read() -> None:
            self.results = read_results(folder)

        self._shell.in_background(read)

    def open_report(self, folder: Path | None = None) -> None:
        """Open a flight's report in the browser."""
        results = read_results(folder) if folder else self.results
        if results is None or results.report is None:
            self._shell.tell("this flight has no report.")
        else:
            self.open_page(results.report)

    def open_page(self, path: Path) -> None:
        """Open a page in the browser."""
        if not webbrowser.open(path.resolve().as_uri()):
            self._shell.tell(f"no browser here; the report is {path}")


class Owner(Protocol):
    """What screens and bars need of their application besides what every application has."""

    @property
    def station(self) -> Station:
        """The station."""
        ...

    def plan_next(self) -> None:
        """Open Plan with the flight that the diagnosis proposes."""
        ...


def owner(app: object) -> Owner:
    """The application of a screen as the owner of the station, which it is."""
    return cast("Owner", app)
