"""Mean thrusts of flights without a gyro, beside those of healthy ones: which rotor, and whether a load could do it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from groundstation.diagnosis.trim import compare_trims
from groundstation.model.rotors import wrench_matrix
from groundstation.paths import find_config
from groundstation.vehicle import load_vehicle

VEHICLE = load_vehicle(find_config("vehicles", "x500"))
HOVER = VEHICLE.mass_kg * VEHICLE.gravity_m_s2 / VEHICLE.rotors.count


def _flight(thrust: np.ndarray) -> Any:
    """What the comparison reads of a flight: a steady thrust of each rotor."""
    samples = np.tile(thrust, (20, 1))
    record = SimpleNamespace(vehicle=VEHICLE, keep=np.ones(20, dtype=bool))
    return SimpleNamespace(record=record, signals=lambda *_: SimpleNamespace(thrust_n=samples))


def _flights(mean: np.ndarray, count: int) -> list[Any]:
    scatter = np.random.default_rng(3).normal(0.0, 0.004 * HOVER, (count, 4))
    return [_flight(mean + one) for one in scatter]


HEALTHY = _flights(np.full(4, HOVER), 5)


def test_a_rotor_that_works_harder_alone_is_a_weak_rotor():
    found = compare_trims(_flights(np.array([1.0, 1.0, 1.12, 1.0]) * HOVER, 3), HEALTHY)
    (finding,) = found.findings
    assert (finding.effect, finding.rotor) == ("weak_rotor", 3)
    assert abs(finding.parameters["loss"].value - (1.0 - 1.0 / 1.12)) < 0.02
    assert found.after["torque_z_nm"] < 0.3 * found.before["torque_z_nm"]


def test_a_load_beside_a_rotor_moves_the_centre_and_leaves_yaw_alone():
    hub = np.asarray(VEHICLE.rotors.position_m)[2]
    load = 0.1 * VEHICLE.mass_kg * VEHICLE.gravity_m_s2
    more = np.linalg.pinv(wrench_matrix(VEHICLE)) @ np.array([load, load * hub[1], -load * hub[0], 0.0])
    (finding,) = compare_trims(_flights(HOVER + more, 3), HEALTHY).findings
    assert (finding.effect, finding.rotor) == ("com_offset", 3)
    assert abs(finding.parameters["mass_change_kg"].value / (0.1 * VEHICLE.mass_kg) - 1.0) < 0.2
    assert np.sign(finding.parameters["com_offset_x_m"].value) == np.sign(hub[0])


def test_flights_that_scatter_as_the_healthy_ones_do_give_no_finding():
    assert compare_trims(_flights(np.full(4, HOVER), 2), HEALTHY).findings == ()
