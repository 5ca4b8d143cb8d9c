"""A core that says what it is told to say, for tests of the terminal UI; the bus is real."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from textual.pilot import Pilot
from textual.widgets import Static

from drivers import bus
from drivers.access import Access
from groundstation.analysis.plans import write_plan
from groundstation.flight.core.lease import OperatorLease
from groundstation.flight.messages import CLIENT_ALIVE, CoreCommand, CoreStatus, Lease, StreamStatus
from groundstation.flight.sequence import Phase
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.tui.app import GroundStation
from groundstation.tui.watch import CoreWatch

PATIENCE_S = 15.0


HOSTILE = "[bold red]battery[/] [@click=app.exit]low[/] [/nonsense"


class ScriptedCore:
    """Says what it is told to say, and keeps the orders it gets."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.orders: list[CoreCommand] = []
        self.lease = OperatorLease()
        self.endpoint = bus.loopback(bus.free_port())
        self.access = Access(self.endpoint)

    @contextmanager
    def running(self) -> Iterator[ScriptedCore]:
        """On the bus."""
        with bus.open_session(listen=[self.endpoint]) as session, bus.alive(session, bus.CORE_ALIVE):
            self._status = bus.Publisher(session, bus.CORE_STATUS)
            self._handles = [
                bus.serve(session, bus.CORE_COMMAND, CoreCommand, self._take),
                bus.serve(session, bus.CORE_ABORT, CoreCommand, self._take),
                bus.serve(session, bus.CORE_LEASE, Lease, self.lease.request),
                bus.watch_alive(session, CLIENT_ALIVE.format(client="*"), self.lease.client_alive),
            ]
            yield self

    def _take(self, command: CoreCommand) -> bus.Answer:
        self.orders.append(command)
        if command.name != "abort" and (refusal := self.lease.refusal(command.client, command.name)):
            return bus.Answer(False, refusal)
        return bus.Answer(True)

    def say(self, phase: str, **changes: Any) -> None:
        """Publish a status."""
        values: dict = {
            "phase": phase,
            "flight_s": 10.0,
            "time_left_s": 42.0,
            "position_m": (0.1, -0.2, 0.7),
            "motors": (200.0, 210.0, 190.0, 205.0),
            "battery_v": 11.1,
            "streams": {"imu": StreamStatus(5000, 500.0, 0.002, 0.004)},
            "lease": self.lease.holder,
        }
        self._status.put(CoreStatus("flight", str(self.folder), "qball2", **(values | changes)))


async def until(pilot: Pilot, condition: Callable[[], object], again: Callable[[], None] = lambda: None) -> None:
    """Let the application run until something holds; ``again`` is done while it does not."""
    loop = asyncio.get_running_loop()
    end_s = loop.time() + PATIENCE_S
    while not condition():
        assert loop.time() < end_s, f"waited in vain; {pilot.app.screen} is on"
        again()
        await pilot.pause(0.05)


async def follow(
    pilot: Pilot, core: ScriptedCore, phase: str = Phase.EXCITING, *, simulated: bool = False, **changes: object
) -> CoreWatch:
    """Let the application follow the scripted core until it shows this phase."""
    app = pilot.app
    assert isinstance(app, GroundStation)
    if app.core is None:
        app.follow(CoreWatch(core.access, core.folder), simulated=simulated)
        await until(pilot, lambda: core.lease.holder, lambda: core.say(phase, **changes))
    watch = app.core
    assert watch is not None
    await until(
        pilot,
        lambda: watch.newest is not None and watch.newest.phase == phase and app.station.seen is watch.newest,
        lambda: core.say(phase, **changes),
    )
    return watch


def text_of(app: GroundStation, selector: str) -> str:
    return "".join(str(widget.content) for widget in app.screen.query(selector).results(Static))


def station(tmp_path: Path) -> GroundStation:
    return GroundStation(tmp_path / "logs")


def screen_text(app: GroundStation) -> str:
    """What the terminal shows, without colours."""
    lines = app.screen._compositor.render_strips()
    return "\n".join("".join(segment.text for segment in strip) for strip in lines)


def write_results(folder: Path) -> None:
    """Documents as the analysis writes them, of a flight that revealed the mass alone."""
    mass = {"value": 1.8254, "std": 0.000338, "ci95": [1.82474, 1.82606]}
    identification = {
        "flight": folder.name,
        "vehicle": "qball2",
        "best": "IV",
        "best_reason": "IV: immune to feedback",
        "methods": {
            "LS": {"parameters": {"mass_kg": mass}, "condition_number": 15.5},
            "IV": {"parameters": {"mass_kg": mass}},
        },
        "model": {},
        "clock": {"mocap_minus_imu_s": 0.0123, "std_s": 1e-4},
        "remedies": {"ixx_kg_m2": "roll more"},
        "validation": [{"kind": "output", "rms": {"nominal": {"force_z_n": 0.35}, "IV": {"force_z_n": 0.0175}}}],
    }
    finding = {"effect": "rotor_drag", "evidence": "the rotors drag", "confidence": 1.0, "parameters": {}}
    diagnosis = {
        "verdict": "explained",
        "findings": [finding],
        "error": {
            "held_out": {"nominal": {"force_x_n": 0.2}, "before": {"force_x_n": 0.1}, "after": {"force_x_n": 0.05}}
        },
        "candidates": [{"effect": "rotor_drag", "evidence": 500.5, "settings": {}}],
    }
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "identification.json").write_text(json.dumps(identification), encoding="utf-8")
    (folder / "diagnosis.json").write_text(json.dumps(diagnosis), encoding="utf-8")
    moving = {
        "t_s": [20.0, 30.0, 40.0],
        "value": [1.83, 1.826, 1.825],
        "low": [1.8, 1.82, 1.824],
        "high": [1.86, 1.83, 1.827],
    }
    (folder / "evolution.json").write_text(json.dumps({"parameters": {"mass_kg": moving}}), encoding="utf-8")
    proposed = load_plan(find_config("plans", "qball2")).model_copy(update={"note": "to settle it"})
    write_plan(proposed, folder / "next_flight.toml")


async def all_shown(pilot: Pilot, number: int, title: str) -> None:
    """What every screen promises to show."""
    promised = ("ABORT + LAND ^g", "KILL ^o", f"[{number} {title}]", "? Help")
    app = pilot.app
    assert isinstance(app, GroundStation)
    await until(pilot, lambda: all(text in screen_text(app) for text in promised))
