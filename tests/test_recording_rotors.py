"""Six rotors: the shipped hexacopter in the planner, the simulator, both emulated autopilots' logs and the regressors."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.paths import find_config
from groundstation.planning.limits import envelope
from groundstation.recording.airframes import ARDUPILOT
from groundstation.recording.autopilot import motor_order
from groundstation.vehicle import load_vehicle


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
