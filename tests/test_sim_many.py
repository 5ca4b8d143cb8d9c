"""Many flights at once: each is, to the last bit, the flight that is simulated alone."""

from __future__ import annotations

import time

import numpy as np
import pytest
from flights import rest_to_rest_plan
from sim_states import vehicle_of

from groundstation.errors import FlightAborted
from groundstation.paths import find_config
from groundstation.vehicle import Vehicle, load_vehicle
from sim.flight import SimulatedFlight, simulate
from sim.many import Job, Outcome, simulate_many
from sim.scenario import Scenario, Truth, load_scenario, scenario_from_dict

QBALL = load_vehicle(find_config("vehicles", "qball2"))
LAB = load_scenario(find_config("scenarios", "lab"))
SHORT = rest_to_rest_plan(periods=1.0)
SPREAD = 0.3
"""How far strengths of effects differ from flight to flight of one group, as a share."""

MIXTURES = {
    "motors and battery": ("motor_lag", "input_delay", "battery_sag", "rotor_gyroscopic", "weak_rotor"),
    "aerodynamics": ("rotor_drag", "body_drag", "flapping_moment", "angular_damping", "translational_lift", "wind"),
    "inflow and rotors": ("climb_inflow", "ground_effect", "thrust_scale", "torque_scale", "thrust_curve"),
    "wear": ("rotor_degradation", "thrust_memory", "com_offset", "payload_change"),
    "attachments": ("slung_load", "tether", "constant_wrench"),
    "room": ("attracting_wall", "magnet"),
    "instruments": ("imu_misalignment", "mocap_misalignment", "mocap_tilt", "clock_offset"),
}


def _varied(table: dict, random: np.random.Generator) -> dict:
    """An effect's table with its numbers a little different; what is no float stays."""

    def other(value):
        if isinstance(value, tuple):
            return tuple(other(v) for v in value)
        return value * random.uniform(1.0 - SPREAD, 1.0) if isinstance(value, float) else value

    return {name: other(value) for name, value in table.items()}


def _world(names: tuple[str, ...], random: np.random.Generator) -> Scenario:
    drawn = {name: _varied(getattr(LAB.effects, name)._asdict(), random) | {"on": True} for name in names}
    truth = LAB.truth.model_copy(update={"mass_factor": random.uniform(0.95, 1.05)})
    clock = LAB.imu.clock.model_copy(update={"phase": None})
    update = {"effects": scenario_from_dict({"effects": drawn}).effects, "truth": truth}
    return LAB.model_copy(update=update | {"imu": LAB.imu.model_copy(update={"clock": clock})})


def _alone(job: Job) -> SimulatedFlight:
    return simulate(job.vehicle, job.plan, job.scenario, job.seed, rest_s=job.rest_s)


def _assert_equal(job: Job, found: Outcome) -> None:
    alone = _alone(job)
    assert isinstance(found, SimulatedFlight), found
    assert found.window_s == alone.window_s
    assert found.streams.keys() == alone.streams.keys()
    for name, samples in alone.streams.items():
        for ours, theirs in zip(found.streams[name], samples, strict=True):
            np.testing.assert_array_equal(ours, theirs, err_msg=f"{name} of seed {job.seed}")


@pytest.mark.parametrize("mixture", MIXTURES)
def test_each_of_many_flights_is_the_flight_alone_bit_by_bit(mixture):
    seed = 20_000 + list(MIXTURES).index(mixture)
    print(f"seed {seed}")
    random = np.random.default_rng(seed)
    jobs = [Job(QBALL, SHORT, _world(MIXTURES[mixture], random), seed + i) for i in range(3)]
    found = dict(simulate_many(jobs))
    assert sorted(found) == [0, 1, 2]
    for number, job in enumerate(jobs):
        _assert_equal(job, found[number])


def _heavier(factor: float) -> Scenario:
    return LAB.model_copy(update={"truth": Truth(mass_factor=factor)})


def _of(name: str) -> Vehicle:
    return load_vehicle(find_config("vehicles", name))


def test_commands_of_a_wrench_vehicle_are_recorded_as_its_wrench():
    jobs = [Job(vehicle_of(input="wrench"), SHORT, _heavier(1.0 + 0.01 * i), 60 + i) for i in range(3)]
    found = dict(simulate_many(jobs))
    for number, job in enumerate(jobs):
        _assert_equal(job, found[number])


def test_vehicles_of_several_kinds_fly_in_groups_of_their_kind():
    names = ("hexa", "x500", "crazyflie21", "hexa", "qball2-commanded", "x500", "hexa", "x500", "tricopter", "x500")
    plans = [rest_to_rest_plan(name, periods=1.0, seed=2 + i % 2) for i, name in enumerate(names)]
    jobs = [
        Job(_of(name), plan, _heavier(1.0 + 0.01 * i), 7 + i)
        for i, (name, plan) in enumerate(zip(names, plans, strict=True))
    ]
    found = dict(simulate_many(jobs))
    assert sorted(found) == list(range(len(jobs)))
    for number in (0, 2, 4, 6, 9):
        _assert_equal(jobs[number], found[number])


def test_a_flight_that_crashes_says_so_and_leaves_its_neighbours_alone():
    jobs = [Job(QBALL, SHORT, _losing(share), 3) for share in (0.05, 0.9, 0.1)]
    found = dict(simulate_many(jobs))
    with pytest.raises(FlightAborted) as alone:
        _alone(jobs[1])
    assert isinstance(found[1], FlightAborted)
    assert str(found[1]) == str(alone.value)
    for number in (0, 2):
        _assert_equal(jobs[number], found[number])


def _losing(share: float) -> Scenario:
    """The lab with a rotor that loses a share of its thrust eight seconds after take-off."""
    effect = {"rotor": 1, "loss": share, "start_s": 8.0}
    return LAB.model_copy(update={"effects": scenario_from_dict({"effects": {"rotor_degradation": effect}}).effects})


def test_many_at_once_are_several_times_faster_than_one_by_one():
    jobs = [Job(QBALL, SHORT, LAB, seed) for seed in range(40, 48)]
    dict(simulate_many(jobs))  # compiles, or loads
    _alone(jobs[0])
    ratios = []
    for _ in range(3):
        began = time.process_time()
        dict(simulate_many(jobs))
        together = (time.process_time() - began) / len(jobs)
        began = time.process_time()
        _alone(jobs[0])
        ratios.append((time.process_time() - began) / together)
    assert max(ratios) > 1.5, f"alone over together: {ratios}"
