"""An identified model as a scenario of the simulated drone, so that the next rehearsal has what was found.

The simulator writes its physics down by itself and is met on the wire alone; what is known of it here is its file
format. Each effect is refitted to the form that ``sim/scenario.py`` documents: where the two differ, the simulator's
parameter is the one that comes nearest in the least-squares sense over the speeds (or heights) that the vehicle's
limits allow, and the head of the file says what got lost. Sensors and disturbance, which no model holds, are those of
the shipped laboratory.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.effect import library
from groundstation.errors import BadInput
from groundstation.paths import find_config
from groundstation.reporting.identified import Identified, as_rigid_body
from groundstation.reporting.simulators import hash_comment

Array = NDArray[np.float64]
Values = Mapping[str, float]
Table = dict[str, Any]

LABORATORY = "lab"
SPEED_M_S = 1.5
"""Speeds over which forms are fitted to each other where the vehicle declares no limit."""
STANDING_S = 1.0
"""From a rehearsal's first sample to its take-off: findings count from the former, the simulator from the latter."""


LEAST_SHARE, MOST_SHARE = 0.1, 0.95
"""Shares of a motor's damping that come from its propeller: below the first a lag is one of first order."""


@dataclass(frozen=True, slots=True)
class Held:
    """A finding in the simulator's form: its table under ``[effects]``, and what that does not hold."""

    effect: str
    table: Table
    lost: str = ""


Mapper = Callable[[Values, Identified], Held | None]


def _nearest(own: Array, form: Array) -> tuple[float, float]:
    """Factor of a form that comes nearest to given values, and the share of their RMS that it misses."""
    factor = float(form @ own / (form @ form))
    return factor, float(np.linalg.norm(own - factor * form) / max(np.linalg.norm(own), 1e-300))


def _hover_inflow(model: Identified) -> float:
    """Induced velocity of a hovering rotor by momentum theory, m/s."""
    vehicle = model.vehicle
    area = vehicle.rotors.count * np.pi * vehicle.rotors.radius_m**2
    density = vehicle.identification.air_density_kg_m3
    return float(np.sqrt(vehicle.mass_kg * vehicle.gravity_m_s2 / (2.0 * density * area)))


def _speeds(model: Identified) -> Array:
    top = model.vehicle.limits.speed_max_m_s or SPEED_M_S
    return np.linspace(-top, top, 81)


def _rotor_drag(v: Values, model: Identified) -> Held:
    lost = "the drag along body z" if v.get("isotropic") else ""
    return Held("rotor_drag", {"drag_kg_s": [v["d_x_kg_s"], v["d_y_kg_s"]], "induced_share": 0.0}, lost)


def _body_drag(v: Values, model: Identified) -> Held:
    area = 2.0 * v["c_kg_m"] / model.vehicle.identification.air_density_kg_m3
    return Held("body_drag", {"area_m2": [area] * 3})


def _flapping(v: Values, model: Identified) -> Held:
    return Held("flapping_moment", {"k_nm_s_m": v["k_nm_s_m"]}, "its moment also falls with rotor speed there")


def _damping(v: Values, model: Identified) -> Held:
    return Held("angular_damping", {"damping_nms": [v[f"damping_{axis}_nms"] for axis in "xyz"]})


def _translational_lift(v: Values, model: Identified) -> Held:
    speed = _speeds(model)
    # Glauert's edgewise inflow over that of hover thins as speed grows; thrust gains in proportion to what is gone.
    square = (speed / _hover_inflow(model)) ** 2
    gone = 1.0 - np.sqrt(np.sqrt(0.25 * square**2 + 1.0) - 0.5 * square)
    gain, missed = _nearest(v["lift_s2_m2"] * speed**2, gone)
    return Held("translational_lift", {"gain": max(gain, 0.0)}, _missed(missed, "speeds"))


def _climb_inflow(v: Values, model: Identified) -> Held:
    climb = _speeds(model)
    ratio = climb / _hover_inflow(model)
    slower = 0.5 * ratio + np.sqrt(0.25 * ratio**2 + 1.0) - 1.0
    weight = model.vehicle.mass_kg * model.vehicle.gravity_m_s2
    gain, missed = _nearest(v["k_kg_s"] * climb, weight * slower)
    return Held("climb_inflow", {"gain": max(gain, 0.0)}, _missed(missed, "climb speeds"))


def _ground_effect(v: Values, model: Identified) -> Held:
    height = np.linspace(1.0, 8.0, 71)  # in rotor radii
    strength, _ = _nearest(v["strength"] / height**2, 1.0 / (16.0 * height**2))
    return Held("ground_effect", {"strength": strength}, "it grows faster than the square below one rotor radius")


def _wind(v: Values, model: Identified) -> Held:
    force = np.array([v["force_world_x_n"], v["force_world_y_n"]])
    drag = float(np.mean(model.rotor_drag_kg_s))
    if drag <= 0.0:
        lost = "no drag was found that it could be felt through: it is held as a steady force"
        return Held("constant_wrench", {"force_world_n": [*map(float, force), 0.0]}, lost)
    return Held("wind", {"velocity_m_s": [*map(float, force / drag), 0.0], "gust_m_s": 0.0}, "gusts")


def _weak_rotor(v: Values, model: Identified) -> Held:
    lost = "its torque falls with a higher power of the loss there (a cut propeller's)"
    return Held("weak_rotor", {"rotor": int(v["rotor"]), "loss": v["loss"]}, lost)


def _rotor_degradation(v: Values, model: Identified) -> Held:
    table = {"rotor": int(v["rotor"]), "loss": v["loss"], "start_s": v["from_s"] - STANDING_S}
    return Held("rotor_degradation", {**table, "spread_s": max(v["within_s"] / 4.0, 0.05)}, "the exact instant")


def _thrust_curve(v: Values, model: Identified) -> Held:
    return Held("thrust_curve", {"exponent": 2.0 + v["exponent_error"]}, "agreement far from hover thrust")


def _com_offset(v: Values, model: Identified) -> Held:
    return Held("com_offset", {"offset_m": [v["com_offset_x_m"], v["com_offset_y_m"], 0.0]})


def _gyroscopic(v: Values, model: Identified) -> Held:
    return Held("rotor_gyroscopic", {"inertia_kg_m2": max(v["rotor_inertia_kg_m2"], 0.0)})


def _battery_sag(v: Values, model: Identified) -> Held:
    lost = "the voltage is the simulated battery's own"
    return Held("battery_sag", {"strength": float(np.clip(v["exponent"], 0.0, 1.5))}, lost)


def _payload_change(v: Values, model: Identified) -> Held:
    table = {"mass_kg": -v["mass_change_kg"], "time_s": v["at_s"] - STANDING_S, "position_m": [0.0, 0.0, 0.0]}
    return Held("payload_change", table, "the exact instant, and where the load sat (its share of the tensor)")


def _slung_load(v: Values, model: Identified) -> Held:
    return Held("slung_load", {"mass_kg": v["load_kg"], "length_m": v["length_m"]}, "how fast its swing dies")


def _tether(v: Values, model: Identified) -> Held:
    limits = model.vehicle.limits
    middle = np.array([0.0, 0.0, 0.5 * ((limits.z_min_m or 0.0) + (limits.z_max_m or 2.0))])
    pull = np.array([v[f"pull_{axis}_n"] for axis in "xyz"])
    if v["stiffness_n_m"] <= 0.0:
        return Held("constant_wrench", {"force_world_n": list(map(float, pull))}, "it has no stiffness")
    anchor = middle + pull / v["stiffness_n_m"]
    table = {"anchor_m": list(map(float, anchor)), "stiffness_n_m": v["stiffness_n_m"]}
    return Held("tether", table, "the middle of the flight, about which it was found: the room's middle stands for it")


def _constant_wrench(v: Values, model: Identified) -> Held:
    force = [v["force_world_x_n"], v["force_world_y_n"], 0.0]
    table = {"force_world_n": force, "torque_body_nm": [v[f"torque_{axis}_nm"] for axis in "xyz"]}
    return Held("constant_wrench", table)


def _input_delay(v: Values, model: Identified) -> Held:
    return Held("input_delay", {"delay_s": float(np.clip(v["input_delay_s"], 0.0, 0.5))})


def _clock_offset(v: Values, model: Identified) -> Held:
    return Held("clock_offset", {"offset_s": v["mocap_minus_imu_s"], "drift_ppm": 1e6 * v.get("clock_drift", 0.0)})


def _turned(effect: str) -> Mapper:
    def mapper(v: Values, model: Identified) -> Held:
        table: Table = {"rotation_rad": [v.get(f"rotation_{axis}_rad", 0.0) for axis in "xyz"]}
        if effect == "mocap_misalignment":
            table["offset_m"] = [v.get(f"offset_{axis}_m", 0.0) for axis in "xyz"]
        return Held(effect, table)

    return mapper


def _mocap_tilt(v: Values, model: Identified) -> Held:
    return Held("mocap_tilt", {"tilt_rad": [v["tilt_x_rad"], v["tilt_y_rad"]]})


def _motor_lag(v: Values, model: Identified) -> Held | None:
    """A lag whose rate depends on the speed is a motor's with its propeller; else ``truth.lag`` holds it.

    About hover the motor's rate rises by ``propeller_share`` of it per share of speed, and what brakes is that share
    and as much of the rest as the controller uses: tau_up / tau_down = share + braking (1 - share).
    """
    share = v.get("rotor_lag_slope", 0.0)
    if share < LEAST_SHARE:
        return None
    share = min(share, MOST_SHARE)
    braking = (v["rotor_lag_up_s"] / max(v["rotor_lag_down_s"], 1e-3) - share) / (1.0 - share)
    table = {
        "hover_s": v["rotor_lag_up_s"],
        "propeller_share": share,
        "braking_share": min(max(braking, 0.1), 1.0),
    }
    return Held("motor_lag", table, "its rate by the command alone: the simulator's depends on the speed, too")


def _nothing(v: Values, model: Identified) -> None:
    """Held by ``[truth]`` already."""


MAPPERS: Mapping[str, Mapper] = {
    "rotor_drag": _rotor_drag,
    "body_drag": _body_drag,
    "flapping_moment": _flapping,
    "angular_damping": _damping,
    "translational_lift": _translational_lift,
    "climb_inflow": _climb_inflow,
    "ground_effect": _ground_effect,
    "wind": _wind,
    "weak_rotor": _weak_rotor,
    "rotor_degradation": _rotor_degradation,
    "thrust_curve": _thrust_curve,
    "com_offset": _com_offset,
    "rotor_gyroscopic": _gyroscopic,
    "battery_sag": _battery_sag,
    "payload_change": _payload_change,
    "slung_load": _slung_load,
    "tether": _tether,
    "constant_wrench": _constant_wrench,
    "input_delay": _input_delay,
    "clock_offset": _clock_offset,
    "imu_misalignment": _turned("imu_misalignment"),
    "mocap_misalignment": _turned("mocap_misalignment"),
    "mocap_tilt": _mocap_tilt,
    "motor_lag": _motor_lag,
    "thrust_scale": _nothing,
    "torque_scale": _nothing,
}
"""By effect, how the simulator holds it."""


def _missed(share: float, over: str) -> str:
    return f"{share:.0%} of its RMS over the {over} that the limits allow" if share > 0.01 else ""


def scenario_document(model: Identified) -> tuple[Table, list[str]]:
    """The scenario, and sentences about what it does not hold.

    Two findings of one kind (or two that the simulator holds in one form) cannot both be kept: the first is.
    """
    laboratory = tomllib.loads(find_config("scenarios", LABORATORY).read_text(encoding="utf-8"))
    document: Table = {"name": f"as-{model.vehicle.name}-flew"}
    for section in ("imu", "mocap", "motors", "battery", "state", "disturbance"):
        table = dict(laboratory[section])
        if "clock" in table:
            table["clock"] = {k: v for k, v in table["clock"].items() if k not in ("offset_s", "drift_ppm")}
        document[section] = table
    effects: dict[str, Table] = {}
    lost = []
    for name, values in model.effects.items():
        identifier = name.partition("/")[0]
        mapper = MAPPERS.get(identifier)
        effect = library().get(identifier)
        held = None if mapper is None else mapper(values, model)
        if effect is not None and effect.scenario is not None:
            effects |= dict([effect.scenario(values, model.vehicle)])
        elif mapper is None:
            lost.append(f"{identifier}: the simulator has no form of it")
        elif held is not None and held.effect in effects:
            lost.append(f"{name}: the simulator holds one {held.effect} only, and has it already")
        elif held is not None:
            effects[held.effect] = held.table
            if held.lost:
                lost.append(f"{name}: {held.lost}")
    document["truth"] = _truth(model)
    if "motor_lag" in effects:
        document["truth"].pop("lag", None)
    document["effects"] = effects | _scales(model)
    return document, lost


def _truth(model: Identified) -> Table:
    """The vehicle's own mass (the simulator adds the load it lets go), tensor and lag."""
    vehicle = model.vehicle
    truth: Table = {
        "mass_kg": vehicle.mass_kg,
        "inertia_kg_m2": vehicle.inertia_kg_m2.model_dump(),
    }
    if vehicle.rotors.lag.up_s > 0.0 or vehicle.rotors.lag.down_s > 0.0:
        truth["lag"] = vehicle.rotors.lag.model_dump()
    return truth


def _scales(model: Identified) -> dict[str, Table]:
    """Rotor constants that were identified, over the declared ones."""
    found, declared = model.vehicle.rotors, model.declared.rotors
    out: dict[str, Table] = {}
    if found.thrust_coefficient_n_s2 != declared.thrust_coefficient_n_s2:
        ratio = (found.thrust_coefficient_n_s2 or 1.0) / (declared.thrust_coefficient_n_s2 or 1.0)
        out["thrust_scale"] = {"density_ratio": ratio}
    if found.torque_to_thrust_m != declared.torque_to_thrust_m:
        out["torque_scale"] = {"ratio": found.torque_to_thrust_m / declared.torque_to_thrust_m}
    return out


def to_scenario(model: Identified) -> str:
    """A scenario file; its head says where the numbers are from and what got lost.

    A tensor that belongs to no rigid body becomes the nearest one; the head says so.

    Raises:
        BadInput: an effect lacks one of its parameters.
    """
    import tomli_w

    model = as_rigid_body(model)
    try:
        document, lost = scenario_document(model)
    except (KeyError, ValueError, OverflowError) as error:
        raise BadInput(
            f"the model's effects lack {error}, which a scenario needs; write it again with `report`."
        ) from None
    head = [f"Identified from flight {model.flight or 'unnamed'}: what it lacked is switched on here."]
    head.append("Rehearse it with the vehicle as it was declared; sensors and disturbance are the laboratory's.")
    head += [model.adjusted] if model.adjusted else []
    head += [f"Lost: {text}." for text in lost]
    return hash_comment(head) + tomli_w.dumps(document)
