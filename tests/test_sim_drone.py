"""The simulated drone's flight manager: what it accepts when, and that every flight ends on the floor."""

from __future__ import annotations

import json
import re
import zlib

import msgspec
import numpy as np
import pytest
import tomli_w
from flights import rest_to_rest_plan
from hypothesis import given, settings
from hypothesis import strategies as st
from sim_states import vehicle_of

from drivers import bus
from drivers.samples import Batch, Event, encode_batch
from groundstation.paths import configs_dir, find_config
from groundstation.trajectory import Plan, load_plan, plan_to_dict
from groundstation.vehicle import load_vehicle
from sim.drone import Drone, braking_setpoints
from sim.effects import Effects
from sim.flight import simulate
from sim.scenario import Scenario, Truth, load_scenario

QBALL = load_vehicle(find_config("vehicles", "qball2"))


def _upload(plan: Plan) -> bus.Upload:
    return bus.make_upload(tomli_w.dumps(plan_to_dict(plan)).encode())


def _drone(scenario: Scenario | None = None, vehicle=QBALL) -> Drone:
    return Drone("d", vehicle, scenario or Scenario(), 1)


def _started(**plan) -> Drone:
    drone = _drone()
    for answer in (
        drone.upload(_upload(rest_to_rest_plan(periods=1.0, **plan))),
        drone.command(bus.Command("arm")),
        drone.command(bus.Command("start")),
    ):
        assert answer.ok, answer.reason
    return drone


def _until(drone: Drone, *phases: str, at_most_s: float = 90.0) -> list:
    samples = []
    for _ in range(round(at_most_s / 0.05)):
        if drone.phase in phases:
            return samples
        samples += drone.advance(50)
    raise AssertionError(f"still {drone.phase} after {at_most_s} s")


def test_a_flight_goes_through_its_phases_in_order_and_says_so():
    drone = _started()
    samples = _until(drone, "landed")
    samples += drone.advance(50)
    told = [s.text.split(":")[0] for _, s in samples if isinstance(s, Event)]
    assert told == ["uploaded", "armed", "takeoff", "exciting", "landing", "landed"]
    status = drone.status()
    assert not status.armed
    assert status.window_s is not None
    assert status.window_s[1] - status.window_s[0] == pytest.approx(10.0)
    assert abs(status.position_m[2] - 0.1) < 1e-9


def test_samples_come_in_order_of_arrival_and_not_before_they_have_arrived():
    drone = _drone(load_scenario(find_config("scenarios", "lab")))
    last = 0.0
    for _ in range(40):
        batch = drone.advance(50)
        times = [at for at, _ in batch]
        assert times == sorted(times)
        if times:
            assert last <= times[0]
            assert times[-1] <= drone.simulation.time_s
            last = times[-1]


def test_what_is_out_of_order_is_refused_with_the_reason():
    drone = _drone()
    assert "upload a plan first" in drone.command(bus.Command("arm")).reason
    assert "arm first" in drone.command(bus.Command("start")).reason
    assert "nothing to land" in drone.command(bus.Command("abort")).reason
    flying = _started()
    flying.advance(3000)
    assert "in the air" in flying.command(bus.Command("disarm")).reason
    assert "in the air" in flying.command(bus.Command("shutdown")).reason
    assert "takeoff" in flying.upload(_upload(rest_to_rest_plan())).reason


def test_damaged_and_senseless_uploads_are_refused_with_the_reason():
    drone = _drone()
    good = _upload(rest_to_rest_plan())
    assert "checksum" in drone.upload(bus.Upload("toml", good.plan + b" ", good.crc32)).reason
    assert "not valid TOML" in drone.upload(bus.make_upload(b"= =")).reason
    assert "not valid JSON" in drone.upload(bus.make_upload(b"{", "json")).reason
    assert "is no table" in drone.upload(bus.make_upload(b"[1]", "json")).reason
    assert "coefficients" in drone.upload(bus.make_upload(b'vehicle = "x"')).reason
    assert drone.phase == "idle"


@settings(max_examples=50, deadline=None)
@given(st.binary(max_size=300), st.sampled_from(["toml", "json"]))
def test_no_upload_brings_it_down(data, form):
    drone = _CONSTANT
    answer = drone.upload(bus.Upload(form, data, zlib.crc32(data)))
    assert not answer.ok
    assert answer.reason


_CONSTANT = _drone()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"amplitude_m": 1.8}, "reaches"),
        ({"amplitude_m": 0.9, "harmonics": 40}, "tilt|thrust|rotor"),
    ],
)
def test_a_plan_it_cannot_fly_is_refused_with_the_limit_in_the_way(change, reason):
    answer = _drone().upload(_upload(rest_to_rest_plan(**change)))
    assert not answer.ok
    assert re.search(reason, answer.reason)


def test_a_plan_below_the_floor_and_one_a_weak_vehicle_cannot_lift_are_refused():
    low = plan_to_dict(rest_to_rest_plan())
    low["coefficients"]["z"]["c"] = -0.5
    assert "below the floor" in _drone().upload(bus.make_upload(json.dumps(low).encode(), "json")).reason
    weak = vehicle_of(speed_max_rad_s=505.0)
    assert "rotor" in _drone(vehicle=weak).upload(_upload(rest_to_rest_plan("square"))).reason


def test_the_published_trajectory_is_accepted():
    assert _drone().upload(_upload(load_plan(find_config("plans", "paper_table2")))).ok


@pytest.mark.parametrize("after_s", [1.0, 8.0, 13.0, 18.0])
def test_an_abort_at_any_time_ends_on_the_floor_near_where_it_was_given(after_s):
    drone = _started()
    for _ in range(round(after_s / 0.05)):
        drone.advance(50)
    there = drone.simulation.position_m
    answer = drone.command(bus.Command("abort"))
    assert answer.ok
    _until(drone, "landed", at_most_s=15.0)
    assert np.linalg.norm(drone.simulation.position_m[:2] - there[:2]) < 0.5
    assert not drone.simulation.crashed


def test_a_braked_path_joins_in_position_velocity_and_comes_to_a_steady_descent():
    row = np.array([1.0, 2.0, 3.0, 0.5, -1.0, 0.3, 9.0, 9.0, 9.0, 0.4, 0.2])
    rows = braking_setpoints(row, 5.0)(5.0 + np.array([0.0, 1e-6, 10.0]))
    np.testing.assert_allclose(rows[0, :6], row[:6])
    np.testing.assert_allclose((rows[1, :3] - rows[0, :3]) / 1e-6, row[3:6], rtol=1e-3)
    np.testing.assert_allclose(rows[2, 3:9], [0.0, 0.0, -0.4, 0.0, 0.0, 0.0], atol=1e-6)


def test_too_heavy_to_lift_it_gives_up_on_the_floor():
    drone = _drone(Scenario(truth=Truth(mass_factor=4.0)))
    drone.upload(_upload(rest_to_rest_plan(periods=1.0)))
    drone.command(bus.Command("arm"))
    drone.command(bus.Command("start"))
    _until(drone, "landed", at_most_s=40.0)
    assert drone.simulation.position_m[2] == pytest.approx(0.1)


def test_a_vehicle_that_tumbles_says_crashed_and_flies_again_after_a_new_upload():
    drone = _started()
    drone.advance(9000)
    drone.simulation.memory.x[10] = 60.0  # something hit it
    _until(drone, "crashed", at_most_s=10.0)
    assert not drone.armed
    assert drone.upload(_upload(rest_to_rest_plan(periods=1.0))).ok
    drone.command(bus.Command("arm"))
    drone.command(bus.Command("start"))
    _until(drone, "landed")


@pytest.mark.parametrize("idle_steps", [1, 7, 50, 250, 333])
def test_it_may_start_at_any_time_between_two_turns_of_the_position_loop(idle_steps):
    drone = _drone(load_scenario(find_config("scenarios", "seed")))
    drone.advance(idle_steps)
    drone.upload(_upload(rest_to_rest_plan(periods=1.0)))
    drone.command(bus.Command("arm"))
    drone.command(bus.Command("start"))
    _until(drone, "exciting", at_most_s=15.0)


def test_it_flies_again_after_landing():
    drone = _started()
    _until(drone, "landed")
    assert drone.upload(_upload(rest_to_rest_plan(periods=1.0, seed=3))).ok
    assert drone.command(bus.Command("arm")).ok
    assert drone.command(bus.Command("start")).ok
    _until(drone, "landed")


def test_nothing_the_drone_sends_names_an_effect_of_its_world():
    lightly = {name: getattr(Effects(), name)._replace(on=True) for name in Effects._fields}
    lightly["slung_load"] = lightly["slung_load"]._replace(mass_kg=0.02)
    drone = _drone(Scenario(name="hall 3", effects=Effects(**lightly)))
    drone.upload(_upload(rest_to_rest_plan(periods=1.0)))
    drone.command(bus.Command("arm"))
    drone.command(bus.Command("start"))
    sent = [bus.encode(drone.description)]
    for sequence in range(400):
        arrived = drone.advance(50)
        sent.append(encode_batch(Batch(sequence, tuple(a for a, _ in arrived), tuple(s for _, s in arrived))))
        sent.append(bus.encode(drone.status()))
    recorded = b"".join(sent)
    assert b"hall 3" in recorded
    for name in Effects._fields:
        assert not re.search(rb"(?i)\b" + name.replace("_", "[ _-]?").encode() + rb"\b", recorded), name


def test_the_description_carries_the_true_vehicle():
    import tomllib

    from groundstation.vehicle import vehicle_from_dict

    drone = _drone(Scenario(truth=Truth(mass_factor=1.05)))
    truth = vehicle_from_dict(tomllib.loads(drone.description.truth_toml))
    assert truth.mass_kg == pytest.approx(1.05 * QBALL.mass_kg)
    assert msgspec.msgpack.decode(bus.encode(drone.description), type=bus.Description) == drone.description


def test_every_shipped_scenario_flies():
    for path in sorted((configs_dir() / "scenarios").glob("*.toml")):
        simulate(QBALL, rest_to_rest_plan(periods=1.0), load_scenario(path), 1)  # raises when it does not land
