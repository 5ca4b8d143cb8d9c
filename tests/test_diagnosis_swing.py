"""A load that swings below the vehicle is told by the force it pulls with, and a disturbance is no load."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from flights import laboratory

from groundstation.diagnosis import diagnose
from groundstation.diagnosis.columns import Candidate
from groundstation.diagnosis.doubted import identify
from groundstation.diagnosis.effect import library
from groundstation.diagnosis.hanging import hanging
from groundstation.diagnosis.pipeline import _with_swing
from groundstation.diagnosis.results import Diagnosis
from groundstation.diagnosis.swing import Swing, cable, swing_of
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.identification.preparation import Prepared, prepare
from groundstation.identification.results import Estimate
from groundstation.model.parameters import Parameters, declared_parameters
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from studies.flown import flight_data

SEED = 3
VEHICLE = load_vehicle(find_config("vehicles", "qball2"))
PARAMETERS: Parameters = declared_parameters(VEHICLE, lag_s=0.0)


@cache
def _flown(load_kg: float, length_m: float) -> tuple[Prepared, float]:
    """A short flight, and the vehicle's own mass."""
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": 3.0})
    load: dict[str, Any] = {"mass_kg": load_kg, "length_m": length_m, "attachment_m": (0.0, 0.0, -0.05)}
    flown = simulate(VEHICLE, plan, laboratory(**({"slung_load": load} if load_kg else {})), SEED)
    return prepare(flight_data(flown)), flown.truth.mass_kg


def _swing(load_kg: float, length_m: float) -> tuple[Swing | None, float]:
    prepared, mass_kg = _flown(load_kg, length_m)
    signals = prepared.signals(0.0, 0.0, 0.0, 0.0)
    return swing_of(signals, prepared.record.keep, VEHICLE), mass_kg


@pytest.mark.parametrize(("load_kg", "length_m"), [(0.1, 0.6), (0.14, 0.36)])
def test_a_swinging_load_is_told_with_its_size_and_its_cable_within_what_is_said(load_kg: float, length_m: float):
    found, mass_kg = _swing(load_kg, length_m)
    assert found is not None
    assert found.load_kg == pytest.approx(load_kg, rel=3.0 * THRESHOLDS.swing_form), found
    assert found.length_m == pytest.approx(length_m, rel=3.0 * THRESHOLDS.swing_form), found
    assert found.body_kg == pytest.approx(mass_kg, rel=0.01), found
    assert "swings as a load" in found.sentence()


def test_a_disturbance_of_the_laboratory_is_no_load():
    assert _swing(0.0, 1.0)[0] is None


def test_a_mass_that_holds_an_unnamed_load_is_published_with_an_interval_that_holds_the_vehicles_own():
    prepared, mass_kg = _flown(0.14, 0.36)
    wrong = Estimate.normal(mass_kg + 0.14, 0.005)
    before = Diagnosis("a", "b", "clean", parameters_after={"mass_kg": wrong}, covariance_after=np.diag([2.5e-5] * 7))
    found = _with_swing(before, hanging(prepared, PARAMETERS))
    low, high = found.parameters_after["mass_kg"].ci95
    assert low < mass_kg < wrong.value < high
    assert found.covariance_after is not None and found.covariance_after[0, 0] > 0.13**2
    assert found.verdict == "unexplained" and found.warnings == (found.reason,)


def test_an_identification_alone_says_that_its_mass_may_hold_a_load():
    prepared, mass_kg = _flown(0.14, 0.36)
    found = identify([prepared.flight])
    low, high = found.methods[found.best].parameters["mass_kg"].ci95
    assert "swings as a load" in found.warnings[0]
    assert low < mass_kg < high


def test_without_a_plan_a_diagnosis_is_as_unsure_of_a_mass_that_holds_a_load():
    """What low frequencies say comes first: put in after, it was as sure as without a load."""
    prepared, mass_kg = _flown(0.14, 0.36)
    found = diagnose([replace(prepared.flight, plan=None, setpoint=None)])
    assert all(finding.effect != "slung_load" for finding in found.findings)
    assert "swings as a load" in found.warnings[0]
    mass = found.parameters_after["mass_kg"]
    assert mass.ci95[0] < mass_kg < mass.ci95[1]
    assert mass.std > 0.05


def test_the_force_of_what_was_found_is_none_of_a_load():
    """Another thrust curve, found, passed for a load of 90 g."""
    prepared, _ = _flown(0.14, 0.36)
    signals, load = prepared.signals(0.0, 0.0, 0.0, 0.0), library()["slung_load"]
    assert load.searched is not None
    settings = load.searched(signals, prepared.record.keep, VEHICLE)[0]
    candidate = Candidate(load.of(settings), settings)
    swing = hanging(prepared, PARAMETERS)
    assert swing is not None
    values = np.zeros(len(candidate.effect.parameters))
    values[0] = swing.load_kg
    assert hanging(prepared, PARAMETERS, [(candidate, values)]) is None
    again = hanging(prepared, PARAMETERS, [(candidate, 0.0 * values)])
    assert again == swing


def test_without_a_load_a_diagnosis_stays_as_it_is():
    prepared, _ = _flown(0.0, 1.0)
    before = Diagnosis("a", "b", "clean", parameters_after={"mass_kg": Estimate.normal(1.8, 0.005)})
    assert _with_swing(before, hanging(prepared, PARAMETERS)) is before


def test_a_slack_cable_points_between_where_it_did_and_will():
    pull = np.array([[0.0, 0.0, -1.0], [0.1, 0.0, 0.0], [1.0, 0.0, 0.0]])
    found = cable(pull)
    assert found[1] == pytest.approx([np.sqrt(0.5), 0.0, -np.sqrt(0.5)])


def test_flights_that_are_too_short_say_nothing_of_a_load():
    prepared, _ = _flown(0.14, 0.36)
    signals = prepared.signals(0.0, 0.0, 0.0, 0.0)
    short = prepared.record.keep & (signals.t_s < signals.t_s[prepared.record.keep][0] + 5.0)
    assert swing_of(signals, short, VEHICLE) is None
    unknown = replace(signals, velocity_world_m_s=np.full_like(signals.velocity_world_m_s, np.nan))
    assert swing_of(unknown, prepared.record.keep, VEHICLE) is None


@pytest.mark.parametrize(
    "none",
    [
        {"load_kg": 0.8, "body_kg": 1.2},  # the heaviest that is tried: the search ended there
        {"length_m": 4.3},  # swings slower than what was looked at
        {"length_m": 0.05},
        {"air_1_s": -1.4},  # driven by the air
    ],
)
def test_what_a_search_found_at_its_edge_or_against_nature_is_no_load(none: dict[str, float]):
    load = Swing(load_kg=0.1, length_m=0.5, air_1_s=-0.1, body_kg=1.7, drag_kg_s=0.0, left=0.1)
    assert load.hangs(9.81)
    assert not replace(load, **none).hangs(9.81)
