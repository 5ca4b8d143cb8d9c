"""The closed loop with the forces of effects: what is flown obeys Newton with the force that its own motion makes.

And prediction where a log has no poses: rates are predicted all the same.
"""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.frames import quat_from_euler, quat_rotate
from groundstation.model.closed_loop import STEP_S, Body, Start, simulate_closed_loop
from groundstation.model.flight_states import FlightStates
from groundstation.model.prediction import predict
from groundstation.model.rotors import motor_input
from groundstation.model.signals import Signals
from groundstation.model.vehicle_model import declared_model
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
    body, start = Body(vehicle.mass_kg, vehicle.inertia_tensor()), Start(duration_s=8.0)
    return vehicle, *(simulate_closed_loop(vehicle, series, body, start, wrench=w) for w in (None, drag))


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
        Body(vehicle.mass_kg, vehicle.inertia_tensor()),
        Start(duration_s=8.0),
        wrench=lambda signals: np.zeros((len(signals.t_s), 6)),
    )
    np.testing.assert_array_equal(again.position_m, without.position_m)


def test_rates_are_predicted_without_poses():
    """Rotors that turn the vehicle with a steady torque, and a gyro that saw it; position, velocity and attitude
    unknown.
    """
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    t = np.arange(0.0, 2.0, 0.005)
    torque, rate = 0.05, np.zeros((len(t), 3))
    rate[:, 2] = torque / vehicle.inertia_kg_m2.zz * t
    thrust = np.linalg.pinv(vehicle.allocation()) @ [vehicle.mass_kg * vehicle.gravity_m_s2, 0.0, 0.0, torque]
    motors = motor_input(t, np.tile(vehicle.motor_for_thrust(thrust), (len(t), 1)), measured=True)
    place, attitude = np.full((len(t), 3), np.nan), np.full((len(t), 4), np.nan)
    known = (place, place, attitude, rate)
    states = FlightStates(t, *known, *known, motors, np.full(len(t), np.nan), (0.0, 2.0), vehicle)
    error = predict(declared_model(vehicle), states, horizon_s=0.5).error["model"]["0.5"]
    assert error["body_rate_rad_s"]["rms"] < 0.02 * torque / vehicle.inertia_kg_m2.zz * 0.5
