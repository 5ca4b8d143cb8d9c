"""States of the simulated plant put together by hand, and what accelerates them."""

from __future__ import annotations

import numpy as np

from groundstation import frames
from groundstation.vehicle import Vehicle, vehicle_from_dict
from sim.build import build_plant
from sim.effects import Effects
from sim.plant import ATTITUDE, RATE, ROTOR, VELOCITY, Plant, Surroundings, derivative, rk4_step
from sim.scenario import Scenario, Truth

STILL = (0.0, 0.0, 0.0)


def vehicle_of(mass_kg: float = 1.0, *, arm_m: float = 0.2, **rotors) -> Vehicle:
    """A square quadrotor with a full tensor."""
    d = arm_m / np.sqrt(2.0)
    size = mass_kg * arm_m**2
    constants = {
        "position_m": [[d, -d, 0.02], [-d, d, 0.02], [d, d, 0.02], [-d, -d, 0.02]],
        "spin": [1, 1, -1, -1],
        "radius_m": 0.6 * arm_m,
        "thrust_coefficient_n_s2": mass_kg * 9.80665 / 4.0 / 500.0**2,
        "torque_to_thrust_m": 0.08 * arm_m,
        "speed_max_rad_s": 800.0,
    }
    inertia = {"xx": 0.35 * size, "yy": 0.4 * size, "zz": 0.6 * size}
    inertia |= {"xy": 0.03 * size, "xz": -0.02 * size, "yz": 0.04 * size}
    body = {"name": "square", "mass_kg": mass_kg, "inertia_kg_m2": inertia}
    return vehicle_from_dict({"vehicle": body, "rotors": constants | rotors})


def plant_of(vehicle: Vehicle, truth: Truth | None = None, **effects) -> Plant:
    """The true plant with some effects on."""
    return build_plant(vehicle, Scenario(truth=truth or Truth(), effects=Effects()._replace(**effects)))


def state_of(plant: Plant, *, position=(0.0, 0.0, 5.0), velocity=STILL, euler=STILL, rate=STILL, motors=None):
    """A state vector; the rotors at hover unless given."""
    count = len(plant.rotors.spin)
    x = np.zeros(ROTOR + count)
    x[:3], x[VELOCITY : VELOCITY + 3], x[RATE : RATE + 3] = position, velocity, rate
    x[ATTITUDE : ATTITUDE + 4] = frames.quat_from_euler(*euler)
    x[ROTOR:] = plant.rotors.hover_value if motors is None else motors
    return x


def now(*, wind=STILL, force=STILL, torque=STILL, flight_s: float = 0.0, powered: bool = True) -> Surroundings:
    """Surroundings in the air."""
    return Surroundings(
        tuple(map(float, wind)), tuple(map(float, force)), tuple(map(float, torque)), float(flight_s), powered, False
    )


def slope_of(plant: Plant, x, *, memory=None, target=None, **surroundings):
    """Time derivative of a state."""
    slope = np.zeros_like(x)
    count = len(plant.rotors.spin)
    derivative(
        x,
        slope,
        x[ROTOR:].copy() if target is None else np.asarray(target, dtype=float),
        np.zeros(count) if memory is None else memory,
        plant,
        now(**surroundings),
    )
    return slope


def wrench_of(plant: Plant, x, **surroundings) -> tuple[np.ndarray, np.ndarray]:
    """Force in the body (gravity excluded) and torque about the centre of mass that explain a state's derivative."""
    slope = slope_of(plant, x, **surroundings)
    body = plant.after if surroundings.get("flight_s", 0.0) >= plant.change_s else plant.before
    q, w, w1 = x[ATTITUDE : ATTITUDE + 4], x[RATE : RATE + 3], slope[RATE : RATE + 3]
    com = np.array(body.com)
    felt = frames.quat_rotate_inverse(q, slope[VELOCITY : VELOCITY + 3] + plant.gravity * np.array([0.0, 0.0, 1.0]))
    force = body.mass * (felt + np.cross(w1, com) + np.cross(w, np.cross(w, com)))
    tensor = matrix(body.inertia)
    return force, tensor @ w1 + np.cross(w, tensor @ w)


def change_of(vehicle: Vehicle, effect: dict, *, surroundings=None, **state) -> tuple[np.ndarray, np.ndarray]:
    """What an effect adds to force (body) and torque of a state."""
    surroundings = surroundings or {}
    without, with_it = plant_of(vehicle), plant_of(vehicle, **effect)
    x = state_of(without, **state)
    f0, t0 = wrench_of(without, x, **surroundings)
    f1, t1 = wrench_of(with_it, x, **surroundings)
    return f1 - f0, t1 - t0


def matrix(symmetric) -> np.ndarray:
    """Matrix of a tensor's six entries."""
    xx, xy, xz, yy, yz, zz = symmetric
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def advance(plant: Plant, x, seconds: float, dt: float = 0.001, *, target=None, **surroundings) -> np.ndarray:
    """Integrate a state; returns the history, shape (steps + 1, len(x))."""
    count = len(plant.rotors.spin)
    x, work, memory = x.copy(), np.zeros((5, len(x))), np.zeros(count)
    goal = x[ROTOR:].copy() if target is None else np.asarray(target, dtype=float)
    around = now(**surroundings)
    history = [x.copy()]
    for _ in range(round(seconds / dt)):
        rk4_step(x, work, goal, memory, plant, around, dt)
        history.append(x.copy())
    return np.array(history)
