"""Mass, tensor, lag and clock of simulated flights: planted truth within its interval, an anchor that fixes the
scale.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from flights import laboratory

from groundstation.errors import NotIdentifiable
from groundstation.flightdata import FlightData
from groundstation.identification.anchoring import anchored
from groundstation.identification.consistency import nearest_rigid_body, physically_consistent
from groundstation.identification.dynamic_fit import DynamicFit, fit_dynamics
from groundstation.identification.instrumental import _root_of_inverse
from groundstation.identification.pipeline import identify
from groundstation.identification.prediction_error import Fitted
from groundstation.identification.preparation import prepare
from groundstation.identification.results import MASS_AND_TENSOR, Estimate
from groundstation.identification.starts import flight_states
from groundstation.model.parameters import declared_parameters
from groundstation.model.prediction import predict
from groundstation.model.vehicle_model import declared_model, model_from_document
from groundstation.paths import find_config
from groundstation.reporting.exports import model_document
from groundstation.trajectory import load_plan
from groundstation.vehicle import Vehicle, load_vehicle, vehicle_from_dict, vehicle_to_dict
from sim.flight import simulate
from sim.scenario import RotorLag, load_scenario
from studies.flown import flight_data

SEEDS = (1, 2)
TRUE_OFFSET_S = -0.018
DRIFT = 20e-6
IMU_TO_MOTORS_S = 0.0005


@cache
def qball() -> Vehicle:
    """The seed's vehicle."""
    return load_vehicle(find_config("vehicles", "qball2"))


@cache
def lab_flight(seed: int, periods: float = 3.0, commanded: bool = False) -> FlightData:
    """Table 2's plan in the laboratory: lag, moving air, clocks that disagree, mass and tensor not as declared."""
    plan = load_plan(find_config("plans", "paper_table2")).model_copy(update={"periods": periods})
    vehicle = qball()
    if commanded:
        document = vehicle_to_dict(vehicle)
        document["rotors"]["speed_source"] = "command"
        vehicle = vehicle_from_dict(document)
    return flight_data(simulate(vehicle, plan, load_scenario(find_config("scenarios", "lab")), seed), f"lab {seed}")


@cache
def lab_fit(seed: int) -> DynamicFit:
    """Prediction error and instrumental estimates of a laboratory flight."""
    return fit_dynamics([prepare(lab_flight(seed))])


def truth(flight: FlightData) -> dict[str, float]:
    """Planted values."""
    assert flight.truth is not None
    return flight.truth.parameters()


@pytest.mark.parametrize("seed", SEEDS)
def test_planted_mass_and_tensor_are_within_their_intervals(seed: int) -> None:
    found, planted = lab_fit(seed).best, truth(lab_flight(seed))
    z = {name: (found.value(name) - planted[name]) / found.std(name) for name in MASS_AND_TENSOR}
    assert max(abs(v) for v in z.values()) < 3.5, z
    assert found.value("mass_kg") == pytest.approx(planted["mass_kg"], rel=0.01)
    for name in ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2"):
        assert abs(found.value(name) / planted[name] - 1.0) < max(0.02, 3.0 * found.std(name) / planted[name]), name
        assert found.std(name) < 0.05 * planted[name], "an interval so wide says nothing"


def test_noisy_rotor_speeds_bias_the_prediction_error_estimate_but_not_the_instrumental_one() -> None:
    iv, fe = [], []
    for seed in SEEDS:
        planted, fit = truth(lab_flight(seed)), lab_fit(seed)
        assert fit.instrumental is not None
        for name in ("ixx_kg_m2", "iyy_kg_m2"):
            iv.append(fit.instrumental.value(name) / planted[name] - 1.0)
            fe.append(fit.filter_error.value(name) / planted[name] - 1.0)
    assert abs(np.mean(iv)) < 0.04
    assert np.mean(fe) > 0.08, "noise in the regressor must show in an estimate that takes it for exact"


@pytest.mark.parametrize("seed", SEEDS)
def test_the_clock_of_motion_capture_is_found(seed: int) -> None:
    flight = lab_flight(seed)
    clock = prepare(flight).clock
    assert clock is not None
    assert flight.imu is not None
    middle_s = 0.5 * (flight.imu.t_s[0] + flight.imu.t_s[-1])
    assert abs(clock.mocap_minus_imu_s - (TRUE_OFFSET_S + DRIFT * middle_s)) < max(3e-4, 3.3 * clock.std_s)
    assert clock.std_s < 1e-3
    assert abs(clock.drift - DRIFT) < 3.3 * clock.drift_std + 5e-6


def test_the_rotor_lag_of_a_commanded_vehicle_is_found() -> None:
    flight = lab_flight(3, commanded=True)
    found = fit_dynamics([prepare(flight)]).best
    total = found.value("rotor_lag_up_s") + found.value("rotor_lag_down_s")
    assert 0.5 * total + found.value("input_delay_s") == pytest.approx(0.045, abs=0.006)
    planted = truth(flight)
    z = {name: (found.value(name) - planted[name]) / found.std(name) for name in MASS_AND_TENSOR}
    assert max(abs(v) for v in z.values()) < 3.5, z


def test_what_a_flight_tells_nothing_of_counts_for_nothing() -> None:
    """A square root of the inverse information, in any units, and where one direction is not told in double
    precision.
    """
    information = np.array([[4e12, 1e3, 0.0], [1e3, 1.0, 0.0], [0.0, 0.0, 1e-20]])
    root = _root_of_inverse(information)
    np.testing.assert_allclose(root @ root.T @ information, np.eye(3), atol=1e-9)
    twice_the_same = np.array([[1.0, 1.0], [1.0, 1.0]])
    root = _root_of_inverse(twice_the_same)
    np.testing.assert_allclose(root @ root.T, 0.25 * twice_the_same, atol=1e-12)


def test_pooled_flights_know_more_than_each() -> None:
    pooled = fit_dynamics([prepare(lab_flight(seed)) for seed in SEEDS]).best
    planted = truth(lab_flight(SEEDS[0]))
    for name in MASS_AND_TENSOR:
        assert abs(pooled.value(name) - planted[name]) < 3.5 * pooled.std(name), name
    for name in ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2"):
        assert pooled.std(name) < 0.9 * max(lab_fit(seed).best.std(name) for seed in SEEDS)


# What fixes the scale


def weighed(mass_kg: float, std_kg: float = 0.0) -> Vehicle:
    """The vehicle with its true mass on the scales, anchored by it."""
    document = vehicle_to_dict(qball())
    document["vehicle"]["mass_kg"] = mass_kg
    document["identification"] |= {"anchor": "mass", "mass_std_kg": std_kg}
    return vehicle_from_dict(document)


def test_a_weighed_mass_gives_the_thrust_constant() -> None:
    planted = truth(lab_flight(1))
    fit = lab_fit(1).best
    parameters, constants = anchored(weighed(planted["mass_kg"]), fit.names, fit.values, fit.covariance)
    k = constants["thrust_coefficient_n_s2"]
    assert abs(k.value - planted["thrust_coefficient_n_s2"]) < 3.5 * k.std
    assert k.std < 0.01 * k.value
    assert parameters["mass_kg"].value == planted["mass_kg"]
    assert parameters["mass_kg"].std == pytest.approx(0.0, abs=1e-12)
    heavier, _ = anchored(weighed(2.0 * planted["mass_kg"]), fit.names, fit.values, fit.covariance)
    for name in MASS_AND_TENSOR:
        assert heavier[name].value == pytest.approx(2.0 * parameters[name].value), "mass and tensor scale as one"


def test_the_scales_own_uncertainty_widens_every_interval() -> None:
    planted = truth(lab_flight(1))
    fit = lab_fit(1).best
    sure, _ = anchored(weighed(planted["mass_kg"]), fit.names, fit.values, fit.covariance)
    unsure, _ = anchored(weighed(planted["mass_kg"], 0.1 * planted["mass_kg"]), fit.names, fit.values, fit.covariance)
    assert unsure["mass_kg"].std == pytest.approx(0.1 * planted["mass_kg"])
    for name in ("ixx_kg_m2", "izz_kg_m2"):
        assert unsure[name].std == pytest.approx(np.hypot(sure[name].std, 0.1 * sure[name].value), rel=1e-6)


@pytest.mark.parametrize(
    ("tensor", "said"),
    [
        ((1.0, 0.0, 0.0, 1.0, 0.0, 1.9), ""),
        ((1.0, 0.0, 0.0, 1.0, 0.0, 2.1), "sum of the other two"),
        ((1.0, 1.1, 0.0, 1.0, 0.0, 1.0), "positive definite"),
    ],
)
def test_a_tensor_of_no_rigid_body_is_named(tensor: tuple[float, ...], said: str) -> None:
    values = dict(zip(MASS_AND_TENSOR, (1.0, *tensor), strict=True))
    verdict = physically_consistent({name: Estimate.normal(value, 0.01) for name, value in values.items()})
    assert said in verdict if said else verdict == ""


def measured_body(tensor: tuple[float, ...], std: float) -> Fitted:
    """A fit that found a mass of 1 kg and a tensor, all equally uncertain and independent."""
    p = replace(declared_parameters(qball(), lag_s=0.0), mass_kg=1.0)
    values = np.array([1.0, *tensor])
    covariance = std**2 * np.eye(7)
    return Fitted(p, MASS_AND_TENSOR, values, covariance, covariance, (), (), 0.0, np.zeros(6), 0, 0)


def test_the_nearest_rigid_body_is_found_and_how_far_it_is() -> None:
    """Against the plane Izz = Ixx + Iyy, where the nearest point is known; a body that is possible stays itself."""
    rigid, away = nearest_rigid_body(measured_body((1.0, 0.0, 0.0, 1.0, 0.0, 2.3), 0.01), ())
    np.testing.assert_allclose(rigid.values[[1, 4, 6]], [1.1, 1.1, 2.2], atol=1e-3)
    np.testing.assert_allclose(rigid.values[[2, 3, 5]], 0.0, atol=1e-6)
    assert away == pytest.approx(0.3 / np.sqrt(3.0) / 0.01, rel=1e-3)
    moments = np.linalg.eigvalsh(rigid.parameters.tensor)
    assert 0.0 < moments[2] < moments[0] + moments[1]
    same, away = nearest_rigid_body(measured_body((1.0, 0.1, 0.0, 1.2, 0.0, 1.9), 0.01), ())
    np.testing.assert_allclose(same.values, [1.0, 1.0, 0.1, 0.0, 1.2, 0.0, 1.9], atol=1e-8)
    assert away < 1e-4


def test_an_estimate_of_no_rigid_body_is_told_and_the_nearest_body_is_believed() -> None:
    flight = lab_flight(1)
    document = vehicle_to_dict(flight.vehicle)
    document["rotors"]["torque_to_thrust_m"] *= 2.0  # and with it what Izz seems to be
    found = identify([replace(flight, vehicle=vehicle_from_dict(document))])
    assert found.best == "IV, rigid body"
    assert any("belongs to no rigid body" in warning and "effect is missing" in warning for warning in found.warnings)
    assert physically_consistent(found.methods["IV"].parameters)
    assert not physically_consistent(found.methods[found.best].parameters)
    assert "IV" in found.best_reason


# Refusals for want of data


def test_a_flight_of_three_seconds_is_refused_as_too_short() -> None:
    flight = lab_flight(1)
    assert flight.window_s is not None
    start = flight.window_s[0]
    with pytest.raises(NotIdentifiable, match=r"too short: 3\.0 s") as refusal:
        identify([replace(flight, window_s=(start, start + 3.0))])
    assert refusal.value.exit_status == 3


def test_leaving_out_nearly_everything_is_refused() -> None:
    flight = lab_flight(1)
    assert flight.window_s is not None
    with pytest.raises(NotIdentifiable, match="leave out less"):
        prepare(flight, exclude=[(flight.window_s[0] + 2.0, flight.window_s[1])])


# Prediction


def test_the_true_model_predicts_better_than_the_declared_one_and_than_constant_velocity() -> None:
    flight = lab_flight(1)
    assert flight.truth is not None
    error = predict(declared_model(flight.truth), flight_states(flight), horizon_s=0.5).error
    horizon = max(error["model"], key=float)
    for quantity in ("position", "velocity"):
        name = next(key for key in error["model"][horizon] if quantity in key)
        model = error["model"][horizon][name]["rms"]
        assert model < 0.5 * error["constant_velocity"][horizon][name]["rms"], quantity


@pytest.mark.parametrize("lag_s", [0.001, 0.008])
def test_a_dead_time_with_little_lag_is_divided_rightly(lag_s):
    """The commands' highest frequencies divide them, and each period of these has a minimum of its own."""
    document = vehicle_to_dict(qball())
    document["rotors"] |= {"speed_source": "command", "lag": {"up_s": 0.0, "down_s": 0.0}}
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": 4.0})
    late = laboratory(input_delay={"delay_s": 0.025})
    true = late.truth.model_copy(update={"lag": RotorLag(up_s=lag_s, down_s=lag_s)})
    flown = simulate(vehicle_from_dict(document), plan, late.model_copy(update={"truth": true}), 7)
    found = fit_dynamics([prepare(flight_data(flown))]).filter_error.parameters
    assert found.delay_s == pytest.approx(0.025, abs=3e-4)
    assert [found.lag_up_s, found.lag_down_s] == pytest.approx([lag_s, lag_s], abs=4e-4)


def test_what_is_carried_on_makes_the_prediction_of_an_unseen_flight_better():
    """Measured speeds are fitted at 30 Hz, where a good gyro's noise does not show; a prediction's filter runs at the
    gyro's own rate.
    """
    plan = load_plan(find_config("plans", "qball2"))
    room = load_scenario(find_config("scenarios", "lab"))
    air = room.disturbance.model_copy(update={"force_share": 0.003, "torque_share": 0.002, "correlation_s": 0.7})
    room = room.model_copy(update={"imu": room.imu.model_copy(update={"gyro_density": 1e-4}), "disturbance": air})
    seen, unseen = (flight_data(simulate(qball(), plan, room, seed), f"quiet {seed}") for seed in (1, 2))
    model = model_from_document(model_document(identify([seen]), qball()), qball())
    assert model.disturbance is not None
    states = flight_states(unseen)
    carried, plain = (
        predict(each, states, horizon_s=0.5).error["model"] for each in (model, replace(model, disturbance=None))
    )
    for horizon in ("0.01", "0.1", "0.5"):
        assert carried[horizon]["body_rate_rad_s"]["rms"] < plain[horizon]["body_rate_rad_s"]["rms"], horizon
