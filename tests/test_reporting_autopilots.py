"""Exports for autopilots: the numbers fly as the autopilot computes with them."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import yaml

from groundstation.errors import BadInput
from groundstation.paths import find_config
from groundstation.reporting.exports import export, model_document
from groundstation.vehicle import load_vehicle
from tests.exported import MASS, OFFSET, TENSOR, document, planted, tensor_of, x_frame


def test_px4_flies_the_same_torque_in_its_own_axes():
    """Turn SIH's FRD tensor, thrusts and torques back into FLU: angular acceleration must be that of our own
    numbers.
    """
    lines = [line.split("\t") for line in export(document(), "px4-sih").splitlines() if not line.startswith("#")]
    assert {(len(row), row[4]) for row in lines} == {(5, "9")}
    p = {row[2]: float(row[3]) for row in lines}
    frd = tensor_of(lambda n: p[f"SIH_I{n.upper()}"])
    turn = np.diag([1.0, -1.0, -1.0])
    np.testing.assert_allclose(turn @ frd @ turn, TENSOR, rtol=1e-6)
    assert p["SIH_MASS"] == pytest.approx(MASS)
    assert p["SIH_KDV"] == pytest.approx(0.3)
    assert p["SIH_T_TAU"] == pytest.approx(0.05)

    u = np.array([0.3, 0.5, 0.2, 0.7])  # sih.cpp: mixing of its quadrotor, FRD
    roll = p["SIH_L_ROLL"] * p["SIH_T_MAX"] * (-u[0] + u[1] + u[2] - u[3])
    pitch = p["SIH_L_PITCH"] * p["SIH_T_MAX"] * (u[0] - u[1] + u[2] - u[3])
    yaw = p["SIH_Q_MAX"] * (u[0] + u[1] - u[2] - u[3])
    ours = x_frame().allocation() @ (p["SIH_T_MAX"] * u)
    np.testing.assert_allclose(turn @ [roll, pitch, yaw], ours[1:], rtol=1e-6)


def test_px4_gets_the_rotors_of_a_shuffled_vehicle_in_its_own_order():
    plain = x_frame()
    shuffled = x_frame(position_m=[plain.rotors.position_m[i] for i in (2, 0, 3, 1)], spin=[-1, 1, -1, 1])
    text = export(document(shuffled), "px4-sih")
    assert "PX4 motors 1 to 4 are rotors 2, 4, 1, 3 " in text


def test_px4_refuses_frames_it_cannot_hold():
    with pytest.raises(BadInput, match="symmetric X"):
        export(document(load_vehicle(find_config("vehicles", "qball2"))), "px4-sih")
    with pytest.raises(BadInput, match="counter-clockwise"):
        export(document(x_frame(spin=[-1, -1, 1, 1])), "px4-sih")


def test_crazyflie_parameters_have_the_form_that_cflib_stores(tmp_path):
    """As cflib's ParamFileManager asks: type, version, and for each parameter whether it is stored, and its values."""
    text = export(document(), "crazyflie")
    told = yaml.safe_load(text)
    assert (told["type"], told["version"]) == ("persistent_param_state", "1")
    stored = {name: each["stored_value"] for name, each in told["params"].items() if each["is_stored"]}
    assert stored == pytest.approx(
        {
            "ctrlLee.J_x": 0.0268,
            "ctrlLee.J_y": 0.0331,
            "ctrlLee.J_z": 0.0412,
            "ctrlLee.mass": MASS,
            "ctrlMel.mass": MASS,
        }
    )
    assert all(set(each) == {"is_stored", "default_value", "stored_value"} for each in told["params"].values())
    cflib = pytest.importorskip("cflib.localization")
    (tmp_path / "p.yaml").write_text(text)
    assert cflib.ParamFileManager.read(str(tmp_path / "p.yaml"))["ctrlLee.mass"].stored_value == pytest.approx(MASS)


def _ardupilot_wrench(frame: dict[str, Any], commands: np.ndarray, speed_m_s: float) -> np.ndarray:
    """Force and torque (FRD) at an air speed along x, as SIM_Frame.cpp and SIM_Motor.cpp compute them at the reference
    height.
    """
    rho, weight = 1.157, frame["mass"] * 9.80665
    tilt = np.radians(frame["refAngle"])
    drag_force, along = weight * np.tan(tilt), frame["refSpd"] * np.cos(tilt)
    momentum = np.cos(tilt) * frame["mdrag_coef"] * along * np.sqrt(weight / np.cos(tilt) * rho * frame["disc_area"])
    area_cd = max(0.0, drag_force - momentum) / (0.5 * rho * frame["refSpd"] ** 2)
    e, force, torque = frame["propExpo"], np.zeros(3), np.zeros(3)
    for i, pulse in enumerate(1000.0 + 1000.0 * commands, start=1):
        low = frame["pwmMin"] + frame["spin_min"] * (frame["pwmMax"] - frame["pwmMin"])
        high = frame["pwmMin"] + frame["spin_max"] * (frame["pwmMax"] - frame["pwmMin"])
        u = (pulse - low) / (high - low)
        thrust = weight / frame["num_motors"] / frame["hoverThrOut"] * ((1.0 - e) * u + e * u**2)
        twist = np.array([0.0, 0.0, frame[f"motor{i}_yaw"] * u * 0.05 * frame["diagonal_size"] * thrust])
        drag = (
            frame["mdrag_coef"] * np.sqrt(rho * frame["disc_area"] / frame["num_motors"]) * speed_m_s * np.sqrt(thrust)
        )
        push = np.array([-drag, 0.0, -thrust])
        force += push
        torque += np.cross(frame[f"motor{i}_position"], push) + twist
    return np.concatenate([force - [area_cd * 0.5 * rho * speed_m_s**2, 0.0, 0.0], torque])


def test_ardupilot_gives_thrust_torque_and_drag_as_its_frame_code_computes_them():
    frame = json.loads(re.sub("#.*", "", export(document(), "ardupilot-sitl")))
    vehicle = x_frame()
    top_speed = vehicle.rotors.speed_max_rad_s or 0.0
    hover = float(vehicle.motor_for_thrust(MASS * 9.80665 / 4.0)) / top_speed
    commands = hover + np.array([0.02, -0.01, 0.015, -0.02])
    thrust = vehicle.thrust(commands * top_speed)
    wrench = _ardupilot_wrench(frame, commands, 0.0)
    assert -wrench[2] == pytest.approx(thrust.sum())
    arms = np.asarray(vehicle.rotors.position_m) - OFFSET
    torque = np.cross(arms, np.outer(thrust, [0.0, 0.0, 1.0])).sum(axis=0)
    np.testing.assert_allclose(wrench[3:5], [torque[0], -torque[1]])
    reaction = vehicle.rotors.torque_to_thrust_m * np.asarray(vehicle.rotors.spin) @ thrust
    assert wrench[5] == pytest.approx(reaction, rel=0.01), "slope matched at hover, curvature not"
    assert _ardupilot_wrench(frame, np.full(4, hover), 2.0)[0] == pytest.approx(-0.3 * 2.0)
    np.testing.assert_allclose(frame["moment_inertia"], np.diag(TENSOR))
    assert frame["refRotRate"] == 0.0, "no damping was found"


def test_ardupilot_has_no_drag_where_none_was_found():
    frame = json.loads(re.sub("#.*", "", export(model_document(planted(), x_frame()), "ardupilot-sitl")))
    assert _ardupilot_wrench(frame, np.full(4, 0.7), 3.0)[0] == 0.0


def test_sih_never_divides_by_a_lag_shorter_than_its_step():
    """sih.cpp: u += dt / SIH_T_TAU (command - u), with dt of 5 ms at the most."""
    without = replace(planted(), model={})
    vehicle = x_frame(lag={"up_s": 0.0, "down_s": 0.0})
    assert "SIH_T_TAU\t0.005\t" in export(model_document(without, vehicle), "px4-sih")
