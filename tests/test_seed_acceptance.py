"""The four methods on simulated flights of the published trajectory: exact where nothing is hidden, honest where noise
is.
"""

import numpy as np
import pytest

from groundstation.identification.results import MASS_AND_TENSOR
from groundstation.identification.seed import identify_seed
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from sim.scenario import load_scenario
from studies.flown import flight_data


def fly(scenario, seed):
    simulated = simulate(
        load_vehicle(find_config("vehicles", "qball2")),
        load_plan(find_config("plans", "paper_table2")),
        load_scenario(find_config("scenarios", scenario)),
        seed,
    )
    return flight_data(simulated)


def errors(flight, result):
    """Mass error as a share, tensor errors as shares of the true trace, and all over their claimed standard
    deviation.
    """
    truth = flight.truth
    expected = np.array([truth.mass_kg, *truth.inertia_tensor()[np.triu_indices(3)]])
    got = np.array([result.parameters[name].value for name in MASS_AND_TENSOR])
    std = np.array([result.parameters[name].std for name in MASS_AND_TENSOR])
    scale = np.array([truth.mass_kg, *[truth.inertia_tensor().trace()] * 6])
    return (got - expected) / scale, (got - expected) / std


def test_clean_flight_gives_mass_to_a_thousandth_and_the_tensor_to_half_a_percent_of_its_trace():
    flight = fly("clean", 1)
    methods = identify_seed(flight)
    for name in ("LS", "FMLS"):
        relative, _ = errors(flight, methods[name])
        assert abs(relative[0]) < 1e-3
        assert np.abs(relative[1:]).max() < 5e-3, name


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_seed_scenario_is_off_by_what_the_intervals_say(seed):
    """The seed's sensors, clock offset told: errors of a few claimed deviations, gradient descent worse than least
    squares.
    """
    flight = fly("seed", seed)
    methods = identify_seed(flight, mocap_minus_imu_s=0.0125)
    for name, result in methods.items():
        relative, sigmas = errors(flight, result)
        assert np.abs(sigmas).max() < 5.0, (name, sigmas)
        limit = 0.015 if name in ("LS", "FMLS") else 0.06
        assert np.abs(relative[1:]).max() < limit, (name, relative)
    spread = {name: methods[name].parameters["ixx_kg_m2"].std for name in methods}
    assert spread["GD"] > spread["LS"]
    assert spread["FMGD"] > spread["FMLS"]
