"""Scenario files: what is wrong in one is said in one sentence, and the truth they make is a body that can exist."""

from __future__ import annotations

import numpy as np
import pytest
from sim_states import vehicle_of

from groundstation.errors import BadInput
from groundstation.paths import configs_dir
from groundstation.vehicle import Inertia
from sim.build import build_world
from sim.effects import Effects
from sim.scenario import Scenario, Truth, load_scenario, scenario_from_dict, true_vehicle

VEHICLE = vehicle_of()


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ({"imu": {"rate_hz": -1.0}}, ["imu.rate_hz", "greater than 0"]),
        ({"imu": {"rate": 100.0}}, ["imu.rate", "Extra inputs"]),
        ({"weather": {}}, ["weather"]),
        ({"effects": {"gremlins": {}}}, ["gremlins", "rotor_drag"]),
        ({"effects": {"weak_rotor": {"loss": 2.0}}}, ["weak_rotor.loss", "less than 1"]),
        ({"effects": {"weak_rotor": {"lost": 0.2}}}, ["weak_rotor.lost"]),
        ({"truth": {"mass_factor": 0.0}, "mocap": {"rate_hz": "fast"}}, ["truth.mass_factor", "mocap.rate_hz"]),
    ],
)
def test_every_fault_of_a_scenario_is_named(document, words):
    with pytest.raises(BadInput) as caught:
        scenario_from_dict(document, "odd.toml")
    for word in ["odd.toml", *words]:
        assert word in str(caught.value)


def test_a_file_that_is_missing_or_no_toml_is_bad_input(tmp_path):
    with pytest.raises(BadInput, match="there is no such file"):
        load_scenario(tmp_path / "none.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("[imu\n")
    with pytest.raises(BadInput, match="not valid TOML"):
        load_scenario(broken)


def test_the_truth_is_the_declared_vehicle_changed_as_the_file_says():
    truth = Truth(mass_factor=1.1, inertia_factor=(1.2, 0.9, 1.0), product_share=(0.01, 0.02, -0.03))
    tensor = true_vehicle(VEHICLE, Scenario(truth=truth)).inertia_tensor()
    declared = VEHICLE.inertia_tensor()
    np.testing.assert_allclose(np.diag(tensor), np.diag(declared) * [1.2, 0.9, 1.0])
    np.testing.assert_allclose(
        [tensor[0, 1], tensor[0, 2], tensor[1, 2]], np.trace(tensor) * np.array([0.01, 0.02, -0.03])
    )
    absolute = Truth(mass_kg=2.0, mass_factor=3.0, inertia_kg_m2=Inertia(xx=0.01, yy=0.02, zz=0.025))
    assert true_vehicle(VEHICLE, Scenario(truth=absolute)).mass_kg == 2.0
    assert true_vehicle(VEHICLE, Scenario(truth=absolute)).inertia_kg_m2.yy == 0.02


@pytest.mark.parametrize(
    ("truth", "words"),
    [
        (Truth(inertia_factor=(1.0, 1.0, 9.0)), "triangle inequality"),
        (Truth(product_share=(0.6, 0.0, 0.0)), "positive definite"),
    ],
)
def test_a_tensor_that_no_body_has_is_refused(truth, words):
    with pytest.raises(BadInput, match=words):
        true_vehicle(VEHICLE, Scenario(truth=truth))


@pytest.mark.parametrize(
    ("effect", "words"),
    [({"weak_rotor": {"rotor": 7}}, "no rotor 7"), ({"payload_change": {"mass_kg": -5.0}}, "payload_change")],
)
def test_an_effect_that_does_not_fit_the_vehicle_is_refused(effect, words):
    with pytest.raises(BadInput, match=words):
        build_world(VEHICLE, scenario_from_dict({"effects": effect}))


def test_an_effect_table_switches_it_on_and_on_false_keeps_its_numbers_but_switches_it_off():
    scenario = scenario_from_dict({"effects": {"rotor_drag": {}, "wind": {"on": False, "gust_m_s": 1.0}}})
    assert scenario.effects.rotor_drag.on
    assert not scenario.effects.wind.on
    assert scenario.effects._replace(rotor_drag=Effects().rotor_drag, wind=Effects().wind) == Effects()


def test_shipped_scenarios_load_carry_their_own_name_and_no_effects_name():
    paths = sorted((configs_dir() / "scenarios").glob("*.toml"))
    assert {"clean", "seed", "lab"} <= {path.stem for path in paths}
    for path in paths:
        scenario = load_scenario(path)
        assert scenario.name == path.stem
        assert scenario.name not in Effects._fields
        build_world(VEHICLE, scenario)


def test_the_seeds_scenario_is_the_papers_rates_and_a_vehicle_off_by_what_the_issue_asks():
    scenario = load_scenario(configs_dir() / "scenarios" / "seed.toml")
    assert (scenario.mocap.rate_hz, scenario.imu.rate_hz) == (30.0, 500.0)
    assert (scenario.control.position_hz, scenario.control.attitude_hz) == (30.0, 500)
    assert scenario.truth.mass_factor == 1.02
    assert scenario.truth.product_share is not None
    assert max(abs(f - 1.0) for f in scenario.truth.inertia_factor) == pytest.approx(0.3)
