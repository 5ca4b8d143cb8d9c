"""One table of the fit's parameters: what it holds, who reads it, and that a new one is an entry and its
sensitivity.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.diagnosis.effect import catalogue
from groundstation.identification import sensitivities
from groundstation.identification.dynamic_fit import fit_dynamics
from groundstation.identification.preparation import Prepared, prepare
from groundstation.identification.record_model import RecordModel
from groundstation.model import parameters
from groundstation.model.parameters import FREE, FitOptions, Free, declared_parameters, values_of, with_values
from groundstation.paths import find_config
from groundstation.planning.information import effect_parameters
from groundstation.reporting.units import label
from groundstation.trajectory import load_plan, plan_from_dict, plan_to_dict
from groundstation.vehicle import Vehicle
from sim.scenario import scenario_from_dict
from studies.golden import simulated

ALL = FitOptions(accel_delay=True, channels=(0, 1, 2, 3, 4, 5))


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(simulated(21, 1.0, {"speed_source": "command"}))


@pytest.fixture(scope="module")
def qball(prepared: Prepared) -> Vehicle:
    return prepared.record.vehicle


@pytest.mark.parametrize("entry", FREE, ids=lambda entry: entry.name)
def test_what_is_put_is_read_back_and_nothing_else_moves(entry: Free, qball: Vehicle) -> None:
    if entry.name == "accel_delay_s":
        pytest.skip("a change about a fit, which the model does not keep")
    p = declared_parameters(qball, lag_s=0.04)
    value = entry.get(p) * 1.5 + 1e-3
    moved = entry.put(p, value)
    assert entry.get(moved) == value
    others = [e for e in FREE if e.name != entry.name and not {e.name, entry.name} & {"rotor_lag_s"}]
    assert [e.get(moved) for e in others] == [e.get(p) for e in others]
    assert label(entry.name) == entry.label


def test_a_plausible_range_holds_what_is_put(qball: Vehicle) -> None:
    p = with_values(declared_parameters(qball), ("rotor_lag_up_s", "rotor_lag_slope"), np.array([0.7, -3.0]))
    assert values_of(p, ("rotor_lag_up_s", "rotor_lag_slope")).tolist() == [0.5, -1.0]


@pytest.mark.parametrize("options", [ALL, replace(ALL, symmetric_lag=True)], ids=["lags", "one-lag"])
def test_every_entry_has_both_sensitivities_and_the_measured_one_is_the_slope_of_the_model(
    prepared: Prepared, options: FitOptions
) -> None:
    model = RecordModel(prepared.record, (), replace(prepared.planned, extra=()) if prepared.planned else None)
    p = declared_parameters(prepared.record.vehicle, lag_s=0.04)
    _, found, names = model.evaluate(p, options)
    assert sensitivities.planned_sensitivities(model, p, options).shape == found.shape
    scale = np.sqrt(np.mean(found**2, axis=(0, 1)))
    for index, name in enumerate(names):
        entry = parameters.table()[name]
        if name == "accel_delay_s":
            continue
        step = 1e-5 if entry.timing else 1e-6 * max(abs(entry.get(p)), 1e-3)
        slope = (model.residual(p) - model.residual(entry.put(p, entry.get(p) + step))) / step
        away = np.sqrt(np.mean((slope - found[:, :, index]) ** 2))
        assert away < (0.2 if entry.timing else 1e-3) * scale[index], name


def test_a_new_parameter_is_an_entry_and_its_sensitivity(
    prepared: Prepared, qball: Vehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Someone adds the drift of the accelerometer's z axis: an entry of the table and a line of the sensitivities."""
    name = "accel_drift_z_m_s3"
    get, put = parameters.kept_by_name(name)
    entry = Free(
        name=name,
        symbol="d_z",
        label="accelerometer drift z",
        get=get,
        put=put,
        free=lambda options: 5 in options.channels,
        prior=lambda context: (0.0, 1.0),
        joint_std=lambda context: 1.0,
    )
    monkeypatch.setattr(parameters, "FREE", (*FREE, entry))
    monkeypatch.setitem(sensitivities.EITHER, name, lambda at: (at.blank, at.along(2, at.model.elapsed_s)))
    planted = 0.2
    force = prepared.record.force_m_s2.copy()
    force[:, 2] += planted * (prepared.record.t_s - prepared.record.t_s[0])
    found = fit_dynamics([replace(prepared, record=replace(prepared.record, force_m_s2=force))]).best
    assert abs(found.value(name) - planted) < 4.0 * found.std(name) + 0.01 * planted, (
        found.value(name),
        found.std(name),
    )
    assert found.std(name) < 0.2 * planted


def test_planner_and_diagnosis_call_one_parameter_by_one_name(qball: Vehicle) -> None:
    effects = catalogue()
    fitted = {entry.name for entry in FREE}
    for identifier in ("rotor_drag", "com_offset", "angular_damping", "flapping_moment", "motor_lag", "input_delay"):
        known = {parameter.name for parameter in effects[identifier].parameters} | fitted
        assert {p.name for p in effect_parameters(qball, identifier)} <= known, identifier


def test_files_of_earlier_versions_are_read_under_the_new_names() -> None:
    plan = plan_to_dict(load_plan(find_config("plans", "qball2")))
    old = plan_from_dict(plan | {"predicted_std": {"com_x_m": 1e-3, "flapping_n_s": 2e-3, "mass_kg": 3e-3}})
    assert old.predicted_std == {"com_offset_x_m": 1e-3, "k_nm_s_m": 2e-3, "mass_kg": 3e-3}
    effects = {"angular_damping": {"linear_nm_s": [0.1, 0.2, 0.3]}, "flapping_moment": {"moment_n_s": 0.05}}
    read = scenario_from_dict({"effects": effects}).effects
    assert (read.angular_damping.damping_nms, read.flapping_moment.k_nm_s_m) == ((0.1, 0.2, 0.3), 0.05)


NAMES_IN_TABLES = re.compile(r'"(rotor_lag_slope|accel_delay_s|yaw_trim_nm)"')


def test_no_second_table_of_the_names() -> None:
    root = Path(parameters.__file__).parents[1]
    allowed = {"parameters.py", "sensitivities.py", "motor_lag.py"}
    for path in root.rglob("*.py"):
        if path.name not in allowed and len(set(NAMES_IN_TABLES.findall(path.read_text()))) > 1:
            raise AssertionError(f"{path} lists parameters of the fit; read groundstation.model.parameters instead")
