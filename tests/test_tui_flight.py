"""The terminal UI with the real core and the simulated drone: two keys to the report, the UI killed in flight, rotors
stopped.
"""

from __future__ import annotations

import asyncio
import os
import pty
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from textual.pilot import Pilot

from groundstation.flight.client.client import outcome
from groundstation.flight.journal import NAME as JOURNAL
from groundstation.flight.journal import read_journal
from groundstation.flight.sequence import FINAL, Phase
from groundstation.paths import find_config
from groundstation.recording import load_flight, read_recording
from groundstation.trajectory import Plan, load_plan
from groundstation.tui.app import GroundStation
from groundstation.tui.setup import Setup, plan_at_hand
from groundstation.tui.widgets.dialogs import Question
from tests.one_answer import disagreements
from tests.scripted_core import screen_text

PATIENCE_S = 180.0


async def until(pilot: Pilot, condition: Callable[[], object]) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s, f"waited in vain; {pilot.app.screen} is on"
        await pilot.pause(0.05)


def phase(app: GroundStation) -> str:
    return app.core.newest.phase if app.core and app.core.newest else ""


def height_m(app: GroundStation) -> float:
    return app.core.newest.position_m[2] if app.core and app.core.newest else 0.0


def short_plan() -> Plan:
    """One period, ten seconds, of the published trajectory, a tenth smaller so that it keeps its own limits."""
    plan = load_plan(find_config("plans", "paper_table2"))
    channels = {
        name: channel.model_copy(
            update={"a": tuple(0.9 * v for v in channel.a), "b": tuple(0.9 * v for v in channel.b)}
        )
        for name, channel in plan.coefficients
    }
    return plan.model_copy(update={"coefficients": plan.coefficients.model_copy(update=channels), "periods": 1.0})


def station(logs: Path, *, real_time: bool, analyse: bool = False) -> GroundStation:
    app = GroundStation(logs, analyse=analyse)
    app.station.setup = Setup(scenario="clean", real_time=real_time)
    app.station.plan = short_plan()
    return app


async def test_two_keys_fly_and_end_with_a_report(tmp_path: Path) -> None:
    app = station(tmp_path / "logs", real_time=False, analyse=True)
    async with app.run_test(size=(120, 50)) as pilot:
        await pilot.press("r", "s")
        await until(pilot, lambda: app.current_mode == "identify")
        await until(pilot, lambda: phase(app) in FINAL and app.results is not None)
        assert app.core is not None and app.results is not None
        assert phase(app) == Phase.DONE, app.core.newest
        await until(pilot, lambda: "(estimate)" in screen_text(app))
        assert app.results.report is not None
        told = app.results.evolution["parameters"]["mass_kg"]
        truth = load_flight(app.core.folder / "flight.mcap").truth
        assert truth is not None
        assert told["low"][-1] < truth.mass_kg < told["high"][-1]
        assert disagreements(app.core.folder, load_flight(app.core.folder / "flight.mcap").vehicle) == []
        await pilot.press("5")
        await until(pilot, lambda: "verdict:" in screen_text(app))


KILLED = """
import sys; from pathlib import Path; sys.path[:0] = [{tests!r}]
from test_tui_flight import station
station(Path("logs"), real_time=True).run()
"""


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """The UI as a process in a pseudo-terminal, and the end of it that a person types into."""
    ours, theirs = pty.openpty()
    script = KILLED.format(tests=str(Path(__file__).parent))
    environment = os.environ | {"TERM": "xterm-256color", "COLUMNS": "80", "LINES": "24"}
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdin=theirs, stdout=theirs, stderr=theirs, cwd=tmp_path, env=environment,
        start_new_session=True,
    )  # fmt: skip
    os.close(theirs)
    threading.Thread(target=_drain, args=(ours,), daemon=True).start()
    yield process, ours
    process.kill()
    process.wait()


def _drain(ours: int) -> None:
    """Read what it draws, as a terminal does; a full pipe would stop it."""
    try:
        while os.read(ours, 65536):
            pass
    except OSError:
        return  # the other end is gone


async def test_the_ui_is_killed_in_flight_and_another_finds_the_flight_which_ends_as_planned(
    tmp_path: Path, terminal: tuple[subprocess.Popen[bytes], int]
) -> None:
    process, keys = terminal
    os.write(keys, b"rs")
    folder = await entered(tmp_path / "logs", Phase.AIRBORNE)
    process.send_signal(signal.SIGKILL)
    process.wait()
    again = GroundStation(tmp_path / "logs", analyse=False)
    async with again.run_test(size=(80, 24)) as pilot:
        await until(pilot, lambda: again.core is not None and phase(again) in (Phase.AIRBORNE, Phase.EXCITING))
        assert again.core is not None
        assert again.core.folder == folder
        await until(pilot, lambda: again.core is not None and again.core.operator)  # the lease of the dead is free
        await pilot.press("q")  # and this one is closed, after a question
        await until(pilot, lambda: isinstance(again.screen, Question))
        await pilot.press("y")
    await ended(folder)
    assert outcome(folder)[0] == 0
    flight = load_flight(folder / "flight.mcap")
    assert flight.window_s is not None and flight.imu is not None
    assert flight.window_s[1] - flight.window_s[0] == pytest.approx(10.0, abs=0.1), "the plan was completed"
    assert np.diff(flight.imu.t_s).max() < 0.003, "no sample is missing"
    said = [entry["text"] for entry in read_journal(folder / JOURNAL) if entry["kind"] == "vehicle"]
    assert said[-1] == "landed"


async def entered(logs: Path, name: Phase) -> Path:
    """The folder of the one flight, once it is in this phase."""
    end_s = time.monotonic() + PATIENCE_S
    while True:
        assert time.monotonic() < end_s
        for journal in logs.glob(f"*/{JOURNAL}"):
            if f"-> {name}" in journal.read_text(encoding="utf-8"):
                return journal.parent
        await asyncio.sleep(0.1)


async def ended(folder: Path) -> None:
    """The core wrote its outcome."""
    end_s = time.monotonic() + PATIENCE_S
    while '"outcome"' not in (folder / JOURNAL).read_text(encoding="utf-8"):
        assert time.monotonic() < end_s
        await asyncio.sleep(0.1)


def test_a_plan_is_flown_only_by_the_vehicle_it_was_made_for() -> None:
    shipped = plan_at_hand(Setup(vehicle="qball2"), None)
    assert shipped is not None
    mine = shipped.model_copy(update={"note": "mine"})
    assert plan_at_hand(Setup(vehicle="qball2"), mine) is mine
    assert plan_at_hand(Setup(vehicle="x500"), mine) is None
    assert plan_at_hand(Setup(vehicle="qball2"), mine.model_copy(update={"vehicle": "x500"})) == shipped


async def test_kill_asks_and_then_the_vehicle_falls(tmp_path: Path) -> None:
    app = station(tmp_path / "logs", real_time=True)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.press("r", "s")
        await until(pilot, lambda: phase(app) == Phase.AIRBORNE and height_m(app) > 0.55)
        await pilot.press("ctrl+o", "n")
        await pilot.pause(0.3)
        assert phase(app) == Phase.AIRBORNE
        await pilot.press("ctrl+o")
        await until(pilot, lambda: isinstance(app.screen, Question))
        await pilot.press("y")
        await until(pilot, lambda: phase(app) in FINAL)
        assert app.core is not None
        log = app.core.folder / JOURNAL
        await until(pilot, lambda: read_journal(log)[-1]["kind"] == "outcome")
    status, reason = outcome(app.core.folder)
    assert status == 4
    assert "rotors stopped by" in reason
    events = read_recording(app.core.folder / "flight.mcap").texts["events"]
    assert events.received_s is not None
    at_s = {text: arrived_s for arrived_s, (_, text) in zip(events.received_s, events.rows, strict=True)}
    stopped_s = at_s["landing: rotors stopped on command"]
    down_s = max(e["host_s"] for e in read_journal(log) if e["kind"] == "vehicle")
    assert 0.0 < down_s - stopped_s < 1.2, "from half a metre it falls; a controlled descent takes longer"
