"""The terminal UI with the real core and the simulated drone: two keys to a flight, the UI closed in flight, rotors stopped."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from pathlib import Path

from textual.pilot import Pilot

from groundstation.flight.client import outcome
from groundstation.flight.journal import NAME as JOURNAL
from groundstation.flight.journal import read_journal
from groundstation.flight.sequence import FINAL, Phase
from groundstation.recording import load_flight
from groundstation.tui.app import GroundStation
from groundstation.tui.setup import Setup, plan_at_hand
from groundstation.tui.widgets.dialogs import Question

PATIENCE_S = 90.0


async def until(pilot: Pilot, condition: Callable[[], object]) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s, f"waited in vain; {pilot.app.screen} is on"
        await pilot.pause(0.05)


def phase(app: GroundStation) -> str:
    return app.core.newest.phase if app.core and app.core.newest else ""


def station(tmp_path: Path, *, real_time: bool) -> GroundStation:
    app = GroundStation(tmp_path / "logs", analyse=False)
    app.setup = Setup(scenario="clean", real_time=real_time)
    return app


async def test_two_keys_fly_and_the_flight_outlives_the_program(tmp_path: Path) -> None:
    app = station(tmp_path, real_time=False)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.press("r", "s")
        await until(pilot, lambda: phase(app) in (Phase.AIRBORNE, Phase.EXCITING))
        assert app.core is not None
        folder = app.core.folder
        await pilot.press("q")
        await until(pilot, lambda: isinstance(app.screen, Question))
        await pilot.press("y")
    again = GroundStation(tmp_path / "logs", analyse=False)
    async with again.run_test(size=(80, 24)) as pilot:
        await until(pilot, lambda: again.core is not None or (folder / "flight.log.jsonl").read_text().count("outcome"))
        if again.core is not None:
            assert again.core.folder == folder
            await until(pilot, lambda: phase(again) in FINAL or not again.core.following)
    await wait_for_outcome(folder)
    assert outcome(folder)[0] == 0
    flight = load_flight(folder / "flight.mcap")
    assert flight.window_s is not None
    assert flight.window_s[1] - flight.window_s[0] > 30.0


def test_a_plan_is_flown_only_by_the_vehicle_it_was_made_for() -> None:
    shipped = plan_at_hand(Setup(vehicle="qball2"), None)
    assert shipped is not None
    mine = shipped.model_copy(update={"note": "mine"})
    assert plan_at_hand(Setup(vehicle="qball2"), mine) is mine
    assert plan_at_hand(Setup(vehicle="x500"), mine) is None
    assert plan_at_hand(Setup(vehicle="qball2"), mine.model_copy(update={"vehicle": "x500"})) == shipped


async def wait_for_outcome(folder: Path) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while '"outcome"' not in (folder / "flight.log.jsonl").read_text(encoding="utf-8"):
        assert time.monotonic() < end_s
        await asyncio.sleep(0.1)


async def test_kill_asks_and_then_the_vehicle_falls(tmp_path: Path) -> None:
    app = station(tmp_path, real_time=True)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.press("r", "s")
        await until(pilot, lambda: phase(app) == Phase.AIRBORNE and app.core.newest.position_m[2] > 0.55)
        await pilot.press("ctrl+o", "n")
        await pilot.pause(0.3)
        assert phase(app) == Phase.AIRBORNE
        await pilot.press("ctrl+o")
        await until(pilot, lambda: isinstance(app.screen, Question))
        await pilot.press("y")
        await until(pilot, lambda: phase(app) in FINAL)
    assert app.core is not None
    status, reason = outcome(app.core.folder)
    assert status == 4
    assert "rotors stopped by" in reason
    said = {e["said"]: e["host_s"] for e in read_journal(app.core.folder / JOURNAL) if e["kind"] == "vehicle"}
    stopped_s, down_s = said["rotors stopped on command"], max(said.values())
    assert 0.0 < down_s - stopped_s < 1.2, "from half a metre it falls; a controlled descent takes longer"
