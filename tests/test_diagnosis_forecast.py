"""Prediction and closed loop before and after, on what no estimate saw: better where something was hidden, the same
where not.
"""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from groundstation.diagnosis import diagnose
from groundstation.diagnosis.base import for_evidence
from groundstation.diagnosis.comparison import as_declared, splits_of
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.flight_evidence import FlightEvidence
from groundstation.diagnosis.forecast import HORIZONS_S, models_of, unknown_loop, window_starts
from groundstation.diagnosis.results import Diagnosis
from groundstation.flightdata import FlightData
from groundstation.identification.dynamic_fit import fit_dynamics
from groundstation.identification.preparation import prepare
from groundstation.options import AnalysisOptions
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from sim.scenario import scenario_from_dict
from studies.flown import flight_data

QUANTITIES = {"position_m", "velocity_m_s", "attitude_rad", "body_rate_rad_s"}
WEAK = {"weak_rotor": {"rotor": 3, "loss": 0.08}}
DRAG = {"rotor_drag": {"drag_kg_s": (0.5, 0.5)}}
AIR = {
    "imu": {"gyro_density": 1e-4, "accel_density": 2e-3},
    "mocap": {"position_std_m": 5e-4, "attitude_std_rad": 1e-3},
    "disturbance": {"force_share": 2e-3, "torque_share": 2e-3},
    "truth": {"mass_factor": 1.03, "inertia_factor": (1.1, 0.9, 1.05)},
}


@cache
def _flown(seed: int, kind: str) -> FlightData:
    """Two periods of the paper's plan in moving air, with one thing hidden or nothing."""
    hidden: dict[str, Any] = {"nothing": {}, "weak": WEAK, "drag": DRAG}[kind]
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": 2.0})
    return flight_data(simulate(vehicle, plan, scenario_from_dict({**AIR, "effects": hidden}), seed))


@cache
def _diagnosis(kind: str) -> Diagnosis:
    return diagnose([_flown(3, kind)])


def _ratio(diagnosis: Diagnosis, stage: str, quantity: str) -> float:
    error = diagnosis.error["held_out"]
    return error[stage.format("before")][quantity] / error[stage.format("after")][quantity]


def test_a_weak_rotor_put_in_predicts_rates_and_attitude_several_times_better():
    found = _diagnosis("weak")
    assert [f.effect for f in found.findings] == ["weak_rotor"]
    assert _ratio(found, "prediction_0.1_s_{}", "body_rate_rad_s") > 3.0
    assert _ratio(found, "prediction_0.5_s_{}", "attitude_rad") > 3.0


def test_drag_put_in_predicts_velocity_better_and_flies_the_closed_loop_more_like_the_flight():
    found = _diagnosis("drag")
    assert [f.effect for f in found.findings] == ["rotor_drag"]
    assert _ratio(found, "prediction_0.1_s_{}", "velocity_m_s") > 1.5
    assert _ratio(found, "prediction_0.5_s_{}", "position_m") > 1.2
    assert _ratio(found, "simulation_{}", "pitch_rad") > 1.2
    assert _ratio(found, "simulation_{}", "x_m") > 1.2


def test_a_clean_flight_has_nothing_to_gain():
    found = _diagnosis("nothing")
    assert not found.findings
    for stage in ("prediction_0.1_s_{}", "prediction_0.5_s_{}", "simulation_{}"):
        error = found.error["held_out"]
        assert error[stage.format("after")] == error[stage.format("before")]


def test_the_estimate_without_effects_predicts_better_than_the_declared_vehicle():
    error = _diagnosis("nothing").error["held_out"]
    for quantity in QUANTITIES:
        assert error["prediction_0.1_s_before"][quantity] < error["prediction_0.1_s_nominal"][quantity]


def test_the_document_holds_every_stage_quantity_and_what_they_are_of():
    document = json.loads(json.dumps(_diagnosis("drag").to_dict()))
    error = document["error"]["held_out"]
    for horizon in ("0.1", "0.5"):
        for stage in ("nominal", "before", "after"):
            assert set(error[f"prediction_{horizon}_s_{stage}"]) == QUANTITIES
    assert {"x_m", "roll_rad", "torque_z_nm"} <= set(error["simulation_before"]) == set(error["simulation_after"])
    assert any("windows" in note for note in document["notes"])


def test_on_an_unseen_flight_the_parameters_of_the_first_are_judged():
    found = diagnose([_flown(3, "weak")], AnalysisOptions(held_out=(_flown(4, "weak"),)))
    assert _ratio(found, "prediction_0.1_s_{}", "body_rate_rad_s") > 3.0
    assert _ratio(found, "simulation_{}", "torque_x_nm") > 1.0
    other = diagnose([_flown(3, "weak")], AnalysisOptions(held_out=(_flown(4, "nothing"),)))
    assert _ratio(other, "prediction_0.1_s_{}", "body_rate_rad_s") < 0.5  # a fault that the other flight does not have


@pytest.mark.parametrize(
    ("change", "reason"),
    [({"control": None}, "control law"), ({"plan": None}, "plan"), ({"mocap": None}, "poses"), ({}, "")],
)
def test_without_controller_plan_or_poses_the_closed_loop_is_left_out_with_the_reason(change, reason):
    flight = _flown(3, "nothing")
    if "control" in change:
        document = flight.vehicle.model_dump(exclude={"control"}, exclude_unset=True)
        flight = replace(flight, vehicle=type(flight.vehicle).model_validate(document))
    else:
        flight = replace(flight, **change)
    said = unknown_loop(SimpleNamespace(flight=flight))  # pyright: ignore[reportArgumentType]
    assert reason in said and bool(said) == bool(reason)


def test_a_flight_whose_controller_nobody_knows_says_so_and_is_predicted_all_the_same():
    flight = _flown(3, "nothing")
    document = flight.vehicle.model_dump(exclude={"control"}, exclude_unset=True)
    found = diagnose([replace(flight, vehicle=type(flight.vehicle).model_validate(document))])
    error = found.error["held_out"]
    assert error["simulation_before"] == {} == error["simulation_after"] and "simulation_nominal" not in error
    assert set(error["prediction_0.5_s_after"]) == QUANTITIES
    assert any("not known" in note for note in found.notes)


def test_windows_lie_wholly_in_what_is_judged_and_cross_no_gap():
    t = np.arange(0.0, 10.0, 0.01)
    keep = (t < 4.0) | (t > 4.2)
    rates = np.zeros((len(t), 3))
    rates[300] = np.nan
    prepared: Any = SimpleNamespace(record=SimpleNamespace(t_s=t, keep=keep, rate_rad_s=rates))
    starts = t[window_starts(prepared, t[(t >= 2.0) & (t <= 6.0)])]
    assert starts.min() == 2.0 and starts.max() + HORIZONS_S[-1] <= 6.0 and len(starts) == 10
    assert not np.any((starts + HORIZONS_S[-1] >= 4.0) & (starts <= 4.2))
    assert 3.0 not in starts
    assert len(window_starts(prepared, t[:40])) == 0


def test_every_estimate_is_made_on_training_data_alone():
    prepared = for_evidence(prepare(_flown(3, "nothing")))
    fitted = fit_dynamics([prepared])
    evidence = Evidence([FlightEvidence(prepared, fitted.best, fitted.options)])
    split = splits_of(evidence, ())[2]
    ((flight, inside),) = split.judged
    before = as_declared(evidence, prepared.record.vehicle, split.train)
    joint = models_of(evidence, (), (), split)["before"]
    record, judged = flight.model.record, flight.model.t_s[inside]
    spoilt = np.where(
        ((record.t_s >= judged[0]) & (record.t_s <= judged[-1]))[:, None], 3.0 * record.rate_rad_s, record.rate_rad_s
    )
    flight.model.record = replace(record, rate_rad_s=spoilt)
    assert split.train is not None
    evidence.weight = np.where(split.train, evidence.weight, 100.0 * evidence.weight)
    blind = models_of(evidence, (), (), split)["before"]
    assert blind.mass_kg == joint.mass_kg and np.array_equal(blind.tensor, joint.tensor)
    assert models_of(evidence, (), (), replace(split, train=None))["before"].mass_kg != joint.mass_kg
    again = as_declared(evidence, prepared.record.vehicle, split.train)
    np.testing.assert_allclose(again.values, before.values, rtol=1e-9)
    assert not np.allclose(as_declared(evidence, prepared.record.vehicle).values, before.values, rtol=1e-3)
