"""Drawn vehicles, plans and laboratories, one simulated flight of each, and how good its estimates are
(``benchmarks.study``).

Every flight draws its own vehicle (30 g to 3 kg, declared wrongly), plan (gentle: tilt up to 5.73 degrees; fast: three
times that), rotor lag (20 to 100 ms, declared as none), motion capture (30, 120 or 240 Hz), clock offset (up to 50 ms)
and coloured force and torque disturbance (0.1 to 0.5 % of weight and of weight times arm). The estimator is told none
of it.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from groundstation.errors import GroundStationError
from groundstation.flightdata import FlightData
from groundstation.identification.pipeline import identify
from groundstation.identification.results import MASS_AND_TENSOR, Estimate, Identification
from groundstation.paths import find_config
from groundstation.trajectory import Coefficients, Plan, load_plan, rigid_motion
from groundstation.vehicle import Vehicle, vehicle_from_dict
from sim.flight import simulate
from sim.scenario import Scenario, scenario_from_dict
from studies.flown import flight_data

GENTLE_TILT_RAD = np.radians(5.73)
FAST = 3.0
METHODS = ("LS", "GD", "FMLS", "FMGD", "OE", "FE", "IV", "best")
DIAGONAL = ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")
PRODUCTS = ("ixy_kg_m2", "ixz_kg_m2", "iyz_kg_m2")
HALF_95 = 1.959964
IMU_NOISE = {
    "gyro_density": 1e-4,
    "accel_density": 1.5e-3,
    "gyro_bias_std": 2e-3,
    "accel_bias_std": 2e-2,
    "gyro_walk": 2e-5,
    "accel_walk": 2e-4,
}
"""Of a usual MEMS unit, as a scenario's section takes it."""


@dataclass(frozen=True, slots=True)
class Flown:
    """One flight of the study: what was drawn, what is true, what was found (None: refused, for ``reason``)."""

    seed: int
    drawn: Mapping[str, str]
    truth: Mapping[str, float]
    offset_s: float
    found: Identification | None
    reason: str
    seconds: float


def draw_vehicle(random: np.random.Generator) -> Vehicle:
    """An X quadrotor between 30 g and 3 kg: arm as the cube root of mass, radii of gyration a share of the arm."""
    mass = float(np.exp(random.uniform(np.log(0.03), np.log(3.0))))
    arm = 0.2 * (mass / 1.5) ** (1.0 / 3.0) * random.uniform(0.85, 1.15)
    xx, yy = mass * (arm * random.uniform(0.42, 0.6, 2)) ** 2
    zz = (xx + yy) * random.uniform(0.7, 0.95)
    speed_max = 900.0 * (0.2 / arm)
    d = float(arm / np.sqrt(2.0))
    return vehicle_from_dict(
        {
            "vehicle": {
                "name": "drawn",
                "mass_kg": mass,
                "inertia_kg_m2": {"xx": float(xx), "yy": float(yy), "zz": float(zz)},
            },
            "rotors": {
                "position_m": [[d, -d, 0.0], [-d, d, 0.0], [d, d, 0.0], [-d, -d, 0.0]],
                "spin": [1, 1, -1, -1],
                "radius_m": float(0.6 * arm),
                "thrust_coefficient_n_s2": float(mass * 9.80665 * 2.2 / 4.0 / speed_max**2),
                "torque_to_thrust_m": float(0.08 * arm),
                "speed_max_rad_s": float(speed_max),
                "input": "rotor_speed",
                "speed_source": str(random.choice(["command", "telemetry"])),
            },
        }
    )


def draw_plan(random: np.random.Generator, fast: bool) -> Plan:
    """Table 2's trajectory with random signs of its channels, scaled to the tilt; fast is twice the pace as well."""
    plan = load_plan(find_config("plans", "paper_table2"))
    pace = 2.0 if fast else 1.0
    tilt = GENTLE_TILT_RAD * (FAST if fast else 1.0)
    t = np.linspace(0.0, 10.0, 2000)
    largest = float(np.abs(rigid_motion(plan.series().sample(t)).euler_rad[:, :2]).max())
    scale = tilt / largest / pace
    signs = dict(zip(("x", "y", "z", "yaw"), random.choice([-1.0, 1.0], 4), strict=True))
    channels = {}
    for name, sign in signs.items():
        channel = getattr(plan.coefficients, name)
        size = float(sign * scale)
        channels[name] = channel.model_copy(
            update={"a": tuple(size * v for v in channel.a), "b": tuple(size * v for v in channel.b)}
        )
    return plan.model_copy(
        update={
            "coefficients": Coefficients(**channels),
            "base_frequency_rad_s": plan.base_frequency_rad_s * pace,
            "periods": plan.periods * pace,
        }
    )


def draw_scenario(random: np.random.Generator, vehicle: Vehicle, rate_hz: float = 500.0) -> tuple[Scenario, float]:
    """A laboratory with everything drawn, and the clock offset in it (motion capture minus IMU); IMU and motors at a
    rate.
    """
    offset = float(random.uniform(-0.05, 0.05))
    up = float(random.uniform(0.02, 0.1))
    factor = np.exp(random.uniform(-0.2, 0.2, 3))
    # the triangle inequality must hold for the true tensor as well, with its products
    moments = np.diag(vehicle.inertia_tensor()) * factor
    factor[2] *= min(1.0, 0.9 * (moments[0] + moments[1]) / moments[2])
    return scenario_from_dict(
        {
            "name": "study",
            "imu": {
                "rate_hz": rate_hz,
                **IMU_NOISE,
                "clock": {"jitter_s": 2e-5, "latency_s": 0.002, "latency_jitter_s": 5e-4},
            },
            "mocap": {
                "rate_hz": float(random.choice([30.0, 120.0, 240.0])),
                "position_std_m": 1.5e-4,
                "attitude_std_rad": 1e-3,
                "dropouts_per_minute": 1.0,
                "dropout_s": 0.1,
                "clock": {"offset_s": offset, "jitter_s": 2e-4, "latency_s": 0.006, "latency_jitter_s": 1e-3},
            },
            "motors": {
                "rate_hz": rate_hz,
                "noise_share": 0.002,
                "clock": {"latency_s": 0.002, "latency_jitter_s": 5e-4},
            },
            "battery": {"rate_hz": 10.0, "voltage_std_v": 0.01, "current_std_a": 0.1},
            "disturbance": {
                "force_share": float(random.uniform(0.001, 0.005)),
                "torque_share": float(random.uniform(0.001, 0.005)),
                "correlation_s": float(np.exp(random.uniform(np.log(0.1), np.log(1.0)))),
            },
            "truth": {
                "mass_factor": float(np.exp(random.uniform(-0.15, 0.1))),
                "inertia_factor": [float(v) for v in factor],
                "product_share": [float(v) for v in random.uniform(-0.02, 0.02, 3)],
                "lag": {"up_s": up, "down_s": min(0.1, up * float(random.uniform(1.0, 1.5)))},
            },
        }
    ), offset


def draw(seed: int, share: float = 1.0, rate_hz: float = 500.0) -> tuple[FlightData, dict[str, str], float]:
    """One flight, what was drawn for it in words, and its clock offset.

    Args:
        share: of the plan's periods that are flown (40 s at 1).
        rate_hz: of IMU and motors.
    """
    random = np.random.default_rng([4, seed])
    vehicle = draw_vehicle(random)
    fast = bool(random.random() < 0.5)
    plan = draw_plan(random, fast)
    plan = plan.model_copy(update={"periods": share * plan.periods})
    scenario, offset = draw_scenario(random, vehicle, rate_hz)
    flight = flight_data(simulate(vehicle, plan, scenario, seed), f"study {seed}")
    drawn = {
        "mass": f"{vehicle.mass_kg * scenario.truth.mass_factor:.3f} kg",
        "plan": "fast" if fast else "gentle",
        "rotors": vehicle.rotors.speed_source,
        "lag": f"{1e3 * scenario.truth.lag.up_s:.0f} ms" if scenario.truth.lag else "none",
        "mocap": f"{scenario.mocap.rate_hz:.0f} Hz",
        "torque": f"{100.0 * scenario.disturbance.torque_share:.2f} %",
    }
    return flight, drawn, offset


def study_flight(seed: int) -> Flown:
    """Draw, fly and identify one flight.

    Raises:
        FlightAborted: what was drawn cannot be flown.
    """
    flight, drawn, offset = draw(seed)
    assert flight.truth is not None
    began = time.perf_counter()
    found, reason = None, ""
    try:
        found = identify([flight])
    except GroundStationError as error:
        reason = str(error)
    return Flown(seed, drawn, flight.truth.parameters(), offset, found, reason, time.perf_counter() - began)


def faults(flown: Flown, method: str) -> list[str]:
    """Which demands of the study a method's estimates of a flight do not meet; parameters without a number are not
    judged.

    Mass within 1 %, diagonal within max(2 %, 3 bounds), products within max(0.3 % of the trace, 3 bounds), clock offset
    within max(0.3 ms, 3 standard deviations).
    """
    found = flown.found
    if found is None:
        return ["refused"]
    parameters = estimates(found, method)
    if not parameters:
        return ["no estimate"]
    truth, bound = flown.truth, found.bound
    trace = sum(truth[name] for name in DIAGONAL)
    allowed = {"mass_kg": 0.01 * truth["mass_kg"]}
    allowed |= {name: max(0.02 * truth[name], 3.0 * bound.get(name, 0.0)) for name in DIAGONAL}
    allowed |= {name: max(0.003 * trace, 3.0 * bound.get(name, 0.0)) for name in PRODUCTS}
    out = [name for name in allowed if name in parameters and abs(parameters[name].value - truth[name]) > allowed[name]]
    clock = found.clock
    if method == "best" and (
        clock is None or abs(clock.mocap_minus_imu_s - flown.offset_s) > max(3e-4, 3.0 * clock.std_s)
    ):
        out.append("mocap_minus_imu_s")
    return out


def estimates(found: Identification, method: str) -> Mapping[str, Estimate]:
    """Mass and tensor by a method ("best": the one that is believed); empty where it gave none."""
    result = found.methods.get(found.best if method == "best" else method)
    return {} if result is None else result.parameters


def scores(flights: list[Flown], name: str, method: str = "best") -> np.ndarray:
    """Error over its own standard deviation, of each flight that has a number."""
    known = [(f, estimates(f.found, method)) for f in flights if f.found is not None]
    return np.array([(p[name].value - f.truth[name]) / p[name].std for f, p in known if name in p])


def tables(flights: list[Flown]) -> str:
    """Markdown: each flight, the methods side by side, coverage and scatter of the believed estimate."""
    lines = ["| seed | " + " | ".join(flights[0].drawn) + " | best | seconds | not met |"]
    lines.append("|" + "---|" * (len(flights[0].drawn) + 4))
    for f in flights:
        best = "refused" if f.found is None else f.found.best
        said = f.reason or ", ".join(faults(f, "best")) or "-"
        lines.append(f"| {f.seed} | {' | '.join(f.drawn.values())} | {best} | {f.seconds:.1f} | {said} |")
    lines += [
        "",
        "| method | flights that meet everything | median error: mass | Ixx | Iyy | Izz |",
        "|---|---|---|---|---|---|",
    ]
    for method in METHODS:
        met = sum(not faults(f, method) for f in flights)
        medians = []
        for name in ("mass_kg", *DIAGONAL):
            errors = [
                100.0 * abs(estimates(f.found, method)[name].value / f.truth[name] - 1.0)
                for f in flights
                if f.found is not None and name in estimates(f.found, method)
            ]
            medians.append(f"{np.median(errors):.2f} %" if errors else "-")
        lines.append(f"| {method} | {met} of {len(flights)} | {' | '.join(medians)} |")
    lines += [
        "",
        "| parameter | numbers given | inside the 95 % interval | RMS error over std | mean |",
        "|---|---|---|---|---|",
    ]
    for name in MASS_AND_TENSOR:
        z = scores(flights, name)
        if len(z):
            inside = int(np.sum(np.abs(z) <= HALF_95))
            lines.append(
                f"| {name} | {len(z)} | {inside} ({100.0 * inside / len(z):.0f} %) | "
                f"{np.sqrt(np.mean(z**2)):.2f} | {np.mean(z):+.2f} |"
            )
    return "\n".join(lines)
