"""Fly until known: intervals that may be looked at, what is decided at a rest point, and that nothing goes past what
was checked.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import tomli_w

from drivers import bus
from drivers.bus import DroneStatus
from groundstation.errors import BadInput
from groundstation.flight.client.client import FlightOrder
from groundstation.flight.client.rehearse import fly, simulated_drone
from groundstation.flight.core.until import FlyUntil
from groundstation.flight.until import Goal, UntilKnown, lasting_until
from groundstation.identification.results import Estimate
from groundstation.identification.sequential import Spending, at_any_time, at_one_moment
from groundstation.paths import find_config
from groundstation.recording import load_flight
from groundstation.targets import parse_targets
from groundstation.trajectory import changed_length, flight_path, load_plan, plan_from_dict, plan_to_dict
from groundstation.vehicle import Until, load_vehicle, vehicle_from_dict, vehicle_to_dict
from sim.drone import Drone
from sim.scenario import load_scenario

MASS = {"mass_kg": 0.01}
QBALL = load_vehicle(find_config("vehicles", "qball2"))
PLAN = load_plan(find_config("plans", "qball2"))


def estimate(std: float) -> dict[str, Estimate]:
    return {"mass_kg": Estimate.normal(1.0, std)}


def goal(**changes) -> Goal:
    return replace(Goal(MASS, 5.0, 4, 6, automatic=True), **changes)


def test_one_look_is_the_textbook_interval():
    assert Spending(1).look(0.3) == pytest.approx(1.959964, abs=2e-4)
    assert at_one_moment() == pytest.approx(1.959964, abs=1e-6)


def test_all_looks_together_miss_as_often_as_was_said():
    """Independent flights of eight looks at uneven times: spent misses 5 % at any look, the textbook interval far more,
    the mixture less.
    """
    seed, flights = 17, 40_000
    print("seed", seed)
    random = np.random.default_rng(seed)
    information = np.array([1.0, 1.5, 4.0, 4.2, 7.0, 9.0, 9.5, 20.0])
    score = np.cumsum(random.normal(size=(flights, 8)) * np.sqrt(np.diff(information, prepend=0.0)), axis=1)
    z = np.abs(score / np.sqrt(information))
    spending = Spending(8)
    spent = np.array([spending.look(i**-0.5) for i in information])
    always = np.array([at_any_time(i**-0.5, 0.3) for i in information])
    assert np.mean((z > spent).any(axis=1)) == pytest.approx(0.05, abs=0.004)
    assert np.mean((z > always).any(axis=1)) < 0.05
    assert np.mean((z > at_one_moment()).any(axis=1)) > 0.12
    assert (spent > at_one_moment()).all()
    assert (always > spent).all()


def test_the_bound_for_every_moment_is_tightest_where_it_was_asked_to_be():
    at_target = at_any_time(0.1, 0.1)
    assert at_target == pytest.approx(3.04, abs=0.01)
    assert at_target < min(at_any_time(0.3, 0.1), at_any_time(0.03, 0.1))
    assert at_any_time(math.inf, 0.1) == math.inf


def test_a_look_that_knows_nothing_leaves_its_share_to_the_next():
    late, early = Spending(2), Spending(2)
    assert late.look(math.inf) == math.inf
    early.look(1.0)
    assert late.look(1.0) == pytest.approx(1.96, abs=1e-3)
    assert early.look(1.0) > 2.2, "no news: the interval of the look before goes on"


def test_it_ends_at_the_first_rest_point_where_every_target_is_met():
    known = UntilKnown(goal())
    assert known.look(estimate(0.1), 12.0).order == ""
    assert known.look({}, 12.0).order == ""
    look = known.look(estimate(0.002), 12.0)
    assert look.met
    assert look.order == "finish"
    assert known.length == 3


def test_it_goes_on_no_further_than_the_stated_maximum():
    known = UntilKnown(goal())
    orders = [known.look(estimate(0.1 - 0.001 * k), 12.0).order for k in range(6)]
    assert orders == ["", "", "", "extend", "extend", ""]
    assert known.length == 6


def test_an_extension_that_the_vehicle_refuses_is_none():
    known = UntilKnown(goal())
    for k in range(4):
        known.look(estimate(0.1 - 0.001 * k), 12.0)
    known.refused("extend")
    assert known.length == 4


def test_a_battery_that_would_not_last_ends_it_as_planned():
    known = UntilKnown(goal(empty_v=10.0))
    looks = [known.look(estimate(0.1 - 0.001 * k), volts) for k, volts in enumerate((11.2, 10.8, 10.5, 10.3))]
    assert looks[-1].order == ""
    assert "battery" in looks[-1].sentence


@pytest.mark.parametrize("std", [0.002, 0.1])
def test_a_real_vehicle_flies_as_planned_unless_the_operator_agrees(std):
    known = UntilKnown(goal(automatic=False))
    assert [known.look(estimate(std * (1 - 0.01 * k)), 12.0).order for k in range(4)] == ["", "", "", ""]
    assert known.length == 4


def test_the_operator_agrees_to_what_is_proposed_and_to_that_alone():
    known = UntilKnown(goal(automatic=False))
    assert "nothing is proposed" in known.agree(known.preview(estimate(0.1), 12.0).order)
    assert known.agree(known.preview(estimate(0.002), 12.0).order) == ""
    assert known.look(estimate(0.1), 12.0).order == "", "it was no longer true at the rest point"
    assert known.agree(known.preview(estimate(0.002), 12.0).order) == ""
    assert known.look(estimate(0.002), 12.0).order == "finish"


def test_the_screen_looks_as_often_as_it_likes_and_spends_nothing():
    known, other = UntilKnown(goal()), UntilKnown(goal())
    for _ in range(5):
        known.preview(estimate(0.01), 12.0)
    assert known.look(estimate(0.01), 12.0) == other.look(estimate(0.01), 12.0)


def test_time_to_target_is_told_by_how_information_has_grown():
    progress = UntilKnown(goal()).look(estimate(0.0102), 12.0).progress["mass_kg"]
    assert progress.spent > 1.0
    assert progress.seconds == pytest.approx(5.0 * (progress.spent**2 - 1.0))
    assert progress.at_any_time > progress.spent


def test_a_plan_is_given_its_longest_length_and_keeps_its_own():
    plan = lasting_until(PLAN, Until(targets="ixx:2%,mass:1%", at_most_s=61.0), automatic=True)
    assert (plan.periods, plan.first_periods) == (12.0, 8.0)
    assert plan_from_dict(plan_to_dict(plan)) == plan
    assert plan.as_flown(24.9) == PLAN.model_copy(update={"periods": 5.0})
    short = lasting_until(PLAN, Until(targets="mass:1%", at_most_s=20.0), automatic=True)
    assert (short.periods, short.first_periods) == (4.0, 4.0)


@pytest.mark.parametrize(
    ("targets", "at_most", "word"), [("lag:5%", 80.0, "after landing"), ("mass:1%", 3.0, "period")]
)
def test_targets_that_no_flight_reaches_in_the_air_are_refused(targets, at_most, word):
    with pytest.raises(BadInput, match=word):
        lasting_until(PLAN, Until(targets=targets, at_most_s=at_most), automatic=True)


def test_a_vehicle_file_may_say_until_when():
    document = {**vehicle_to_dict(QBALL), "until": {"targets": "mass:0.5%"}}
    vehicle = vehicle_from_dict(document)
    assert vehicle.until == Until(targets="mass:0.5%")
    assert vehicle_from_dict(vehicle_to_dict(vehicle)) == vehicle
    with pytest.raises(BadInput, match="mess"):
        vehicle_from_dict({**document, "until": {"targets": "mess:0.5%"}})


def test_lengths_change_at_rest_points_alone():
    path = flight_path(PLAN, (0.0, 0.0, 0.0, 0.0))
    before = sum(p.duration_s for p in path.parts[:3])
    ended = changed_length(path, before + 12.0, "finish", 8.0)
    assert not isinstance(ended, str)
    assert ended.parts[3].duration_s == pytest.approx(15.0)
    rest = ended.sample([before + 15.0])
    assert np.abs(rest.position[1:3]).max() < 1e-6
    assert np.allclose(rest.position[0], path.sample([before]).position[0])
    assert "checked" in str(changed_length(path, before + 39.0, "extend", 8.0))
    longer = changed_length(ended, before + 14.0, "extend", 8.0)
    assert not isinstance(longer, str)
    assert longer.parts[3].duration_s == pytest.approx(20.0)
    assert "not being flown" in str(changed_length(path, 0.5, "finish", 8.0))


def test_the_simulated_drone_ends_and_extends():
    plan = lasting_until(PLAN, Until(targets="mass:1%", at_most_s=45.0), automatic=True)
    drone = Drone("vehicle", QBALL, load_scenario(find_config("scenarios", "clean")), 1)
    assert drone.upload(bus.make_upload(tomli_w.dumps(plan_to_dict(plan)).encode())).ok
    drone.advance(1000)
    assert not drone.command(bus.Command("finish")).ok
    assert drone.command(bus.Command("arm")).ok
    assert drone.command(bus.Command("start")).ok
    while drone.phase != "exciting":
        drone.advance(100)
    start, end = drone.status().window_s or (0.0, 0.0)
    assert end - start == pytest.approx(40.0), "as planned, although 45 s were checked"
    assert drone.command(bus.Command("extend")).ok
    assert not drone.command(bus.Command("extend")).ok
    assert drone.command(bus.Command("finish")).ok
    start, end = drone.status().window_s or (0.0, 0.0)
    assert end - start == pytest.approx(5.0)


def test_lock_stepped_time_waits_for_the_look_and_for_its_answer():
    plan = lasting_until(PLAN, Until(targets="mass:1%"), automatic=True)
    until = FlyUntil(plan, QBALL, lock_step=True)
    until.follow(DroneStatus("exciting", True, 10.0, 20.0, window_s=(10.0, 50.0)))
    assert until.hold_s() == pytest.approx(24.8)
    assert until.moment(24.7, 0.05, estimate(0.1), 12.0) == ("", "")
    order, told = until.moment(24.8, 0.05, estimate(0.001), 12.0)
    assert order == "finish"
    assert "can end after 5 s" in told
    assert until.hold_s() == pytest.approx(24.8), "until the vehicle has answered"
    until.answered(order, ok=True)
    assert until.hold_s() == math.inf
    assert until.status() is not None


@pytest.mark.slow
def test_a_rehearsal_ends_when_it_is_known_and_its_recording_says_so(tmp_path):
    """Targets that the second period meets: the core, the drone and the recording agree on where the excitation
    ended.
    """
    from groundstation.analysis.plans import write_plan

    folder, vehicle = tmp_path / "flight", find_config("vehicles", "qball2").resolve()
    folder.mkdir()
    plan = lasting_until(PLAN, Until(targets="ixx,iyy,izz:5%,mass:1%", at_most_s=80.0), automatic=True)
    drone = simulated_drone(vehicle, find_config("scenarios", "seed").resolve(), 1)
    order = FlightOrder(folder, write_plan(plan, folder / "plan.toml"), vehicle, drone, analyse=False)
    fly(order, say=lambda text: None)
    flight = load_flight(folder)
    assert flight.window_s is not None
    assert flight.plan is not None
    flown = flight.window_s[1] - flight.window_s[0]
    assert flown == pytest.approx(5.0 * flight.plan.periods, abs=0.1)
    assert flown < 39.0
    assert parse_targets("ixx,iyy,izz:5%,mass:1%") == plan.until.targets  # type: ignore[union-attr]
