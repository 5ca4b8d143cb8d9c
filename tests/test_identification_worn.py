"""An identification of a vehicle with a weak rotor says so, and its intervals hold the truth."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.diagnosis.doubted import identify
from groundstation.diagnosis.worn import widened
from groundstation.identification.results import MASS_AND_TENSOR, Estimate, Identification
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import Vehicle, load_vehicle
from sim.flight import simulate
from sim.scenario import load_scenario
from studies.flown import flight_data
from studies.worn import ROTOR
from tests.flights import laboratory

SEED = 57001


def identified(scenario: str) -> tuple[Identification, Vehicle]:
    flown = simulate(
        load_vehicle(find_config("vehicles", "qball2")),
        load_plan(find_config("plans", "qball2")),
        load_scenario(find_config("scenarios", scenario)),
        SEED,
    )
    return identify([flight_data(flown, scenario)]), flown.truth


def test_a_weak_rotor_is_warned_of_and_the_mass_holds_the_truth():
    found, truth = identified("worn")
    mass = found.methods[found.best].parameters["mass_kg"]
    assert any(warning.startswith(f"Rotor {ROTOR} seems to give 6.") for warning in found.warnings), found.warnings
    assert mass.value > 1.01 * truth.mass_kg, f"seed {SEED}: a rotor that gives 6 % less is 1.5 % of the mass"
    assert mass.ci95[0] < truth.mass_kg < mass.ci95[1], f"seed {SEED}: {mass} {truth.mass_kg}"
    covariance = found.methods[found.best].covariance
    assert covariance is not None and covariance[0, 0] == pytest.approx(mass.std**2)


def test_healthy_rotors_are_not_spoken_of():
    found, truth = identified("lab")
    mass = found.methods[found.best].parameters["mass_kg"]
    assert not any("Rotor" in warning for warning in found.warnings), f"seed {SEED}: {found.warnings}"
    assert mass.ci95[0] < truth.mass_kg < mass.ci95[1] and mass.std < 0.005 * mass.value, f"seed {SEED}: {mass}"


def test_another_thrust_curve_is_no_weak_rotor():
    """On the paper's gentle plan one of exponent 1.67 passed for a rotor that lacks a tenth."""
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    plan = load_plan(find_config("plans", "paper_table2"))
    flown = simulate(vehicle, plan, laboratory(thrust_curve={"exponent": 1.67}), SEED)
    found = identify([flight_data(flown, "curve")])
    assert not any("Rotor" in warning for warning in found.warnings), f"seed {SEED}: {found.warnings}"


def test_a_weighed_mass_stays_and_others_follow_the_thrust():
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    settings = vehicle.identification.model_copy(update={"anchor": "mass"})
    weighed = vehicle.model_copy(update={"identification": settings})
    own = {name: Estimate.normal(2.0, 0.01) for name in MASS_AND_TENSOR}
    assert widened(own, None, 0.02, weighed) == (own, None)
    wider, covariance = widened(own, 1e-4 * np.eye(7), 0.02, vehicle)
    assert wider["ixx_kg_m2"].std == pytest.approx(np.hypot(0.01, 0.04))
    assert covariance is not None and covariance[0, 1] == pytest.approx(0.0016)
