"""The guard: one test per limit, its timer, its figures; decisions only grow; every shipped station file is what it
says.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from groundstation.errors import BadInput
from groundstation.flight.link.guard import Guard, Observations, Oscillation
from groundstation.flight.station import Station, load_station, station_from_dict

FINE = Observations(
    position_m=(0.0, 0.0, 1.0), velocity_m_s=(0.5, 0.0, 0.0), quaternion=(1.0, 0.0, 0.0, 0.0),
    target_m=(0.1, 0.0, 1.0), state_age_s=0.02, link_age_s=0.01, pose_age_s=0.01, pose_disagreement_m=0.02,
    battery_remaining=0.8, battery_v=16.0, estimator_jump_m=0.0, oscillation_rad_s=0.1, core_age_s=0.1,
    setpoint_age_s=0.02,
)  # fmt: skip

TILTED = (math.cos(0.4), math.sin(0.4), 0.0, 0.0)
CROSSED = {
    "box": {"position_m": (3.2, 0.0, 1.0), "target_m": None},
    "speed": {"velocity_m_s": (2.5, 2.5, 0.0)},
    "tilt": {"quaternion": TILTED},
    "tracking": {"target_m": (1.5, 0.0, 1.0)},
    "pose_age": {"pose_age_s": 0.4},
    "pose_disagreement": {"pose_disagreement_m": 0.5},
    "state_age": {"state_age_s": 1.0},
    "link_age": {"link_age_s": 0.9},
    "battery": {"battery_remaining": 0.1},
    "estimator_reset": {"estimator_jump_m": 0.5},
    "oscillation": {"oscillation_rad_s": 1.2},
    "core_silent": {"core_age_s": 4.0},
    "setpoint_age": {"setpoint_age_s": 0.5},
    "abort": {"abort": "the operator pressed a key"},
}


def guard(**limits) -> Guard:
    station = station_from_dict({"guard": limits})
    return Guard(station.guard, station.box, empty_v=14.0)


def watch(watched: Guard, seen: Observations, seconds: float, start: float = 0.0):
    """Show the same for some time at 50 Hz; the time and decision of the first verdict."""
    for n in range(int(seconds * 50) + 1):
        verdict = watched.step(start + n / 50, seen)
        if verdict is not None:
            return n / 50, verdict
    return None


def test_every_limit_has_a_test_here():
    assert set(CROSSED) == set(type(Station().guard).model_fields)


def test_a_flight_within_its_limits_is_left_alone():
    assert watch(guard(), FINE, 10.0) is None


@pytest.mark.parametrize("name", CROSSED)
@pytest.mark.parametrize("action", ["hold", "land", "kill"])
def test_each_limit_does_its_action_after_its_time_and_says_why(name, action):
    limit = getattr(Station().guard, name)
    watched = guard(**{name: {"limit": limit.limit, "action": action, "for_s": 0.5}})
    found = watch(watched, replace(FINE, **CROSSED[name]), 1.0)
    assert found is not None
    waited, verdict = found
    assert (verdict.action, verdict.limit) == (action, name)
    assert waited == pytest.approx(0.5, abs=0.021)
    assert any(c.isdigit() for c in verdict.reason) or name == "abort"


@pytest.mark.parametrize("name", sorted(set(CROSSED) - {"abort"}))
def test_a_limit_crossed_for_less_than_its_time_is_forgiven(name):
    limit = getattr(Station().guard, name)
    watched = guard(**{name: {"limit": limit.limit, "action": "land", "for_s": 0.5}})
    for n in range(500):
        crossed = n % 24 < 20  # 0.4 s out, 0.08 s in
        assert watched.step(n / 50, replace(FINE, **CROSSED[name]) if crossed else FINE) is None


def test_decisions_only_grow_stronger():
    watched = guard(speed={"limit": 1.0, "action": "land"}, tilt={"limit": 0.5, "action": "kill"},
                    battery={"limit": 0.2, "action": "hold"})  # fmt: skip
    low = replace(FINE, battery_remaining=0.1)
    assert watched.step(0.0, low).action == "hold"
    assert watched.step(0.1, replace(low, velocity_m_s=(2.0, 0.0, 0.0))).action == "land"
    assert watched.step(0.2, FINE).action == "land"
    assert watched.step(0.3, replace(FINE, quaternion=TILTED)).action == "kill"
    assert watched.step(9.9, FINE).limit == "tilt"


@pytest.mark.parametrize("field", ["position_m", "velocity_m_s"])
def test_a_state_that_is_not_a_number_is_no_good_state(field):
    assert watch(guard(), replace(FINE, **{field: (math.nan, 0.0, 1.0)}), 1.0) is not None


def test_a_quaternion_that_is_not_a_number_counts_as_tilted():
    assert watch(guard(), replace(FINE, quaternion=(math.nan,) * 4), 1.0) is not None


def test_a_simulation_behind_real_time_is_told_from_a_vehicle_astray():
    astray = replace(FINE, **CROSSED["tracking"])
    for rate, slow in ((None, False), (1.0, False), (0.988, False), (0.7, True)):
        found = watch(guard(), replace(astray, clock_rate=rate), 1.0)
        assert found is not None
        assert ("its clock ran at 0.70 of ours" in found[1].reason) is slow
    assert watch(guard(), replace(FINE, clock_rate=0.3), 10.0) is None  # it explains, and decides nothing


def test_what_does_not_apply_is_not_watched():
    assert watch(guard(), Observations(), 10.0) is None


def test_the_vehicles_empty_voltage_counts_where_no_charge_is_reported():
    watched = guard()
    assert watch(watched, replace(FINE, battery_remaining=None, battery_v=13.5), 3.0)[1].limit == "battery"


def test_a_limit_cycle_shows_as_oscillation_and_an_excitation_does_not():
    for frequency, amplitude, low, high in ((23.0, math.radians(95), 0.9, 1.3), (1.0, 1.5, 0.0, 0.25)):
        seen = Oscillation()
        for t in np.arange(0.0, 3.0, 0.004):
            seen.add(float(t), (amplitude * math.sin(2 * math.pi * frequency * t), 0.0, 0.0))
        assert low < seen.rms_rad_s < high


def test_oscillation_survives_a_gap_and_a_clock_that_restarts():
    seen = Oscillation()
    for t in (0.0, 0.01, 5.0, 5.01, 0.0, 0.01):
        seen.add(t, (0.5, 0.0, 0.0))
    assert seen.rms_rad_s < 0.01


def test_the_shipped_station_shows_every_default_as_it_is():
    assert load_station("default") == Station()


@pytest.mark.parametrize(
    ("document", "says"),
    [
        ({"guard": {"tilt": {"limit": -1.0}}}, "guard.tilt.limit"),
        ({"guard": {"tilt": {"limit": 1.0, "action": "pray"}}}, "'hold', 'land' or 'kill'"),
        ({"box": {"x_m": [2.0, -2.0]}}, "must be below"),
        ({"gaurd": {}}, "gaurd"),
    ],
)
def test_a_wrong_station_file_is_refused_by_name(document, says):
    with pytest.raises(BadInput, match=says):
        station_from_dict(document)
