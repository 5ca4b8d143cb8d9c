"""The closed loop with the forces of effects: what is flown obeys Newton with the force that its own motion makes."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.frames import quat_from_euler, quat_rotate
from groundstation.model.closed_loop import STEP_S, simulate_closed_loop
from groundstation.model.signals import Signals
from groundstation.paths import find_config
from groundstation.planning import paper_plan
from groundstation.vehicle import load_vehicle

DRAG_KG_S = 0.4


def drag(signals: Signals) -> np.ndarray:
    force = np.zeros((len(signals.t_s), 6))
    force[:, :3] = -DRAG_KG_S * signals.velocity_body_m_s()
    return force


@pytest.fixture(scope="module")
def flown():
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    series = paper_plan().series()
    kwargs = {"mass_kg": vehicle.mass_kg, "inertia": vehicle.inertia_tensor(), "duration_s": 8.0}
    return vehicle, *(simulate_closed_loop(vehicle, series, **kwargs, wrench=w) for w in (None, drag))


def test_the_motion_obeys_newton_with_the_force_it_makes_itself(flown):
    vehicle, _, with_drag = flown
    q = quat_from_euler(*with_drag.euler_rad.T)
    velocity = quat_rotate(q, with_drag.velocity_body_m_s)
    acceleration = (velocity[2:] - velocity[:-2]) / (2.0 * STEP_S)
    lift = np.zeros_like(velocity)
    lift[:, 2] = 0.5 * (with_drag.wrench[:, 0] + np.roll(with_drag.wrench[:, 0], 1))
    weight = np.array([0.0, 0.0, -vehicle.mass_kg * vehicle.gravity_m_s2])
    felt = vehicle.mass_kg * acceleration - quat_rotate(q, lift)[1:-1] - weight
    resisted = -DRAG_KG_S * velocity[1:-1]
    assert np.sqrt(np.mean((felt - resisted)[50:] ** 2)) < 0.03 * np.sqrt(np.mean(resisted[50:] ** 2))


def test_drag_moves_the_path_and_an_effect_of_nothing_does_not(flown):
    vehicle, without, with_drag = flown
    assert np.abs(with_drag.position_m - without.position_m).max() > 2e-3
    again = simulate_closed_loop(
        vehicle,
        paper_plan().series(),
        mass_kg=vehicle.mass_kg,
        inertia=vehicle.inertia_tensor(),
        duration_s=8.0,
        wrench=lambda signals: np.zeros((len(signals.t_s), 6)),
    )
    np.testing.assert_array_equal(again.position_m, without.position_m)
