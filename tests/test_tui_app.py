"""The terminal UI against a core on the loopback bus: orders, views, faults.

What the core says is scripted, the bus is real.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from textual.app import App
from textual.events import Event, Key
from textual.widgets import Input

from drivers import bus
from drivers.access import Access
from groundstation.flight.client.access import write_access
from groundstation.flight.messages import Lease, StreamStatus
from groundstation.flight.sequence import Phase
from groundstation.tui.screens.base import StationScreen
from groundstation.tui.screens.flights import Flights
from groundstation.tui.watch import CoreWatch
from groundstation.tui.widgets.bars import SCREENS
from groundstation.tui.widgets.dialogs import Choice, Question, TextPage, TypedQuestion
from tests.scripted_core import (
    HOSTILE,
    ScriptedCore,
    all_shown,
    follow,
    screen_text,
    station,
    text_of,
    until,
    write_results,
)


@pytest.fixture
def core(tmp_path: Path) -> Iterator[ScriptedCore]:
    with ScriptedCore(tmp_path / "flight").running() as running:
        yield running


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
        app.station.fail(HOSTILE)
        await until(pilot, lambda: HOSTILE in text_of(app, "#flight-line"))


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
