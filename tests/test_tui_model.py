"""The station that the screens show, without a terminal: a real bus, a core that says what it is told to say."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from groundstation.flight.sequence import Phase
from groundstation.tui.model import Severity, Station
from groundstation.tui.watch import CoreWatch
from tests.scripted_core import PATIENCE_S, ScriptedCore


class Desk:
    """The program around a station, for a test: jobs run at once, and it keeps what it was asked for."""

    def __init__(self) -> None:
        self.told: list[tuple[Severity, str]] = []
        self.opened: list[str] = []
        self.questions: list[Callable[[bool | None], None]] = []

    def tell(self, sentence: str, severity: Severity = "information", timeout_s: float | None = None) -> None:
        self.told.append((severity, sentence))

    def bell(self) -> None:
        pass

    def open_screen(self, mode: str) -> None:
        self.opened.append(mode)

    def ask_to_fly(self, answered: Callable[[bool | None], None]) -> None:
        self.questions.append(answered)

    def in_background(self, job: Callable[[], None]) -> None:
        job()

    def in_front(self, call: Callable[[], None]) -> None:
        call()


def hear(station: Station, core: ScriptedCore, phase: str) -> None:
    """Let the core say a phase until the station has acted upon it."""
    end_s = time.monotonic() + PATIENCE_S
    while station.seen is None or station.seen.phase != phase:
        assert time.monotonic() < end_s, f"the station never saw {phase}"
        core.say(phase)
        time.sleep(0.02)
        if station.newest is not None and station.newest.phase == phase:
            station.see(station.newest)


@pytest.fixture
def core(tmp_path: Path) -> Iterator[ScriptedCore]:
    with ScriptedCore(tmp_path / "flight").running() as running:
        yield running


@pytest.fixture
def desk() -> Desk:
    return Desk()


@pytest.fixture
def station(desk: Desk, core: ScriptedCore, tmp_path: Path) -> Iterator[Station]:
    made = Station(desk, tmp_path / "logs")
    yield made
    made.leave()


def orders(core: ScriptedCore) -> list[str]:
    return [order.name for order in core.orders]


def test_a_flight_is_started_aborted_and_killed_without_a_terminal(desk: Desk, core: ScriptedCore, station: Station):
    station.abort()
    station.start_flight()
    assert [told for _, told in desk.told] == [
        "nothing flies, so there is nothing to abort.",
        "no flight is prepared; r prepares one.",
    ]
    station.follow(CoreWatch(core.access, core.folder), simulated=True)
    hear(station, core, Phase.UPLOADED)
    assert desk.opened == ["fly"]
    assert station.flying and not station.may_prepare
    station.start_flight()
    station.seen = None
    hear(station, core, Phase.UPLOADED)
    assert orders(core) == [], "not before everything is checked"
    hear(station, core, Phase.CHECKED)
    hear(station, core, Phase.EXCITING)
    assert orders(core) == ["start"]
    station.abort()
    station.kill()
    assert orders(core) == ["start", "abort", "kill"]
    assert desk.told[2:] == [
        ("information", "started"),
        ("information", "abort: asked the vehicle to land"),
        ("information", "kill: the rotors were told to stop"),
    ]
    hear(station, core, Phase.DONE)
    assert desk.opened == ["fly", "identify"]
    assert station.results is not None and station.results.folder == core.folder


def test_what_is_not_known_to_be_simulated_asks_for_the_word(desk: Desk, core: ScriptedCore, station: Station):
    station.follow(CoreWatch(core.access, core.folder))
    hear(station, core, Phase.CHECKED)
    for answer, starts in ((False, []), (True, ["start"])):
        station.start_flight()
        desk.questions.pop()(answer)
        station.seen = None
        hear(station, core, Phase.CHECKED)
        assert orders(core) == starts


def test_the_model_imports_no_terminal():
    code = "import sys, groundstation.tui.model; sys.exit('textual' in sys.modules)"
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr or "groundstation.tui.model imports textual"
