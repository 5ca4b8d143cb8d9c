"""What turns a vehicle beside its model, carried on: told from the past alone, worth what its covariance says, and no
harm where there is nothing to carry.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.signal import lfilter

from groundstation.errors import BadInput
from groundstation.model.disturbance import TurningDisturbance, carried, gains, pooled, turning
from groundstation.model.flight_states import FlightStates
from groundstation.model.prediction import predict
from groundstation.model.rotors import motor_input
from groundstation.model.vehicle_model import declared_model
from groundstation.paths import find_config
from groundstation.vehicle import load_vehicle

STEP_S = 0.004
SIZE, MEMORY_S, SENSOR = 2.0, 0.8, 1e-3


def alike(value: float) -> tuple[float, float, float]:
    return value, value, value


NOISE = TurningDisturbance(
    alike(SIZE), alike(MEMORY_S), alike(0.0), alike(SENSOR * np.sqrt(STEP_S)), alike(np.inf), alike(1.0)
)


def ornstein_uhlenbeck(generator: np.random.Generator, count: int, size: float, memory_s: float) -> np.ndarray:
    keep = np.exp(-STEP_S / memory_s)
    driven = size * np.sqrt(1.0 - keep**2) * generator.standard_normal((count + 4000, 3))
    return lfilter([1.0], [1.0, -keep], driven, axis=0)[4000:]


def integrated(values: np.ndarray) -> np.ndarray:
    return cumulative_trapezoid(values, dx=STEP_S, axis=0, initial=0.0)


def hovering(generator: np.random.Generator, pushed: np.ndarray, balanced: np.ndarray) -> FlightStates:
    """A vehicle of equal moments (rates do not couple) that d turns, with rotors that hold it up and balance some of d,
    and a gyro; nothing else is known of its motion.
    """
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    moments = vehicle.inertia_kg_m2.model_copy(update=dict.fromkeys(("xx", "yy", "zz"), vehicle.inertia_kg_m2.xx))
    vehicle = vehicle.model_copy(update={"inertia_kg_m2": moments})
    t = STEP_S * np.arange(len(pushed))
    rate = integrated(pushed + balanced)
    rate += SENSOR * generator.standard_normal(rate.shape)
    wrench = np.column_stack(
        [np.full(len(t), vehicle.mass_kg * vehicle.gravity_m_s2), balanced @ vehicle.inertia_tensor()]
    )
    motors = motor_input(t, vehicle.motor_for_thrust(wrench @ np.linalg.pinv(vehicle.allocation()).T), measured=True)
    known = (np.full((len(t), 3), np.nan), np.full((len(t), 3), np.nan), np.full((len(t), 4), np.nan), rate)
    return FlightStates(t, *known, *known, motors, np.full(len(t), np.nan), (2.0, t[-1]), vehicle)


def rate_error(model, states: FlightStates, horizon_s: float) -> float:
    return predict(model, states, horizon_s=horizon_s).error["model"][f"{horizon_s:g}"]["body_rate_rad_s"]["rms"]


def test_a_disturbance_is_told_and_carried_on_as_well_as_its_process_allows():
    """Conditional on d(0), omega(h) - omega(0) has the variance s^2 tau (2 h - 3 tau + 4 tau e - tau e^2), e =
    exp(-h/tau).
    """
    generator = np.random.default_rng(21)
    pushed = ornstein_uhlenbeck(generator, 20_000, SIZE, MEMORY_S)
    states = hovering(generator, pushed, np.zeros_like(pushed))
    model = declared_model(states.vehicle)
    for horizon in (0.1, 0.5):
        e = np.exp(-horizon / MEMORY_S)
        least = SIZE * np.sqrt(3.0 * MEMORY_S * (2.0 * horizon - MEMORY_S * (3.0 - 4.0 * e + e**2)))
        error = rate_error(replace(model, disturbance=NOISE), states, horizon)
        assert 0.85 * least < error < 1.25 * least
        assert error < 0.85 * rate_error(model, states, horizon)


def test_what_is_carried_owes_nothing_to_the_future():
    generator = np.random.default_rng(22)
    beside = integrated(ornstein_uhlenbeck(generator, 2000, SIZE, MEMORY_S))
    t = STEP_S * np.arange(2000)
    changed = beside.copy()
    changed[1500:] += 5.0
    early = carried(NOISE, t, beside).acceleration_rad_s2[:1500]
    np.testing.assert_array_equal(early, carried(NOISE, t, changed).acceleration_rad_s2[:1500])


def test_the_filter_says_how_sure_it_is():
    """Over sixty flights the error of d at the end stands as its covariance says."""
    generator = np.random.default_rng(23)
    t = STEP_S * np.arange(1000)
    errors = []
    for _ in range(60):
        d = ornstein_uhlenbeck(generator, 1000, SIZE, MEMORY_S)
        y = integrated(d) + SENSOR * generator.standard_normal(d.shape)
        found = carried(NOISE, t, y)
        errors.append((found.acceleration_rad_s2[-1] - d[-1]) / np.sqrt(found.covariance[:, 1, 1]))
    assert 0.8 < np.sqrt(np.mean(np.square(errors))) < 1.25


def test_a_vehicle_that_is_held_is_predicted_to_keep_turning_back():
    """Rotors that answer d at once but for its fast part: an open loop drifts away with the answers, the flight did
    not.
    """
    generator = np.random.default_rng(24)
    pushed = ornstein_uhlenbeck(generator, 20_000, SIZE, MEMORY_S)
    seen = lfilter([0.05], [1.0, -0.95], pushed, axis=0)
    states = hovering(generator, pushed, -seen)
    model = declared_model(states.vehicle)
    size, time = turning(states.rate_rad_s, STEP_S)
    held = replace(NOISE, turning_rad_s=tuple(size), turning_correlation_s=tuple(time))
    alone, carries, turns_back = (rate_error(replace(model, disturbance=d), states, 0.5) for d in (None, NOISE, held))
    constant = predict(model, states, horizon_s=0.5).error["constant_velocity"]["0.5"]["body_rate_rad_s"]["rms"]
    assert turns_back < 0.7 * carries < 0.7 * alone
    assert turns_back < 1.05 * constant


def test_a_model_that_knows_its_vehicle_is_left_alone():
    """With a disturbance a thousand times smaller than the rates, what the rates are like on average takes nothing
    off.
    """
    covariance = np.zeros((3, 2, 2))
    quiet = replace(NOISE, acceleration_rad_s2=alike(1e-3), turning_rad_s=alike(0.3))
    assert np.abs(gains(quiet, covariance, 0.005, 100).sum(axis=0)).max() < 1e-4
    told_nothing = replace(NOISE, turning_rad_s=alike(np.inf))
    assert not gains(told_nothing, covariance, 0.005, 100).any()


def test_variance_and_correlation_time_of_rates_are_those_of_their_process():
    rates = ornstein_uhlenbeck(np.random.default_rng(25), 400_000, 0.5, 0.1)
    size, time = turning(rates, STEP_S)
    np.testing.assert_allclose(size, 0.5, rtol=0.05)
    np.testing.assert_allclose(time, 0.1, rtol=0.2)


def test_flights_that_tell_nothing_of_an_axis_do_not_vote_on_it():
    silent = replace(NOISE, acceleration_rad_s2=(SIZE, SIZE, 0.0), turning_rad_s=(0.1, 0.1, 9.0))
    both = pooled([replace(NOISE, turning_rad_s=alike(0.1)), silent])
    assert both.turning_rad_s == pytest.approx(alike(0.1))
    assert both.acceleration_rad_s2 == pytest.approx(alike(SIZE))


def test_it_goes_into_a_document_and_back_and_a_damaged_one_is_refused_in_a_sentence():
    assert TurningDisturbance.from_dict(NOISE.to_dict()) == NOISE
    for damaged in ({}, NOISE.to_dict() | {"correlation_s": [1.0]}, NOISE.to_dict() | {"sensor_rad_rs": "none"}):
        with pytest.raises(BadInput, match=r"\[disturbance\] lacks three numbers"):
            TurningDisturbance.from_dict(damaged)
