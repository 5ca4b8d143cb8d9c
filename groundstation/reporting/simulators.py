"""Writers for simulators: each documents, in the file it writes, the units, the signs and what got lost.

Common ground: body x forward, y left, z up, origin at the declared geometric centre; the tensor is about the centre of
mass and its products are the tensor's entries (I_xy = -integral x y dm). A rotor with spin +1 turns counter-clockwise
seen from above, and its reaction torque about body z is -c T.
"""

from __future__ import annotations

import csv
import io
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from groundstation.errors import BadInput
from groundstation.frames import matrix_from_quat, quat_from_euler
from groundstation.reporting.identified import Identified, as_rigid_body
from groundstation.reporting.units import split_unit
from groundstation.texts import shown
from groundstation.vehicle import INERTIA_NAMES, Vehicle, vehicle_to_dict


def number(value: float) -> str:
    return f"{float(value):.9g}"


def numbers(values: object) -> str:
    return " ".join(number(v) for v in np.ravel(np.asarray(values, dtype=float)))


def identifier(name: str) -> str:
    """A name that every simulator takes."""
    return re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "vehicle"


_COMMENT = 100_000


def comment(sentences: list[str]) -> Any:
    """An XML comment; "--" may not stand in one."""
    return ET.Comment(" " + re.sub(r"-{2,}", "-", shown(" ".join(sentences), limit=_COMMENT)).rstrip("-") + " ")


def hash_comment(sentences: Iterable[str]) -> str:
    """Lines that start with #, whatever breaks a sentence has."""
    return "".join(f"# {shown(line, limit=_COMMENT)}\n" for sentence in sentences for line in sentence.splitlines())


def xml_text(root: ET.Element) -> str:
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def child(parent: ET.Element, tag: str, text: str | None = None, **attributes: str) -> ET.Element:
    node = ET.SubElement(parent, tag, attributes)
    node.text = text
    return node


def to_csv(model: Identified) -> str:
    """One line per number: name, value, standard deviation, unit, identified or declared."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["name", "value", "std", "unit", "source"])
    values = model.vehicle.parameters()
    values |= {f"com_offset_{a}_m": v for a, v in zip("xyz", model.com_offset_m, strict=True)}
    values |= {f"d_{a}_kg_s": v for a, v in zip("xy", model.rotor_drag_kg_s, strict=True)}
    values |= {f"damping_{a}_nms": v for a, v in zip("xyz", model.damping_nms, strict=True)}
    values["input_delay_s"] = model.delay_s
    values |= {name: value for name, value in model.model.items() if name not in values}
    for name, value in values.items():
        std = model.std.get(name)
        source = "identified" if std is not None else "declared"
        writer.writerow([name, repr(float(value)), "" if std is None else repr(std), split_unit(name)[1], source])
    return out.getvalue()


def to_vehicle_toml(model: Identified) -> str:
    """A vehicle file in which what was identified is now declared, for the next plan and flight."""
    import tomli_w

    return hash_comment(model.provenance()) + tomli_w.dumps(vehicle_to_dict(model.vehicle))


SIH_STEP_S = 0.005
"""Longest step of SIH, which divides by the lag and steps it by Euler's rule: a shorter lag would not be stable
(sih.cpp).
"""


def sih_order(model: Identified) -> tuple[int, int, int, int]:
    """Our rotor numbers (from 0) in the order of PX4's SIH quadrotor: front right, rear left, front left, rear right.

    Raises:
        BadInput: the rotors are no symmetric X whose diagonals spin alike, front right counter-clockwise.
    """
    position = np.asarray(model.vehicle.rotors.position_m)[:, :2]
    wanted = ((1, -1), (-1, 1), (1, 1), (-1, -1))
    size = np.mean(np.abs(position), axis=0)
    order = []
    for sign_x, sign_y in wanted:
        distance = np.linalg.norm(position - size * (sign_x, sign_y), axis=1)
        order.append(int(np.argmin(distance)))
    matched = position[order] if len(position) == 4 else position
    target = size * np.asarray(wanted)
    if len(position) != 4 or len(set(order)) != 4 or np.abs(matched - target).max() > 0.05 * size.max():
        raise BadInput("px4-sih models four rotors in a symmetric X, which this vehicle's are not; export sdf or mjcf.")
    if [model.vehicle.rotors.spin[i] for i in order] != [1, 1, -1, -1]:
        raise BadInput(
            "px4-sih spins front right and rear left counter-clockwise, the others clockwise; this vehicle does not; "
            "export sdf or mjcf."
        )
    return (order[0], order[1], order[2], order[3])


def hover_motor_share(vehicle: Vehicle) -> float:
    """The motor command at hover as a share of the full one: of the top speed where speeds are the input, else of the
    command.
    """
    motor = float(vehicle.motor_for_thrust(vehicle.mass_kg * vehicle.gravity_m_s2 / vehicle.rotors.count))
    if vehicle.rotors.input == "rotor_speed":
        return motor / (vehicle.rotors.speed_max_rad_s or motor)
    return motor


def _turned_to_frd(vehicle: Vehicle) -> dict[str, float]:
    """Entries of the tensor by name with y and z turned round: I_xy and I_xz change sign, I_yz does not."""
    tensor = {name: float(getattr(vehicle.inertia_kg_m2, name)) for name in INERTIA_NAMES}
    return {name: -value if name in {"xy", "xz"} else value for name, value in tensor.items()}


def to_px4_sih(model: Identified) -> str:
    """A parameter file (tab separated, as ground stations load it) for PX4's simulation in hardware.

    SIH works in FRD: with x kept and y, z turned round, I_xy and I_xz change sign and I_yz does not. Its thrust is
    linear in the command, T = SIH_T_MAX u. Hover is matched, as a vehicle flies there; the head gives the error at full
    throttle. Drag is one number, the mean of x and y.
    """
    order = sih_order(model)
    vehicle = model.vehicle
    position = np.asarray(vehicle.rotors.position_m)[list(order)]
    top = vehicle.rotor_thrust_max_n()
    if not np.isfinite(top):
        raise BadInput("px4-sih needs the rotors' top thrust: declare speed_max_rad_s, a thrust_curve or thrust_max_n.")
    hover = vehicle.mass_kg * vehicle.gravity_m_s2 / vehicle.rotors.count
    share = hover_motor_share(vehicle)
    full = hover / share
    values = {
        "SIH_MASS": vehicle.mass_kg,
        **{f"SIH_I{name.upper()}": value for name, value in _turned_to_frd(vehicle).items()},
        "SIH_T_MAX": full,
        "SIH_Q_MAX": full * vehicle.rotors.torque_to_thrust_m,
        "SIH_L_ROLL": float(np.mean(np.abs(position[:, 1]))),
        "SIH_L_PITCH": float(np.mean(np.abs(position[:, 0]))),
        "SIH_KDV": max(0.0, float(np.mean(model.rotor_drag_kg_s))),
        "SIH_KDW": max(0.0, float(np.mean(model.damping_nms))),
        "SIH_T_TAU": max(model.mean_lag_s(), SIH_STEP_S),
    }
    offset = " ".join(number(v) for v in model.com_offset_m)
    notes = [
        *model.provenance({"rotor_drag", "angular_damping"}),
        "Axes are FRD: I_xy and I_xz have the sign opposite to FLU. SI units.",
        f"SIH thrust is linear in the command. SIH_T_MAX matches hover, at {share:.3f} of full command; at full "
        f"command a rotor of this vehicle gives {top:.4g} N, and SIH {100.0 * (full / top - 1.0):+.0f} % of that off.",
        f"PX4 motors 1 to 4 are rotors {', '.join(str(i + 1) for i in order)} of the vehicle file.",
        f"SIH has its centre of mass at the origin (here it is at {offset} m, FLU) and one lag, the mean of up and "
        "down.",
    ]
    lines = [f"1\t1\t{name}\t{number(value)}\t9" for name, value in values.items()]
    return hash_comment(notes) + "#\n# Vehicle-Id Component-Id Name Value Type\n" + "\n".join(lines) + "\n"


def add_inertial(parent: ET.Element, mass: float, centre: np.ndarray, tensor: np.ndarray, *, urdf: bool) -> None:
    """``<inertial>`` of SDF or URDF: both take the tensor's entries about the centre of mass."""
    node = child(parent, "inertial")
    entries = {f"i{a}{b}": tensor["xyz".index(a), "xyz".index(b)] for a, b in INERTIA_NAMES}
    if urdf:
        child(node, "origin", xyz=numbers(centre), rpy="0 0 0")
        child(node, "mass", value=number(mass))
        child(node, "inertia", **{name: number(value) for name, value in entries.items()})
        return
    child(node, "pose", f"{numbers(centre)} 0 0 0")
    child(node, "mass", number(mass))
    inertia = child(node, "inertia")
    for name, value in entries.items():
        child(inertia, name, number(value))


def to_urdf(model: Identified) -> str:
    """Inertial properties of one link, and a massless frame per rotor."""
    model = as_rigid_body(model)
    vehicle = model.vehicle
    root = ET.Element("robot", name=identifier(vehicle.name))
    root.append(
        comment(
            [*model.provenance({"com_offset"}), "SI units; x forward, y left, z up; products are the tensor's entries."]
        )
    )
    link = child(root, "link", name="base_link")
    add_inertial(link, vehicle.mass_kg, model.com_offset_m, vehicle.inertia_tensor(), urdf=True)
    add_urdf_frame(link, vehicle)
    for i, (position, axis) in enumerate(zip(vehicle.rotors.position_m, vehicle.rotors.axes(), strict=True), start=1):
        child(root, "link", name=f"rotor_{i}")
        joint = child(root, "joint", name=f"rotor_{i}_joint", type="fixed")
        child(joint, "parent", link="base_link")
        child(joint, "child", link=f"rotor_{i}")
        child(joint, "origin", xyz=numbers(position), rpy=numbers(upright_to(axis)))
    return xml_text(root)


def upright_to(axis: np.ndarray) -> tuple[float, float, float]:
    """Roll, pitch and yaw (zero) that turn body z into a rotor's axis, rad."""
    x, y, z = (float(v) for v in axis)
    return float(np.arcsin(-y)) + 0.0, float(np.arctan2(x, z)) + 0.0, 0.0


def _arm(position: Sequence[float]) -> tuple[float, float, float]:
    """Length, middle height share and heading of an arm from the origin to a rotor: (length, elevation, azimuth)."""
    x, y, z = (float(v) for v in position)
    return float(np.sqrt(x * x + y * y + z * z)), float(np.arctan2(z, np.hypot(x, y))), float(np.arctan2(y, x))


def add_urdf_frame(link: ET.Element, vehicle: Vehicle) -> None:
    """What one sees: an arm to each rotor and a disc on it. It has no mass and does not collide."""
    for position in vehicle.rotors.position_m:
        length, elevation, azimuth = _arm(position)
        arm = child(link, "visual")
        child(arm, "origin", xyz=numbers(0.5 * np.asarray(position)), rpy=numbers([0.0, -elevation, azimuth]))
        child(child(arm, "geometry"), "box", size=numbers([length, 0.08 * length, 0.04 * length]))
        disc = child(link, "visual")
        child(disc, "origin", xyz=numbers(position), rpy="0 0 0")
        child(child(disc, "geometry"), "cylinder", radius=number(vehicle.rotors.radius_m), length=number(0.02 * length))


ROTOR_MASS_FRACTION = 1e-4
"""Share of the vehicle's mass that each rotor link of the SDF gets: Gazebo needs massive links to turn."""


def _parallel_axis(mass: float, offset: np.ndarray) -> np.ndarray:
    """Inertia of a point mass about the origin, m (|d|^2 E - d d^T), shape (3, 3)."""
    return mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))


def _sdf_rotor(body: ET.Element, model: Identified, i: int, mass_kg: float, disc: np.ndarray) -> None:
    """A turning link of a rotor and its joint."""
    rotors = model.vehicle.rotors
    link = child(body, "link", name=f"rotor_{i}")
    child(link, "pose", f"{numbers(rotors.position_m[i])} {numbers(upright_to(rotors.axes()[i]))}")
    add_inertial(link, mass_kg, np.zeros(3), disc, urdf=False)
    joint = child(body, "joint", name=f"rotor_{i}_joint", type="revolute")
    child(joint, "parent", "base_link")
    child(joint, "child", f"rotor_{i}")
    axis = child(joint, "axis")
    child(axis, "xyz", "0 0 1")
    limit = child(axis, "limit")
    child(limit, "lower", "-1e16")
    child(limit, "upper", "1e16")


def to_sdf(model: Identified) -> str:
    """A Gazebo model: a base link, a turning link per rotor, and the multicopter motor model where rotor speeds are
    known.

    What the rotor links weigh is taken off the base, so that all links together have the identified mass, centre and
    tensor.
    """
    model = as_rigid_body(model)
    vehicle, rotors = model.vehicle, model.vehicle.rotors
    positions = np.asarray(rotors.position_m, dtype=float)
    each = ROTOR_MASS_FRACTION * vehicle.mass_kg
    disc = each * rotors.radius_m**2 * np.diag([0.25, 0.25, 0.5])
    base_mass = vehicle.mass_kg - len(positions) * each
    centre = (vehicle.mass_kg * model.com_offset_m - each * positions.sum(axis=0)) / base_mass
    about_origin = vehicle.inertia_tensor() + _parallel_axis(vehicle.mass_kg, model.com_offset_m)
    turned = [matrix_from_quat(quat_from_euler(*upright_to(axis))) for axis in rotors.axes()]
    about_origin -= sum(r @ disc @ r.T + _parallel_axis(each, p) for r, p in zip(turned, positions, strict=True))
    base_tensor = about_origin - _parallel_axis(base_mass, centre)

    root = ET.Element("sdf", version="1.9")
    body = child(root, "model", name=identifier(vehicle.name))
    notes = [
        *model.provenance({"com_offset", "rotor_drag", "weak_rotor"}),
        "SI units; x forward, y left, z up; products are the tensor's entries about the centre of mass.",
    ]
    notes.append("motorConstant: N s^2 (T = k Omega^2); momentConstant: m (Q = c T); time constants: s.")
    body.append(comment(notes))
    base = child(body, "link", name="base_link")
    add_inertial(base, base_mass, centre, base_tensor, urdf=False)
    for i in range(len(positions)):
        _sdf_rotor(body, model, i, each, disc)
    if rotors.thrust_coefficient_n_s2 is None or rotors.speed_max_rad_s is None:
        body.append(
            comment(["No motor model: it needs thrust_coefficient_n_s2 and speed_max_rad_s, which are not known."])
        )
        return xml_text(root)
    for i in range(len(positions)):
        _motor_plugin(body, model, i)
    return xml_text(root)


def _motor_plugin(body: ET.Element, model: Identified, index: int) -> None:
    rotors = model.vehicle.rotors
    speed_sum = model.hover_speed_sum_rad_s() or 1.0
    plugin = child(
        body,
        "plugin",
        filename="gz-sim-multicopter-motor-model-system",
        name="gz::sim::systems::MulticopterMotorModel",
    )
    settings = {
        "jointName": f"rotor_{index}_joint",
        "linkName": f"rotor_{index}",
        "turningDirection": "ccw" if rotors.spin[index] > 0 else "cw",
        "timeConstantUp": number(rotors.lag.up_s),
        "timeConstantDown": number(rotors.lag.down_s),
        "maxRotVelocity": number(rotors.speed_max_rad_s or 0.0),
        "motorConstant": number(model.rotor_effectiveness[index] * (rotors.thrust_coefficient_n_s2 or 0.0)),
        "momentConstant": number(rotors.torque_to_thrust_m),
        "commandSubTopic": "command/motor_speed",
        "motorNumber": str(index),
        "actuator_number": str(index),
        "rotorDragCoefficient": number(float(np.mean(model.rotor_drag_kg_s)) / speed_sum),
        "rollingMomentCoefficient": "0",
        "rotorVelocitySlowdownSim": "10",
        "motorType": "velocity",
    }
    for tag, text in settings.items():
        child(plugin, tag, text)
