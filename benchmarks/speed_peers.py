"""Section of ``benchmarks.speed``: the same work by other tools, in one run: ``make bench-peers``.

The packages are the optional extra ``peers``; a tool that is not installed has no row.
"""

from __future__ import annotations

import importlib.util
import statistics
from collections.abc import Callable, Mapping

import numpy as np

from benchmarks import planner, simulator
from benchmarks.simulator import WORLDS
from benchmarks.speed import Row
from groundstation.identification.pipeline import identify
from groundstation.paths import find_config
from groundstation.planning import paper_plan
from groundstation.planning.criteria import regressor
from groundstation.trajectory import RigidMotion, rigid_motion
from groundstation.vehicle import load_vehicle
from sim.flight import SimulatedFlight, simulate
from sim.scenario import load_scenario
from studies.flown import flight_data
from studies.timing import seconds

TITLE = "Beside other tools"
ABOUT = """Processor time of one core on the same machine in one run; the last column counts in times of ours for the \
same row's task.

| tool | what it computes | what it leaves out |
| --- | --- | --- |
| ours, regressor | thrust and torque rows for mass and six inertias, Gram matrix, solution | centre of mass |
| FIGAROH 1.0, regressor | six wrench rows for the ten parameters of a body by Pinocchio, sample by sample; Gram \
matrix, solution | noise, lag, clocks, intervals |
| ours, simulator | rigid body, rotors, battery, PID, estimator, IMU, poses, clocks, disturbance; Runge-Kutta at 1 ms; \
many at once are eight in lockstep in each of two processes | |
| RotorPy | rigid body, rotors, SE3 controller, IMU; SciPy's integrator | pose sensor, clocks, battery, estimator |
| MuJoCo | one free body with four rotor forces; Runge-Kutta at 1 ms | controller, sensors, motors, everything else |
| crazyflow | 1024 worlds at once: rigid body, first-order motors, attitude controller, compiled by JAX for the \
processor | sensors, clocks, disturbance |
| ours, planner | the paper's problem to within 1 % of the best known, from random starts | |
| SLSQP | the same program by finite differences, one run | |
| ours, identify | mass, six inertias, lag and dead time of a whole simulated flight of 58 s at 500 Hz, by all \
methods, with intervals | |
| AeroID 0.5 | three moments of inertia from 20 s of the same flight at 50 Hz: extended Kalman filter over body rates, \
least squares of its innovations, standard errors | mass, products, lag, dead time, poses, clocks |

Flights on two cores are counted by processor time of both, and on the clock, which also counts what else the machine \
does."""
SAMPLES = 30_000
"""A minute at 500 Hz."""
RUNS = 3
WRENCH = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
MUJOCO_STEPS = 20_000
FLIGHTS_GOAL = 5e6
AXES, TORQUES, MOMENTS = "pqr", "lmn", ("xx", "yy", "zz")
BUDGET_S = 4.0
"""Processor seconds that SLSQP gets."""
BODY = """<mujoco><option timestep="0.001" integrator="RK4"/><worldbody><body><freejoint/>
<inertial pos="0 0 0" mass="1.79" diaginertia="0.03 0.03 0.04"/>
<site name="a" pos=".2 0 0"/><site name="b" pos="-.2 0 0"/><site name="c" pos="0 .2 0"/><site name="d" pos="0 -.2 0"/>
</body></worldbody><actuator><motor site="a" gear="0 0 1 0 0 .01"/><motor site="b" gear="0 0 1 0 0 .01"/>
<motor site="c" gear="0 0 1 0 0 -.01"/><motor site="d" gear="0 0 1 0 0 -.01"/></actuator></mujoco>"""


def _median(function: Callable[[], object], runs: int = RUNS) -> float:
    function()  # loads and compiles
    return statistics.median(seconds(function) for _ in range(runs))


def _motion() -> RigidMotion:
    series = paper_plan().series()
    return rigid_motion(series.sample(np.linspace(0.0, series.duration_s, SAMPLES, endpoint=False)))


def _solve(w: np.ndarray) -> np.ndarray:
    theta = np.ones(w.shape[1])
    return np.linalg.pinv(w.T @ w, hermitian=True) @ (w.T @ (w @ theta))


def _regressors() -> list[Row]:
    motion = _motion()
    ours = _median(lambda: _solve(regressor(motion).reshape(-1, 7)))
    rows = [Row("regressor and least squares, a minute at 500 Hz: ours", ours, "s", ratio=1.0)]
    if importlib.util.find_spec("figaroh"):
        import pinocchio as pin
        from figaroh.tools.regressor import RegressorBuilder, RegressorConfig

        model = pin.Model()
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
        model.appendBodyToJoint(joint, pin.Inertia(1.79, np.zeros(3), np.diag([0.03, 0.03, 0.04])), pin.SE3.Identity())

        class Robot:
            """What FIGAROH asks of a robot."""

            def __init__(self) -> None:
                self.model, self.data = model, model.createData()

        config = RegressorConfig(is_joint_torques=False, is_external_wrench=True, force_torque=list(WRENCH))
        builder = RegressorBuilder(Robot(), config)
        q = np.column_stack([motion.position_m, np.zeros((SAMPLES, 3)), np.ones(SAMPLES)])
        v = np.column_stack([motion.velocity_world_m_s, motion.angular_velocity_body_rad_s])
        a = np.column_stack([motion.acceleration_world_m_s2, motion.angular_acceleration_body_rad_s2])
        theirs = _median(lambda: _solve(builder.build_basic_regressor(q, v, a)))
        rows.append(Row("the same: FIGAROH", theirs, "s", ratio=theirs / ours))
    return rows


def _simulators() -> list[Row]:
    vehicle, plan = load_vehicle(find_config("vehicles", "qball2")), paper_plan()
    rate, _ = simulator.ours(vehicle, plan)
    theirs = simulator.rotorpy(vehicle, plan)
    rows = [
        Row("simulator, one flight: ours", rate, "steps/s", ratio=1.0),
        Row("the same: RotorPy", theirs, "steps/s", ratio=theirs / rate),
    ]
    import mujoco

    model = mujoco.MjModel.from_xml_string(BODY)
    data = mujoco.MjData(model)
    data.ctrl[:] = 1.79 * 9.81 / 4.0

    def fly() -> None:
        for _ in range(MUJOCO_STEPS):
            mujoco.mj_step(model, data)

    rate_mujoco = MUJOCO_STEPS / _median(fly)
    rows.append(Row("a free body with four forces: MuJoCo", rate_mujoco, "steps/s", ratio=rate_mujoco / rate))
    each, clock = simulator.many_on_two(WORLDS)
    for how, found, goal in (
        ("per processor second", each, None),
        ("two cores, by processor time", 2.0 * each, FLIGHTS_GOAL),
        ("two cores, on the clock", clock, FLIGHTS_GOAL),
    ):
        rows.append(Row(f"{WORLDS} flights at once, {how}: ours", found, "steps/s", goal, ratio=found / rate))
    if (theirs := simulator.crazyflow()) is not None:
        what = f"{WORLDS} worlds at once, per processor second: crazyflow"
        rows.append(Row(what, theirs, "steps/s", ratio=theirs / rate))
    return rows


def _planners() -> list[Row]:
    task = planner.problem()
    planner.ours(task, 0, BUDGET_S)
    ours = statistics.median(planner.ours(task, seed, BUDGET_S) for seed in range(1, RUNS + 1))
    rows = [Row("a plan within 1 % of the best known: ours", ours, "s", ratio=1.0)]
    theirs = planner.finite_differences(task, 1, BUDGET_S)
    reached = np.isfinite(theirs)
    what = "the same: SLSQP" if reached else f"the same: SLSQP, not reached within {BUDGET_S:g} s"
    value = theirs if reached else BUDGET_S
    return [*rows, Row(what, value, "s", ratio=value / ours)]


def _estimates() -> list[Row]:
    vehicle, scenario = (
        load_vehicle(find_config("vehicles", "qball2")),
        load_scenario(find_config("scenarios", "clean")),
    )
    flight = simulate(vehicle, paper_plan(), scenario, 1)
    ours = _median(lambda: identify([flight_data(flight)]), 1)
    rows = [Row("a flight of 58 s identified by all methods: ours", ours, "s", ratio=1.0)]
    if importlib.util.find_spec("aeroid"):
        theirs = seconds(lambda: _filter_error(flight))
        rows.append(Row("moments of inertia from 20 s of it at 50 Hz: AeroID", theirs, "s", ratio=theirs / ours))
    return rows


def _filter_error(flight: SimulatedFlight) -> None:
    """AeroID's estimate with torques by the rotors' measured speeds, and noise as it is in the flight."""
    import aeroid

    vehicle = flight.vehicle
    moments = {name: getattr(vehicle.inertia_kg_m2, name) for name in MOMENTS}

    def dynamics(t: float, rates: np.ndarray, torque: np.ndarray, p: Mapping[str, float]) -> np.ndarray:
        inertia = np.array([p[name] for name in MOMENTS])
        return (torque - np.cross(rates, inertia * rates)) / inertia

    times = flight.window_s[0] + np.arange(0.0, 20.0, 0.02)
    series = {name: (stamps, values) for name, (stamps, _, values) in flight.streams.items()}
    rates, speeds = (
        np.stack([np.interp(times, series[name][0], column) for column in series[name][1].T])
        for name in ("imu", "motors")
    )
    torque = (vehicle.allocation() @ (vehicle.rotors.thrust_coefficient_n_s2 * speeds**2))[1:]
    channels = dict(zip(AXES, rates, strict=False)) | dict(zip(TORQUES, torque, strict=True))
    model = aeroid.Model(states=tuple(AXES), controls=tuple(TORQUES), parameters=moments, dynamics=dynamics)
    process, measurement = dict.fromkeys(AXES, 1e-2), dict.fromkeys(AXES, 3e-3)
    data = aeroid.FlightData(times - times[0], channels)
    aeroid.identify(
        model, data, list(MOMENTS), method="filter_error", process_noise=process, measurement_noise=measurement
    )


def measure() -> list[Row]:
    """All tools that are installed."""
    return [*_regressors(), *_simulators(), *_planners(), *_estimates()]
