"""A MuJoCo model of an identified vehicle."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from groundstation.reporting.identified import Identified, as_rigid_body
from groundstation.reporting.simulators import child, comment, identifier, number, numbers, xml_text


def to_mjcf(model: Identified) -> str:
    """A MuJoCo model: a free body with one site and one actuator per rotor; the control is the rotor's thrust, N."""
    model = as_rigid_body(model)
    vehicle, rotors = model.vehicle, model.vehicle.rotors
    k = rotors.thrust_coefficient_n_s2
    curve = f"T = {number(k)} Omega^2" if k else "T from the thrust curve"
    notes = [
        *model.provenance({"com_offset", "weak_rotor"}),
        "SI units; x forward, y left, z up; fullinertia is xx yy zz xy xz yz, entries of the tensor about the centre "
        "of mass.",
        f"Controls are rotor thrusts in newton ({curve}); the mean of the lags up and down acts on the thrust.",
    ]
    root = ET.Element("mujoco", model=identifier(vehicle.name))
    root.append(comment(notes))
    child(root, "compiler", angle="radian", autolimits="true")
    child(root, "option", gravity=f"0 0 {number(-vehicle.gravity_m_s2)}", timestep="0.001", integrator="RK4")
    _mjcf_body(child(root, "worldbody"), model)
    _mjcf_actuators(child(root, "actuator"), model)
    sensors = child(root, "sensor")
    child(sensors, "gyro", name="gyro", site="imu")
    child(sensors, "accelerometer", name="accelerometer", site="imu")
    return xml_text(root)


def _mjcf_body(world: ET.Element, model: Identified) -> None:
    """The free body, a site per rotor and for the IMU, arms and discs to look at."""
    vehicle, rotors = model.vehicle, model.vehicle.rotors
    body = child(world, "body", name="base")
    child(body, "freejoint", name="root")
    entries = [getattr(vehicle.inertia_kg_m2, name) for name in ("xx", "yy", "zz", "xy", "xz", "yz")]
    child(body, "inertial", pos=numbers(model.com_offset_m), mass=number(vehicle.mass_kg), fullinertia=numbers(entries))
    for i, position in enumerate(rotors.position_m, start=1):
        child(body, "site", name=f"rotor{i}", pos=numbers(position))
    look = {"mass": "0", "contype": "0", "conaffinity": "0", "group": "1"}
    for position in rotors.position_m:
        width = 0.04 * float(np.linalg.norm(position))
        arm = {"fromto": f"0 0 0 {numbers(position)}", "size": number(width), "rgba": "0.3 0.3 0.35 1"}
        child(body, "geom", type="capsule", **arm, **look)
        size = numbers([rotors.radius_m, 0.25 * width])
        child(body, "geom", type="cylinder", pos=numbers(position), size=size, rgba="0.2 0.5 0.8 0.4", **look)
    child(body, "site", name="imu", pos=numbers(vehicle.imu.position_m))


def _mjcf_actuators(actuators: ET.Element, model: Identified) -> None:
    """One per rotor: thrust along its axis and the reaction torque, behind the mean lag."""
    rotors = model.vehicle.rotors
    lag, top = model.mean_lag_s(), model.vehicle.rotor_thrust_max_n()
    for i, (spin, share) in enumerate(zip(rotors.spin, model.rotor_effectiveness, strict=True), start=1):
        push = share * rotors.axes()[i - 1]
        attributes = {
            "name": f"rotor{i}",
            "site": f"rotor{i}",
            "gear": f"{numbers(push)} {numbers(-spin * rotors.torque_to_thrust_m * push + 0.0)}",
        }
        if np.isfinite(top):
            attributes["ctrlrange"] = f"0 {number(top)}"
        if lag > 0.0:
            attributes |= {"dyntype": "filterexact", "dynprm": number(lag)}
        child(actuators, "general", **attributes)
