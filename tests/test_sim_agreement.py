"""The simulator and the analysis are written apart; here they are held against each other where theory makes them
agree.
"""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from sim_states import change_of, plant_of, slope_of, state_of, vehicle_of

from groundstation import frames
from groundstation.identification.regressors import standard_regressor
from groundstation.model.signals import Signals
from sim.effects import (
    ClimbInflow,
    ComOffset,
    FlappingMoment,
    GroundEffect,
    RotorDrag,
    TranslationalLift,
    WeakRotor,
)
from sim.effects.angular_damping import AngularDamping
from sim.effects.body_drag import BodyDrag
from sim.plant import ROTOR

VEHICLE = vehicle_of()
PLANT = plant_of(VEHICLE)
WEIGHT = VEHICLE.mass_kg * VEHICLE.gravity_m_s2
INFLOW = PLANT.rotors.hover_inflow


def test_the_regressor_of_eq_12_times_the_true_parameters_is_the_wrench_of_the_rotors():
    random = np.random.default_rng(1)
    tensor = VEHICLE.inertia_tensor()
    theta = [VEHICLE.mass_kg, *tensor[np.triu_indices(3)]]
    for _ in range(20):
        motors = PLANT.rotors.hover_value * random.uniform(0.7, 1.3, 4)
        x = state_of(
            PLANT,
            velocity=random.normal(size=3),
            euler=random.uniform(-0.8, 0.8, 3),
            rate=random.normal(size=3) * 3.0,
            motors=motors,
        )
        slope = slope_of(PLANT, x)
        felt = frames.quat_rotate_inverse(x[6:10], slope[3:6] + PLANT.gravity * np.array([0.0, 0.0, 1.0]))
        phi = standard_regressor(felt[2:3], x[None, 10:13], slope[None, 10:13])[0]
        np.testing.assert_allclose(phi @ theta, VEHICLE.allocation() @ VEHICLE.thrust(motors), rtol=1e-9, atol=1e-9)


def _explained(identifier: str, x, parameters, settings=None) -> np.ndarray:
    """Wrench of the analysis' model of an effect at a state, shape (6,)."""
    signals = Signals(
        t_s=np.zeros(1),
        position_m=x[None, :3],
        velocity_world_m_s=x[None, 3:6],
        quaternion=x[None, 6:10],
        rate_rad_s=x[None, 10:13],
        motor=x[None, ROTOR:],
        lagged=x[None, ROTOR:],
        lagged_rate=np.zeros((1, 4)),
        thrust_n=VEHICLE.thrust(x[None, ROTOR:]),
        voltage_v=np.full(1, np.nan),
        charge_as=np.full(1, np.nan),
    )
    effect = importlib.import_module(f"groundstation.diagnosis.effects.{identifier}").EFFECT
    return effect.wrench(signals, VEHICLE, settings or {})[0] @ np.asarray(parameters, dtype=float)


@pytest.mark.parametrize(
    ("simulated", "parameters", "state"),
    [
        (RotorDrag((0.3, 0.2)), (0.3, 0.2), {"velocity": (0.05, -0.04, 0.0)}),
        (BodyDrag((0.04, 0.04, 0.04)), (0.5 * 1.2 * 0.04,), {"velocity": (2.0, -1.0, 0.5)}),
        (AngularDamping((0.01, 0.02, 0.03)), (0.01, 0.02, 0.03), {"rate": (1.0, -2.0, 0.5)}),
        (FlappingMoment(0.03), (0.03,), {"velocity": (1.0, -2.0, 0.0)}),
        (ComOffset((0.01, -0.004, 0.0)), (0.01, -0.004), {}),
        (GroundEffect(1.0), (1.0 / 16.0,), {"position": (0.0, 0.0, 1.5)}),
        (TranslationalLift(0.7), (0.7 / (4.0 * INFLOW**2),), {"velocity": (0.2, 0.1, 0.0)}),
        (ClimbInflow(0.7), (0.7 * WEIGHT / (2.0 * INFLOW),), {"velocity": (0.0, 0.0, 0.05)}),
    ],
    ids=lambda value: type(value).__name__ if hasattr(value, "on") else None,
)
def test_an_effect_and_its_explanation_agree_to_first_order(simulated, parameters, state):
    identifier = "".join(f"_{c.lower()}" if c.isupper() else c for c in type(simulated).__name__).lstrip("_")
    force, torque = change_of(VEHICLE, {identifier: simulated}, **state)
    expected = _explained(identifier, state_of(PLANT, **state), parameters)
    scale = np.abs(expected).max()
    assert scale > 0.0
    np.testing.assert_allclose([*force, *torque], expected, atol=0.03 * scale)


def test_a_weak_rotor_is_explained_but_for_the_propellers_own_share_of_torque():
    force, torque = change_of(VEHICLE, {"weak_rotor": WeakRotor(rotor=2, loss=0.1)})
    expected = _explained("weak_rotor", state_of(PLANT), (0.1,), {"rotor": 2.0})
    np.testing.assert_allclose([*force, *torque[:2]], expected[:5], atol=1e-9)
    assert torque[2] == pytest.approx(1.25 * expected[5], rel=0.03)
