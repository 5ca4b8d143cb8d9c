"""Are intervals right where an effect's form is not the library's? `python -m benchmarks.other_forms`

MuJoCo (Todorov, Erez, Tassa 2012) moves a Hummingbird by laws that are nobody's in the library: drag with the power 1.5
of the speed, a flapping that saturates, a lift linear in speed, a thrust curve with a cubic term, a floor felt
exponentially, quadratic damping, a weak rotor that keeps its torque, and a load on a rigid rod that hangs below the
centre of mass (a body of its own, on a ball joint). RotorPy's controller flies plans made for the declared vehicle.
`--rotorpy` draws the flights of `benchmarks.rotorpy_blind` instead.

What is counted is how often the 95 % intervals of mass and moments hold the truth after the diagnosis, by what is
hidden, and how wide they are; and how the prediction of the last 15 s, from the flight before them, compares with
constant velocity. Truth, sizes and sensors are drawn from a seed for each flight; it is printed.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.rotorpy_blind import (
    ARM_M,
    DURATION_S,
    HOVER_RAD_S,
    SETTLE_S,
    STEP_S,
    WEIGHT_N,
    coloured,
    declared,
    pilot,
    recorded,
)
from benchmarks.rotorpy_blind import KINDS as ROTORPY
from benchmarks.rotorpy_blind import fly as fly_in_rotorpy
from benchmarks.rotorpy_blind import truth as truth_in_rotorpy
from groundstation import api
from groundstation.diagnosis import diagnose
from groundstation.errors import Refused
from groundstation.flightdata import FlightData
from groundstation.planning import plan_excitation
from groundstation.trajectory import Plan
from groundstation.vehicle import Vehicle
from studies.tally import share

Array = NDArray[np.float64]
Random = np.random.Generator
Hidden = dict[str, Any]

SUBSTEPS = 2
INDUCED_M_S = 4.5
"""Induced speed of the Hummingbird's rotors in hover."""
MASS_KG = WEIGHT_N / 9.81
TORQUE_NM = WEIGHT_N * ARM_M
NAMES = ("mass_kg", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")

KINDS: dict[str, Callable[[Random], Hidden]] = {
    "nothing": lambda r: {},
    "drag": lambda r: {"drag": MASS_KG * r.uniform(0.06, 0.25)},
    "flapping": lambda r: {"flapping": TORQUE_NM * r.uniform(0.005, 0.02)},
    "inflow": lambda r: {"inflow": r.uniform(0.4, 1.0)},
    "lift": lambda r: {"lift": r.uniform(0.01, 0.03)},
    "damping": lambda r: {"damping": TORQUE_NM * r.uniform(0.004, 0.015)},
    "curve": lambda r: {"curve": r.choice([-1.0, 1.0]) * r.uniform(0.1, 0.3)},
    "weak rotor": lambda r: {"rotor": int(r.integers(4)), "loss": r.uniform(0.03, 0.15)},
    "floor": lambda r: {"floor": r.uniform(0.2, 0.6)},
    "spin": lambda r: {"spin": MASS_KG * r.uniform(1e-5, 4e-5)},
    "load let go": lambda r: {"load_kg": MASS_KG * r.uniform(0.02, 0.06), "gone_s": r.uniform(12.0, 28.0)},
    "slung load": lambda r: {
        "slung_kg": MASS_KG * r.uniform(0.03, 0.08),
        "length_m": r.uniform(0.35, 0.6),
        "hook_m": r.uniform(0.0, 0.06),
        "air_1_s": r.uniform(0.05, 0.3),
    },
    "several": lambda r: {
        "drag": MASS_KG * r.uniform(0.06, 0.25),
        "inflow": r.uniform(0.4, 1.0),
        "lift": r.uniform(0.005, 0.015),
        "damping": TORQUE_NM * r.uniform(0.004, 0.015),
    },
}
"""What is hidden, and its draw."""


@dataclass(frozen=True, slots=True)
class Body:
    """The vehicle as it is: mass and principal moments; what hangs on it is hidden."""

    mass_kg: float
    moments: Array

    def model(self, hidden: Hidden) -> str:
        """As MuJoCo reads it; the load hangs on a rod without mass from a ball joint."""
        air = hidden.get("air_1_s", 0.0) * hidden.get("slung_kg", 0.0) * hidden.get("length_m", 0.0) ** 2
        slung = (
            f'<body name="load" pos="0 0 {-hidden["hook_m"]}">'
            f'<joint type="ball" damping="{air:.9g}"/>'
            f'<inertial pos="0 0 {-hidden["length_m"]}" mass="{hidden["slung_kg"]}" diaginertia="1e-5 1e-5 1e-5"/>'
            "</body>"
            if "slung_kg" in hidden
            else ""
        )
        moments = " ".join(f"{m:.9g}" for m in self.moments)
        return (
            f'<mujoco><option timestep="{STEP_S / SUBSTEPS}" integrator="RK4" gravity="0 0 -9.81"/><worldbody>'
            f'<body name="frame"><freejoint/><inertial pos="0 0 0" mass="{self.mass_kg:.9g}" diaginertia="{moments}"/>'
            f"{slung}</body></worldbody></mujoco>"
        )


def wrench(vehicle: Vehicle, hidden: Hidden, speeds: Array, slope: Array, state: tuple[Array, Array]) -> Array:
    """Force and torque in the body, (6,), at rotor speeds and their slopes.

    Args:
        state: height and velocity in the body as (4,), rates (3,).
    """
    rotors = vehicle.rotors
    (height, *velocity), rate = state
    u, speed = np.array(velocity), float(np.linalg.norm(velocity))
    places = np.array(rotors.position_m)
    ratio = speeds / HOVER_RAD_S
    thrust = rotors.thrust_coefficient_n_s2 * speeds**2
    thrust = thrust * (1.0 + hidden.get("curve", 0.0) * (ratio - 1.0))
    torque = rotors.torque_to_thrust_m * thrust
    climb = u[2] + rate[0] * places[:, 1] - rate[1] * places[:, 0]
    thrust = thrust * (1.0 - hidden.get("inflow", 0.0) * np.tanh(climb / (2.0 * INDUCED_M_S)))
    thrust = thrust * (1.0 + hidden.get("lift", 0.0) * float(np.hypot(u[0], u[1])))
    thrust = thrust * (1.0 + hidden.get("floor", 0.0) * np.exp(-height / 0.3))
    if "rotor" in hidden:
        thrust[hidden["rotor"]] *= 1.0 - hidden["loss"]
    spin = np.array(rotors.spin, dtype=float)
    out = np.zeros(6)
    out[:3] = -hidden.get("drag", 0.0) * np.sqrt(speed) * u
    out[2] += thrust.sum()
    out[3:] = np.array([places[:, 1] @ thrust, -places[:, 0] @ thrust, -spin @ torque])
    edge = hidden.get("flapping", 0.0) / (1.0 + 0.5 * speed) / max(float(ratio.mean()), 0.2)
    out[3:] += edge * np.array([u[1], -u[0], 0.0])
    out[3:] -= hidden.get("damping", 0.0) * np.abs(rate) * rate
    inertia = hidden.get("spin", 0.0)
    total = inertia * float(spin @ speeds)
    out[3:] -= np.array([rate[1] * total, -rate[0] * total, inertia * float(spin @ slope)])
    return out


def fly(vehicle: Vehicle, plan: Plan, hidden: Hidden, body: Body, random: Random) -> FlightData:
    """One flight by MuJoCo, as a recording."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(body.model(hidden))
    data = mujoco.MjData(model)
    control, flat_series = pilot(), plan.series()
    count = round((2.0 * SETTLE_S + flat_series.duration_s) / STEP_S)
    t = STEP_S * np.arange(count)
    flat = flat_series.sample(t - SETTLE_S)
    push = coloured(random, count, 0.003 * WEIGHT_N, random.uniform(0.2, 0.8))
    twist = coloured(random, count, 0.002 * TORQUE_NM, random.uniform(0.2, 0.8))
    data.qpos[:3] = flat.position[0, 0]
    data.qpos[3:7] = [np.cos(0.5 * flat.yaw[0, 0]), 0.0, 0.0, np.sin(0.5 * flat.yaw[0, 0])]
    speeds = np.full(4, HOVER_RAD_S)
    states, slopes = np.zeros((count, 20)), np.zeros((count, 20))
    gone = SETTLE_S + hidden.get("gone_s", 0.0)
    for i in range(count):
        carried = hidden.get("load_kg", 0.0) if t[i] < gone else 0.0
        if model.body_mass[1] != body.mass_kg + carried:
            model.body_mass[1] = body.mass_kg + carried
            mujoco.mj_setConst(model, mujoco.MjData(model))  # or it would weigh more and be no harder to move
        x, v, w = data.qpos[:3].copy(), data.qvel[:3].copy(), data.qvel[3:6].copy()
        q = np.roll(data.qpos[3:7], -1)
        wanted = dict(zip(("x", "x_dot", "x_ddot", "x_dddot", "x_ddddot"), flat.position[:, i], strict=False))
        wanted |= {"yaw": flat.yaw[0, i], "yaw_dot": flat.yaw[1, i]}
        command = control.update(t[i], {"x": x, "v": v, "q": q, "w": w}, wanted)["cmd_motor_speeds"]
        command = np.clip(command, 0.0, vehicle.rotors.speed_max_rad_s)
        for number in range(SUBSTEPS):
            slope = (command - speeds) / 0.02
            turn = np.empty(9)
            mujoco.mju_quat2Mat(turn, data.qpos[3:7])
            turn = turn.reshape(3, 3)
            rate = data.qvel[3:6].copy()
            local = np.array([data.qpos[2], *(turn.T @ data.qvel[:3])])
            force = wrench(vehicle, hidden, speeds, slope, (local, rate))
            data.qfrc_applied[:3] = turn @ force[:3] + push[i]
            data.qfrc_applied[3:6] = force[3:] + twist[i]
            if number == 0:
                mujoco.mj_forward(model, data)
                states[i] = [*x, *v, *q, *w, 0.0, 0.0, 0.0, *speeds]
                slopes[i, 3:6], slopes[i, 10:13] = data.qacc[:3], data.qacc[3:6]
            mujoco.mj_step(model, data)
            speeds = speeds + (STEP_S / SUBSTEPS) * slope
    return recorded(vehicle, plan, t, (states, slopes, states[:, 16:]), np.zeros(3), random)


def drawn(seed: int, kind: str, plans: Sequence[Plan], rotorpy: bool) -> tuple[FlightData, dict[str, float]]:
    """A flight and its true mass and moments."""
    random = np.random.default_rng([30, seed])
    plan = plans[int(random.integers(len(plans)))]
    if rotorpy:
        names, draw = ROTORPY[kind]
        vehicle = declared("motor_lag" in names)
        hidden = draw(random)
        found = truth_in_rotorpy(np.random.default_rng([31, seed]), hidden)
        flight = fly_in_rotorpy(vehicle, plan, hidden, random, found)
        return flight, {"mass_kg": found["mass"], **{f"i{a}{a}_kg_m2": found[f"I{a}{a}"] for a in "xyz"}}
    vehicle = declared(False)
    moments = np.diag(vehicle.inertia_tensor()) * random.uniform([0.95, 0.95, 0.8], [1.15, 1.15, 0.95])
    body = Body(vehicle.mass_kg * random.uniform(0.95, 1.05), moments)
    flight = fly(vehicle, plan, KINDS[kind](random), body, random)
    return flight, dict(zip(NAMES, (body.mass_kg, *moments), strict=True))


UNSEEN_S, APART_S = 15.0, 2.0
"""Of the end of a flight that is predicted, and of what is left out before it."""


def ahead(flight: FlightData) -> dict[str, Any]:
    """Errors of the prediction 0.1 and 0.5 s ahead over those of constant velocity, on a part that no fit has seen."""
    last = (flight.window_s or (0.0, 0.0))[1]
    begins = last - UNSEEN_S
    try:
        found = api.identify(flight, exclude=[(begins - APART_S, np.inf)])
        model = api.model_document(found, flight.vehicle)
        predicted = api.predict(model, replace(flight, plan=None, window_s=(begins, last)))
    except Refused as refusal:
        return {"refused": str(refusal)}
    still = predicted.error["constant_velocity"]
    return {
        "windows": predicted.windows,
        "summary": found.prediction.get("summary", ""),
        "over_constant_velocity": {
            h: {q: round(e["mean_norm"] / still[h][q]["mean_norm"], 3) for q, e in predicted.error["model"][h].items()}
            for h in ("0.1", "0.5")
        },
        "worse": list(predicted.to_dict()["worse_than_constant_velocity"]),
    }


def judged(flight: FlightData, true: dict[str, float], *, predicted: bool) -> dict[str, Any]:
    """What the diagnosis says, and how far off in its own deviations; and what is predicted."""
    began = time.process_time()
    found = diagnose([flight])
    after = {name: found.parameters_after[name] for name in NAMES if name in found.parameters_after}
    return {
        "verdict": found.verdict,
        "named": {f.effect: {n: [e.value, e.std] for n, e in f.parameters.items()} for f in found.findings},
        "left": [f"{u.channel} by {', '.join(u.depends_on)}" for u in found.unexplained],
        "inside": {n: bool(e.ci95[0] <= true[n] <= e.ci95[1]) for n, e in after.items()},
        "away": {n: (e.value - true[n]) / e.std for n, e in after.items()},
        "std": {n: e.std / true[n] for n, e in after.items()},
        "ahead": ahead(flight) if predicted else {},
        "cpu_s": round(time.process_time() - began, 1),
    }


def summary(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown: by what is hidden, intervals that hold the truth and how wide they are."""
    lines = [
        "| hidden | flights | mass inside | moments inside | std of mass, median | of moments | first names |",
        "|---|---|---|---|---|---|---|",
    ]
    for kind in dict.fromkeys(row["kind"] for row in rows):
        own = [row for row in rows if row["kind"] == kind]
        mass = [row["inside"]["mass_kg"] for row in own if "mass_kg" in row["inside"]]
        moments = [v for row in own for n, v in row["inside"].items() if n != "mass_kg"]
        widths = [[v for r in own for n, v in r["std"].items() if (n == "mass_kg") == m] for m in (True, False)]
        first = [next(iter(row["named"]), row["verdict"]) for row in own]
        lines.append(
            f"| {kind} | {len(own)} | {sum(mass)} of {len(mass)} | {sum(moments)} of {len(moments)} | "
            f"{np.median(widths[0]):.3%} | {np.median(widths[1]):.2%} | {', '.join(first)} |"
        )
    lines += ["", *_predicted(rows)]
    every = [v for row in rows for v in row["inside"].values()]
    mass = [row["inside"]["mass_kg"] for row in rows if "mass_kg" in row["inside"]]
    return "\n".join([*lines, "", f"all {share(sum(every), len(every))}; mass {share(sum(mass), len(mass))}"])


def _predicted(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Lines on the prediction of what no fit has seen."""
    told = [row["ahead"] for row in rows if "worse" in row["ahead"]]
    if not any(row["ahead"] for row in rows):
        return []
    lines = [f"predicted {len(told)} of {len(rows)} flights; worse than constant velocity in any: "
             f"{sum(bool(each['worse']) for each in told)}"]  # fmt: skip
    for horizon in ("0.1", "0.5"):
        for quantity in told[0]["over_constant_velocity"][horizon] if told else ():
            ratio = [each["over_constant_velocity"][horizon][quantity] for each in told]
            lines.append(f"{quantity} at {horizon} s over constant velocity's: median {np.median(ratio):.2f}, largest "
                         f"{max(ratio):.2f}")  # fmt: skip
    return lines


def main(argv: Sequence[str] | None = None) -> int:
    """Fly, diagnose, count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--flights", type=int, default=2, help="of each kind")
    parser.add_argument("--first", type=int, default=5000, help="seed of the first; the others follow")
    parser.add_argument("--only", nargs="*", help="these kinds alone")
    parser.add_argument("--rotorpy", action="store_true", help="RotorPy's physics instead of MuJoCo")
    parser.add_argument("--intervals", action="store_true", help="predict nothing: half of the time")
    parser.add_argument("--out", type=Path, help="keep the rows as JSON")
    options = parser.parse_args(argv)
    plans = [
        plan_excitation(
            declared(False), criterion="A", duration_s=DURATION_S, seed=options.first + i, time_budget_s=5.0
        )
        for i in range(2)
    ]
    kinds = options.only or list(ROTORPY if options.rotorpy else KINDS)
    rows: list[dict[str, Any]] = []
    for seed, kind in enumerate((k for k in kinds for _ in range(options.flights)), options.first):
        flight, true = drawn(seed, kind, plans, options.rotorpy)
        rows.append({"seed": seed, "kind": kind, **judged(flight, true, predicted=not options.intervals)})
        print(json.dumps(rows[-1]), flush=True)
    print(summary(rows))
    if options.out:
        physics = "rotorpy" if options.rotorpy else "mujoco"
        document = {"schema": "groundstation.benchmark.other_forms/1", "physics": physics, "rows": rows}
        options.out.write_text(json.dumps(document, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
