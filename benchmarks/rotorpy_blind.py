"""The blind bench on physics nobody here wrote: RotorPy's vehicle and aerodynamics. `python -m
benchmarks.rotorpy_blind`

RotorPy's Hummingbird (Folk, Paulos, Kumar 2023) flies planned trajectories by RotorPy's own SE3 controller; its
equations of motion give rates and specific forces, to which noise, biases, stamp jitter and a coloured disturbance are
added. Its aerodynamics (drag of hubs and frame, inflow, translational lift, flapping, motor lag, wind) are off but for
what is hidden. Two of them are more than one effect of the vocabulary: hubs feel the velocity they get from the body's
rates, so that inflow also damps roll and pitch, and hub drag yaw. Its flapping coefficient is given the sign with which
the nose rises. What is hidden is drawn with its size, true mass and inertia from a master seed that is new each run and
printed.
"""

from __future__ import annotations

import argparse
import secrets
import time
from collections import Counter
from collections.abc import Callable, Sequence
from copy import deepcopy
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.vehicles.hummingbird_params import quad_params
from rotorpy.vehicles.multirotor import Multirotor

from groundstation.diagnosis import diagnose
from groundstation.flightdata import IMU_COLUMNS, MOCAP_COLUMNS, FlightData, Stream, motor_columns
from groundstation.planning import plan_excitation
from groundstation.trajectory import Plan
from groundstation.vehicle import Vehicle, vehicle_from_dict
from studies.tally import share

Array = NDArray[np.float64]
Random = np.random.Generator

STEP_S = 0.004
"""Of integration, control and inertial sensor; every other one has a pose."""
SETTLE_S = 3.0
DURATION_S = 40.0
ATTITUDE = {"kp_att": 200.0, "kd_att": 25.0}
POSITION = (np.array([3.0, 3.0, 8.0]), np.array([3.0, 3.0, 5.0]))
"""Gains of the controller, 1/s^2 and 1/s: with RotorPy's own it chatters at this step with rotors that lag."""
COEFFICIENTS = ("c_Dx", "c_Dy", "c_Dz", "k_d", "k_z", "k_h", "k_flap")
HOVER_RAD_S = float(np.sqrt(quad_params["mass"] * 9.81 / (4.0 * quad_params["k_eta"])))
WEIGHT_N = quad_params["mass"] * 9.81
ARM_M = 0.17

Hidden = dict[str, Any]
"""Coefficients of RotorPy that are on, and of ours: wind_m_s, com_m, load_kg with load_s."""

KINDS: dict[str, tuple[tuple[str, ...], Callable[[Random], Hidden]]] = {
    "nothing": ((), lambda r: {}),
    "rotor_drag": (("rotor_drag",), lambda r: {"k_d": quad_params["k_d"] * r.uniform(0.3, 1.0)}),
    "inflow": (("climb_inflow",), lambda r: {"k_z": quad_params["k_z"] * r.uniform(0.3, 1.0)}),
    "frame drag": (("body_drag",), lambda r: dict.fromkeys(("c_Dx", "c_Dy", "c_Dz"), r.uniform(0.03, 0.08))),
    "translational lift": (("translational_lift",), lambda r: {"k_h": quad_params["k_h"] * r.uniform(1.0, 4.0)}),
    "flapping": (
        ("flapping_moment",),
        lambda r: {"k_flap": -WEIGHT_N * ARM_M * r.uniform(0.005, 0.02) / (4.0 * HOVER_RAD_S)},
    ),
    "motor lag": (("motor_lag",), lambda r: {"tau_m": r.uniform(0.02, 0.03)}),
    "wind": (
        ("rotor_drag", "wind"),
        lambda r: {"k_d": quad_params["k_d"] * r.uniform(0.3, 1.0), "wind_m_s": [*r.uniform(0.4, 1.2, 2), 0.0]},
    ),
    "centre of mass": (
        ("com_offset",),
        lambda r: {"com_m": [*(r.choice([-1, 1], 2) * r.uniform(0.002, 0.006, 2)), 0.0]},
    ),
    "load let go": (
        ("payload_change",),
        lambda r: {"load_kg": 0.5 * r.uniform(0.02, 0.06), "load_s": r.uniform(12, 28)},
    ),
    "as shipped": (
        ("rotor_drag", "climb_inflow"),
        lambda r: {name: quad_params[name] for name in COEFFICIENTS},
    ),
}
"""What is hidden: the names it must be found by (the first of them as the first finding where it is one), and its draw.
"""


def declared(commanded: bool) -> Vehicle:
    """RotorPy's Hummingbird as a vehicle file would have it, at its nominal mass and inertia."""
    position = [list(map(float, p)) for p in quad_params["rotor_pos"].values()]
    return vehicle_from_dict(
        {
            "vehicle": {
                "name": "hummingbird",
                "mass_kg": quad_params["mass"],
                "inertia_kg_m2": {axis: quad_params[f"I{axis}"] for axis in ("xx", "yy", "zz")},
            },
            "rotors": {
                "position_m": position,
                "spin": [-int(d) for d in quad_params["rotor_directions"]],
                "radius_m": quad_params["rotor_radius"],
                "thrust_coefficient_n_s2": quad_params["k_eta"],
                "torque_to_thrust_m": quad_params["k_m"] / quad_params["k_eta"],
                "speed_max_rad_s": quad_params["rotor_speed_max"],
                "speed_source": "command" if commanded else "telemetry",
                **({"lag": {"up_s": quad_params["tau_m"], "down_s": quad_params["tau_m"]}} if commanded else {}),
            },
            "limits": {
                "x_max_m": 2.0,
                "y_max_m": 2.0,
                "z_min_m": 0.6,
                "z_max_m": 2.6,
                "yaw_max_rad": 3.1,
                "speed_max_m_s": 2.0,
                "yaw_rate_max_rad_s": 1.0,
                "tilt_max_rad": 0.25,
            },
            "identification": {"gravity_m_s2": 9.81, "air_density_kg_m3": 1.225},
        }
    )


def truth(random: Random, hidden: Hidden) -> dict[str, Any]:
    """RotorPy's parameters of the true vehicle: mass within 5 %, moments of inertia within 15 %, positions from its
    centre of mass.
    """
    found = deepcopy(quad_params)
    found["mass"] *= random.uniform(0.95, 1.05)
    for axis in ("xx", "yy", "zz"):
        found[f"I{axis}"] *= random.uniform(0.9, 1.15)
    found["Izz"] = min(found["Izz"], 0.98 * (found["Ixx"] + found["Iyy"]))  # of a body that exists
    found |= {name: hidden.get(name, 0.0) for name in COEFFICIENTS} | {"tau_m": hidden.get("tau_m", found["tau_m"])}
    com = np.array(hidden.get("com_m", (0.0, 0.0, 0.0)))
    found["rotor_pos"] = {key: np.array(p) - com for key, p in found["rotor_pos"].items()}
    return found


def coloured(random: Random, count: int, rms: float, correlation_s: float) -> Array:
    """Ornstein-Uhlenbeck disturbance on three axes, shape (count, 3)."""
    keep = np.exp(-STEP_S / correlation_s)
    noise = random.standard_normal((count, 3)) * rms * np.sqrt(1.0 - keep**2)
    out = np.empty((count, 3))
    x = random.standard_normal(3) * rms
    for i in range(count):
        x = keep * x + noise[i]
        out[i] = x
    return out


def pilot() -> Any:
    """RotorPy's controller with the softer gains."""
    control = SE3Control(quad_params | ATTITUDE)
    control.kp_pos, control.kd_pos = POSITION
    return control


def fly(vehicle: Vehicle, plan: Plan, hidden: Hidden, random: Random, real: dict[str, Any] | None = None) -> FlightData:
    """One flight by RotorPy's equations and controller (fourth-order Runge-Kutta), as a recording.

    Args:
        real: the true vehicle's parameters; drawn where None.
    """
    real = truth(random, hidden) if real is None else real
    body = Multirotor(real, aero=True)
    control = pilot()
    series = plan.series()
    count = round((2.0 * SETTLE_S + series.duration_s) / STEP_S)
    t = STEP_S * np.arange(count)
    flat = series.sample(t - SETTLE_S)
    push = coloured(random, count, 0.003 * WEIGHT_N, random.uniform(0.2, 0.8)) / body.mass
    twist = coloured(random, count, 0.002 * WEIGHT_N * ARM_M, random.uniform(0.2, 0.8)) @ body.inv_inertia.T
    com = np.array(hidden.get("com_m", (0.0, 0.0, 0.0)))
    wind = np.array(hidden.get("wind_m_s", (0.0, 0.0, 0.0)))
    load, gone = hidden.get("load_kg", 0.0), SETTLE_S + hidden.get("load_s", 0.0)
    state = np.concatenate(
        [flat.position[0, 0], np.zeros(3), _yawed(flat.yaw[0, 0]), np.zeros(3), wind, np.full(4, HOVER_RAD_S)]
    )
    states, slopes, commands = np.empty((count, 20)), np.empty((count, 20)), np.empty((count, 4))

    def slope(s: Array, command: Array, i: int) -> Array:
        out = body._s_dot_fn(0.0, s, command)
        out[3:6] += push[i]
        out[10:13] += twist[i]
        return out

    empty = body.mass
    for i in range(count):
        body.mass = empty + (load if t[i] < gone else 0.0)
        body.weight = np.array([0.0, 0.0, -body.mass * body.g])
        wanted = {
            "x": flat.position[0, i],
            "x_dot": flat.position[1, i],
            "x_ddot": flat.position[2, i],
            "x_dddot": flat.position[3, i],
            "x_ddddot": flat.position[4, i],
            "yaw": flat.yaw[0, i],
            "yaw_dot": flat.yaw[1, i],
        }
        command = control.update(t[i], Multirotor._unpack_state(state), wanted)["cmd_motor_speeds"]
        command = np.clip(command, body.rotor_speed_min, body.rotor_speed_max)
        k1 = slope(state, command, i)
        states[i], slopes[i], commands[i] = state, k1, command
        k2 = slope(state + 0.5 * STEP_S * k1, command, i)
        k3 = slope(state + 0.5 * STEP_S * k2, command, i)
        k4 = slope(state + STEP_S * k3, command, i)
        state = state + STEP_S / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        state[6:10] /= np.linalg.norm(state[6:10])
    return recorded(vehicle, plan, t, (states, slopes, commands), com, random)


def _yawed(yaw: float) -> list[float]:
    return [0.0, 0.0, float(np.sin(0.5 * yaw)), float(np.cos(0.5 * yaw))]


def recorded(
    vehicle: Vehicle, plan: Plan, t: Array, flown: tuple[Array, Array, Array], com: Array, random: Random
) -> FlightData:
    """What sensors at the geometric centre, beside the centre of mass, would have recorded.

    Args:
        flown: states and their slopes as RotorPy packs them, (count, 20), and commanded speeds, (count, 4).
    """
    from scipy.spatial.transform import Rotation

    states, slopes, commands = flown
    turn = Rotation.from_quat(states[:, 6:10])
    rate, turning = states[:, 10:13], slopes[:, 10:13]
    force = turn.inv().apply(slopes[:, 3:6] + [0.0, 0.0, 9.81])
    force = force + np.cross(turning, -com) + np.cross(rate, np.cross(rate, -com))
    count = len(t)
    gyro = rate + random.normal(0.0, 2e-3, 3) + 1e-4 * np.sqrt(0.5 / STEP_S) * random.standard_normal((count, 3))
    accel = force + random.normal(0.0, 0.02, 3) + 1.5e-3 * np.sqrt(0.5 / STEP_S) * random.standard_normal((count, 3))
    stamps = t + random.normal(0.0, 2e-5, count)
    poses = slice(0, count, 2)
    shaken = turn[poses] * Rotation.from_rotvec(random.normal(0.0, 1e-3, (len(t[poses]), 3)))
    place = states[poses, :3] + turn[poses].apply(-com) + random.normal(0.0, 1.5e-4, (len(t[poses]), 3))
    commanded = vehicle.rotors.speed_source == "command"
    speeds = commands if commanded else states[:, 16:] + random.normal(0.0, 0.002 * HOVER_RAD_S, (count, 4))

    def stream(at: Array, values: Array, columns: tuple[str, ...]) -> Stream:
        return Stream(np.maximum.accumulate(at), values, columns, at + 0.004)

    return FlightData(
        name="unknown",
        vehicle=vehicle,
        plan=plan,
        window_s=(SETTLE_S, SETTLE_S + plan.series().duration_s),
        imu=stream(stamps, np.hstack([gyro, accel]), IMU_COLUMNS),
        motors=stream(t, speeds, motor_columns("rotor_speed", 4)),
        mocap=stream(
            t[poses] + random.normal(0.0, 2e-4, len(t[poses])),
            np.hstack([place, np.roll(shaken.as_quat(), 1, axis=1)]),
            MOCAP_COLUMNS,
        ),
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.rotorpy_blind", description="Blind diagnosis on RotorPy's physics."
    )
    parser.add_argument("--flights", type=int, default=2, help="of each kind")
    parser.add_argument("--clean", type=int, default=6, help="flights with nothing hidden")
    parser.add_argument("--seed", type=int, default=None, help="master seed (default: a fresh one, printed)")
    parser.add_argument("--only", choices=tuple(KINDS), help="one kind only")
    options = parser.parse_args(argv)
    master = secrets.randbits(32) if options.seed is None else options.seed
    print(
        "master seed", master, f"hummingbird, {options.flights} flights of each kind, {options.clean} clean", flush=True
    )
    random = np.random.default_rng(master)
    plans = [
        plan_excitation(declared(False), criterion="A", duration_s=DURATION_S, seed=int(s), time_budget_s=5.0)
        for s in random.integers(2**31, size=2)
    ]
    kinds = [k for k in KINDS if options.only in (None, k)]
    work = [k for k in kinds for _ in range(options.clean if k == "nothing" else options.flights)]
    right: dict[str, Counter[str]] = {k: Counter() for k in kinds}
    seconds = []
    for kind, own in zip(work, random.spawn(len(work)), strict=True):
        names, draw = KINDS[kind]
        vehicle = declared("motor_lag" in names)
        flight = fly(vehicle, plans[int(own.integers(len(plans)))], draw(own), own)
        began = time.perf_counter()
        found = diagnose([flight])
        seconds.append(time.perf_counter() - began)
        named = [f.effect for f in found.findings]
        others = {a for f in found.findings for a in f.alternatives}
        all_there = set(names) <= set(named) if names else found.verdict == "clean"
        outcome = "right" if all_there and (not names or named[0] in names) else "wrong"
        if outcome == "wrong" and set(names) & {*named, *others}:
            outcome = "in part"
        right[kind][outcome] += 1
        right[kind][f"verdict {found.verdict}"] += 1
        print(f"{kind:20} -> {found.verdict}: {_told(found)}", flush=True)
    print(f"\n{'hidden':20} {'must be named':26} right  in part  wrong   verdicts")
    for kind in kinds:
        counts = right[kind]
        verdicts = ", ".join(f"{k.removeprefix('verdict ')} {n}" for k, n in counts.items() if k.startswith("verdict"))
        told = f"{counts['right']:5}  {counts['in part']:7}  {counts['wrong']:5}"
        print(f"{kind:20} {' + '.join(KINDS[kind][0]) or 'clean':26} {told}   {verdicts}")
    hidden = [k for k in kinds if k != "nothing"]
    total = sum(right[k][o] for k in hidden for o in ("right", "in part", "wrong"))
    print(f"\nall named, first name right   {share(sum(right[k]['right'] for k in hidden), total)}")
    if "nothing" in right:
        clean = right["nothing"]
        print(f"false alarms                  {share(clean['wrong'], clean['right'] + clean['wrong'])}")
    print(f"diagnosis of {DURATION_S:.0f} s: median {np.median(seconds):.0f} s")
    return 0


def _told(found: Any) -> str:
    named = [f.effect + (f" (or {', '.join(f.alternatives)})" if f.alternatives else "") for f in found.findings]
    left = [f"{u.channel} by {', '.join(u.depends_on)}" for u in found.unexplained]
    return ", ".join(named or ["no finding"]) + (f"; left: {'; '.join(left)}" if left else "")


if __name__ == "__main__":
    raise SystemExit(main())
