"""Exports read back by readers nobody here wrote, and compared with what was identified, signs included."""

from __future__ import annotations

import csv
import io
import json
import re
import tomllib
import xml.etree.ElementTree as ET
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from groundstation.diagnosis.results import Diagnosis, Finding
from groundstation.errors import BadInput
from groundstation.frames import skew
from groundstation.identification.results import Estimate, Identification
from groundstation.paths import find_config
from groundstation.reporting.exports import FORMATS, export, mat_file, model_document, read_model, write_model
from groundstation.vehicle import Vehicle, load_vehicle, vehicle_from_dict, vehicle_to_dict
from tests.reporting_fixture import identification

TENSOR = np.array([[0.0268, 0.0011, -0.0006], [0.0011, 0.0331, 0.0004], [-0.0006, 0.0004, 0.0412]])
MASS = 1.8258
OFFSET = np.array([0.004, -0.003, 0.002])


def x_frame(**rotors: object) -> Vehicle:
    """An X quadrotor with PX4's numbering and spins."""
    document = vehicle_to_dict(load_vehicle(find_config("vehicles", "qball2")))
    document["rotors"] |= {
        "position_m": [[0.16, -0.18, 0.01], [-0.16, 0.18, 0.01], [0.16, 0.18, 0.01], [-0.16, -0.18, 0.01]]
    }
    document["rotors"] |= {"spin": [1, 1, -1, -1], **rotors}
    return vehicle_from_dict(document)


def planted(tensor: np.ndarray = TENSOR) -> Identification:
    axes = [("xx", 0, 0), ("xy", 0, 1), ("xz", 0, 2), ("yy", 1, 1), ("yz", 1, 2), ("zz", 2, 2)]
    parameters = {
        "mass_kg": Estimate.normal(MASS, 0.002),
        **{f"i{n}_kg_m2": Estimate.normal(tensor[i, j], 1e-4) for n, i, j in axes},
    }
    base = identification()
    model = {
        "rotor_lag_up_s": Estimate.normal(0.04, 0.001),
        "rotor_lag_down_s": Estimate.normal(0.06, 0.001),
        "input_delay_s": Estimate.normal(0.002, 0.001),
        **{f"com_offset_{a}_m": Estimate.normal(v, 1e-4) for a, v in zip("xyz", OFFSET, strict=True)},
    }
    methods = {"PE": replace(base.methods["PE"], parameters=parameters)}
    return replace(base, methods=methods, model=model, not_identifiable={})


def drag() -> Diagnosis:
    finding = Finding(
        "rotor_drag", {"d_x_kg_s": Estimate.normal(0.3, 0.01), "d_y_kg_s": Estimate.normal(0.3, 0.01)}, "", 0.99
    )
    return Diagnosis("f", "v", "explained", findings=(finding,))


def xml(text: str) -> Any:
    """The root of what we wrote."""
    return ET.fromstring(text)  # noqa: S314


def document(vehicle: Vehicle | None = None, tensor: np.ndarray = TENSOR) -> dict:
    return model_document(planted(tensor), vehicle or x_frame(), drag())


def tensor_of(get) -> np.ndarray:
    xx, xy, xz, yy, yz, zz = (float(get(n)) for n in ("xx", "xy", "xz", "yy", "yz", "zz"))
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@pytest.mark.parametrize("suffix", [".toml", ".json"])
def test_a_model_document_survives_its_file(tmp_path, suffix):
    path = write_model(tmp_path / f"identification{suffix}", document())
    assert read_model(path) == document()
    assert read_model(path)["effects"]["rotor_drag"]["d_x_kg_s"] == {"value": 0.3, "std": 0.01}
    assert vehicle_from_dict(read_model(path)["vehicle"]) == x_frame()


def test_the_json_of_identify_exports_the_same_once_the_vehicle_is_given(tmp_path):
    path = tmp_path / "identification.json"
    path.write_text(json.dumps(planted().to_dict()), encoding="utf-8")
    with pytest.raises(BadInput, match="--vehicle"):
        export(path, "urdf")
    without_effects = model_document(planted(), x_frame())
    assert export(path, "urdf", x_frame()) == export(without_effects, "urdf")


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


def weak_rotors() -> Diagnosis:
    def loss(value: float) -> dict[str, Estimate]:
        return {"loss": Estimate.normal(value, 0.01)}

    findings = (
        Finding("weak_rotor", loss(0.1), "", 0.9, rotor=3),
        Finding("weak_rotor", loss(0.2), "", 0.9, rotor=1),
        Finding(
            "payload_change",
            {"mass_change_kg": Estimate.normal(0.2, 0.01), "at_s": Estimate(12.0, 0.0, (12.0, 12.0))},
            "",
            0.9,
        ),
        Finding("clock_offset", {"mocap_minus_imu_s": Estimate.normal(0.01, 0.001)}, "", 0.9),
    )
    return Diagnosis("f", "v", "explained", findings=findings)


def test_two_weak_rotors_stay_two_and_keep_their_places():
    model = model_document(planted(), x_frame(), weak_rotors())
    assert {name: v["rotor"]["value"] for name, v in model["effects"].items() if "rotor" in v} == {
        "weak_rotor": 3.0,
        "weak_rotor/2": 1.0,
    }
    assert tomllib.loads(export(model, "toml")) == model
    root = xml(export(model, "sdf"))
    constants = [float(p.findtext("motorConstant")) for p in root.iter("plugin")]
    np.testing.assert_allclose(constants, 1.11e-5 * np.array([0.8, 1.0, 0.9, 1.0]), rtol=1e-6)
    gears = [g.get("gear").split() for g in xml(export(model, "mjcf")).iter("general")]
    np.testing.assert_allclose([float(g[2]) for g in gears], [0.8, 1.0, 0.9, 1.0])
    np.testing.assert_allclose([float(g[5]) for g in gears], 0.016 * np.array([-0.8, -1.0, 0.9, 1.0]))


def test_the_model_that_predicts_has_every_weak_rotor(monkeypatch):
    from groundstation.diagnosis import effect

    asked = []

    def wrench(signals: object, vehicle: object, settings: dict[str, float]) -> np.ndarray:
        asked.append((int(settings["rotor"]), settings["loss"]))
        return np.zeros((3, 6, 1))

    monkeypatch.setattr(
        effect, "library", lambda: {"weak_rotor": SimpleNamespace(names=lambda: ("loss",), wrench=wrench)}
    )
    total = effect.wrench_of(model_document(planted(), x_frame(), weak_rotors())["effects"], x_frame())
    still: Any = SimpleNamespace(t_s=np.zeros(3))
    total(still)
    assert asked == [(3, 0.1), (1, 0.2)]


def test_what_a_format_cannot_hold_stands_in_its_head():
    model = model_document(planted(), x_frame(), weak_rotors())
    assert "not held by this file: payload_change." in export(model, "mjcf")
    assert "not held by this file: payload_change, weak_rotor." in export(model, "px4-sih")
    assert "clock_offset" not in export(model, "px4-sih")
    assert "delay of 0.0020 s" in export(model, "sdf")


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


def test_csv_says_what_was_identified_and_what_declared():
    rows = {row["name"]: row for row in csv.DictReader(io.StringIO(export(document(), "csv")))}
    assert float(rows["ixz_kg_m2"]["value"]) == TENSOR[0, 2]
    assert (rows["ixz_kg_m2"]["std"], rows["ixz_kg_m2"]["unit"], rows["ixz_kg_m2"]["source"]) == (
        "0.0001",
        "kg m²",
        "identified",
    )
    assert (rows["torque_to_thrust_m"]["std"], rows["torque_to_thrust_m"]["source"]) == ("", "declared")
    assert float(rows["d_x_kg_s"]["value"]) == 0.3
    assert rows["d_x_kg_s"]["source"] == "identified"


def test_the_vehicle_file_declares_what_was_identified():
    vehicle = vehicle_from_dict(tomllib.loads(export(document(), "vehicle")))
    np.testing.assert_array_equal(vehicle.inertia_tensor(), TENSOR)
    assert vehicle.rotors.lag.down_s == 0.06
    assert vehicle.rotors.position_m == x_frame().rotors.position_m


def test_what_was_not_identified_keeps_its_declared_value_and_says_so():
    partial = document()
    del partial["parameters"]["ixy_kg_m2"]
    text = export(partial, "urdf")
    assert "declared values kept: ixy_kg_m2" in text
    assert xml(text).find("link/inertial/inertia").get("ixy") == "0"


def test_what_the_flight_did_not_reveal_is_as_declared():
    model = document() | {"not_identifiable": ["com_offset_z_m", "ixy_kg_m2"]}
    rows = {row["name"]: row for row in csv.DictReader(io.StringIO(export(model, "csv")))}
    assert (rows["com_offset_z_m"]["value"], rows["com_offset_z_m"]["source"]) == ("0.0", "declared")
    assert (rows["ixy_kg_m2"]["value"], rows["ixy_kg_m2"]["source"]) == ("0.0", "declared")


@pytest.mark.parametrize("format_name", ["mjcf", "sdf", "urdf", "pybullet", "webots"])
def test_a_tensor_of_no_rigid_body_becomes_the_nearest_one_where_it_would_not_load(format_name):
    impossible = np.diag([0.0120, 0.0121, 0.0830])  # the seed paper's Table 3, LS
    text = export(document(tensor=impossible), format_name)
    assert "belongs to no rigid body" in text and "nearest one" in text
    if format_name == "mjcf":
        mujoco = pytest.importorskip("mujoco")
        moments = np.sort(mujoco.MjModel.from_xml_string(text).body_inertia[1])
        shift = (0.0830 - 0.0120 - 0.0121) / 3.0
        np.testing.assert_allclose(moments, [0.0120 + shift, 0.0121 + shift, 0.0830 - shift], rtol=1e-5)
    assert "SIH_IZZ\t0.083\t" in export(document(tensor=impossible), "px4-sih")


def test_a_thrust_curve_exports_where_it_can():
    curve = x_frame(input="command", thrust_curve=[0.0, 5.0, 2.0], thrust_coefficient_n_s2=None, speed_max_rad_s=None)
    model = document(vehicle_from_dict(vehicle_to_dict(curve)))
    assert "No motor model" in export(model, "sdf")
    share = (-5.0 + np.sqrt(25.0 + 8.0 * MASS * 9.80665 / 4.0)) / 4.0  # 5 u + 2 u^2 = weight per rotor
    text = export(model, "px4-sih")
    full = float(next(line for line in text.splitlines() if "SIH_T_MAX\t" in line).split("\t")[3])
    assert full * share == pytest.approx(MASS * 9.80665 / 4.0, rel=1e-6)
    assert f"{100.0 * (full / 7.0 - 1.0):+.0f} %" in text
    with pytest.raises(BadInput, match="drives rotors by speed"):
        export(model, "rotorpy")


@pytest.mark.parametrize("format_name", list(FORMATS))
def test_hostile_names_break_no_format(format_name):
    named = x_frame().model_copy(update={"name": '--"""<a>&\n]]> \\'})
    model = {**model_document(planted(), named), "flight": '-->"""\n"\\ <b>'}
    text = export(model, format_name)
    if format_name in {"mjcf", "sdf", "urdf", "pybullet"}:
        xml(text)
    elif format_name in {"ros2", "agilicious", "crazyflie"}:
        assert isinstance(yaml.safe_load(text), dict)
    elif format_name == "ardupilot-sitl":
        json.loads(re.sub("#.*", "", text))
    elif format_name in {"matlab", "webots"}:
        assert all("<a>" not in line for line in text.splitlines() if line[:1] not in "%#")
    elif format_name in {"toml", "vehicle", "scenario", "crazyflow"}:
        tomllib.loads(text)
    elif format_name == "json":
        json.loads(text)
    elif format_name == "rotorpy":
        compile(text, "params", "exec")
    elif format_name == "px4-sih":
        assert all(line.startswith("#") or line.count("\t") == 4 for line in text.splitlines())
    else:
        assert len(next(csv.reader(io.StringIO(text)))) == 5


@pytest.mark.parametrize(
    ("content", "name", "message"),
    [
        (None, "m.toml", "there is no such file"),
        ("a = [", "m.toml", "is not valid TOML"),
        ("[]", "m.json", "schema None"),
        ('schema = "other/1"', "m.toml", "'other/1'"),
        ('schema = "groundstation.model/1"', "m.toml", "vehicle: Field required"),
    ],
)
def test_bad_model_files_get_one_sentence(tmp_path, content, name, message):
    path = tmp_path / name
    if content is not None:
        path.write_text(content, encoding="utf-8")
    with pytest.raises(BadInput, match=message):
        export(path, "csv")


def test_an_unknown_format_lists_the_known_ones():
    with pytest.raises(BadInput, match=r"mjcf, rotorpy"):
        export(document(), "blender")


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
