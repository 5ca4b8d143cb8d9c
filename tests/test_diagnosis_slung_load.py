"""A load that swings below the vehicle: the pendulum against Newton's law, and a flight with one that is named."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from flights import laboratory
from scipy.integrate import solve_ivp

from groundstation.diagnosis import diagnose
from groundstation.diagnosis.effect import Acting, library
from groundstation.diagnosis.pendulum import pulls_per_mass
from groundstation.model.signals import Signals
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from studies.flown import flight_data

SEED = 3
GRAVITY, LENGTH_M, AIR_1_S = 9.81, 0.45, 0.2
EFFECT = library()["slung_load"]
VEHICLE = load_vehicle(find_config("vehicles", "qball2"))


def _velocity(t: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(3.0 * t), 0.5 * np.cos(2.0 * t) - 0.5, 0.3 * np.sin(2.2 * t)], axis=-1)


def _free_fall(t: float, u: np.ndarray) -> np.ndarray:
    """Acceleration of the mass beside the hook if there were no cable."""
    acceleration = np.array([3.0 * np.cos(3.0 * t), -np.sin(2.0 * t), 0.66 * np.cos(2.2 * t)])
    return np.array([0.0, 0.0, -GRAVITY]) - acceleration - AIR_1_S * (_velocity(np.array(t)) + u)


def _pull(t: float, x: np.ndarray) -> np.ndarray:
    """What keeps the mass at its distance: the second derivative of |r|^2 is zero."""
    r, u = x[:3], x[3:]
    return (_free_fall(t, u) @ r + u @ u) / (r @ r) * r


def test_the_pull_is_that_of_newtons_law_at_large_swings():
    t = np.arange(0.0, 20.0, 0.005)
    start = [0.0, 0.0, -LENGTH_M, 0.0, 0.0, 0.0]
    exact = solve_ivp(
        lambda t, x: np.concatenate([x[3:], _free_fall(t, x[3:]) - _pull(t, x)]),
        (0.0, 20.0),
        start,
        t_eval=t,
        rtol=1e-8,
        atol=1e-10,
    ).y.T
    tilt = np.degrees(np.arccos(-exact[:, 2] / LENGTH_M).max())
    assert tilt > 50.0
    expected = np.array([_pull(at, x) for at, x in zip(t, exact, strict=True)])
    pendulums = np.array([[LENGTH_M, AIR_1_S, 0.0], [2.0 * LENGTH_M, AIR_1_S, 0.0]])
    found, _ = pulls_per_mass(t, (_velocity(t), 0.0 * _velocity(t)), GRAVITY, pendulums, False)
    np.testing.assert_allclose(found[1:-1, :, 0], expected[1:-1], atol=2e-3)
    assert np.abs(found[:, :, 1] - found[:, :, 0]).max() > 1.0  # another pendulum beside it


HUNG = {"length_m": 0.52, "air_1_s": 0.12, "depth_m": 0.04}


def _signals(duration_s: float = 10.0, step_s: float = 0.004) -> Signals:
    """A level vehicle that moves sideways and climbs."""
    t = np.arange(0.0, duration_s, step_s)
    blank, thrust = np.zeros((len(t), 3)), np.full((len(t), 4), VEHICLE.mass_kg * GRAVITY / 4.0)
    level, unknown = np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1)), np.full(len(t), np.nan)
    return Signals(t, blank, _velocity(t), level, blank, thrust, thrust, 0.0 * thrust, thrust, unknown, unknown)


@pytest.mark.parametrize(
    ("name", "column", "step"), [("length_m", 1, 0.002), ("air_1_s", 2, 0.01), ("depth_m", 3, 0.002)]
)
def test_a_change_of_a_setting_is_what_its_column_says(name: str, column: int, step: float):
    signals, settings = _signals(), {"length_m": LENGTH_M, "air_1_s": 0.5, "depth_m": 0.03}
    about = EFFECT.wrench(signals, VEHICLE, settings)
    moved = EFFECT.wrench(signals, VEHICLE, {**settings, name: settings[name] + step})
    difference = moved[:, :, 0] - about[:, :, 0]
    error = difference - step * about[:, :, column]
    assert np.sqrt(np.mean(error**2)) < 0.1 * np.sqrt(np.mean(difference**2))


def test_the_instrument_of_a_flight_that_flies_its_plan_is_the_pull_itself():
    signals, settings = _signals(), {"length_m": LENGTH_M, "air_1_s": AIR_1_S, "depth_m": 0.03}
    assert EFFECT.instrument is not None
    acceleration = np.gradient(signals.velocity_world_m_s, signals.t_s, axis=0)
    thrust = VEHICLE.mass_kg * (acceleration[:, 2:] + VEHICLE.gravity_m_s2) / 4.0
    rising = replace(signals, thrust_n=np.repeat(thrust, 4, axis=1))
    found = EFFECT.instrument(rising, rising, VEHICLE, settings)[:, :, 0]
    pull = EFFECT.wrench(rising, VEHICLE, settings)[:, :, 0]
    np.testing.assert_allclose(found[5:-5, 2], pull[5:-5, 2], atol=0.25 * np.abs(pull).max())


def test_the_pull_holds_nothing_of_the_disturbance_that_the_accelerometer_feels():
    signals, settings = _signals(), {"length_m": LENGTH_M, "air_1_s": AIR_1_S, "depth_m": 0.0}
    shaken = signals.velocity_world_m_s + [0.0, 0.0, 0.01] * np.sin(40.0 * signals.t_s)[:, None]
    calm, disturbed = (
        EFFECT.wrench(each, VEHICLE, settings)[:, 2, 0]
        for each in (signals, replace(signals, velocity_world_m_s=shaken))
    )
    assert np.sqrt(np.mean((calm - disturbed) ** 2)) < 0.05 * 0.01 * 40.0


def test_a_load_swings_on_in_windows_that_start_in_a_flight():
    signals, settings = _signals(), {"length_m": LENGTH_M, "air_1_s": AIR_1_S, "depth_m": 0.03}
    acting = Acting([(EFFECT, settings, np.array([0.1, 0.0, 0.0, 0.0]))], VEHICLE)
    along, starts = acting(signals), np.array([500, 1200])
    ahead = acting.begun(signals, starts)
    for step in range(1, 120):
        now = signals.at(starts + step)
        found = ahead(now)
    np.testing.assert_allclose(found, along[starts + 119], atol=0.3 * np.abs(along).max())  # the thrust is not theirs


def _searched(share_of_time: float, disturbance_n: float) -> list[dict[str, float]]:
    """What a search gives of a load that pulls for a share of the flight, beside a slow disturbance of this RMS."""
    signals = _signals(30.0)
    pull = EFFECT.wrench(signals, VEHICLE, HUNG)[:, :3, 0] * 0.06 * VEHICLE.mass_kg
    pull[signals.t_s > 30.0 * share_of_time] = 0.0
    random, wind = np.random.default_rng(SEED), np.zeros_like(pull)
    for k in range(1, len(wind)):  # correlated over 0.4 s
        wind[k] = 0.99 * wind[k - 1] + random.standard_normal(3)
    wind *= disturbance_n / max(float(np.sqrt(np.mean(wind**2))), 1e-9)
    force = np.gradient(signals.velocity_world_m_s, signals.t_s, axis=0) * VEHICLE.mass_kg - pull - wind
    force[:, 2] += VEHICLE.mass_kg * GRAVITY
    # what hangs on the thrust is level: all of the force that is missing points along the thrust
    size = np.linalg.norm(force, axis=1)
    axis = force / size[:, None]
    quaternion = np.stack([1.0 + axis[:, 2], -axis[:, 1], axis[:, 0], 0.0 * size], axis=1)
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    thrust = np.repeat(size[:, None] / 4.0, 4, axis=1)
    flown = replace(signals, quaternion=quaternion, thrust_n=thrust)
    assert EFFECT.searched is not None
    return [dict(found) for found in EFFECT.searched(flown, np.ones(len(size), dtype=bool), VEHICLE)]


def test_a_search_finds_the_pendulum_among_lengths_that_are_soon_out_of_step():
    found = _searched(1.0, 0.0)[0]
    assert found["length_m"] == pytest.approx(HUNG["length_m"], rel=0.01)
    assert found["air_1_s"] == pytest.approx(HUNG["air_1_s"], abs=0.1)


def test_a_disturbance_as_large_as_what_no_mass_takes_of_the_pull_does_not_hide_it():
    print("seed", SEED)
    signals = _signals(30.0)
    pull = EFFECT.wrench(signals, VEHICLE, HUNG)[:, :2, 0] * 0.06 * VEHICLE.mass_kg
    found = _searched(1.0, 0.6 * float(np.sqrt(np.mean(pull**2))))[0]
    assert found["length_m"] == pytest.approx(HUNG["length_m"], rel=0.03)


def test_a_pendulum_that_is_in_step_for_half_of_the_flight_is_not_followed():
    assert all("body_kg" in found for found in _searched(0.5, 0.0))


def test_a_load_far_below_is_named_with_its_size_and_improves_the_prediction():
    print("seed", SEED)
    load = {"mass_kg": 0.1, "length_m": 0.5, "attachment_m": (0.0, 0.0, -0.05)}
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": 3.0})
    flown = simulate(VEHICLE, plan, laboratory(slung_load=load), SEED)
    found = diagnose([flight_data(flown)])
    first = found.findings[0]
    assert first.effect == "slung_load"
    assert first.parameters["load_kg"].value == pytest.approx(0.1, rel=0.05)
    assert first.parameters["length_m"].value == pytest.approx(0.5, rel=0.02)  # under its load the cable is longer
    assert first.parameters["length_m"].std > 0.0
    assert found.adopted
    assert found.parameters_after["mass_kg"].value == pytest.approx(flown.truth.mass_kg, rel=0.005)


def test_a_load_that_no_pendulum_keeps_in_step_with_is_named_with_its_size(monkeypatch: pytest.MonkeyPatch):
    """Its cable is seen where the force points that thrust and weight leave."""
    print("seed", SEED)
    monkeypatch.setattr(sys.modules[EFFECT.wrench.__module__], "likely_pendulums", lambda *args: [])
    load = {"mass_kg": 0.14, "length_m": 0.36, "attachment_m": (0.0, 0.0, -0.05)}
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": 3.0})
    flown = simulate(VEHICLE, plan, laboratory(slung_load=load), SEED)
    found = diagnose([flight_data(flown)])
    first = found.findings[0]
    assert first.effect == "slung_load"
    for name, true in {"load_kg": 0.14, "length_m": 0.36, "depth_m": 0.05, "body_kg": flown.truth.mass_kg}.items():
        estimate = first.parameters[name]
        assert abs(estimate.value - true) < 3.0 * estimate.std, name
    mass = found.parameters_after["mass_kg"]
    assert mass.ci95[0] < flown.truth.mass_kg < mass.ci95[1]
    assert mass.std < 0.05 * flown.truth.mass_kg
