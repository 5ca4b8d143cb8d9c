"""Flights nobody planned for an identification: what is revealed, are the intervals right, does the model predict
(``benchmarks.unplanned``)?

Each seed draws a vehicle of 30 g to 3 kg, declared wrongly, and two flights of it: a pilot's wandering, waypoints flown
by minimum-jerk legs, or circles and figures of eight. The recordings hold neither plan nor setpoints nor a known
window, 100 Hz each, rotor speeds behind a filter (5 to 30 ms) and late (0 to 20 ms) by what no stamp says. Air resists
turning and moving, each effect with a chance of a half. The air is told from the first flight and from both; the first
flight is identified, and the model file's own choice predicts the second one, which nothing has seen.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from groundstation import api
from groundstation.diagnosis.unplanned import tell_unplanned
from groundstation.errors import GroundStationError
from groundstation.flightdata import FlightData, Stream, resampled
from groundstation.identification.dynamic_fit import fit_dynamics
from groundstation.identification.pipeline import identify
from groundstation.identification.preparation import Prepared, prepare
from groundstation.identification.results import MASS_AND_TENSOR
from groundstation.model.parameters import declared_parameters
from groundstation.trajectory import FlatState
from groundstation.vehicle import Vehicle, vehicle_from_dict, vehicle_to_dict
from sim.flight import simulate
from sim.scenario import Scenario, scenario_from_dict
from studies.flown import flight_data
from studies.study import draw_scenario, draw_vehicle

Array = NDArray[np.float64]
Random = np.random.Generator

DURATION_S = 40.0
RATE_HZ = 100.0
MODELLED = {
    "angular_damping": ("damping_x_nms", "damping_y_nms", "damping_z_nms"),
    "flapping_moment": ("k_nm_s_m",),
    "rotor_drag": ("d_x_kg_s", "d_y_kg_s"),
    "climb_inflow": (),
    "translational_lift": (),
}
"""Effects that are drawn, and the estimates that have a true value in the scenario's own terms."""


@dataclass(frozen=True, slots=True)
class Path4:
    """A path of x, y, z and yaw through a quintic spline, standing in for a plan in the simulator."""

    spline: Any
    duration_s: float

    def series(self) -> Path4:
        """Itself: what the simulator asks a plan for."""
        return self

    def derivatives(self, t_s: object, highest: int) -> Array:
        """Channels and derivatives 0..highest, shape (highest + 1, k, 4)."""
        t = np.clip(np.atleast_1d(np.asarray(t_s, dtype=float)), 0.0, self.duration_s)
        return np.stack([self.spline(t) if n == 0 else self.spline.derivative(n)(t) for n in range(highest + 1)])

    def sample(self, t_s: object) -> FlatState:
        """Flat outputs, at rest before and after."""
        t = np.atleast_1d(np.asarray(t_s, dtype=float))
        d = self.derivatives(t, 4)
        d[1:, (t < 0.0) | (t > self.duration_s)] = 0.0
        return FlatState(d[:, :, :3], d[:3, :, 3])


def spline_path(times: Array, points: Array, smoothing: float = 0.0) -> Path4:
    """Through points (k, 4) with rest at both ends; corners rounded by a moving mean of ``smoothing`` seconds."""
    from scipy.interpolate import make_interp_spline
    from scipy.ndimage import gaussian_filter1d

    fine = np.arange(0.0, times[-1] + 1e-9, 0.05)
    values = resampled(fine, times, points)
    if smoothing > 0.0:
        values = gaussian_filter1d(values, smoothing / 0.05, axis=0, mode="nearest")
    return Path4(make_interp_spline(fine, values, k=5), float(fine[-1]))


def pilot(random: Random, speed: float) -> Path4:
    """Sticks pushed at random: a wandering velocity that turns back at the room's walls."""
    times = np.concatenate([[0.0], np.cumsum(random.uniform(0.6, 2.0, 60))])
    times = np.append(times[times < DURATION_S - 2.0], [DURATION_S - 2.0, DURATION_S])
    points, place = [], np.array([0.0, 0.0, 1.5, 0.0])
    for step in np.diff(times, prepend=0.0):
        wanted = place + random.uniform(-1.0, 1.0, 4) * np.array([speed, speed, 0.4 * speed, 0.8]) * step
        place = np.clip(wanted, [-2.5, -2.5, 0.8, -3.0], [2.5, 2.5, 2.4, 3.0])
        points.append(place)
    points[-1] = points[-2]
    return spline_path(times, np.array(points), 0.25)


def waypoints(random: Random, speed: float) -> Path4:
    """Corners of a room in a random order, a stop at each."""
    times, points = [0.0], [np.array([0.0, 0.0, 1.5, 0.0])]
    while times[-1] < DURATION_S - 3.0:
        goal = np.append(random.choice([-1.5, 0.0, 1.5], 2) + random.normal(0.0, 0.1, 2), random.uniform(0.9, 2.2))
        goal = np.append(goal, random.choice([0.0, 0.7, -0.7]))
        took = max(0.8, float(np.linalg.norm(goal[:3] - points[-1][:3])) / speed)
        times += [times[-1] + took, times[-1] + took + 0.5]
        points += [goal, goal]
    times.append(times[-1] + 1.0)
    points.append(points[-1])
    return spline_path(np.array(times), np.array(points), 0.2)


def figures(random: Random, speed: float) -> Path4:
    """A figure of eight or a circle that grows, at one height or a slanting one."""
    times = np.arange(0.0, DURATION_S + 1e-9, 0.1)
    grow = np.clip(times / 6.0, 0.0, 1.0) * np.clip((DURATION_S - times) / 6.0, 0.0, 1.0)
    radius, eight = random.uniform(0.8, 1.6), int(random.integers(1, 3))
    phase = speed / radius * times
    points = np.zeros((len(times), 4))
    points[:, 0] = grow * radius * np.cos(phase)
    points[:, 1] = grow * radius * np.sin(eight * phase) / eight
    points[:, 2] = 1.5 + random.uniform(0.0, 0.4) * grow * np.sin(0.37 * phase)
    points[:, 3] = random.uniform(0.0, 0.8) * grow * np.sin(0.5 * phase)
    return spline_path(times, points, 0.3)


PLANNERS: dict[str, Callable[[Random, float], Path4]] = {"pilot": pilot, "waypoints": waypoints, "figures": figures}


def world(random: Random, vehicle: Vehicle) -> tuple[Scenario, dict[str, dict[str, Any]]]:
    """A laboratory with air in it, and what of the air there is."""
    scenario, _ = draw_scenario(random, vehicle, RATE_HZ)
    document = scenario.model_dump(exclude_none=True, exclude={"effects"})
    mass, torque = vehicle.mass_kg, vehicle.mass_kg * vehicle.gravity_m_s2 * vehicle.arm_m()
    moments = np.diag(vehicle.inertia_tensor())
    drawn = {
        "angular_damping": {"damping_nms": [float(m * random.uniform(0.5, 4.0)) for m in moments]},
        "flapping_moment": {"k_nm_s_m": float(torque * random.uniform(0.01, 0.03))},
        "rotor_drag": {"drag_kg_s": [float(mass * random.uniform(0.1, 0.6)) for _ in "xy"]},
        "climb_inflow": {"gain": float(random.uniform(0.4, 1.0))},
        "translational_lift": {"gain": float(random.uniform(0.5, 1.0))},
    }
    hidden = {name: values for name, values in drawn.items() if random.random() < 0.5}
    document |= {
        "effects": hidden,
        "setpoint": {"rate_hz": 0.0},
        "state": {"rate_hz": RATE_HZ},
        "mocap": {**document["mocap"], "rate_hz": RATE_HZ},
    }
    return scenario_from_dict(document), hidden


def as_recorded(flight: FlightData, filter_s: float, late_s: float) -> FlightData:
    """Without plan, setpoints and window; rotor speeds filtered and late."""
    from scipy.signal import lfilter

    motors = flight.motors
    keep = float(np.exp(-np.median(np.diff(motors.t_s)) / filter_s))
    first = motors.values[0]
    slow = lfilter([1.0 - keep], [1.0, -keep], motors.values - first, axis=0) + first
    late = Stream(motors.t_s + late_s, slow, motors.columns, motors.received_s)
    return replace(flight, plan=None, setpoint=None, window_s=None, truth=None, motors=late)


def flights_of(
    seed: int, source: Literal["telemetry", "command"] = "telemetry"
) -> tuple[list[FlightData], Vehicle, dict[str, dict[str, Any]], dict[str, Any]]:
    """Two flights of a vehicle, the true vehicle, what acts on it, and what else was drawn.

    Args:
        source: of the recorded rotor speeds; commands are neither filtered nor late.

    Raises:
        FlightAborted: what was drawn cannot be flown.
    """
    random = np.random.default_rng([14, seed])
    document = vehicle_to_dict(draw_vehicle(random))
    document["rotors"]["speed_source"] = source
    vehicle = vehicle_from_dict(document)
    scenario, hidden = world(random, vehicle)
    speed = float(random.uniform(0.8, 2.5))
    names = [str(n) for n in random.choice(list(PLANNERS), 2)]
    filter_s, late_s = float(random.uniform(0.005, 0.03)), float(random.uniform(0.0, 0.02))
    flown = [simulate(vehicle, PLANNERS[n](random, speed), scenario, seed + 7 * i) for i, n in enumerate(names)]  # type: ignore[arg-type]
    late = (filter_s, late_s) if source == "telemetry" else (1e-6, 0.0)
    flights = [as_recorded(flight_data(f, f"unplanned {seed} {i}"), *late) for i, f in enumerate(flown)]
    drawn = {"planners": names, "speed_m_s": speed, "filter_s": filter_s, "late_s": late_s}
    return flights, flown[0].truth, hidden, drawn


def _inside(estimate: Any, true: float) -> bool:
    return bool(estimate.ci95[0] <= true <= estimate.ci95[1])


def _air(
    prepared: Sequence[Prepared], mass_kg: float, hidden: dict[str, dict[str, Any]], true_kg: float
) -> dict[str, Any]:
    """Effects of the air by past motion: found, missed, invented, and which values lie in their intervals."""
    vehicle = prepared[0].record.vehicle
    told = tell_unplanned(prepared, replace(declared_parameters(vehicle, lag_s=0.0), mass_kg=mass_kg))
    standing = {each.effect.identifier: each.finding() for each in told if each.stands}
    # Drag is given at the rotor speeds of the declared vehicle's hover.
    scale = {"rotor_drag": float(np.sqrt(vehicle.mass_kg / true_kg))}
    covered: dict[str, bool] = {}
    for name, parameters in MODELLED.items():
        if name in standing and name in hidden and parameters:
            (true,) = hidden[name].values()
            for key, value in zip(parameters, np.atleast_1d(true), strict=True):
                covered[f"{name}.{key}"] = _inside(standing[name].parameters[key], scale.get(name, 1.0) * float(value))
    return {
        "found": sorted(set(standing) & set(hidden)),
        "missed": sorted(set(hidden) - set(standing)),
        "others": sorted(set(standing) - set(hidden)),
        "effects_covered": covered,
    }


def air(seed: int) -> dict[str, Any]:
    """Fly and tell the air alone, by the mass that the same equations give: a row."""
    flights, truth, hidden, drawn = flights_of(seed)
    prepared = [prepare(flight) for flight in flights]
    mass_kg = fit_dynamics(prepared[:1]).best.parameters.mass_kg
    told = {
        "one": _air(prepared[:1], mass_kg, hidden, truth.mass_kg),
        "two": _air(prepared, mass_kg, hidden, truth.mass_kg),
    }
    return {"seed": seed, "hidden": sorted(hidden), **drawn, "air": told}


FEWER = {"poses": ("imu", "state"), "IMU": ("mocap", "state"), "state": ("imu", "mocap"), "IMU and poses": ("state",)}
"""What of a flight is there beside the rotors, and the streams that are taken away."""


def fewer(seed: int) -> dict[str, Any]:
    """Fly, and identify the first flight as logs with fewer streams would have it: a row."""
    row: dict[str, Any] = {"seed": seed, "away": {}}
    for source in ("telemetry", "command"):
        flights, truth, hidden, drawn = flights_of(seed, source)  # type: ignore[arg-type]
        row |= {"hidden": sorted(hidden), **drawn}
        true = truth.parameters()
        for name, lacking in FEWER.items():
            try:
                found = identify([replace(flights[0], **dict.fromkeys(lacking))])
            except GroundStationError as refusal:
                row["away"][f"{source}, {name}"] = str(refusal)
                continue
            published = found.methods[found.best].parameters
            row["away"][f"{source}, {name}"] = {
                n: (e.value - true[n]) / e.std for n, e in published.items() if n in MASS_AND_TENSOR
            }
    return row


def fewer_summary(rows: Sequence[dict[str, Any]]) -> str:
    """The table of :func:`fewer`."""
    lines = ["| there is | refused | revealed | inside their 95 % interval | farthest, standard deviations |"]
    lines.append("|---|---|---|---|---|")
    for name in rows[0]["away"]:
        told = [row["away"][name] for row in rows if isinstance(row["away"][name], dict)]
        away = [abs(value) for each in told for value in each.values()]
        lines.append(
            f"| {name} | {len(rows) - len(told)} | {len(away)} of {7 * len(rows)} | "
            f"{sum(value < 1.96 for value in away)} | {max(away, default=0.0):.1f} |"
        )
    return "\n".join(lines)


def one(seed: int, diagnosed: bool) -> dict[str, Any]:
    """Fly, identify, predict, tell the air, and diagnose if asked: a row."""
    flights, truth, hidden, drawn = flights_of(seed)
    row: dict[str, Any] = {"seed": seed, "hidden": sorted(hidden), **drawn}
    began = time.process_time()
    mass_kg = flights[0].vehicle.mass_kg
    try:
        found = api.identify(flights[:1])
        model = api.model_document(found, flights[0].vehicle)
        true = truth.parameters()
        published = found.methods[found.best].parameters
        mass_kg = published["mass_kg"].value if "mass_kg" in published else mass_kg
        row["revealed"] = sorted(set(published) & set(MASS_AND_TENSOR))
        row["covered"] = {n: _inside(published[n], true[n]) for n in row["revealed"]}
        row["away"] = {n: (published[n].value - true[n]) / published[n].std for n in row["revealed"]}
        row["error"] = {n: published[n].value / true[n] - 1.0 for n in row["revealed"] if true[n]}
        row["summary"] = found.prediction.get("summary", "")
        ahead = api.predict(model, flights[1], own_state=True)
        row["predicted"] = {k: {q: e["mean_norm"] for q, e in by["0.5"].items()} for k, by in ahead.error.items()}
        row["worse"] = list(ahead.to_dict()["worse_than_constant_velocity"])
    except GroundStationError as refusal:
        row["refused"] = str(refusal)
    try:
        prepared = [prepare(flight) for flight in flights]
        row["air"] = {
            "one": _air(prepared[:1], mass_kg, hidden, truth.mass_kg),
            "two": _air(prepared, mass_kg, hidden, truth.mass_kg),
        }
        if diagnosed:
            diagnosis = api.diagnose(flights[:1])
            row["diagnosis"] = [diagnosis.verdict, *(f.effect for f in diagnosis.findings)]
    except GroundStationError as refusal:
        row["air_refused"] = str(refusal)
    return row | {"cpu_s": round(time.process_time() - began, 1)}


def _revealed(rows: Sequence[dict[str, Any]], ran: Sequence[dict[str, Any]]) -> list[str]:
    """Lines of what identifications show, and how right it is."""
    count = len(MASS_AND_TENSOR) * len(rows)
    revealed = sum(len(r["revealed"]) for r in ran)
    covered = [value for r in ran for value in r["covered"].values()]
    lines = [f"| refused | {len(rows) - len(ran)} |"]
    lines.append(f"| parameters revealed | {revealed} of {count} ({revealed / max(count, 1):.0%}) |")
    lines.append(f"| of these inside their 95 % interval | {sum(covered)} of {len(covered)} |")
    for name in MASS_AND_TENSOR:
        each = [r["covered"][name] for r in ran if name in r["covered"]]
        lines.append(f"| {name}: inside, revealed, flights | {sum(each)}, {len(each)}, {len(rows)} |")
    return lines


def summary(rows: Sequence[dict[str, Any]]) -> str:
    """The table."""
    lines = ["| what | |", "|---|---|", f"| vehicles | {len(rows)}, seeds {rows[0]['seed']} to {rows[-1]['seed']} |"]
    ran = [r for r in rows if "revealed" in r]
    if ran:
        lines += _revealed(rows, ran)
    for flights in ("one", "two"):
        air = [(r["hidden"], r["air"][flights]) for r in rows if "air" in r]
        for name in MODELLED:
            right = sum(name in a["found"] for _, a in air)
            there, invented = sum(name in h for h, _ in air), sum(name in a["others"] for _, a in air)
            lines.append(
                f"| {name}, {flights} flight{'s' if flights == 'two' else ''}: named, there, invented | {right}, "
                f"{there}, {invented} |"
            )
        inside = [value for _, a in air for value in a["effects_covered"].values()]
        lines.append(f"| their values inside the 95 % interval, {flights} | {sum(inside)} of {len(inside)} |")
    judged = [r["predicted"] for r in ran if "predicted" in r]
    for quantity in judged[0]["model"] if judged else ():
        ratio = [p["model"][quantity] / p["constant_velocity"][quantity] for p in judged]
        better = sum(value <= 1.02 for value in ratio)
        lines.append(f"| {quantity} 0.5 s ahead over constant velocity's | median {np.median(ratio):.2f}, "
                     f"largest {max(ratio):.2f}, no worse in {better} of {len(ratio)} |")  # fmt: skip
    return "\n".join(lines)
