"""Exports read back by readers nobody here wrote, and compared with what was identified, signs included."""

from __future__ import annotations

import csv
import io
import json
import re
import tomllib
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from groundstation.errors import BadInput
from groundstation.reporting.exports import FORMATS, export, model_document, read_model, write_model
from groundstation.vehicle import vehicle_from_dict, vehicle_to_dict
from tests.exported import MASS, TENSOR, document, planted, weak_rotors, x_frame, xml


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

    weak = replace(effect.library()["weak_rotor"], wrench=wrench)
    monkeypatch.setattr(effect, "library", lambda: {"weak_rotor": weak})
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
