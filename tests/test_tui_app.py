"""The terminal UI against a core on the loopback bus: orders, views, faults.

What the core says is scripted, the bus is real.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from textual.app import App
from textual.events import Event, Key
from textual.pilot import Pilot
from textual.widgets import DataTable, Input, Static

from drivers import bus
from drivers.access import Access
from groundstation.analysis.plans import write_plan
from groundstation.campaign.campaign import Campaign, Round, load_campaign
from groundstation.fleet.catalogue import Catalogue
from groundstation.flight.client.access import write_access
from groundstation.flight.core.lease import OperatorLease
from groundstation.flight.messages import CLIENT_ALIVE, CoreCommand, CoreStatus, Lease, StreamStatus
from groundstation.flight.sequence import Phase
from groundstation.paths import find_config
from groundstation.trajectory import Plan, load_plan
from groundstation.tui.app import GroundStation
from groundstation.tui.screens.base import StationScreen
from groundstation.tui.screens.flights import Flights
from groundstation.tui.screens.plan import Planner
from groundstation.tui.setup import Setup
from groundstation.tui.watch import CoreWatch
from groundstation.tui.widgets.bars import SCREENS
from groundstation.tui.widgets.dialogs import Choice, Question, TextPage, TypedQuestion
from groundstation.vehicle import load_vehicle

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


@pytest.fixture
def core(tmp_path: Path) -> Iterator[ScriptedCore]:
    with ScriptedCore(tmp_path / "flight").running() as running:
        yield running


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
        lambda: watch.newest is not None and watch.newest.phase == phase and app._shown is watch.newest,
        lambda: core.say(phase, **changes),
    )
    return watch


def text_of(app: GroundStation, selector: str) -> str:
    return "".join(str(widget.content) for widget in app.screen.query(selector).results(Static))


def station(tmp_path: Path) -> GroundStation:
    return GroundStation(tmp_path / "logs")


async def test_abort_works_from_inside_a_field_on_every_screen_and_in_front_of_every_question(
    core: ScriptedCore, tmp_path: Path
) -> None:
    app = station(tmp_path)
    async with app.run_test(size=(80, 24)) as pilot:
        await follow(pilot, core)
        given = 0

        async def abort(key: str) -> None:
            nonlocal given
            await pilot.press(key)
            given += 1
            await until(pilot, lambda: len(core.orders) >= given)
            assert core.orders[-1].name == "abort"

        for number, (mode, title) in enumerate(SCREENS.items(), 1):
            await app.switch_mode(mode)
            await all_shown(pilot, number, title)
            fields = list(app.screen.query(Input))
            if not fields:  # a screen without one gets one, so that the promise holds for those to come
                field = Input()
                await app.screen.mount(field)
                fields = [field]
            fields[0].focus()
            await pilot.press("1")
            assert fields[0].value.endswith("1"), "a digit typed into a field is text, not a change of screen"
            await abort("ctrl+g")
        await abort("f8")
        for question in (Question("?"), TypedQuestion("?", "FLY"), TextPage("log", "text")):
            await app.push_screen(question)
            await until(pilot, lambda: "ABORT + LAND ^g" in screen_text(app) and "KILL ^o" in screen_text(app))
            await abort("ctrl+g")
            app.pop_screen()
        assert len(core.orders) == given


async def test_abort_from_a_watcher_that_does_not_hold_the_lease(core: ScriptedCore, tmp_path: Path) -> None:
    core.lease.request(Lease("somebody else"))
    app = station(tmp_path)
    async with app.run_test(size=(80, 24)) as pilot:
        watch = await follow(pilot, core)
        await until(
            pilot, lambda: "another is the operator" in text_of(app, "#flight-line"), lambda: core.say("exciting")
        )
        assert not watch.operator
        await pilot.press("b")
        await until(pilot, lambda: core.orders)
        assert "needs the operator's lease" in watch.order("land")
        await pilot.press("ctrl+g")
        await until(pilot, lambda: core.orders[-1].name == "abort")
        assert watch.order("abort") == ""


async def test_two_at_once_see_the_same_and_one_holds_the_lease(core: ScriptedCore, tmp_path: Path) -> None:
    first, second = station(tmp_path), station(tmp_path)
    async with first.run_test(size=(80, 24)) as one:
        a = await follow(one, core)
        async with second.run_test(size=(200, 60)) as two:
            b = await follow(two, core)
            await until(two, lambda: a.newest == b.newest, lambda: core.say("exciting"))
            assert (a.operator, b.operator) == (True, False)
            await two.press("o")
            await until(two, lambda: b.operator and not a.operator, lambda: core.say("exciting"))
        await until(one, lambda: core.lease.holder == "")  # with its holder gone the lease is free


async def test_a_simulated_flight_is_started_once_it_is_checked_and_not_before(
    core: ScriptedCore, tmp_path: Path
) -> None:
    app = station(tmp_path)
    async with app.run_test(size=(80, 24)) as pilot:
        await follow(pilot, core, Phase.UPLOADED, simulated=True, flight_s=0.0)
        await pilot.press("s")
        await pilot.pause(0.4)
        assert core.orders == []
        await follow(pilot, core, Phase.CHECKED, flight_s=0.0)
        await until(pilot, lambda: [order.name for order in core.orders] == ["start"])


async def test_what_is_not_known_to_be_simulated_starts_only_after_the_word(core: ScriptedCore, tmp_path: Path) -> None:
    app = station(tmp_path)
    async with app.run_test(size=(80, 24)) as pilot:
        await follow(pilot, core, Phase.CHECKED, flight_s=0.0)
        for typed, starts in (("fly", 0), ("", 0), ("FLY", 1)):
            await pilot.press("s")
            await until(pilot, lambda: isinstance(app.screen, TypedQuestion))
            await pilot.press(*typed, "enter")
            await until(pilot, lambda: isinstance(app.screen, StationScreen))
            core.say(Phase.CHECKED, flight_s=0.0)
            await pilot.pause(0.4)
            await until(pilot, lambda n=starts: len(core.orders) >= n, lambda: core.say(Phase.CHECKED, flight_s=0.0))
            assert len(core.orders) == starts, typed


async def test_text_of_vehicles_and_logs_is_text(core: ScriptedCore, tmp_path: Path) -> None:
    app = station(tmp_path)
    async with app.run_test(size=(200, 60)) as pilot:
        hostile = {"reason": HOSTILE, "notes": (HOSTILE,), "text": HOSTILE, "streams": {HOSTILE: StreamStatus(1, 9.0)}}
        for phase, keys in ((Phase.EXCITING, "13"), (Phase.IDENTIFYING, "4")):
            for key in keys:
                await pilot.press(key)
                await follow(pilot, core, phase, **hostile)
                await until(pilot, lambda: HOSTILE in screen_text(app))
        app._fail(HOSTILE)
        await until(pilot, lambda: HOSTILE in text_of(app, "#flight-line"))


def screen_text(app: GroundStation) -> str:
    """What the terminal shows, without colours."""
    lines = app.screen._compositor.render_strips()
    return "\n".join("".join(segment.text for segment in strip) for strip in lines)


async def test_after_landing_identify_comes_up_by_itself_and_shows_what_the_analysis_wrote(
    core: ScriptedCore, tmp_path: Path
) -> None:
    core.folder.mkdir()
    app = station(tmp_path)
    async with app.run_test(size=(200, 60)) as pilot:
        await follow(pilot, core, Phase.EXCITING)
        assert app.current_mode == "fly"
        table = {
            "mass_kg": (1.79, 1.8253, 1.8247, 1.8259),
            "ixx_kg_m2": (0.03, float("nan"), float("nan"), float("nan")),
        }
        await follow(pilot, core, Phase.LANDED)
        await until(pilot, lambda: app.current_mode == "identify")
        await follow(pilot, core, Phase.IDENTIFYING, progress=0.4, text="instruments", table=table)
        await until(pilot, lambda: "1.82530 ± 0.00060" in screen_text(app) and "not revealed" in screen_text(app))
        write_results(core.folder)
        await follow(pilot, core, Phase.DONE)
        await until(pilot, lambda: "IV (estimate)" in screen_text(app) and "1.82540 ± 0.00066" in screen_text(app))
        assert "mass, kg, over s" in screen_text(app)
        await pilot.press("5")
        await until(pilot, lambda: "the rotors drag" in screen_text(app))
        await pilot.press("n")
        await until(pilot, lambda: app.current_mode == "plan" and "to settle it" in screen_text(app))
        assert app.plan is not None
        assert app.plan.note == "to settle it", "n takes the plan that the diagnosis proposes"


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


async def test_a_plan_never_takes_the_place_of_another(tmp_path: Path) -> None:
    app = GroundStation(tmp_path / "logs")
    folder = tmp_path / "logs" / "plans"
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.press("2")
        app.plan = load_plan(find_config("plans", "qball2"))
        await pilot.press("w", "w")
        (folder / "qball2-2.toml").write_text("mine")
        (folder / "qball2-1.toml").unlink()
        await pilot.press("w", "w")
    assert sorted(p.name for p in folder.iterdir()) == [f"qball2-{n}.toml" for n in (1, 2, 3)]
    assert (folder / "qball2-2.toml").read_text() == "mine"


async def test_flights_lists_filters_and_opens(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    for name in ("alpha", "beta[red]"):
        write_results(logs / name)
    app = GroundStation(logs)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.press("6")
        table = app.screen.query_one("#catalogue", DataTable)
        await until(pilot, lambda: table.row_count == 2)
        await pilot.press("m", "down", "m")
        assert app.screen.query_one("#comparison", DataTable).row_count == 1
        await pilot.pause()
        assert "alpha" in text_of(app, "#flights-text")
        await pilot.press("w")
        await until(pilot, lambda: (logs / "compare.html").is_file() and (logs / "compare.md").is_file())
        await pilot.press("slash", *"beta", "enter")
        await until(pilot, lambda: table.row_count == 1)
        await pilot.press("enter")
        await until(pilot, lambda: app.current_mode == "identify" and "IV (estimate)" in screen_text(app))
        assert "beta[red]" in screen_text(app)


async def test_flights_are_tagged_noted_and_their_trend_is_shown(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    for name in ("alpha", "beta"):
        write_results(logs / name)
    app = GroundStation(logs)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.press("6")
        await until(pilot, lambda: app.screen.query_one("#catalogue", DataTable).row_count == 2)
        await pilot.press("g", *"payload", "enter")
        await until(pilot, lambda: any(row["tags"] == ["payload"] for row in Catalogue(logs).rows()))
        await pilot.press("n", *"windy", "enter")
        await until(pilot, lambda: any(row["note"] == "windy" for row in Catalogue(logs).rows()))
        await pilot.press("v")
        await until(pilot, lambda: "a trend needs 4" in text_of(app, "#flights-text"))
        await pilot.press("b")
        await until(pilot, lambda: "every recording here has results" in text_of(app, "#flights-text"))


async def test_nothing_in_the_logs_and_a_core_that_does_not_exist_are_sentences(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("groundstation.tui.watch.CONNECT_S", 0.5)
    app = station(tmp_path)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.press("6")
        await until(pilot, lambda: "no flights in" in text_of(app, "#flights-text"))
        assert app.focused is None, "the screens' digits are not the filter's"
        await pilot.press("4", "5", "ctrl+g", "ctrl+o", "l", "question_mark", "escape")
        assert isinstance(app.screen, StationScreen)
        app.follow(CoreWatch(Access(bus.loopback(bus.free_port())), tmp_path / "gone"))
        await until(pilot, lambda: "no core answers" in text_of(app, "#flight-line"))


async def test_keys_on_a_screen_that_opens_and_on_one_that_closes_do_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken: list[Event] = []

    async def take(_: App[int], event: Event) -> None:
        taken.append(event)

    monkeypatch.setattr(App, "on_event", take)
    Flights().action_scroll_body(1)  # it has no body yet
    app, key = station(tmp_path), Key("6", "6")
    await app.on_event(key)
    assert taken == [key]
    monkeypatch.setattr(app, "exit", lambda status: None)
    app.action_leave()
    await app.on_event(key)
    assert taken == [key], "what is typed while it closes is the shell's"


async def test_a_flight_under_way_is_found(core: ScriptedCore, tmp_path: Path) -> None:
    folder = tmp_path / "logs" / "2025-01-01T00-00-00-qball2"
    folder.mkdir(parents=True)
    write_access(folder / "core.endpoint", core.access)
    app = station(tmp_path)
    async with app.run_test(size=(80, 24)) as pilot:
        await until(pilot, lambda: app.core is not None)
        await follow(pilot, core)
        assert "EXCITING" in text_of(app, "#big-state")


async def all_shown(pilot: Pilot, number: int, title: str) -> None:
    """What every screen promises to show."""
    promised = ("ABORT + LAND ^g", "KILL ^o", f"[{number} {title}]", "? Help")
    app = pilot.app
    assert isinstance(app, GroundStation)
    await until(pilot, lambda: all(text in screen_text(app) for text in promised))


async def test_digits_open_the_screens_in_a_large_light_terminal(tmp_path: Path) -> None:
    app = station(tmp_path)
    async with app.run_test(size=(200, 60)) as pilot:
        app.theme = "textual-light"
        for number, (mode, title) in enumerate(SCREENS.items(), 1):
            app.screen.set_focus(None)
            await pilot.press(str(number))
            await until(pilot, lambda mode=mode: app.current_mode == mode)
            await all_shown(pilot, number, title)


async def test_the_footer_offers_only_what_can_be_done_now(core: ScriptedCore, tmp_path: Path) -> None:
    app = station(tmp_path)
    async with app.run_test(size=(120, 40)) as pilot:

        def offered() -> set[str]:
            return {b.binding.description for b in app.screen.active_bindings.values() if b.binding.show and b.enabled}

        await pilot.press("3")
        await until(pilot, lambda: {"Prepare"} <= offered() and not {"Start", "Land early"} & offered())
        await follow(pilot, core, Phase.CHECKED, simulated=True, flight_s=0.0)
        await until(pilot, lambda: {"Start"} <= offered() and not {"Prepare", "Land early"} & offered())
        await follow(pilot, core, Phase.EXCITING)
        await until(pilot, lambda: {"Land early"} <= offered() and not {"Start", "Prepare"} & offered())
        await pilot.press("ctrl+p")
        await until(pilot, lambda: "Abort and land" in screen_text(app))
        await pilot.press(*"early")
        await until(pilot, lambda: "Land early" in screen_text(app))


async def test_a_limit_that_is_near_rings_the_bell_and_says_so(core: ScriptedCore, tmp_path: Path) -> None:
    app, rung = station(tmp_path), []
    app.bell = lambda: rung.append(1)  # type: ignore[method-assign]
    async with app.run_test(size=(80, 24), notifications=True) as pilot:
        await follow(pilot, core)
        assert not rung
        near = "off plan is near"
        await until(pilot, lambda: near in screen_text(app), lambda: core.say(Phase.EXCITING, tracking_error_m=1.0))
        assert len(rung) == 1
        shown = screen_text(app)
        assert "NEAR" in shown and "◉" in shown and "height" in shown and "streams" in shown
        assert "WALL" not in shown and "PAST" not in shown


async def test_the_plan_before_comes_back(tmp_path: Path) -> None:
    app = GroundStation(tmp_path / "logs")
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.press("2")
        screen = app.screen
        assert isinstance(screen, Planner)
        first = load_plan(find_config("plans", "qball2"))
        second = first.model_copy(update={"note": "another"})
        app.plan = first
        screen._found(second)
        await pilot.press("u")
        assert app.plan is first and "another" not in text_of(app, "#plan-text")
        await pilot.press("u")
        assert app.plan is second


async def test_the_campaign_screen_shows_rounds_and_one_key_prepares_the_next_flight(tmp_path: Path) -> None:
    app = station(tmp_path)
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    folder = app.logs / "campaign-2026-01-31T12-00-00-qball2"
    done = Round(
        str(app.logs / "flight-1"),
        "first flight",
        40.0,
        {},
        {},
        "explained",
        ({"effect": "rotor_drag", "rotor": None, "evidence": "Drag."},),
        {},
        {"mass_kg": 1.4},
        ("not sharp enough: mass",),
    )
    plan = find_config("plans", "qball2")
    stand = Campaign(
        folder, vehicle, {"mass_kg": 0.005}, 5, 1, (done,), {"why": "to sharpen mass", "plan": str(plan)}
    ).save()
    (folder / "vehicle.toml").write_bytes(find_config("vehicles", "qball2").read_bytes())
    prepared: list[tuple[object, ...]] = []
    app.prepare_this = lambda *what: prepared.append(what)  # type: ignore[method-assign, assignment]
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.press("7")
        await until(pilot, lambda: "rotor drag" in screen_text(app) and "next: to sharpen mass" in screen_text(app))
        await pilot.press("n")
        await until(pilot, lambda: bool(prepared))
        setup, flown, begun = prepared[0]
        assert isinstance(setup, Setup) and setup.vehicle == str(folder / "vehicle.toml")
        assert isinstance(flown, Plan) and flown.vehicle == "qball2"
        begun(app.logs / "flight-2")  # type: ignore[operator]
        assert load_campaign(folder).pending["folder"] == str(app.logs / "flight-2")
        assert load_campaign(folder).rounds == stand.rounds


async def test_signals_for_the_chart_are_chosen_and_escape_leaves_them(core: ScriptedCore, tmp_path: Path) -> None:
    app = station(tmp_path)
    signals = {"imu/gyro_x_rad_s": 0.1}
    async with app.run_test(size=(120, 40)) as pilot:
        await follow(pilot, core, signals=signals)
        await pilot.press("c")
        await until(pilot, lambda: isinstance(app.screen, Choice) and "imu gyro x, rad/s" in screen_text(app))
        await pilot.press("escape")
        await until(pilot, lambda: isinstance(app.screen, StationScreen))
        await pilot.press("c")
        await until(pilot, lambda: isinstance(app.screen, Choice))
        await pilot.press("end", "space", "enter")
        await until(
            pilot,
            lambda: "imu gyro x, rad/s, over s" in screen_text(app),
            lambda: core.say(Phase.EXCITING, signals=signals),
        )
