"""No interval is finer than what sampled streams resolve, and one that is wider stays as it is, bit for bit."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from groundstation.identification import dynamic_fit
from groundstation.identification.pipeline import identify
from groundstation.identification.prediction_error import Fitted
from groundstation.identification.resolution import frequency_squared, no_finer
from groundstation.model.parameters import declared_parameters
from groundstation.paths import find_config
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from sim.scenario import load_scenario
from studies.flown import flight_data
from tests.flights import rest_to_rest_plan

NAMES = ("mass_kg", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2", "lag_up_s")
VALUES = np.array([2.0, 0.02, 0.03, 0.04, 0.05])


@pytest.mark.parametrize(("frequency", "step"), [(3.0, 0.02), (6.0, 0.01), (10.0, 0.02)])
def test_what_is_linear_between_samples_lacks_the_share_that_is_stated(frequency, step):
    t = np.linspace(0.0, 40.0 * np.pi / frequency, 200_001)
    sampled = np.arange(0.0, t[-1] + step, step)
    held = np.interp(t, sampled, np.sin(frequency * sampled))
    gain = np.trapezoid(held * np.sin(frequency * t), t) / np.trapezoid(np.sin(frequency * t) ** 2, t)
    assert 1.0 - gain == pytest.approx((frequency * step) ** 2 / 12.0, rel=0.03)


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.3])
def test_the_frequency_of_a_motion_is_found_beside_white_noise(noise):
    step, rng = 0.03, np.random.default_rng(7)
    t = step * np.arange(6000)
    restart = np.zeros(len(t), bool)
    restart[[0, 2000]] = True
    model = SimpleNamespace(restart=restart, dt=np.full(len(t), step))
    values = (np.sin(4.0 * t) + noise * rng.normal(size=len(t)))[:, None]
    assert frequency_squared(model, values)[0] == pytest.approx(16.0, rel=0.03 + 2.0 * noise**2)


def fitted(std):
    covariance = np.outer(std, std) * (0.5 + 0.5 * np.eye(len(NAMES)))
    parameters = declared_parameters(load_vehicle(find_config("vehicles", "x500")), lag_s=0.0, extra=0)
    return Fitted(parameters, NAMES, VALUES, covariance, covariance, (), (), 0.0, np.zeros(6), 0, 0)


def test_deviations_are_no_smaller_than_what_is_not_resolved_and_correlations_stay():
    found = fitted(1e-6 * VALUES)
    share = np.array([0.0, 0.0, 5e-5, 1e-4, 1e-7, 2e-4])
    widened = no_finer(found, share)
    expected = VALUES * [5e-5, 1e-4, 1e-6, 2e-4, 1e-6]
    assert [widened.std(name) for name in NAMES] == pytest.approx(expected)
    scale = np.outer(expected, expected)
    assert widened.covariance / scale == pytest.approx(0.5 + 0.5 * np.eye(len(NAMES)))
    assert widened.bound is found.bound
    assert no_finer(fitted(1e-3 * VALUES), share).covariance.tolist() == fitted(1e-3 * VALUES).covariance.tolist()


def test_a_flight_without_noise_has_its_mass_within_its_interval(monkeypatch):
    """A laboratory without noise: the fit alone states less than what the streams resolve."""
    alone = []
    monkeypatch.setattr(dynamic_fit, "no_finer", lambda fit, share: alone.append(fit) or no_finer(fit, share))
    vehicle = load_vehicle(find_config("vehicles", "tricopter"))
    scenario = load_scenario(find_config("scenarios", "clean"))
    flight = flight_data(simulate(vehicle, rest_to_rest_plan("tricopter"), scenario, 1))
    found = identify([flight])
    mass, truth = found.methods[found.best].parameters["mass_kg"], flight.truth.mass_kg
    assert alone[0].std("mass_kg") < 0.9 * mass.std, (alone[0].std("mass_kg"), mass.std)
    assert abs(mass.value - truth) < 1.96 * mass.std
    assert 2e-5 * truth < mass.std < 1e-4 * truth
