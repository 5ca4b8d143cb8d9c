"""Six rotors: the shipped hexacopter in the planner, the simulator, both emulated autopilots' logs and the
regressors.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation import api
from groundstation.flightdata import Stream, motor_columns
from groundstation.paths import find_config
from groundstation.planning.limits import envelope
from groundstation.recording.airframes import ARDUPILOT
from groundstation.recording.autopilot import motor_order
from groundstation.vehicle import load_vehicle, vehicle_from_dict, vehicle_to_dict
from tests.recording_flight import flight


@pytest.fixture(scope="module")
def hexa():
    return load_vehicle(find_config("vehicles", "hexa"))


def test_the_shipped_hexacopter_stands_like_the_autopilots_hexa_x(hexa):
    order, notes = motor_order(hexa, ARDUPILOT[2, 1], "log")
    assert order == list(range(6))
    assert notes == []


def test_a_wrench_is_shared_by_six_rotors_and_comes_back(hexa):
    wrench = np.array([25.0, 0.3, -0.2, 0.05])
    mixing = envelope(hexa).mixing
    assert mixing.shape == (6, 4)
    assert np.allclose(hexa.allocation() @ (mixing @ wrench), wrench)


def flown(count, weak=None):
    """The kinematic flight with its wrench shared by any number of rotors in a ring; one may give less thrust than
    declared.
    """
    made = flight(12.0, scale=1.5)
    angle = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    document = vehicle_to_dict(made.vehicle)
    position = 0.2 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    spin = [1 if i % 2 else -1 for i in range(count)]
    document["rotors"] |= {"position_m": position.tolist(), "spin": spin}
    vehicle = vehicle_from_dict(document)
    wrench = made.vehicle.thrust(made.motors.values) @ made.vehicle.allocation().T
    thrust = np.linalg.lstsq(vehicle.allocation(), wrench.T, rcond=None)[0].T
    speed = np.sqrt(np.maximum(thrust, 0.01) / vehicle.rotors.thrust_coefficient_n_s2)
    if weak is not None:
        speed[:, weak - 1] /= np.sqrt(0.9)
    motors = Stream(made.motors.t_s, speed, motor_columns("rotor_speed", count), made.motors.received_s)
    return replace(made, vehicle=vehicle, motors=motors, truth=None)


@pytest.mark.parametrize("count", [5, 6, 8, 12])
def test_any_number_of_rotors_gives_the_same_vehicle(count):
    found = api.identify([flown(count)])
    best = found.methods[found.best].parameters
    for name, value in {"mass_kg": 1.79, "ixx_kg_m2": 0.03, "iyy_kg_m2": 0.03, "izz_kg_m2": 0.04}.items():
        assert best[name].value == pytest.approx(value, rel=0.01), name
