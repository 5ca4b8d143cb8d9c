"""Every effect's model by itself: shape, direction, growth; a new effect is one new file; the results' JSON form."""

from __future__ import annotations

import importlib
import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from groundstation.diagnosis import effect as effects_module
from groundstation.diagnosis import next_flight
from groundstation.diagnosis.effect import (
    Effect,
    FittedEffect,
    ParameterInfo,
    SensorEffect,
    blank,
    catalogue,
    library,
    wrench_of,
)
from groundstation.diagnosis.pool import candidates
from groundstation.diagnosis.results import Diagnosis, Finding, Unexplained
from groundstation.diagnosis.sentences import filled
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.errors import BadInput
from groundstation.frames import quat_rotate
from groundstation.identification.results import Estimate
from groundstation.model.parameters import declared_parameters
from groundstation.model.signals import Signals
from groundstation.paths import find_config
from groundstation.reporting.identified import identified_from_document
from groundstation.reporting.scenario import scenario_document
from groundstation.vehicle import load_vehicle, vehicle_to_dict

VEHICLE = load_vehicle(find_config("vehicles", "x500"))
HOVER_N = VEHICLE.mass_kg * VEHICLE.gravity_m_s2 / VEHICLE.rotors.count

IDENTIFIERS = (
    "motor_lag",
    "input_delay",
    "clock_offset",
    "rotor_drag",
    "body_drag",
    "flapping_moment",
    "angular_damping",
    "translational_lift",
    "climb_inflow",
    "ground_effect",
    "wind",
    "weak_rotor",
    "thrust_scale",
    "torque_scale",
    "thrust_curve",
    "rotor_degradation",
    "com_offset",
    "rotor_gyroscopic",
    "battery_sag",
    "payload_change",
    "slung_load",
    "tether",
    "constant_wrench",
    "imu_misalignment",
    "mocap_misalignment",
    "mocap_tilt",
)
UNITS = ("_s", "_m", "_n", "_nm", "_nms", "_nm_s_m", "_n_m", "_kg", "_kg_s", "_kg_m", "_kg_m2", "_rad", "_s2_m2")
RATIOS = {
    "clock_drift",
    "rotor_lag_slope",
    "strength",
    "loss",
    "exponent",
    "exponent_error",
    "thrust_scale",
    "torque_scale",
}

TOY = '''"""A toy."""

from groundstation.diagnosis.effect import Effect, ParameterInfo, blank


def _wrench(signals, vehicle, settings):
    out = blank(signals)
    out[:, 5, 0] = signals.position_m[:, 0]
    return out


EFFECT = Effect(
    identifier="toy_compass",
    equation="tau_z = k x",
    source="none",
    parameters=(ParameterInfo("k_n", lambda v: 1.0),),
    wrench=_wrench,
    sentence="It turns with x by {k_n} N m per metre.",
    confused_with=(),
    manoeuvre="fly along x",
)
'''


def _signals(count: int = 200, **given: np.ndarray) -> Signals:
    """Hover at 1 m, level, full battery, but for what is given."""
    t = np.linspace(0.0, 20.0, count)
    speed = np.full((count, 4), np.sqrt(HOVER_N / (VEHICLE.rotors.thrust_coefficient_n_s2 or np.nan)))
    values = {
        "t_s": t,
        "position_m": np.tile([0.0, 0.0, 1.0], (count, 1)),
        "velocity_world_m_s": np.zeros((count, 3)),
        "quaternion": np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
        "rate_rad_s": np.zeros((count, 3)),
        "motor": speed,
        "lagged": speed,
        "lagged_rate": np.zeros((count, 4)),
        "thrust_n": np.full((count, 4), HOVER_N),
        "voltage_v": np.full(count, VEHICLE.battery.full_v),
        "charge_as": np.zeros(count),
    }
    return Signals(**{**values, **given})


def _random_signals(seed: int = 0) -> Signals:
    random = np.random.default_rng(seed)
    q = random.standard_normal((200, 4))
    return _signals(
        velocity_world_m_s=random.standard_normal((200, 3)),
        rate_rad_s=random.standard_normal((200, 3)),
        position_m=random.uniform(0.5, 2.0, (200, 3)),
        quaternion=q / np.linalg.norm(q, axis=1, keepdims=True),
        lagged_rate=random.standard_normal((200, 4)),
        thrust_n=random.uniform(0.5, 1.5, (200, 4)) * HOVER_N,
        voltage_v=np.linspace(16.8, 15.0, 200),
    )


def _wrench(name: str, signals: Signals, **settings: float) -> np.ndarray:
    effect = library()[name]
    return effect.wrench(signals, VEHICLE, settings or dict(effect.variants(signals, VEHICLE)[0]))


def test_every_identifier_of_the_vocabulary_has_its_file_and_no_file_has_another():
    files = importlib.import_module("groundstation.diagnosis.effects").__path__[0]
    assert {path.stem for path in Path(files).glob("[!_]*.py")} == set(IDENTIFIERS) == set(catalogue())


@pytest.mark.parametrize("name", IDENTIFIERS)
def test_every_file_says_what_the_effect_is_where_it_is_from_and_what_reveals_it(name):
    effect = catalogue()[name]
    assert (
        effect.identifier
        == name
        == importlib.import_module(f"groundstation.diagnosis.effects.{name}").EFFECT.identifier
    )
    assert effect.equation and effect.source and effect.manoeuvre
    assert effect.confused_with and set(effect.confused_with) <= set(IDENTIFIERS) - {name}
    assert effect.parameters
    for parameter in effect.parameters:
        assert parameter.name.endswith(UNITS) or parameter.name in RATIOS, parameter.name
        assert parameter.plausible[0] < parameter.plausible[1]


def test_what_the_base_fit_or_the_sensors_show_has_a_least_size_and_a_sentence():
    for effect in catalogue().values():
        shown = (
            effect.readings
            if isinstance(effect, SensorEffect)
            else [effect]
            if isinstance(effect, FittedEffect)
            else []
        )
        assert all(item.least > 0.0 and item.sentence for item in shown)
        if isinstance(effect, SensorEffect):
            assert {n for r in effect.readings for n in (*r.parameters, *r.beside)} == set(effect.names())
    scale = catalogue()["thrust_scale"]
    assert isinstance(scale, FittedEffect) and scale.least == THRESHOLDS.material_share


@pytest.mark.parametrize("name", sorted(library()))
def test_every_effect_gives_a_finite_wrench_for_each_parameter_and_says_where_it_is_from(name):
    effect, signals = library()[name], _random_signals()
    for settings in effect.variants(signals, VEHICLE):
        wrench = effect.wrench(signals, VEHICLE, settings)
        assert wrench.shape == (200, 6, len(effect.parameters))
        assert np.isfinite(wrench).all()
        assert np.any(wrench != 0.0)
    values = {n: "1" for n in effect.names()} | {n: "1" for n in effect.variants(signals, VEHICLE)[0]}
    assert "{" not in filled(effect.sentence, **values)
    assert all(0.0 < p.prior_std(VEHICLE) < np.inf for p in effect.parameters)


def test_air_resists_motion_in_every_attitude_and_gives_it_no_energy():
    signals = _random_signals()
    velocity = signals.velocity_body_m_s()
    for name in ("body_drag", "climb_inflow"):
        power = np.einsum("ki,kip->kp", velocity, _wrench(name, signals)[:, :3])
        assert np.all(power <= 0.0) and power.min() < -0.1
    drag = _wrench("rotor_drag", signals)
    turning = np.einsum("ki,kip->kp", signals.rate_rad_s, drag[:, 3:])
    assert np.all(np.einsum("ki,kip->kp", velocity, drag[:, :3]) + turning <= 0.0)
    assert np.all(drag[:, 2] == 0.0), "rotors drag in their plane"


def test_a_faster_rotor_turns_a_vehicle_that_flies_along_and_drag_of_hubs_damps_its_yaw():
    """A drag of 0.3 kg/s whose yaw torque was left out took 2 % off a yaw inertia."""
    left = np.array(VEHICLE.rotors.position_m)[:, 1] > 0.0
    thrust = np.tile(HOVER_N * np.where(left, 1.44, 0.64), (200, 1))
    forward = np.tile([1.0, 0.0, 0.0], (200, 1))
    torque = _wrench("rotor_drag", _signals(velocity_world_m_s=forward, thrust_n=thrust))[0, 5, 0]
    arms = np.array(VEHICLE.rotors.position_m)[:, 1]
    assert torque == pytest.approx(np.sum(arms * np.where(left, 1.2, 0.8)) / len(arms))
    turning = _wrench("rotor_drag", _signals(rate_rad_s=np.tile([0.0, 0.0, 2.0], (200, 1))))[0]
    np.testing.assert_allclose(turning[:5], 0.0, atol=1e-12)
    np.testing.assert_allclose(turning[5], -2.0 * np.mean(np.array(VEHICLE.rotors.position_m)[:, [1, 0]] ** 2, axis=0))


@pytest.mark.parametrize("name", ["climb_inflow", "translational_lift", "ground_effect"])
def test_air_through_rotors_changes_their_thrust_and_not_the_torque_that_turns_them(name):
    """Five flights of a vehicle that climbs told a yaw torque of 0.1 % of the weight by turning speed, and no cause."""
    thrust = np.tile(HOVER_N * np.array([1.3, 0.9, 1.2, 0.7]), (200, 1))
    signals = _signals(velocity_world_m_s=np.tile([0.5, 0.3, 1.0], (200, 1)), thrust_n=thrust)
    wrench = _wrench(name, signals)[:, :, 0]
    declared = thrust @ VEHICLE.six_row_allocation().T
    assert np.all(np.abs(declared[:, 3:]) > 0.001), "these thrusts roll, pitch and yaw"
    assert np.all(wrench[:, 2:5] != 0.0)
    assert wrench[:, 5] == pytest.approx(0.0, abs=1e-12)


def test_rotor_drag_is_linear_in_speed_and_body_drag_quadratic():
    slow, fast = (_signals(velocity_world_m_s=np.tile([v, 0.0, 0.0], (200, 1))) for v in (1.0, 2.0))
    assert _wrench("rotor_drag", slow)[0, 0, 0] == pytest.approx(-1.0)
    assert _wrench("rotor_drag", fast)[0, 0, 0] == pytest.approx(-2.0)
    assert _wrench("body_drag", fast)[0, 0, 0] == pytest.approx(4.0 * _wrench("body_drag", slow)[0, 0, 0])


def test_angular_damping_takes_energy_from_rotation_and_gyroscopic_coupling_takes_none():
    signals = _random_signals()
    damping = _wrench("angular_damping", signals)[:, 3:].sum(axis=2)
    assert np.all(np.einsum("ki,ki->k", damping, signals.rate_rad_s) < 0.0)
    steady = _signals(rate_rad_s=signals.rate_rad_s, lagged=np.tile([900.0, 900.0, 700.0, 700.0], (200, 1)))
    gyroscopic = _wrench("rotor_gyroscopic", steady)[:, 3:, 0]
    assert np.abs(gyroscopic).max() > 1.0
    np.testing.assert_allclose(np.einsum("ki,ki->k", gyroscopic, steady.rate_rad_s), 0.0, atol=1e-9)


def test_spinning_rotors_up_turns_the_body_the_other_way():
    spin_up = np.zeros((200, 4))
    spin_up[:, :2] = 100.0  # the rotors that turn counter-clockwise, spin +1
    assert _wrench("rotor_gyroscopic", _signals(lagged_rate=spin_up))[0, 5, 0] < 0.0


def test_flying_forward_flaps_the_nose_up():
    forward = _signals(velocity_world_m_s=np.tile([1.0, 0.0, 0.0], (200, 1)))
    wrench = _wrench("flapping_moment", forward)[0, :, 0]
    assert wrench[4] < 0.0 and wrench[3] == wrench[5] == 0.0  # FLU: nose up is a negative pitch torque


def test_the_centre_of_mass_beside_the_origin_falls_to_its_own_side():
    wrench = _wrench("com_offset", _signals())[0]
    lift = 4 * HOVER_N
    np.testing.assert_allclose(wrench[3:, 0], [0.0, lift, 0.0])  # in front: nose down, positive pitch
    np.testing.assert_allclose(wrench[3:, 1], [-lift, 0.0, 0.0])  # left: left side down, negative roll


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_a_weak_rotor_lacks_lift_where_it_is_and_its_own_reaction_torque(rotor):
    x, y, _ = VEHICLE.rotors.position_m[rotor - 1]
    spin = VEHICLE.rotors.spin[rotor - 1]
    wrench = _wrench("weak_rotor", _signals(), rotor=rotor)[0, :, 0]
    expected = [0.0, 0.0, -HOVER_N, -HOVER_N * y, HOVER_N * x, HOVER_N * spin * VEHICLE.rotors.torque_to_thrust_m]
    np.testing.assert_allclose(wrench, expected, atol=1e-12)
    degraded = _wrench("rotor_degradation", _signals(), rotor=rotor, from_s=10.0, within_s=1.0)[:, :, 0]
    np.testing.assert_allclose(degraded[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(degraded[-1], expected, atol=1e-12)


def test_ground_effect_lifts_more_the_nearer_the_floor():
    heights = np.linspace(0.2, 2.0, 200)
    position = np.stack([0.0 * heights, 0.0 * heights, heights], axis=1)
    lift = _wrench("ground_effect", _signals(position_m=position))[:, 2, 0]
    assert np.all(np.diff(lift) < 0.0) and lift[-1] > 0.0
    assert lift[0] / lift[-1] == pytest.approx(100.0)


def test_wind_keeps_its_direction_in_the_world_when_the_vehicle_turns():
    half_turn = np.tile([0.0, 0.0, 0.0, 1.0], (200, 1))
    np.testing.assert_allclose(_wrench("wind", _signals())[0, 0, 0], 1.0)
    np.testing.assert_allclose(_wrench("wind", _signals(quaternion=half_turn))[0, 0, 0], -1.0)


def test_a_steady_force_stays_level_in_the_world_and_a_steady_torque_in_the_body():
    signals = _random_signals()
    wrench = _wrench("constant_wrench", signals)
    world = quat_rotate(signals.quaternion[:, None, :], wrench[:, :3, :2].transpose(0, 2, 1))
    np.testing.assert_allclose(world, np.broadcast_to(np.eye(3)[:2], (200, 2, 3)), atol=1e-12)
    np.testing.assert_allclose(wrench[:, 3:, 2:], np.broadcast_to(np.eye(3), (200, 3, 3)), atol=1e-12)
    assert np.all(wrench[:, 3:, :2] == 0.0) and np.all(wrench[:, :3, 2:] == 0.0)


def test_translational_lift_grows_with_the_square_of_level_speed_in_every_direction_and_not_with_climb():
    def lift(*velocity: float) -> np.ndarray:
        return _wrench("translational_lift", _signals(velocity_world_m_s=np.tile(velocity, (200, 1))))[0, :, 0]

    np.testing.assert_allclose(lift(1.0, 0.0, 0.0), [0.0, 0.0, 4 * HOVER_N, 0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(lift(0.0, -2.0, 0.0), 4.0 * lift(1.0, 0.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(lift(0.0, 0.0, 3.0), 0.0, atol=1e-12)


def test_thrust_sags_with_the_square_of_voltage_and_not_at_all_on_a_full_battery():
    share = np.linspace(1.0, 0.8, 200)
    voltage = share * (VEHICLE.battery.full_v or np.nan)
    sag = _wrench("battery_sag", _signals(voltage_v=voltage))[:, :, 0]
    np.testing.assert_allclose(sag[:, 2], -4 * HOVER_N * (1.0 - share**2), atol=1e-9)
    np.testing.assert_allclose(np.delete(sag, 2, axis=1), 0.0, atol=1e-9)
    strong = _wrench("battery_sag", _signals(voltage_v=voltage, thrust_n=np.full((200, 4), 2.0 * HOVER_N)))
    np.testing.assert_allclose(strong[:, 2, 0], 2.0 * sag[:, 2], atol=1e-9)  # a share of thrust, whatever it is


def test_a_tether_pulls_back_to_the_middle_and_sums_to_nothing():
    position = np.random.default_rng(1).standard_normal((200, 3))
    spring = _wrench("tether", _signals(position_m=position))[:, :3, 0]
    np.testing.assert_allclose(spring.sum(axis=0), 0.0, atol=1e-9)
    assert np.all(np.einsum("ki,ki->k", spring, position - position.mean(axis=0)) <= 0.0)


def test_a_lost_load_lifts_from_its_instant_on():
    wrench = _wrench("payload_change", _signals(), at_s=10.0, within_s=1.0)[:, 2, 0]
    assert wrench[0] == 0.0
    assert wrench[-1] == pytest.approx(-VEHICLE.gravity_m_s2)  # one kilogram more, in hover
    carried = _wrench("payload_change", _signals(), at_s=10.0, within_s=1.0, carried_kg=0.5)[:, 2, 0]
    share = VEHICLE.mass_kg / (VEHICLE.mass_kg + 0.5)  # on board until then: the same step, about the empty vehicle
    np.testing.assert_allclose(carried, (wrench - wrench[-1]) * share)


@pytest.mark.parametrize("carried_kg", [0.0, 0.5])
def test_a_load_moves_the_centre_of_mass_while_it_is_on_board(carried_kg):
    """Whatever a load does to the centre of mass, none of it is the vehicle's own."""
    signals = _random_signals()
    wrench = _wrench("payload_change", signals, at_s=10.0, within_s=0.05, carried_kg=carried_kg)
    offset = _wrench("com_offset", signals)
    there, gone = (slice(None, 98), slice(102, None))[:: 1 if carried_kg else -1]
    np.testing.assert_allclose(wrench[there, :, 1:], offset[there])
    np.testing.assert_allclose(wrench[gone, :, 1:], 0.0)


def test_a_slung_load_is_pulled_after_the_vehicle_and_rings_at_its_own_frequency():
    t = np.linspace(0.0, 20.0, 4000)
    velocity = np.zeros((4000, 3))
    velocity[:, 0] = (t > 1.0) * 0.2  # a small swing
    signals = Signals(
        **{
            each.name: np.repeat(getattr(_signals(), each.name)[:1], 4000, axis=0)
            for each in fields(Signals)
            if each.name not in ("t_s", "velocity_world_m_s")
        },
        t_s=t,
        velocity_world_m_s=velocity,
    )
    force = _wrench("slung_load", signals, length_m=0.5, air_1_s=0.05)[:, 0, 0]
    assert force[int(1.2 * 200)] < 0.0, "the load lags behind and holds the vehicle back"
    crossings = t[1:][np.diff(np.sign(force)) > 0]
    assert 1.0 / np.mean(np.diff(crossings)) == pytest.approx(np.sqrt(9.80665 / 0.5) / (2 * np.pi), rel=0.02)


def test_steeper_thrust_gives_more_above_hover_and_less_below():
    level = np.linspace(0.5, 1.5, 200)[:, None]
    force = _wrench("thrust_curve", _signals(thrust_n=HOVER_N * level * np.ones((200, 4))))[:, 2, 0]
    assert np.all(np.sign(force) == np.sign(level[:, 0] - 1.0))


def test_effects_that_need_what_the_vehicle_does_not_record_are_not_tried():
    signals = _signals()
    tried = {c.identifier for c in candidates(VEHICLE, signals)}
    assert "battery_sag" not in tried, "speeds are measured: voltage cannot change what they mean"
    assert {c.settings["rotor"] for c in candidates(VEHICLE, signals) if c.identifier == "weak_rotor"} == {1, 2, 3, 4}


def test_adding_an_effect_is_adding_one_file(tmp_path, monkeypatch):
    package = importlib.import_module("groundstation.diagnosis.effects")
    (tmp_path / "toy_compass.py").write_text(TOY, encoding="utf-8")
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(tmp_path)])
    effects_module.library.cache_clear()
    try:
        assert "toy_compass" in library()
        assert [c.identifier for c in candidates(VEHICLE, _signals())].count("toy_compass") == 1
    finally:
        monkeypatch.undo()
        effects_module.library.cache_clear()
    assert "toy_compass" not in library()


CITIZEN = (
    TOY.replace("toy_compass", "toy_citizen").rstrip()[:-1]
    + """    instants=("at_s",),
    of_one_rotor=True,
    shared_by_healthy=99,
    bends_base=99,
    scenario=lambda values, vehicle: ("body_drag", {"area_m2": [0.1, 0.1, 0.1]}),
)
"""
)


def test_one_file_makes_an_effect_a_full_citizen(tmp_path, monkeypatch):
    """Nothing outside the file names it: healthy flights, the base fit, a replay's instants, rotors and the scenario
    read its fields.
    """
    package = importlib.import_module("groundstation.diagnosis.effects")
    (tmp_path / "toy_citizen.py").write_text(CITIZEN, encoding="utf-8")
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(tmp_path)])
    effects_module.library.cache_clear()
    try:
        own = library()["toy_citizen"]
        assert effects_module.shared_by_healthy()[-1] is own
        assert effects_module.bending()[-1] is own
        assert own.of_one_rotor
        kept = next_flight._on_plan(own, {"at_s": 90.0, "rotor": 3.0}, np.array([0.0, 10.0]))
        assert kept == {"at_s": 8.0, "rotor": 3.0}
        values = {name: {"value": 0.1, "std": 0.01} for name in own.names()}
        document = {"vehicle": vehicle_to_dict(VEHICLE), "parameters": {}, "effects": {"toy_citizen": values}}
        held, _ = scenario_document(identified_from_document(document))
        assert held["effects"]["body_drag"] == {"area_m2": [0.1, 0.1, 0.1]}
    finally:
        monkeypatch.undo()
        effects_module.library.cache_clear()


def test_what_effects_say_of_themselves_is_what_their_settings_hold():
    for effect in library().values():
        for settings in effect.variants(_signals(), VEHICLE):
            assert set(effect.instants) <= set(settings)
            assert effect.of_one_rotor == ("rotor" in settings), effect.identifier
            assert {"at_s", "from_s"} & set(settings) <= set(effect.instants), effect.identifier


def test_a_model_document_adds_up_its_effects():
    signals = _signals(velocity_world_m_s=np.tile([1.0, 0.0, 0.0], (200, 1)))
    document = {
        "rotor_drag": {"d_x_kg_s": {"value": 0.3, "std": 0.0}, "d_y_kg_s": {"value": 0.2, "std": 0.0}},
        "weak_rotor": {"loss": {"value": 0.1, "std": 0.0}, "rotor": {"value": 1, "std": 0.0}},
        "weak_rotor/2": {"loss": {"value": 0.1, "std": 0.0}, "rotor": {"value": 2, "std": 0.0}},
    }
    total = wrench_of(document, VEHICLE)(signals)[0]
    assert total[0] == pytest.approx(-0.3)
    assert total[2] == pytest.approx(-0.2 * HOVER_N)
    np.testing.assert_allclose(total[3:5], 0.0, atol=1e-12)  # opposite rotors, equally weak: no tilt


def test_the_json_form_has_the_contracts_keys_and_only_plain_values():
    finding = Finding("weak_rotor", {"loss": Estimate.normal(0.1, 0.01)}, "Rotor 3 is weak.", 0.99, ("com_offset",), 3)
    left = Unexplained("force_z_n", 0.12, ("position_x_m",))
    document = json.loads(json.dumps(Diagnosis("f", "x500", "unexplained", (finding,), (left,)).to_dict()))
    assert document["schema"] == "groundstation.diagnosis/1"
    assert {"findings", "unexplained", "error", "parameters_before", "parameters_after", "next_flight"} <= set(document)
    assert set(document["findings"][0]) == {"effect", "parameters", "evidence", "confidence", "alternatives", "rotor"}
    assert set(document["findings"][0]["parameters"]["loss"]) == {"value", "std", "ci95"}
    assert {"channel", "share", "depends_on"} <= set(document["unexplained"][0])
    assert document["findings"][0]["rotor"] == 3


def test_measured_speeds_have_their_lag_behind_them_and_commanded_ones_ahead():
    assert VEHICLE.rotors.lag.up_s > 0.0
    assert declared_parameters(VEHICLE, lag_s=0.0).lag_up_s == 0.0
    commanded = VEHICLE.model_copy(update={"rotors": VEHICLE.rotors.model_copy(update={"speed_source": "command"})})
    assert declared_parameters(commanded, lag_s=0.0).lag_down_s == VEHICLE.rotors.lag.down_s


def test_a_toy_effect_can_stand_for_the_library():
    toy = Effect(
        identifier="toy",
        equation="F = k",
        source="none",
        parameters=(ParameterInfo("k_n", lambda v: 1.0),),
        wrench=lambda signals, vehicle, settings: blank(signals),
        sentence="{k_n}",
        confused_with=(),
        manoeuvre="none",
    )
    assert [c.identifier for c in candidates(VEHICLE, _signals(), effects=[toy])] == ["toy"]


def test_the_origin_is_drawn_round_the_centre_of_mass_when_the_vehicle_spins():
    """Spinning at w about z draws the origin towards the centre of mass with w^2 c; spinning up moves it sideways."""
    steady = _wrench("com_offset", _signals(rate_rad_s=np.tile([0.0, 0.0, 2.0], (200, 1))))[0]
    np.testing.assert_allclose(steady[:3, 0], [4.0 * VEHICLE.mass_kg, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(steady[:3, 1], [0.0, 4.0 * VEHICLE.mass_kg, 0.0], atol=1e-9)
    t = _signals().t_s
    nose_up = np.stack([0.0 * t, -1e-6 * t, 0.0 * t], axis=1)  # about a centre of mass in front: the origin sinks
    assert _wrench("com_offset", _signals(rate_rad_s=nose_up))[0, 2, 0] < 0.0


@pytest.mark.parametrize("kept", ["rotor", "loss"])
def test_an_effect_of_a_model_that_lacks_a_number_is_refused(kept):
    """A parameter as the model is read, a setting as the effect acts."""
    document = {"weak_rotor": {kept: {"value": 1.0, "std": 0.0}}}
    with pytest.raises(BadInput, match=r"effect 'weak_rotor' lacks '(loss|rotor)'.*`report`"):
        wrench_of(document, VEHICLE)(_signals())
