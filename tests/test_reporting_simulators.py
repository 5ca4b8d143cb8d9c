"""Exports for simulators and robotics, read back by the programs they are for."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import yaml

from groundstation.diagnosis.results import Diagnosis, Finding
from groundstation.frames import skew
from groundstation.identification.results import Estimate
from groundstation.reporting.exports import export, mat_file, model_document
from tests.exported import MASS, OFFSET, TENSOR, document, planted, tensor_of, x_frame, xml


def test_mujoco_loads_mass_centre_tensor_and_wrench():
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(export(document(), "mjcf"))
    body = model.body("base").id
    assert model.body_mass[body] == pytest.approx(MASS, rel=1e-8)
    np.testing.assert_allclose(model.body_ipos[body], OFFSET, rtol=1e-8)
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
    axes = rotation.reshape(3, 3)
    np.testing.assert_allclose(axes @ np.diag(model.body_inertia[body]) @ axes.T, TENSOR, atol=1e-9)

    # One rotor at 2 N: acceleration of a free body at rest, from Newton and Euler about the centre of mass.
    data = mujoco.MjData(model)
    vehicle = x_frame()
    for i, (position, spin) in enumerate(zip(vehicle.rotors.position_m, vehicle.rotors.spin, strict=True)):
        mujoco.mj_resetData(model, data)
        data.act[:] = 0.0
        data.act[i] = 2.0
        mujoco.mj_forward(model, data)
        torque = np.cross(np.array(position) - OFFSET, [0.0, 0.0, 2.0]) + np.array([0.0, 0.0, -spin * 0.016 * 2.0])
        np.testing.assert_allclose(data.qacc[3:6], np.linalg.solve(TENSOR, torque), rtol=1e-6, atol=1e-9)
    assert model.actuator_ctrlrange[0, 1] == pytest.approx(vehicle.rotor_thrust_max_n(), rel=1e-6)


def composite(links: list[tuple[float, np.ndarray, np.ndarray]]) -> tuple[Any, Any, Any]:
    """Mass, centre and central tensor of rigidly joined links (mass, centre, central tensor), by S(d)^T S(d)."""
    mass = sum(m for m, _, _ in links)
    centre = sum(m * c for m, c, _ in links) / mass
    tensor = sum(t + m * skew(c - centre).T @ skew(c - centre) for m, c, t in links)
    return mass, centre, tensor


def test_gazebo_links_together_weigh_and_turn_as_identified():
    root = xml(export(document(), "sdf"))
    links = []
    for link in root.iter("link"):
        pose = np.array((link.findtext("pose") or "0 0 0").split()[:3], dtype=float)
        inertial = link.find("inertial")
        inner = np.array(inertial.findtext("pose").split()[:3], dtype=float)
        tensor = tensor_of(lambda n, i=inertial: i.findtext(f"inertia/i{n}"))
        links.append((float(inertial.findtext("mass")), pose + inner, tensor))
    assert len(links) == 5
    mass, centre, tensor = composite(links)
    assert mass == pytest.approx(MASS, rel=1e-7)
    np.testing.assert_allclose(centre, OFFSET, atol=1e-9)
    np.testing.assert_allclose(tensor, TENSOR, atol=1e-10)

    plugins = list(root.iter("plugin"))
    assert [p.findtext("turningDirection") for p in plugins] == ["ccw", "ccw", "cw", "cw"]
    k, top = float(plugins[0].findtext("motorConstant")), float(plugins[0].findtext("maxRotVelocity"))
    assert k * top**2 == pytest.approx(x_frame().rotor_thrust_max_n())
    assert (plugins[2].findtext("timeConstantUp"), plugins[2].findtext("timeConstantDown")) == ("0.04", "0.06")
    # Gazebo: per rotor, drag = coefficient |Omega| v. Together at hover they must give 0.3 N per m/s.
    hover = np.sqrt(MASS * 9.80665 / (4 * k))
    assert 4 * hover * float(plugins[0].findtext("rotorDragCoefficient")) == pytest.approx(0.3, rel=1e-6)


def test_rotorpy_gets_the_aerodynamics_that_were_found():
    """At hover speeds, RotorPy's own aerodynamics must give the forces and moments of our effects' equations."""
    multirotor = pytest.importorskip("rotorpy.vehicles.multirotor")

    def found(effect: str, **parameters: float) -> Finding:
        return Finding(effect, {n: Estimate.normal(v, 0.01) for n, v in parameters.items()}, "", 0.9)

    findings = (
        found("rotor_drag", d_x_kg_s=0.3, d_y_kg_s=0.3),
        found("climb_inflow", k_kg_s=0.5),
        found("body_drag", c_kg_m=0.04),
        found("translational_lift", lift_s2_m2=0.006),
        found("flapping_moment", k_nm_s_m=0.02),
    )
    centred = replace(planted(), model={})
    text = export(model_document(centred, x_frame(), Diagnosis("f", "v", "explained", findings=findings)), "rotorpy")
    scope: dict = {}
    exec(text, scope)  # noqa: S102
    assert "not held" not in text
    quad = multirotor.Multirotor(scope["quad_params"])
    weight = MASS * 9.80665
    hover = np.full(4, np.sqrt(weight / (4 * 1.11e-5)))
    v = np.array([1.2, -0.7, 0.4])
    still, _ = quad.compute_body_wrench(np.zeros(3), hover, np.zeros(3))
    force, moment = quad.compute_body_wrench(np.zeros(3), hover, v)
    expected = -0.04 * np.linalg.norm(v) * v - np.array([0.3, 0.3, 0.5]) * v
    expected[2] += 0.006 * (v[0] ** 2 + v[1] ** 2) * weight
    np.testing.assert_allclose(force - still, expected, rtol=1e-6)
    # Rotors sit 1 cm above the centre of mass: their drag also turns the vehicle.
    lever = np.cross([0.0, 0.0, 0.01], np.array([-0.3, -0.3, 0.0]) * v)
    np.testing.assert_allclose(moment - lever, 0.02 * np.array([v[1], -v[0], 0.0]), rtol=1e-6, atol=1e-12)


def test_urdf_carries_the_tensor_with_its_signs():
    root = xml(export(document(), "urdf"))
    inertia = root.find("link/inertial/inertia")
    np.testing.assert_allclose(tensor_of(lambda n: inertia.get(f"i{n}")), TENSOR, rtol=1e-8)
    assert float(root.find("link/inertial/mass").get("value")) == pytest.approx(MASS)
    np.testing.assert_allclose(np.array(root.find("link/inertial/origin").get("xyz").split(), dtype=float), OFFSET)
    fourth = next(j for j in root.iter("joint") if j.get("name") == "rotor_4_joint")
    assert fourth.find("origin").get("xyz") == "-0.16 -0.18 0.01"


def test_rotorpy_accelerates_as_the_numbers_say():
    multirotor = pytest.importorskip("rotorpy.vehicles.multirotor")
    scope: dict = {}
    exec(export(document(), "rotorpy"), scope)  # noqa: S102
    from rotorpy.vehicles.crazyflie_params import quad_params as theirs

    params = scope["quad_params"]
    assert set(params) >= {k for k in theirs if not k.startswith(("k_w", "k_v", "kp_", "kd_"))}
    speeds = np.array([600.0, 610.0, 650.0, 640.0])
    velocity = np.array([0.5, -0.2, 0.0])
    state = {
        "x": np.zeros(3),
        "v": velocity,
        "q": np.array([0.0, 0.0, 0.0, 1.0]),
        "w": np.zeros(3),
        "wind": np.zeros(3),
        "rotor_speeds": speeds,
    }
    quad = multirotor.Multirotor(params, initial_state=state)
    # RotorPy also turns the rotors' drag into a moment; without motion there is none.
    rate = quad.statedot({**state, "v": np.zeros(3)}, {"cmd_motor_speeds": speeds}, 0.0)
    thrust = 1.11e-5 * speeds**2
    vehicle = x_frame()
    arms = np.asarray(vehicle.rotors.position_m) - OFFSET
    torque = np.cross(arms, np.outer(thrust, [0, 0, 1])).sum(axis=0)
    torque[2] += -np.dot(vehicle.rotors.spin, 0.016 * thrust)
    np.testing.assert_allclose(rate["wdot"], np.linalg.solve(TENSOR, torque), rtol=1e-9)
    moving = quad.statedot(state, {"cmd_motor_speeds": speeds}, 0.0)
    hover = 4 * np.sqrt(MASS * 9.81 / (4 * 1.11e-5))
    np.testing.assert_allclose(
        MASS * (moving["vdot"] - rate["vdot"])[:2], -0.3 * speeds.sum() / hover * velocity[:2], rtol=1e-3
    )


def test_rotorpy_never_divides_by_a_lag_of_zero():
    """Multirotor divides by tau_m; a vehicle without lag must fly there."""
    multirotor = pytest.importorskip("rotorpy.vehicles.multirotor")
    model = document()
    model["model"] |= {f"rotor_lag_{side}_s": {"value": 0.0, "std": 0.0} for side in ("up", "down")}
    text = export(model, "rotorpy")
    names: dict = {}
    exec(text, names)  # noqa: S102
    assert names["quad_params"]["tau_m"] == 1e-3 and "no lag was found" in text
    body = multirotor.Multirotor(names["quad_params"])
    state = {"x": np.zeros(3), "v": np.zeros(3), "q": np.array([0, 0, 0, 1.0]), "w": np.zeros(3), "wind": np.zeros(3)}
    after = body.step(state | {"rotor_speeds": np.full(4, 400.0)}, {"cmd_motor_speeds": np.full(4, 500.0)}, 0.01)
    np.testing.assert_allclose(after["rotor_speeds"], 500.0, rtol=1e-2)


def test_pybullet_loads_mass_centre_and_tensor(tmp_path):
    """Bullet's own reader; principal moments, as it keeps no products."""
    pybullet = pytest.importorskip("pybullet")
    path = tmp_path / "vehicle.urdf"
    path.write_text(export(document(), "pybullet"), encoding="utf-8")
    client = pybullet.connect(pybullet.DIRECT)
    try:
        body = pybullet.loadURDF(str(path), flags=pybullet.URDF_USE_INERTIA_FROM_FILE, physicsClientId=client)
        info = pybullet.getDynamicsInfo(body, -1, physicsClientId=client)
        assert pybullet.getNumJoints(body, physicsClientId=client) == 5
    finally:
        pybullet.disconnect(client)
    assert info[0] == pytest.approx(MASS)
    np.testing.assert_allclose(np.sort(info[2]), np.linalg.eigvalsh(TENSOR), rtol=1e-5)
    np.testing.assert_allclose(info[3], OFFSET, atol=1e-9)
    properties = xml(export(document(), "pybullet")).find("properties")
    speed, vehicle = 4000.0, x_frame()
    thrust = float(properties.get("kf")) * speed**2
    assert thrust == pytest.approx(float(vehicle.thrust(speed * np.pi / 30.0)), rel=1e-6)
    assert float(properties.get("km")) / float(properties.get("kf")) == pytest.approx(vehicle.rotors.torque_to_thrust_m)


def test_scipy_reads_the_mat_file_whole(tmp_path):
    """The struct holds what the script says, the tensor with its products, and a deviation for each value; bytes are
    repeatable.
    """
    from scipy.io import loadmat

    path = tmp_path / "vehicle.mat"
    path.write_bytes(mat_file(document()))
    vehicle = loadmat(path, simplify_cells=True)["vehicle"]
    assert vehicle["mass_kg"] == MASS and vehicle["std"]["mass_kg"] == pytest.approx(0.002)
    np.testing.assert_array_equal(vehicle["inertia_kg_m2"], TENSOR)
    np.testing.assert_allclose([vehicle[f"com_offset_{a}_m"] for a in "xyz"], OFFSET)
    np.testing.assert_array_equal(vehicle["rotor_position_m"], x_frame().rotors.position_m)
    script = export(document(), "matlab")
    for name, value in vehicle.items():
        if isinstance(value, float):
            assert f"vehicle.{name} = " in script
    assert mat_file(document()) == path.read_bytes()


def test_crazyflow_and_agilicious_give_each_rotor_its_torque():
    """Torques by the readers' own mixing: crazyflow's signs times L, Agilicious' positions."""
    vehicle = x_frame(position_m=[[0.17, -0.17, 0.0], [-0.17, 0.17, 0.0], [0.17, 0.17, 0.0], [-0.17, -0.17, 0.0]])
    model = model_document(replace(planted(), model={}), vehicle)
    (table,) = tomllib.loads(export(model, "crazyflow")).values()
    np.testing.assert_allclose(table["J"], TENSOR)
    thrust = np.array([1.0, 2.0, 3.0, 4.0])
    mixing = np.array(table["mixing_matrix"])
    ratio = table["rpm2torque"][2] / table["rpm2thrust"][2]
    torque = [table["L"] * mixing[0] @ thrust, table["L"] * mixing[1] @ thrust, ratio * mixing[2] @ thrust]
    np.testing.assert_allclose(torque, (vehicle.allocation() @ thrust)[1:], rtol=1e-6, atol=1e-12)
    quad = yaml.safe_load(export(model, "agilicious"))
    np.testing.assert_allclose(quad["tbm_fl"], [0.17, 0.17, 0.0])
    np.testing.assert_allclose(quad["tbm_br"], [-0.17, -0.17, 0.0])
    assert quad["thrust_map"][0] * quad["motor_omega_max"] ** 2 == pytest.approx(quad["thrust_max"])


def test_ros2_parameters_are_floats_and_carry_the_spread():
    values = yaml.safe_load(export(document(), "ros2"))["/**"]["ros__parameters"]["vehicle"]
    assert values["mass_kg"] == pytest.approx(MASS) and values["std"]["mass_kg"] == pytest.approx(0.002)
    assert all(isinstance(v, float) for v in [*values["rotor_spin"], values.get("rotor_lag_up_s", 0.0)])


def test_a_model_has_a_frame_that_one_sees_and_that_weighs_nothing():
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(export(document(), "mjcf"))
    assert model.ngeom == 8 and model.body_mass.sum() == pytest.approx(MASS)
    assert len(xml(export(document(), "urdf")).findall("link/visual")) == 8
