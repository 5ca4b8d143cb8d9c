"""The simulator against RotorPy on the same flight: steps a second on one core, controller and all sensors on.

Both fly the paper's published trajectory with the QBall 2's mass, inertia and rotors; the ground-truth loop of RotorPy
is its own (Multirotor with the SE3 controller and its IMU), stepped at the same rate over a part of the flight, because
it is slow.

Run with ``python -m benchmarks.simulator``.
"""

from __future__ import annotations

import statistics
import time

import numpy as np
from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.sensors.imu import Imu
from rotorpy.vehicles.multirotor import Multirotor

from groundstation.paths import find_config
from groundstation.planning import paper_plan
from groundstation.trajectory import Plan, flight_path
from groundstation.vehicle import Vehicle, load_vehicle
from sim.build import STEP_S
from sim.flight import simulate
from sim.scenario import load_scenario

RUNS = 3
ROTORPY_S = 4.0


def ours(vehicle: Vehicle, plan: Plan) -> tuple[float, float]:
    """Steps per second and times real time, median of several whole flights in the seed's laboratory."""
    scenario = load_scenario(find_config("scenarios", "seed"))
    flown_s = flight_path(plan, np.zeros(4)).duration_s
    simulate(vehicle, plan, scenario, 0)  # compiles
    took = []
    for seed in range(1, RUNS + 1):
        began = time.process_time()
        simulate(vehicle, plan, scenario, seed)
        took.append(time.process_time() - began)
    median = statistics.median(took)
    return flown_s / STEP_S / median, flown_s / median


def parameters(vehicle: Vehicle) -> dict:
    """The vehicle in RotorPy's terms; what it does not declare is zero."""
    rotors, inertia = vehicle.rotors, vehicle.inertia_kg_m2
    zero = (
        "Ixy",
        "Iyz",
        "Ixz",
        "c_Dx",
        "c_Dy",
        "c_Dz",
        "k_d",
        "k_z",
        "k_h",
        "k_flap",
        "rotor_speed_min",
        "motor_noise_std",
    )
    thrust = rotors.thrust_coefficient_n_s2
    return {
        **dict.fromkeys(zero, 0.0),
        **{"mass": vehicle.mass_kg, "Ixx": inertia.xx, "Iyy": inertia.yy, "Izz": inertia.zz, "rI": np.zeros(3)},
        **{"num_rotors": rotors.count, "rotor_directions": np.array(rotors.spin), "tau_m": 0.05},
        "rotor_pos": {f"r{i + 1}": np.array(p) for i, p in enumerate(rotors.position_m)},
        **{"k_eta": thrust, "k_m": thrust * rotors.torque_to_thrust_m, "rotor_speed_max": rotors.speed_max_rad_s},
        **{"k_w": 1, "k_v": 10, "kp_att": 300, "kd_att": 50},
    }


def rotorpy(vehicle: Vehicle, plan: Plan) -> float:
    """Steps per second of RotorPy's plant, controller and IMU."""
    settings = parameters(vehicle)
    plant, control, imu = Multirotor(settings), SE3Control(settings), Imu(sampling_rate=1.0 / STEP_S)
    path = flight_path(plan, np.zeros(4))
    hover = np.sqrt(vehicle.mass_kg * 9.81 / (4.0 * settings["k_eta"]))
    state = {name: np.zeros(3) for name in ("x", "v", "w", "wind")}
    state |= {"q": np.array([0.0, 0.0, 0.0, 1.0]), "rotor_speeds": np.full(4, hover)}
    steps = round(ROTORPY_S / STEP_S)
    began = time.process_time()
    for step in range(steps):
        flat = path.sample(step * STEP_S)
        wanted = dict(zip(("x", "x_dot", "x_ddot", "x_dddot", "x_ddddot"), flat.position[:, 0], strict=True))
        wanted |= {"yaw": flat.yaw[0, 0], "yaw_dot": flat.yaw[1, 0], "yaw_ddot": flat.yaw[2, 0]}
        command = control.update(step * STEP_S, state, wanted)
        acceleration = plant.statedot(state, command, STEP_S)
        imu.measurement(state, acceleration)
        state = plant.step(state, command, STEP_S)
    return steps / (time.process_time() - began)


def main() -> None:
    """Print both."""
    vehicle, plan = load_vehicle(find_config("vehicles", "qball2")), paper_plan()
    rate, times = ours(vehicle, plan)
    theirs = rotorpy(vehicle, plan)
    print(
        f"simulator: {rate:9.0f} steps/s of {1e3 * STEP_S:g} ms, all sensors on: {times:.0f} times real time on one "
        "core"
    )
    print(
        f"RotorPy:   {theirs:9.0f} steps/s of {1e3 * STEP_S:g} ms, plant, controller and IMU; ratio {rate / theirs:.0f}"
    )


if __name__ == "__main__":
    main()
