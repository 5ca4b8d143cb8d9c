"""All of a flight is used: dips bridged, every stretch in the air taken, gaps left out, the share told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.flightdata import FlightData
from groundstation.identification.dynamic_fit import fit_dynamics
from groundstation.identification.preparation import prepare
from groundstation.identification.stretches import airborne, gaps, runs_of, within
from groundstation.paths import find_config
from groundstation.recording import load_flight
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from studies.flown import flight_data
from tests.flights import laboratory, rest_to_rest_plan

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
T = np.arange(0.0, 40.0, 0.01)


def test_a_dip_is_bridged_and_a_landing_parts_two_stretches() -> None:
    thrust = np.ones(len(T))
    thrust[T < 3.0] = 0.0
    thrust[(T > 10.0) & (T < 10.5)] = 0.1  # a dive
    thrust[(T > 18.0) & (T < 24.0)] = 0.2  # on the ground
    assert airborne(T, thrust) == pytest.approx([(4.0, 17.0), (25.0, 39.99)], abs=0.02)


def test_one_sample_below_half_thrust_does_not_end_a_flight() -> None:
    thrust = np.ones(len(T))
    thrust[2000] = 0.3
    assert airborne(T, thrust) == ((T[0], T[-1]),)


def test_a_record_that_is_mostly_ground_still_holds_its_flight() -> None:
    thrust = np.where((T > 30.0) & (T < 36.0), 1.0, 0.02)
    assert airborne(T, thrust) == pytest.approx([(31.01, 34.99)], abs=0.02)


def test_rotors_that_never_turned_flew_nowhere() -> None:
    assert airborne(T, np.zeros(len(T))) == ()


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(0.001, 2.0), min_size=20, max_size=60))
def test_no_sample_lies_inside_a_gap_and_runs_keep_every_sample(steps: list[float]) -> None:
    t_s = np.cumsum(steps)
    assert not np.any([np.any((t_s > a) & (t_s < b)) for a, b in gaps(t_s)])
    keep = np.random.default_rng(len(steps)).random(len(steps)) < 0.7
    assert np.array_equal(within(t_s, runs_of(t_s, keep)) & keep, keep)


@pytest.fixture(scope="module")
def flown() -> FlightData:
    """A laboratory flight, seed 1, commanded rotors behind a lag, so that what was not recorded lasts."""
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    rotors = vehicle.rotors.model_copy(update={"speed_source": "command"})
    return flight_data(
        simulate(vehicle.model_copy(update={"rotors": rotors}), rest_to_rest_plan(seed=1), laboratory(), 1)
    )


def test_gaps_are_left_out_of_the_fit_and_cost_it_no_accuracy(flown: FlightData) -> None:
    assert flown.window_s is not None
    starts = flown.window_s[0] + np.arange(1.0, 19.0, 2.0)
    holes = [(start, start + 0.5) for start in starts]
    cut = {
        name: stream.select(~within(stream.t_s, holes))
        for name, stream in flown.streams().items()
        if name in ("imu", "motors")
    }
    prepared = prepare(replace(flown, **cut))
    record = prepared.record
    assert not np.any(record.keep & within(record.t_s, [(a + 0.01, b - 0.01) for a, b in holes]))
    assert any("9 gaps of the motors' stream (4.5 s)" in note for note in prepared.notes)
    assert len(prepared.stretches) == 10
    best = fit_dynamics([prepared]).best
    for name, truth in flown.truth.parameters().items():
        if name in ("mass_kg", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2"):
            assert abs(best.value(name) - truth) < 3.0 * best.std(name), name


def test_an_unusable_mocap_beside_a_good_imu_costs_only_what_it_would_have_told(flown: FlightData) -> None:
    mocap = flown.mocap
    assert mocap is not None
    still = np.tile(mocap.values[:1], (len(mocap), 1)) + 1e-4 * np.random.default_rng(1).standard_normal(
        (len(mocap), 7)
    )
    prepared = prepare(replace(flown, mocap=replace(mocap, values=still)))
    assert any(note.startswith("The poses are left out") for note in prepared.notes)
    assert prepared.compatibility is None
    assert prepared.flight.mocap is None
    assert np.isfinite(prepared.record.force_m_s2).all()


@pytest.mark.parametrize(("name", "used_s"), [("square_20251017_run3", 20.0), ("square_20251017_run1", 25.0)])
def test_measured_squares_are_used_whole(name: str, used_s: float) -> None:
    """run3 flew 21.6 s with dips; run1 flew 8 s, stood on the ground for 38 s and flew again."""
    folder = DATA / "nanodrone" / name
    if not folder.exists():
        pytest.skip(f"the measured flights are not there: {folder}")
    prepared = prepare(load_flight(folder))
    assert sum(end - start for start, end in prepared.stretches) > used_s
    assert any("recorded are used" in note for note in prepared.notes)
    if name.endswith("run1"):
        assert len(prepared.stretches) == 2
        assert not np.any(within(np.arange(10.0, 45.0), prepared.stretches))
