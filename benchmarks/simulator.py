"""The simulator alone, many flights at once on one core and on two, RotorPy, crazyflow: steps a second.

All fly the paper's published trajectory with the QBall 2's mass, inertia and rotors; the ground-truth loop of RotorPy
is its own (Multirotor with the SE3 controller and its IMU), stepped at the same rate over a part of the flight, because
it is slow. Flights at once share the plan and differ in seeds, masses and tensors. Rates are per second of processor
time of one core; of two processes at once also per second on the clock, which counts what else the machine does.
Processes take blocks of flights, ever smaller ones towards the end, and give back only what is asked of a flight.

Run with ``python -m benchmarks.simulator``; ``--flights 1024`` is the study of 1024.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from multiprocessing.synchronize import Barrier

import numpy as np
from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.sensors.imu import Imu
from rotorpy.vehicles.multirotor import Multirotor

from groundstation.paths import find_config
from groundstation.planning import paper_plan
from groundstation.trajectory import Plan, flight_path
from groundstation.vehicle import Vehicle, load_vehicle
from sim.build import STEP_S
from sim.flight import SimulatedFlight, simulate
from sim.lanes import WIDTH
from sim.many import Job, simulate_many
from sim.scenario import load_scenario
from studies.timing import seconds

RUNS = 3
WORLDS, WORLD_STEPS = 1024, 200
WARM = 8
PROCESSES = 2
ROTORPY_S = 4.0


def ours(vehicle: Vehicle, plan: Plan) -> tuple[float, float]:
    """Steps per processor second and times real time, median of several whole flights in the seed's laboratory."""
    scenario = load_scenario(find_config("scenarios", "seed"))
    simulate(vehicle, plan, scenario, 0)  # compiles
    rates = []
    for seed in range(1, RUNS + 1):
        began = time.process_time()
        flight = simulate(vehicle, plan, scenario, seed)
        rates.append(flown_steps(flight) / (time.process_time() - began))
    rate = statistics.median(rates)
    return rate, rate * STEP_S


def jobs(vehicle: Vehicle, plan: Plan, seeds: range) -> list[Job]:
    """Flights in the seed's laboratory, each with a mass and a tensor of its own."""
    scenario = load_scenario(find_config("scenarios", "seed"))
    truth = scenario.truth

    def world(seed: int):
        x, y, z = np.random.default_rng(seed).uniform(0.97, 1.03, 3)
        a, b, c = truth.inertia_factor
        update = {"mass_factor": 1.02 * x, "inertia_factor": (a * y, b * y, c * z)}
        return scenario.model_copy(update={"truth": truth.model_copy(update=update)})

    return [Job(vehicle, plan, world(seed), seed) for seed in seeds]


def _many(first: int, flights: int) -> tuple[float, float]:
    """Simulated steps and processor seconds of so many flights at once."""
    vehicle, plan = load_vehicle(find_config("vehicles", "qball2")), paper_plan()
    steps = 0.0
    began = time.process_time()
    for _, flight in simulate_many(jobs(vehicle, plan, range(first, first + flights))):
        if not isinstance(flight, SimulatedFlight):
            raise flight
        steps += flown_steps(flight)
    return steps, time.process_time() - began


def flown_steps(flight: SimulatedFlight) -> float:
    """Steps that a flight took, by its IMU."""
    stamps = flight.streams["imu"][0]
    return float(np.round((stamps[-1] - stamps[0]) / STEP_S))


def many(flights: int) -> float:
    """Steps per processor second of flights at once on one core."""
    _many(0, WARM)  # compiles, or loads
    steps, took = _many(1, flights)
    return steps / took


def blocks(flights: int) -> Iterator[tuple[int, int]]:
    """First and number of flights of each block: a share of what is left, whole groups, so that both end together."""
    done = 0
    while done < flights:
        share = max((flights - done) // (2 * PROCESSES) // WIDTH, 1) * WIDTH
        yield done, min(share, flights - done)
        done += share


def _warm(ready: Barrier) -> None:
    _many(0, WARM)
    ready.wait()


def many_on_two(flights: int) -> tuple[float, float]:
    """Steps per second of processor time of one core, and per second on the clock, of flights in two processes."""
    context = get_context("spawn")
    ready = context.Barrier(PROCESSES + 1)
    with ProcessPoolExecutor(PROCESSES, context, initializer=_warm, initargs=(ready,)) as pool:
        waiting = [pool.submit(os.getpid) for _ in range(PROCESSES)]  # starts the processes
        ready.wait()
        for each in waiting:
            each.result()
        began = time.perf_counter()
        done = list(pool.map(_many, *zip(*((1 + first, count) for first, count in blocks(flights)), strict=True)))
        clock = time.perf_counter() - began
    steps = sum(s for s, _ in done)
    return steps / sum(took for _, took in done), steps / clock


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


def crazyflow() -> float | None:
    """Steps a processor second of all worlds of crazyflow together; none where it is not installed.

    In a process of its own, for it wants SciPy's settings before SciPy.
    """
    code = "from benchmarks.simulator import crazyflow_here; print(crazyflow_here())"
    settings = {**os.environ, "SCIPY_ARRAY_API": "1"}
    done = subprocess.run([sys.executable, "-c", code], env=settings, capture_output=True, text=True, check=False)
    return None if done.returncode else float(done.stdout.split()[-1])


def crazyflow_here() -> float:
    """Steps a processor second, median of several runs."""
    from crazyflow.control import Control
    from crazyflow.dynamics import Dynamics
    from crazyflow.sim import Sim

    worlds = Sim(n_worlds=WORLDS, dynamics=Dynamics.first_principles, control=Control.attitude, freq=500)
    worlds.reset()
    command = np.zeros((WORLDS, 1, 4), dtype=np.float32)
    command[..., 3] = 0.3

    def fly() -> None:
        worlds.attitude_control(command)
        worlds.step(WORLD_STEPS)
        np.asarray(worlds.data.states.pos)  # waits until it is done

    fly()  # compiles
    return WORLDS * WORLD_STEPS / statistics.median(seconds(fly) for _ in range(RUNS))


def main() -> None:
    """Print all of them."""
    parser = argparse.ArgumentParser(description="Steps a second of the simulator, and of RotorPy.")
    parser.add_argument("--flights", type=int, default=64, help="flights at once")
    options = parser.parse_args()
    vehicle, plan = load_vehicle(find_config("vehicles", "qball2")), paper_plan()
    rate, times = ours(vehicle, plan)
    together = many(options.flights)
    each, clock = many_on_two(options.flights)
    theirs = rotorpy(vehicle, plan)
    print(
        f"simulator: {rate:9.0f} steps/s of {1e3 * STEP_S:g} ms, all sensors on: {times:.0f} times real time on one "
        "core"
    )
    print(f"{options.flights} flights at once, one core: {together:9.0f} steps/s; ratio {together / rate:.1f}")
    print(
        f"{options.flights} flights at once, two processes: {2.0 * each:9.0f} steps/s by processor time of both, "
        f"{clock:.0f} on the clock"
    )
    print(
        f"RotorPy:   {theirs:9.0f} steps/s of {1e3 * STEP_S:g} ms, plant, controller and IMU; ratio {rate / theirs:.0f}"
    )
    if (worlds := crazyflow()) is not None:
        print(
            f"crazyflow: {worlds:9.0f} steps/s of a processor second, {WORLDS} worlds, body, motors and attitude loop"
        )


if __name__ == "__main__":
    main()
