"""The prediction model: its dynamics against the physical one's, its document, its fit, and the choice between it and
simpler ones.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation.errors import BadInput
from groundstation.identification.predictive_choice import chosen_predictor, section, with_moments
from groundstation.identification.predictive_fit import (
    Squares,
    _simplest_of_the_best,
    fitted,
    free_numbers,
    judged,
    shooting,
)
from groundstation.model.flight_states import FlightStates
from groundstation.model.prediction import _how_far, predict
from groundstation.model.predictive import (
    NAMES,
    NUMBERS,
    Base,
    PredictiveModel,
    course,
    run,
    simulate,
    starting,
    windows,
)
from groundstation.model.rotors import motor_input
from groundstation.model.vehicle_model import VehicleModel, declared_model, model_from_document
from groundstation.vehicle import Vehicle, vehicle_from_dict

SEED = 20261129


def small() -> Vehicle:
    """A quadrotor of 45 g whose telemetry gives its rotors' speeds."""
    return vehicle_from_dict(
        {
            "vehicle": {
                "name": "small",
                "mass_kg": 0.045,
                "inertia_kg_m2": {"xx": 2.4e-5, "yy": 2.6e-5, "zz": 3.3e-5, "xy": 1e-6},
            },
            "rotors": {
                "position_m": [[0.025, -0.025, 0.0], [-0.025, -0.025, 0.0], [-0.025, 0.025, 0.0], [0.025, 0.025, 0.0]],
                "spin": [1, -1, 1, -1],
                "radius_m": 0.0275,
                "thrust_coefficient_n_s2": 3.7e-8,
                "torque_to_thrust_m": 0.002,
                "speed_max_rad_s": 3500.0,
                "input": "rotor_speed",
                "speed_source": "telemetry",
            },
        }
    )


def still(vehicle: Vehicle, seconds: float, seed: int = SEED, size: float = 6.0) -> FlightStates:
    """Rotor speeds that shake a vehicle about its hover, and no motion yet."""
    print("seed", seed)
    random = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.01)
    hover = np.sqrt(vehicle.mass_kg * 9.80665 / 4 / 3.7e-8)
    tones = [np.sin(2 * np.pi * f * t + random.uniform(0, 6.3, (4, 1))) for f in (0.7, 1.3, 2.1, 3.7)]
    motors = motor_input(t, hover + size * sum(tones).T, measured=True, hover=hover)  # type: ignore[union-attr]
    zero, level = np.zeros((len(t), 3)), np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1))
    parts = (zero, zero, level, zero)
    return FlightStates(t, *parts, *parts, motors, np.full(len(t), np.nan), (t[0], t[-1]), vehicle)


def flown(model: PredictiveModel, states: FlightStates, noise_rad_s: float = 0.0) -> FlightStates:
    """The states of a vehicle that is exactly the model, and their measured rates."""
    marks = states.t_s[1:]
    path = run(model.values, windows(course(model.base, states), np.array([0])), list(marks), 0.01)[:, 0]
    path = np.concatenate([[[0.0] * 6 + [1.0] + [0.0] * 6], path])
    rate = path[:, 10:] + noise_rad_s * np.random.default_rng(SEED).standard_normal((len(path), 3))
    parts = (path[:, :3], path[:, 3:6], path[:, 6:10], rate)
    names = ("position_m", "velocity_m_s", "quaternion", "rate_rad_s")
    both = dict(zip(names, parts, strict=True)) | {f"start_{n}": p for n, p in zip(names, parts, strict=True)}
    return replace(states, **both)


def plain(model: VehicleModel) -> PredictiveModel:
    """The prediction model that is the physical one: all gains one, and nothing that the other lacks."""
    start = PredictiveModel(Base.of(model), np.array([n.start for n in NUMBERS]))
    ones = dict.fromkeys(
        ("torque_gain_x", "torque_gain_y", "torque_gain_z", "slow_torque_share", "measured_rate_share"), 1.0
    )
    stems = ("drag", "damping", "delay", "lead", "disturbance_gain", "force_bandwidth", "flapping")
    nothing = {n: 0.0 for n in NAMES if n.startswith(stems)}
    values = ones | nothing
    return start.with_values(tuple(values), np.array(list(values.values())))


def bad_telemetry() -> PredictiveModel:
    """A vehicle that is damped, and whose recorded torque is worth a third of what it says."""
    model = plain(declared_model(small()))
    values = {
        "torque_gain_x": 0.3,
        "torque_gain_y": 0.3,
        "torque_gain_z": 0.4,
        "damping_x_1_s": 9.0,
        "damping_y_1_s": 9.0,
        "damping_z_1_s": 7.0,
        "drag_x_1_s": 0.7,
        "drag_y_1_s": 0.6,
        "flapping_x_rad_s_m": 4.0,
        "flapping_y_rad_s_m": 4.0,
    }
    return model.with_values(tuple(values), np.array(list(values.values())))


def test_with_gains_of_one_it_is_the_physical_model() -> None:
    vehicle = small()
    physical = replace(declared_model(vehicle), com_m=(0.0004, -0.0003, 0.0), thrust_scale=1.03)
    states = still(vehicle, 3.0)
    aslant = np.array([0.96, 0.2, -0.1, 0.15])
    turned = np.tile(aslant / np.linalg.norm(aslant), (len(states.t_s), 1))
    moving = replace(states, start_quaternion=turned, start_rate_rad_s=np.full((len(turned), 3), [0.5, -0.4, 0.8]))
    index = np.array([30, 100])
    ours = simulate(replace(plain(physical), base=Base.of(physical)), moving, index, [0.1, 0.5])
    theirs = predict(physical, moving, horizon_s=0.5)
    row = [int(np.flatnonzero(np.isclose(theirs.start_s, moving.t_s[i]))[0]) for i in index]
    # The observer of rates has not measured any acceleration here; only the start's constant rate is compared.
    for name, tolerance in (("position", 2e-3), ("velocity", 2e-2), ("rate", 0.3)):
        assert ours[0.5][name] == pytest.approx(theirs.final[name][row], abs=tolerance), name


def test_a_document_carries_the_model_and_bounds_it() -> None:
    model = bad_telemetry()
    document = model.to_dict()
    again = PredictiveModel.from_dict(document)
    assert again.values == pytest.approx(model.values)
    assert again.base.tensor == pytest.approx(model.base.tensor)
    document["numbers"]["damping_x_1_s"] = -3.0
    with pytest.raises(BadInput, match="damping_x_1_s = -3"):
        PredictiveModel.from_dict(document)
    with pytest.raises(BadInput, match="incomplete"):
        PredictiveModel.from_dict({"numbers": {}})


def test_an_untrustworthy_torque_and_a_damping_are_found_from_what_lies_ahead() -> None:
    true = bad_telemetry()
    states = flown(true, still(small(), 25.0))
    shot = shooting(states, 0, np.ones(len(states.t_s), bool), 300)
    assert shot is not None
    start = starting(declared_model(small()))
    begun = windows(course(start.base, states), shot.index)
    found = fitted(Squares((shot,), (begun,), start, free_numbers(pose=True, torque=True))).model
    for name, tolerance in (
        ("torque_gain_x", 0.06),
        ("torque_gain_z", 0.08),
        ("damping_x_1_s", 1.5),
        ("drag_x_1_s", 0.1),
    ):
        assert found.value(name) == pytest.approx(true.value(name), abs=tolerance), name
    sizes = predict(found, states).error
    for quantity, still_error in sizes["constant_velocity"]["0.5"].items():
        assert sizes["model"]["0.5"][quantity]["mean_norm"] < 0.2 * still_error["mean_norm"], quantity


def test_what_predicts_unseen_blocks_best_is_chosen_and_told() -> None:
    states = flown(bad_telemetry(), still(small(), 30.0), noise_rad_s=0.02)
    shot = shooting(states, 0, np.ones(len(states.t_s), bool), 250)
    assert shot is not None
    declared = declared_model(small())
    found = section(judged([shot], declared, declared))
    assert found["kind"] == "fitted"
    assert found["error"]["fitted"]["0.5"]["body_rate_rad_s"] < found["error"]["declared"]["0.5"]["body_rate_rad_s"]
    assert (
        found["error"]["fitted"]["0.5"]["body_rate_rad_s"]
        < found["error"]["constant_velocity"]["0.5"]["body_rate_rad_s"]
    )
    assert "WORSE" not in found["summary"]
    assert isinstance(chosen_predictor({"prediction": found}, declared), PredictiveModel)


def test_a_physical_model_that_is_right_stays() -> None:
    declared = declared_model(small())
    states = flown(plain(declared), still(small(), 30.0, size=0.3), noise_rad_s=0.01)
    shot = shooting(states, 0, np.ones(len(states.t_s), bool), 250)
    assert shot is not None
    found = judged([shot], declared, declared)
    score = {name: value for name, (value, _) in found.score.items()}
    assert score[found.kind] <= score["physical"]
    assert score[found.kind] < 0.5 * score["constant_velocity"]


def test_moments_that_are_not_published_predict_where_they_are_better() -> None:
    declared = declared_model(small())
    published = replace(declared, tensor=1.7 * declared.tensor)
    states = flown(plain(declared), still(small(), 30.0, size=0.3), noise_rad_s=0.01)
    shot = shooting(states, 0, np.ones(len(states.t_s), bool), 250)
    assert shot is not None
    own = with_moments(published, declared.tensor, None)
    found = judged([shot], published, published, own)
    assert found.score["unpublished"][0] < found.score["physical"][0]
    assert judged([shot], declared, declared, published).kind != "unpublished"
    document = section(replace(found, kind="unpublished", model=None), own)
    chosen = chosen_predictor({"prediction": document}, published)
    assert isinstance(chosen, VehicleModel) and np.allclose(chosen.tensor, declared.tensor)
    with pytest.raises(BadInput, match="no rigid body"):
        chosen_predictor({"prediction": {**document, "tensor": (-declared.tensor).tolist()}}, published)


@pytest.mark.filterwarnings("ignore:overflow encountered", "ignore:invalid value encountered")
def test_a_physical_model_that_runs_away_is_never_chosen() -> None:
    declared = declared_model(small())
    states = flown(plain(declared), still(small(), 30.0, size=0.3), noise_rad_s=0.01)
    shot = shooting(states, 0, np.ones(len(states.t_s), bool), 250)
    assert shot is not None
    explosive = model_from_document({"model": {"damping_x_nms": {"value": -1.0}}}, small())
    found = judged([shot], explosive, declared)
    assert found.kind != "physical"
    assert found.score["physical"][0] > 100.0
    assert predict(chosen_predictor({"prediction": section(found)}, explosive), states, horizon_s=0.5).windows > 0


def test_a_model_that_loses_to_constant_velocity_says_so_in_its_first_line() -> None:
    states = flown(bad_telemetry(), still(small(), 20.0))
    found = predict(declared_model(small()), states, horizon_s=0.5)
    assert found.to_text().startswith("WORSE than constant velocity in this flight: ")
    assert "body_rate_rad_s at 0.5 s" in found.to_text().splitlines()[0]


def test_a_model_is_held_back_in_a_flight_in_which_it_misses_more_than_constant_velocity() -> None:
    states = flown(bad_telemetry(), still(small(), 20.0))
    losing = predict(declared_model(small()), states, horizon_s=0.5)
    assert ("0.5", "body_rate_rad_s") in losing.worse()
    found = predict(declared_model(small()), states, horizon_s=0.5, hold_back=True)
    assert not found.worse()
    assert "held back towards constant velocity" in found.to_text().splitlines()[0]


def test_a_model_that_predicts_well_is_hardly_held_back() -> None:
    states = flown(bad_telemetry(), still(small(), 20.0), noise_rad_s=0.02)
    plainly, held = (predict(bad_telemetry(), states, hold_back=back).error["model"] for back in (False, True))
    for horizon, quantities in plainly.items():
        for quantity, sizes in quantities.items():
            assert held[horizon][quantity]["mean_norm"] < 1.02 * sizes["mean_norm"], (horizon, quantity)


def test_a_gain_that_is_too_small_for_a_lively_flight_is_made_up_for() -> None:
    gains = ("torque_gain_x", "torque_gain_y", "torque_gain_z")
    true = bad_telemetry()
    states = flown(true, still(small(), 20.0, size=25.0), noise_rad_s=0.01)
    shy = true.with_values(gains, 0.6 * true.values[[NAMES.index(name) for name in gains]])
    size = [predict(shy, states, hold_back=back).error["model"]["0.5"] for back in (False, True)]
    for quantity in ("attitude_rad", "body_rate_rad_s"):
        assert size[1][quantity]["mean_norm"] < 0.9 * size[0][quantity]["mean_norm"], quantity
    told = _how_far({"position": 1.0, "velocity": 0.9, "quaternion": 1.05, "rate": 1.3})
    assert told == " (carried on beyond the model, which moves too little here: body_rate_rad_s by 130% of the model)"


def test_what_holds_a_model_back_is_known_when_a_window_starts() -> None:
    states = flown(bad_telemetry(), still(small(), 12.0))
    cut = int(np.searchsorted(states.t_s, 8.0))
    later = replace(
        states, start_rate_rad_s=np.where(np.arange(len(states.t_s))[:, None] < cut, states.rate_rad_s, 9.0)
    )
    early, changed = (predict(declared_model(small()), each, hold_back=True) for each in (states, later))
    before = early.start_s < states.t_s[cut - 1]
    np.testing.assert_array_equal(early.final["rate"][before], changed.final["rate"][before])


def test_a_candidate_that_loses_at_a_horizon_is_out_where_another_does_not() -> None:
    blocks = {"constant_velocity": np.full(9, 1.0), "physical": np.full(9, 0.50), "fitted": np.full(9, 0.51)}
    assert _simplest_of_the_best(blocks, {name: () for name in blocks}) == "physical"
    lost = {"constant_velocity": (), "physical": (("0.1", "body_rate_rad_s"),), "fitted": (("0.01", "attitude_rad"),)}
    assert _simplest_of_the_best(blocks, lost) == "fitted"


def test_constant_velocity_stays_where_no_model_is_clearly_better() -> None:
    blocks = {"constant_velocity": np.array([1.0, 1.1, 0.9]), "physical": np.array([1.2, 0.8, 0.95])}
    assert _simplest_of_the_best(blocks, {name: () for name in blocks}) == "constant_velocity"


def test_a_kind_nobody_knows_is_named() -> None:
    with pytest.raises(BadInput, match="'oracle'"):
        chosen_predictor({"prediction": {"kind": "oracle"}}, declared_model(small()))
