"""Identify, export, fly in the other simulator, record as a bundle, identify again. `python -m
benchmarks.exports_round_trip`

The first flight is our simulator's (scenario lab): a QBall 2, and for crazyflow, which knows an X of equal arms, an
x500. Its model is exported and flown in RotorPy, MuJoCo, Bullet and crazyflow, by RotorPy's SE3 controller, with sensor
noise and a coloured disturbance. The second identification starts from the declared vehicle, as the first did. What
flies there is the exported point estimate, so the second interval has to hold it; z is the difference in its standard
deviations. crazyflow runs in an environment of its own (`--only crazyflow`, SCIPY_ARRAY_API=1); firmware that simulates
by itself is `benchmarks.round_trip_firmware`'s.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

import mujoco as bindings
import numpy as np
from numpy.typing import NDArray
from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.vehicles.multirotor import Multirotor

from benchmarks.exports_round_trip_table import CERTAIN, RESULTS
from benchmarks.rotorpy_blind import SETTLE_S, STEP_S, coloured
from benchmarks.round_trip_crazyflow import InCrazyflow
from groundstation import api
from groundstation.flightdata import IMU_COLUMNS, MOCAP_COLUMNS, FlightData, Stream, motor_columns
from groundstation.identification.results import MASS_AND_TENSOR
from groundstation.recording import write_bundle
from groundstation.trajectory import Plan
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
mujoco: Any = bindings
"""Its functions are compiled, and known to no type checker."""
ATTITUDE = {"kp_att": 36.0, "kd_att": 9.0}
POSITION = (np.array([2.0, 2.0, 4.0]), np.array([2.4, 2.4, 3.6]))
"""Gains of the controller, 1/s^2 and 1/s: slow enough for rotors that lag by 50 ms."""
SUBSTEPS = 3
"""Of a step in RotorPy: a vehicle whose rotor speeds are measured has the least lag, 1 ms."""
PLAN_S = 20.0


def _params(text: str) -> dict[str, Any]:
    names: dict[str, Any] = {}
    exec(compile(text, "params", "exec"), names)  # noqa: S102 - a file that this program wrote
    return {"rotor_radius": 0.1, **names["quad_params"]}


class Place(Protocol):
    """Another simulator with the exported vehicle in it."""

    def state(self) -> dict[str, Array]:
        """Of the centre of mass, as the controller wants it."""
        ...

    def step(self, speeds: Array, push: Array, twist: Array) -> tuple[Array, Array, Array, Array]:
        """Sample at the start of a step (pose of the origin, rates, specific force, speeds), then step on."""
        ...


class InRotorPy:
    """RotorPy's equations of motion; its state is the centre of mass's."""

    def __init__(self, params: dict[str, Any], com: Array, start: Array, hover: float):
        self._body = Multirotor(params, aero=True)
        self._com = com
        still = [start, np.zeros(3), [0.0, 0.0, 0.0, 1.0], np.zeros(3), np.zeros(3), np.full(4, hover)]
        self._s = np.concatenate(still)
        self._s[:3] += com

    def state(self) -> dict[str, Array]:
        """Of the centre of mass, as the controller wants it."""
        return Multirotor._unpack_state(self._s)

    def step(self, speeds: Array, push: Array, twist: Array) -> tuple[Array, Array, Array, Array]:
        """Sample at the start of a step (pose of the origin, rates, specific force, speeds), then step on."""

        def slope(s: Array) -> Array:
            out = self._body._s_dot_fn(0.0, s, speeds)
            out[3:6] += push / self._body.mass
            out[10:13] += self._body.inv_inertia @ twist
            return out

        k1 = slope(self._s)
        turn = _matrix(np.roll(self._s[6:10], 1))
        w, dw, arm = self._s[10:13], k1[10:13], -self._com
        force = (
            turn.T @ (k1[3:6] + np.array([0.0, 0.0, self._body.g])) + np.cross(dw, arm) + np.cross(w, np.cross(w, arm))
        )
        pose = np.concatenate([self._s[:3] + turn @ arm, np.roll(self._s[6:10], 1)])
        sample = pose, w.copy(), force, self._s[16:].copy()
        h = STEP_S / SUBSTEPS
        for _ in range(SUBSTEPS):
            k1 = slope(self._s)
            k2 = slope(self._s + 0.5 * h * k1)
            k3 = slope(self._s + 0.5 * h * k2)
            k4 = slope(self._s + h * k3)
            self._s = self._s + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            self._s[6:10] /= np.linalg.norm(self._s[6:10])
        return sample


class InMujoco:
    """MuJoCo's own integration, gyro and accelerometer; controls are thrusts."""

    def __init__(self, text: str, com: Array, start: Array, hover: float, k: float):
        self._model = mujoco.MjModel.from_xml_string(text)
        self._data = mujoco.MjData(self._model)
        self._k, self._com = k, com
        self._data.qpos[:3] = start
        if self._model.na:
            self._data.act[:] = k * hover**2
        self._body = self._model.body("base").id

    def state(self) -> dict[str, Array]:
        """Of the centre of mass, as the controller wants it."""
        turn = _matrix(self._data.qpos[3:7])
        w = self._data.qvel[3:6].copy()
        return {
            "x": self._data.qpos[:3] + turn @ self._com,
            "v": self._data.qvel[:3] + turn @ np.cross(w, self._com),
            "q": np.roll(self._data.qpos[3:7], -1),
            "w": w,
        }

    def step(self, speeds: Array, push: Array, twist: Array) -> tuple[Array, Array, Array, Array]:
        """Sample at the start of a step (pose of the origin, rates, specific force, speeds), then step on."""
        data = self._data
        data.ctrl[:] = self._k * speeds**2
        data.xfrc_applied[self._body, :3] = push
        data.xfrc_applied[self._body, 3:] = _matrix(data.qpos[3:7]) @ twist
        mujoco.mj_forward(self._model, data)
        thrust = data.act if self._model.na else data.ctrl
        gyro, accel = (data.sensor(name).data.copy() for name in ("gyro", "accelerometer"))
        sample = data.qpos[:7].copy(), gyro, accel, np.sqrt(np.maximum(thrust, 0.0) / self._k)
        for _ in range(round(STEP_S / self._model.opt.timestep)):
            mujoco.mj_step(self._model, data)
        return sample


def _matrix(q: Array) -> Array:
    w, v = q[0], q[1:]
    cross = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross


def fly(there: Place, pilot: SE3Control, vehicle: Vehicle, plan: Plan, random: np.random.Generator) -> FlightData:
    """One flight of a plan, with noise, as a recording."""
    series = plan.series()
    count = round((2.0 * SETTLE_S + series.duration_s) / STEP_S)
    t: Array = STEP_S * np.arange(count, dtype=np.float64)
    flat = series.sample(t - SETTLE_S)
    weight = vehicle.mass_kg * vehicle.gravity_m_s2
    push = coloured(random, count, 0.002 * weight, 0.5)
    twist = coloured(random, count, 0.001 * weight * vehicle.arm_m(), 0.5)
    rows = []
    for i in range(count):
        wanted = {name: flat.position[d, i] for d, name in enumerate(("x", "x_dot", "x_ddot", "x_dddot", "x_ddddot"))}
        wanted |= {"yaw": flat.yaw[0, i], "yaw_dot": flat.yaw[1, i]}
        speeds = np.clip(
            pilot.update(t[i], there.state(), wanted)["cmd_motor_speeds"], 0.0, vehicle.rotors.speed_max_rad_s
        )
        rows.append(np.concatenate(there.step(speeds, push[i], twist[i])))
    table = np.array(rows)
    noise = random.standard_normal(table.shape) * np.concatenate(
        [
            np.full(3, 1.5e-4),
            np.full(4, 5e-4),
            np.full(3, 1e-4 / np.sqrt(2 * STEP_S)),
            np.full(3, 1.5e-3 / np.sqrt(2 * STEP_S)),
            np.full(4, 0.5),
        ]
    )
    table = table + noise
    table[:, 3:7] /= np.linalg.norm(table[:, 3:7], axis=1, keepdims=True)
    poses = slice(0, count, 2)
    return FlightData(
        name="there",
        vehicle=vehicle,
        plan=plan,
        window_s=(SETTLE_S, SETTLE_S + series.duration_s),
        imu=Stream(t, table[:, 7:13], IMU_COLUMNS, t),
        motors=Stream(t, table[:, 13:], motor_columns("rotor_speed", 4), t),
        mocap=Stream(t[poses], table[poses, :7], MOCAP_COLUMNS, t[poses]),
    )


def compare(here: Any, there: Any) -> dict[str, dict[str, float]]:
    """Each parameter here and there, and the difference in standard deviations of the second estimate."""
    first, second = (found.methods[found.best].parameters for found in (here, there))
    return {
        name: {
            "exported": first[name].value,
            "again": second[name].value,
            "std": second[name].std,
            "z": (second[name].value - first[name].value) / second[name].std,
        }
        for name in MASS_AND_TENSOR
        if name in first and name in second
    }


@dataclass(frozen=True)
class Here:
    """The first flight: what was identified, and what flies there."""

    found: Any
    model: dict[str, Any]
    vehicle: Vehicle
    plan: Plan
    params: dict[str, Any]
    com: Array
    hover: float
    start: Array

    @property
    def k(self) -> float:
        """Thrust coefficient, N s^2."""
        return float(self.vehicle.rotors.thrust_coefficient_n_s2 or 0.0)


def flown_here(name: str, seed: int) -> Here:
    """Fly and identify a shipped vehicle in our simulator."""
    declared = api.load_vehicle(name)
    if name == "qball2":
        plan = api.load_plan(name).model_copy(update={"periods": 4.0})
    else:
        plan = api.plan_excitation(declared, duration_s=PLAN_S, time_budget_s=4.0)
    flight = api.simulate(declared, scenario="lab", plan=plan, seed=seed)
    found = api.identify(flight, predictive=False)
    model = api.model_document(found, flight.vehicle)
    values = {name: e.value for name, e in found.model.items()}
    hidden = set(found.not_identifiable)
    com = np.array([0.0 if f"com_offset_{a}_m" in hidden else values.get(f"com_offset_{a}_m", 0.0) for a in "xyz"])
    params = _params(api.export(model, "rotorpy"))
    k = float(declared.rotors.thrust_coefficient_n_s2 or 0.0)
    hover = float(np.sqrt(params["mass"] * 9.81 / (4.0 * k)))
    start = plan.series().sample(np.array([0.0])).position[0, 0]
    return Here(found, model, declared, plan, params, com, hover, start)


def _in_bullet(here: Here) -> Place:
    from benchmarks.round_trip_bullet import InPyBullet

    rotors, gravity = here.vehicle.rotors, here.vehicle.gravity_m_s2
    return InPyBullet(api.export(here.model, "pybullet"), here.com, here.start, rotors.spin, gravity)


PLACES: dict[str, tuple[str, Callable[[Here], Place]]] = {
    "rotorpy": ("qball2", lambda here: InRotorPy(here.params, here.com, here.start, here.hover)),
    "mujoco": (
        "qball2",
        lambda here: InMujoco(api.export(here.model, "mjcf"), here.com, here.start, here.hover, here.k),
    ),
    "pybullet": ("qball2", _in_bullet),
    "crazyflow": (
        "x500",
        lambda here: InCrazyflow(
            api.export(here.model, "crazyflow"), here.start, here.hover, here.vehicle.gravity_m_s2
        ),
    ),
}
LACKS = {"crazyflow": "centre of mass"}


def again(name: str, here: Here, random: np.random.Generator) -> dict[str, Any]:
    """Fly there, record a bundle, identify it; the comparison."""
    place = PLACES[name][1](here)
    pilot = SE3Control(here.params | ATTITUDE)
    pilot.kp_pos, pilot.kd_pos = POSITION
    gravity = 9.81 if name == "rotorpy" else here.vehicle.gravity_m_s2
    settings = here.vehicle.identification.model_copy(update={"gravity_m_s2": gravity})
    declared = here.vehicle.model_copy(update={"identification": settings})
    flown = fly(place, pilot, declared, here.plan, random)
    with tempfile.TemporaryDirectory() as folder:
        write_bundle(flown, Path(folder) / "there")
        found = api.identify(api.load_flight(Path(folder) / "there"), predictive=False)
    rows = compare(here.found, found)
    worst = max(abs(row["z"]) for row in rows.values())
    told = {"version": version(name), "parameters": rows, "worst_z": worst, "agrees": worst < CERTAIN}
    return told | ({"lacks": LACKS[name]} if name in LACKS else {})


def main() -> int:
    """Every simulator; prints a table and keeps it as JSON."""
    parser = argparse.ArgumentParser(prog="benchmarks.exports_round_trip", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", action="append", choices=PLACES, help="this simulator (repeatable)")
    options = parser.parse_args()
    document: dict[str, Any] = {"schema": "groundstation.round_trip/1", "readers": {}}
    if RESULTS.is_file():
        document = json.loads(RESULTS.read_text(encoding="utf-8"))
    document["seed"] = options.seed
    flown: dict[str, Here] = {}
    for number, name in enumerate(PLACES):
        if name not in (options.only or PLACES):
            continue
        vehicle = PLACES[name][0]
        if vehicle not in flown:
            flown[vehicle] = flown_here(vehicle, options.seed)
        told = document["readers"][name] = again(name, flown[vehicle], np.random.default_rng([options.seed, number]))
        print(
            f"\n{name} {told['version']}: worst |z| {told['worst_z']:.2f}, {'agrees' if told['agrees'] else 'DIFFERS'}"
        )
        for parameter, row in told["parameters"].items():
            print(
                f"  {parameter:<10} exported {row['exported']:.6g}  again {row['again']:.6g} ± {1.96 * row['std']:.2g} "
                f" z {row['z']:+.2f}"
            )
        RESULTS.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return 0 if all(each["agrees"] for each in document["readers"].values()) else 1


if __name__ == "__main__":
    raise SystemExit(main())
