"""The terminal UI's screens on their own: plans, flights, campaigns, charts."""

from __future__ import annotations

from pathlib import Path

from textual.widgets import DataTable

from groundstation.campaign.campaign import Campaign, Round, load_campaign
from groundstation.fleet.catalogue import Catalogue
from groundstation.paths import find_config
from groundstation.trajectory import Plan, load_plan
from groundstation.tui.app import GroundStation
from groundstation.tui.screens.plan import Planner
from groundstation.tui.setup import Setup
from groundstation.tui.widgets.bars import SCREENS
from groundstation.vehicle import load_vehicle
from tests.scripted_core import (
    all_shown,
    screen_text,
    station,
    text_of,
    until,
    write_results,
)


async def test_a_plan_never_takes_the_place_of_another(tmp_path: Path) -> None:
    app = GroundStation(tmp_path / "logs")
    folder = tmp_path / "logs" / "plans"
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.press("2")
        app.station.plan = load_plan(find_config("plans", "qball2"))
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


async def test_digits_open_the_screens_in_a_large_light_terminal(tmp_path: Path) -> None:
    app = station(tmp_path)
    async with app.run_test(size=(200, 60)) as pilot:
        app.theme = "textual-light"
        for number, (mode, title) in enumerate(SCREENS.items(), 1):
            app.screen.set_focus(None)
            await pilot.press(str(number))
            await until(pilot, lambda mode=mode: app.current_mode == mode)
            await all_shown(pilot, number, title)


async def test_the_plan_before_comes_back(tmp_path: Path) -> None:
    app = GroundStation(tmp_path / "logs")
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.press("2")
        screen = app.screen
        assert isinstance(screen, Planner)
        first = load_plan(find_config("plans", "qball2"))
        second = first.model_copy(update={"note": "another"})
        app.station.plan = first
        screen._found(second)
        await pilot.press("u")
        assert app.plan is first and "another" not in text_of(app, "#plan-text")
        await pilot.press("u")
        assert app.plan is second


async def test_the_campaign_screen_shows_rounds_and_one_key_prepares_the_next_flight(tmp_path: Path) -> None:
    app = station(tmp_path)
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    folder = app.station.logs / "campaign-2026-01-31T12-00-00-qball2"
    done = Round(
        str(app.station.logs / "flight-1"),
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
    app.station.prepare_this = lambda *what: prepared.append(what)  # type: ignore[method-assign, assignment]
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.press("7")
        await until(pilot, lambda: "rotor drag" in screen_text(app) and "next: to sharpen mass" in screen_text(app))
        await pilot.press("n")
        await until(pilot, lambda: bool(prepared))
        setup, flown, begun = prepared[0]
        assert isinstance(setup, Setup) and setup.vehicle == str(folder / "vehicle.toml")
        assert isinstance(flown, Plan) and flown.vehicle == "qball2"
        begun(app.station.logs / "flight-2")  # type: ignore[operator]
        assert load_campaign(folder).pending["folder"] == str(app.station.logs / "flight-2")
        assert load_campaign(folder).rounds == stand.rounds
