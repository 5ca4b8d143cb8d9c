"""Writers for further simulators, firmware and tools. Common ground as in :mod:`.simulators`.

Each states in its head, or beside its numbers where it has no comments, what was identified and what its format does
not hold.
"""

from __future__ import annotations

import io
import json
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np

from groundstation.errors import BadInput
from groundstation.reporting.identified import Identified, as_rigid_body
from groundstation.reporting.simulators import (
    add_inertial,
    add_urdf_frame,
    child,
    comment,
    hash_comment,
    hover_motor_share,
    identifier,
    number,
    numbers,
    xml_text,
)
from groundstation.vehicle import Rotors, Vehicle

MAT_TEXT = 116
"""Bytes of text at the head of a MAT-file (MAT-File Format, version 5, MathWorks, Level 5 header)."""
RPM = 30.0 / np.pi
"""Revolutions per minute in a radian per second."""
ARDUPILOT_AIR = 1.157
"""Density at ArduPilot's reference height of 593 m, kg/m^3 (International Standard Atmosphere)."""
ARDUPILOT_TILT_DEG = 45.0
"""Of the reference flight; ArduPilot's own."""


def _speed_driven(model: Identified, format_name: str) -> tuple[float, float]:
    """Thrust coefficient (N s^2) and top speed (rad/s).

    Raises:
        BadInput: the vehicle is not declared by rotor speeds.
    """
    rotors = model.vehicle.rotors
    if rotors.thrust_coefficient_n_s2 is None or rotors.speed_max_rad_s is None:
        raise BadInput(
            f"{format_name} drives rotors by speed: declare thrust_coefficient_n_s2 and speed_max_rad_s, or export "
            "mjcf."
        )
    return rotors.thrust_coefficient_n_s2, rotors.speed_max_rad_s


def _bend_and_yaw(vehicle: Vehicle, share: float, diagonal: float) -> tuple[float, float]:
    """``propExpo`` that matches thrust at hover and full command; the yaw factor that matches torque at hover."""
    u = hover_motor_share(vehicle)
    bend = float(np.clip((u - share) / (u - u**2), 0.0, 1.0)) if 0.0 < u < 1.0 else 0.0
    slope = 1.0 - bend + 2.0 * bend * u
    return bend, vehicle.rotors.torque_to_thrust_m * slope / (share + u * slope) / (0.05 * diagonal)


def to_ardupilot_sitl(model: Identified) -> str:
    """A frame file for ArduPilot's simulator (``-f quad:vehicle.json``). ArduPilot's axes are FRD; lines with # are
    comments.

    Formulas and keys: libraries/SITL/SIM_Frame.cpp and SIM_Motor.cpp. With u the servo output between pwmMin and
    pwmMax, a rotor gives T = hover / hoverThrOut ((1 - propExpo) u + propExpo u^2), which is matched at hover and at
    full command, and the torque 0.05 diagonal_size yaw u T, whose slope is matched at hover. Rotor positions are from
    the centre of mass. Drag is the linear momentum drag alone, and angular damping one rate; both are zero where none
    was found. It has principal moments only and no lag.
    """
    vehicle = model.vehicle
    top = vehicle.rotor_thrust_max_n()
    if not np.isfinite(top):
        raise BadInput(
            "ardupilot-sitl needs the rotors' top thrust: declare speed_max_rad_s, a thrust_curve or thrust_max_n."
        )
    positions = np.asarray(vehicle.rotors.position_m)
    diagonal = 2.0 * float(np.linalg.norm(positions[:, :2], axis=1).mean())
    if diagonal == 0.0:
        raise BadInput("ardupilot-sitl needs rotors beside the centre of the body; look at rotors.position_m.")
    share = vehicle.mass_kg * vehicle.gravity_m_s2 / len(positions) / top
    bend, yaw = _bend_and_yaw(vehicle, share, diagonal)
    frame: dict[str, Any] = {
        "mass": vehicle.mass_kg,
        "diagonal_size": diagonal,
        "hoverThrOut": share,
        "propExpo": bend,
        "pwmMin": 1000,
        "pwmMax": 2000,
        "spin_min": 0.0,
        "spin_max": 1.0,
        **_ardupilot_drag(model, len(positions) * np.pi * vehicle.rotors.radius_m**2),
        "moment_inertia": [getattr(vehicle.inertia_kg_m2, name) for name in ("xx", "yy", "zz")],
        "num_motors": len(positions),
        "maxVoltage": vehicle.battery.full_v,
    }
    for i, (x, y, z) in enumerate((positions - model.com_offset_m).tolist(), start=1):
        frame[f"motor{i}_position"] = [x, 0.0 - y, 0.0 - z]
        frame[f"motor{i}_yaw"] = vehicle.rotors.spin[i - 1] * yaw
    notes = [
        *model.provenance({"com_offset", "rotor_drag"}),
        "Axes are FRD, SI units. Products of inertia and lag are not held; the drag acts along z, too.",
        "ArduPilot's simulator divides torque by moment: it has no gyroscopic torque.",
        "Thrust is that of air at refAlt (593 m, as ArduPilot starts) and of a full battery, which does not sag.",
        "Motor 1 is rotor 1 of the vehicle file; ArduPilot's frame class must number its motors alike.",
        "ArduPilot reads it from the folder it runs in: --model quad:NAME.json, without a path.",
    ]
    return hash_comment(notes) + json.dumps(frame, indent=2) + "\n"


def _ardupilot_drag(model: Identified, disc_m2: float) -> dict[str, float]:
    """Drag and angular damping as SIM_Frame.cpp derives them from a reference flight: at ``refAngle`` the speed is
    ``refSpd``.

    Momentum drag of all rotors is mdrag_coef sqrt(rho A W) v at hover. What the reference flight needs beyond it
    becomes drag by the square of the speed; the reference speed is therefore the one that momentum drag alone explains.
    """
    weight = model.vehicle.mass_kg * model.vehicle.gravity_m_s2
    drag = max(0.0, float(np.mean(model.rotor_drag_kg_s)))
    moments = np.array([getattr(model.vehicle.inertia_kg_m2, name) for name in ("xx", "yy", "zz")])
    rate = float(np.mean(np.maximum(model.damping_nms, 0.0) / moments))
    values = {"disc_area": disc_m2, "mdrag_coef": 0.0, "refAngle": 0.0, "refSpd": 15.0}
    if drag > 0.0:
        tilt = np.radians(ARDUPILOT_TILT_DEG)
        thrust = np.sqrt(np.cos(tilt))  # a tilted rotor pushes more, and drags by the root of that
        values |= {
            "mdrag_coef": drag / float(np.sqrt(ARDUPILOT_AIR * disc_m2 * weight)),
            "refAngle": ARDUPILOT_TILT_DEG,
            "refSpd": float(weight * np.tan(tilt) / drag * thrust / np.cos(tilt) ** 2),
        }
    return values | {"refRotRate": float(np.radians(400.0)) / rate if rate > 0.0 else 0.0}


def to_pybullet(model: Identified) -> str:
    """A URDF as gym-pybullet-drones reads it: ``<properties>``, four propeller links from prop0 on, a link at the
    centre of mass.

    Its kf and km are per squared RPM. Ground effect, drag and downwash are zero where nothing was found.
    """
    k, top = _speed_driven(model, "pybullet")
    rigid = as_rigid_body(model)
    vehicle = rigid.vehicle
    positions = np.asarray(vehicle.rotors.position_m)
    root = ET.Element("robot", name=identifier(vehicle.name))
    root.append(comment([*rigid.provenance({"com_offset", "rotor_drag"}), "kf, km: N and N m per squared RPM."]))
    drag = float(np.mean(model.rotor_drag_kg_s)) / max(model.hover_speed_sum_rad_s() or 1.0, 1e-9)
    properties = {
        "arm": number(float(np.linalg.norm(positions[:, :2], axis=1).mean())),
        "kf": number(k / RPM**2),
        "km": number(k * vehicle.rotors.torque_to_thrust_m / RPM**2),
        "thrust2weight": number(len(positions) * k * top**2 / (vehicle.mass_kg * vehicle.gravity_m_s2)),
        "max_speed_kmh": number(3.6 * (vehicle.limits.speed_max_m_s or 5.0)),
        "gnd_eff_coeff": "0",
        "prop_radius": number(vehicle.rotors.radius_m),
        "drag_coeff_xy": number(drag),
        "drag_coeff_z": "0",
        **{f"dw_coeff_{i}": "0" for i in (1, 2, 3)},
    }
    child(root, "properties", **properties)
    base = child(root, "link", name="base_link")
    add_inertial(base, vehicle.mass_kg, rigid.com_offset_m, vehicle.inertia_tensor(), urdf=True)
    add_urdf_frame(base, vehicle)
    links = {**{f"prop{i}_link": p for i, p in enumerate(positions)}, "center_of_mass_link": rigid.com_offset_m}
    for name, position in links.items():
        link = child(root, "link", name=name)
        add_inertial(link, 0.0, np.zeros(3), np.zeros((3, 3)), urdf=True)
        joint = child(root, "joint", name=f"{name.removesuffix('_link')}_joint", type="fixed")
        child(joint, "parent", link="base_link")
        child(joint, "child", link=name)
        child(joint, "origin", xyz=numbers(position), rpy="0 0 0")
    return xml_text(root)


def to_crazyflow(model: Identified) -> str:
    """Parameters of crazyflow's first-principles dynamics, as its params.toml holds them: one table, thrust by RPM.

    The mixing matrix has the signs of rotor positions and reaction torques; crazyflow wants an X of equal arms.
    """
    import tomli_w

    k, top = _speed_driven(model, "crazyflow")
    vehicle = model.vehicle
    positions = np.asarray(vehicle.rotors.position_m)
    arm = np.abs(positions[:, :2])
    if len(positions) != 4 or arm.min() < 0.5 * arm.max():
        raise BadInput("crazyflow models four rotors in an X of equal arms, which this vehicle's are not; export mjcf.")
    up, down = (max(value, 1e-3) for value in (vehicle.rotors.lag.up_s, vehicle.rotors.lag.down_s))
    drag = -model.rotor_drag_kg_s
    table = {
        "mass": vehicle.mass_kg,
        "J": vehicle.inertia_tensor().tolist(),
        "thrust_min": 0.0,
        "thrust_max": k * top**2,
        "L": float(arm.mean()),
        "prop_inertia": 0.0,
        "rpm2thrust": [0.0, 0.0, k / RPM**2],
        "rpm2torque": [0.0, 0.0, k * vehicle.rotors.torque_to_thrust_m / RPM**2],
        "rotor_dyn_coef": [1.0 / up, 0.0, 1.0 / down, 0.0],
        "mixing_matrix": [
            np.sign(positions[:, 1]).tolist(),
            (-np.sign(positions[:, 0])).tolist(),
            [-float(spin) for spin in vehicle.rotors.spin],
        ],
        "drag_matrix": np.diag([float(drag[0]), float(drag[1]), 0.0]).tolist(),
    }
    return hash_comment(model.provenance({"rotor_drag"})) + tomli_w.dumps({identifier(vehicle.name): table})


def to_agilicious(model: Identified) -> str:
    """A quadrotor file for Agilicious and Flightmare (YAML).

    Principal moments only; thrust_map is per squared rotor speed.
    """
    k, top = _speed_driven(model, "agilicious")
    vehicle = model.vehicle
    positions = np.asarray(vehicle.rotors.position_m) - model.com_offset_m
    if len(positions) != 4:
        raise BadInput("agilicious models four rotors; export mjcf.")
    corners = {"fr": (1, -1), "bl": (-1, 1), "br": (-1, -1), "fl": (1, 1)}
    if np.abs(np.asarray(vehicle.rotors.position_m)[:, :2]).min() < 1e-6:
        corners = {"fr": (1, 0), "bl": (-1, 0), "br": (0, -1), "fl": (0, 1)}  # a plus: front, back, right, left
    found = {corner: positions[int(np.argmax(positions[:, :2] @ np.array(sign)))] for corner, sign in corners.items()}
    lines = [
        f"mass: {number(vehicle.mass_kg)}",
        *(f"tbm_{corner}: [{', '.join(number(v) for v in at)}]" for corner, at in found.items()),
        f"inertia: [{', '.join(number(getattr(vehicle.inertia_kg_m2, n)) for n in ('xx', 'yy', 'zz'))}]",
        "motor_omega_min: 0.0",
        f"motor_omega_max: {number(top)}",
        f"motor_tau: {number(max(model.mean_lag_s(), 1e-3))}",
        f"thrust_map: [{number(k)}, 0.0, 0.0]",
        f"kappa: {number(vehicle.rotors.torque_to_thrust_m)}",
        "thrust_min: 0.0",
        f"thrust_max: {number(k * top**2)}",
        'rotors_config: "cross"' if "fr" in corners and corners["fr"] == (1, -1) else 'rotors_config: "plus"',
    ]
    notes = [
        *model.provenance({"com_offset"}),
        "SI units. Products of inertia are not held. tbm: rotor positions from the centre of mass.",
    ]
    return hash_comment(notes) + "\n".join(lines) + "\n"


def _propellers(rotors: Rotors, k: float, top: float) -> list[str]:
    """Webots' devices, a line each of their fields."""
    lines: list[str] = []
    each = zip(rotors.position_m, rotors.spin, rotors.axes(), strict=True)
    for i, (position, spin, axis) in enumerate(each, start=1):
        lines += [
            "      Propeller {",
            f"        shaftAxis {numbers(axis)}",
            f"        centerOfThrust {numbers(position)}",
            f"        thrustConstants {number(spin * k)} 0",
            f"        torqueConstants {number(k * rotors.torque_to_thrust_m)} 0",
            f'        device RotationalMotor {{ name "rotor{i}" maxVelocity {number(top)} }}',
            "      }",
        ]
    return lines


def to_webots(model: Identified) -> str:
    """A Webots PROTO: a robot with mass, centre and tensor, and a propeller device per rotor (thrust k Omega
    |Omega|).
    """
    k, top = _speed_driven(model, "webots")
    rigid = as_rigid_body(model)
    vehicle = rigid.vehicle
    t = vehicle.inertia_kg_m2
    body = [
        "#VRML_SIM R2023b utf8",
        hash_comment(
            [
                *rigid.provenance({"com_offset"}),
                "SI units; inertiaMatrix is xx yy zz, then xy xz yz, about the centre of mass.",
            ]
        ).rstrip(),
        f"PROTO {identifier(vehicle.name)} [",
        "  field SFVec3f translation 0 0 0.1",
        "  field SFRotation rotation 0 0 1 0",
        '  field SFString controller "<none>"',
        "] {",
        "  Robot {",
        "    translation IS translation",
        "    rotation IS rotation",
        "    controller IS controller",
        "    children [",
    ]
    body += _propellers(vehicle.rotors, k, top)
    half = 2.0 * float(np.abs(np.asarray(vehicle.rotors.position_m)[:, :2]).max())
    body += [
        f"      Shape {{ appearance PBRAppearance {{ }} geometry Box {{ size {number(half)} {number(half)} 0.02 }} }}",
        "    ]",
        f"    boundingObject Box {{ size {number(half)} {number(half)} 0.02 }}",
        "    physics Physics {",
        "      density -1",
        f"      mass {number(vehicle.mass_kg)}",
        f"      centerOfMass [ {numbers(rigid.com_offset_m)} ]",
        f"      inertiaMatrix [ {numbers([t.xx, t.yy, t.zz])}, {numbers([t.xy, t.xz, t.yz])} ]",
        "    }",
        "  }",
        "}",
    ]
    return "\n".join(body) + "\n"


def _flat(model: Identified) -> dict[str, float]:
    """Numbers by name: mass, tensor, rotor constants, lag, delay, centre of mass."""
    values = model.vehicle.parameters()
    values |= {f"com_offset_{a}_m": float(v) for a, v in zip("xyz", model.com_offset_m, strict=True)}
    values["input_delay_s"] = model.delay_s
    return {name: float(value) for name, value in values.items()}


def to_matlab(model: Identified) -> str:
    """A MATLAB script that fills the struct ``vehicle``: values, standard deviations, geometry, and the variances as a
    matrix.
    """
    values = _flat(model)
    vehicle = model.vehicle
    lines = [*(f"% {line}" for sentence in model.provenance() for line in sentence.splitlines())]
    lines += [
        "% SI units, named in each field. x forward, y left, z up. A standard deviation of 0: declared, not identified."
    ]
    lines += ["vehicle = struct();", f"vehicle.name = '{identifier(vehicle.name)}';"]
    lines += [f"vehicle.{name} = {number(value)};" for name, value in values.items()]
    tensor = "; ".join(numbers(row) for row in vehicle.inertia_tensor())
    lines += [f"vehicle.inertia_kg_m2 = [{tensor}];"]
    lines += [f"vehicle.rotor_position_m = [{'; '.join(numbers(p) for p in vehicle.rotors.position_m)}];"]
    lines += [f"vehicle.rotor_axis = [{'; '.join(numbers(a) for a in vehicle.rotors.axes())}];"]
    lines += [f"vehicle.rotor_spin = [{numbers(vehicle.rotors.spin)}];"]
    lines += [f"vehicle.std.{name} = {number(model.std.get(name, 0.0))};" for name in values]
    return "\n".join(lines) + "\n"


def to_matfile(model: Identified) -> bytes:
    """A MAT-file (version 5) with the struct ``vehicle``, as :func:`to_matlab` fills it; the same model gives the same
    bytes.
    """
    from scipy.io import savemat

    vehicle, values = model.vehicle, _flat(model)
    fields = {
        "name": identifier(vehicle.name),
        "provenance": "\n".join(model.provenance()),
        **values,
        "inertia_kg_m2": vehicle.inertia_tensor(),
        "rotor_position_m": np.asarray(vehicle.rotors.position_m),
        "rotor_axis": vehicle.rotors.axes(),
        "rotor_spin": np.asarray(vehicle.rotors.spin, dtype=float),
        "std": {name: model.std.get(name, 0.0) for name in values},
    }
    file = io.BytesIO()
    savemat(file, {"vehicle": fields}, long_field_names=True)  # pyright: ignore[reportArgumentType] - an open file, too
    head = b"MATLAB 5.0 MAT-file, written by groundstation"  # instead of the date at which it was written
    return head.ljust(MAT_TEXT) + file.getvalue()[MAT_TEXT:]


def to_crazyflie(model: Identified) -> str:
    """Parameters of the Crazyflie firmware's Lee and Mellinger controllers, as cflib stores them from a file (YAML).

    The firmware holds the mass and, in its Lee controller, principal moments; thrust and lag are compiled in.
    """
    vehicle = model.vehicle
    tensor = vehicle.inertia_kg_m2
    values = {
        "ctrlLee.J_x": tensor.xx,
        "ctrlLee.J_y": tensor.yy,
        "ctrlLee.J_z": tensor.zz,
        "ctrlLee.mass": vehicle.mass_kg,
        "ctrlMel.mass": vehicle.mass_kg,
    }
    lines = ["params:"]
    for name, value in values.items():
        shown = _yaml(value)
        lines += [f"  {name}:", f"    default_value: {shown}", "    is_stored: true", f"    stored_value: {shown}"]
    lines += ["type: persistent_param_state", "version: '1'"]
    notes = [*model.provenance(), "kg and kg m^2. default_value is not the firmware's own: it is what is stored."]
    return hash_comment(notes) + "\n".join(lines) + "\n"


def to_ros2(model: Identified) -> str:
    """A ROS 2 parameter file for any node: values and, under ``std``, standard deviations."""
    values = _flat(model)
    vehicle = model.vehicle
    indent = " " * 6
    lines = ["/**:", "  ros__parameters:", "    vehicle:", f"{indent}name: {identifier(vehicle.name)}"]
    lines += [f"{indent}{name}: {_yaml(value)}" for name, value in values.items()]
    lines += [
        f"{indent}rotor_{a}_m: [{', '.join(_yaml(p[i]) for p in vehicle.rotors.position_m)}]"
        for i, a in enumerate("xyz")
    ]
    lines += [
        f"{indent}rotor_axis_{a}: [{', '.join(_yaml(v) for v in column)}]"
        for a, column in zip("xyz", vehicle.rotors.axes().T, strict=True)
    ]
    lines += [f"{indent}rotor_spin: [{', '.join(_yaml(s) for s in vehicle.rotors.spin)}]", f"{indent}std:"]
    lines += [f"{indent}  {name}: {_yaml(model.std[name])}" for name in values if name in model.std]
    return hash_comment([*model.provenance(), "SI units, named in each key."]) + "\n".join(lines) + "\n"


def _yaml(value: float) -> str:
    """A YAML number that stays a float: ROS parameters are typed."""
    text = f"{float(value):.9g}"
    mantissa, _, exponent = text.partition("e")
    mantissa = mantissa if "." in mantissa else f"{mantissa}.0"
    return f"{mantissa}e{exponent}" if exponent else mantissa
