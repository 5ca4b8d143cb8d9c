"""Rotors that are tilted: six rows of force and torque from the vehicle file to the fit, the prediction and the
exports.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest

from groundstation import api
from groundstation.errors import BadInput
from groundstation.flightdata import Stream, motor_columns
from groundstation.frames import quat_from_euler, quat_rotate
from groundstation.identification.preparation import prepare
from groundstation.identification.record_model import RecordModel
from groundstation.model import parameters
from groundstation.model.parameters import FitOptions, declared_parameters
from groundstation.model.rigid_kernel import stepped
from groundstation.paths import find_config
from groundstation.planning.limits import envelope
from groundstation.reporting.exports import export
from groundstation.vehicle import load_vehicle, vehicle_from_dict, vehicle_to_dict
from studies.golden import simulated
from tests.recording_flight import flight


def shipped(name):
    return load_vehicle(find_config("vehicles", name))


def with_rotors(vehicle, **changes):
    document = vehicle_to_dict(vehicle)
    document["rotors"] |= changes
    return vehicle_from_dict(document)


def turned_ring(count=6, degrees=20.0):
    """Places, axes and spins of rotors in a ring, each tilted about its arm, by turns to either side."""
    angle = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    sign, tilt = np.where(np.arange(count) % 2, 1.0, -1.0), np.radians(degrees)
    place = 0.2 * np.column_stack([np.cos(angle), np.sin(angle), 0.1 * np.sin(2.0 * angle)])
    side = np.sin(tilt) * sign
    axes = np.column_stack([-side * np.sin(angle), side * np.cos(angle), np.full(count, np.cos(tilt))])
    return {"position_m": place.tolist(), "axis": axes.tolist(), "spin": sign.astype(int).tolist()}


def test_six_rows_are_the_sum_of_thrusts_levers_and_reactions():
    vehicle = with_rotors(shipped("hexa"), **turned_ring())
    rotors = vehicle.rotors
    thrust = np.array([3.0, 4.0, 5.0, 6.0, 7.0, 8.0])
    force, torque = np.zeros(3), np.zeros(3)
    for t, place, axis, spin in zip(thrust, rotors.position_m, rotors.axes(), rotors.spin, strict=True):
        force += t * np.array(axis)
        torque += np.cross(place, t * np.array(axis)) - spin * rotors.torque_to_thrust_m * t * np.array(axis)
    assert np.allclose(vehicle.six_row_allocation() @ thrust, [*force, *torque])
    assert np.linalg.matrix_rank(vehicle.six_row_allocation()) == 6


def test_upright_rotors_have_the_rows_they_had():
    vehicle = shipped("hexa")
    said = with_rotors(vehicle, axis=[[0.0, 0.0, 1.0]] * 6)
    place, spin = np.array(vehicle.rotors.position_m), np.array(vehicle.rotors.spin)
    rows = [np.ones(6), place[:, 1], -place[:, 0], -spin * vehicle.rotors.torque_to_thrust_m]
    for each in (vehicle, said):
        assert not each.rotors.tilted
        assert np.array_equal(each.allocation(), np.stack(rows))
        assert not each.six_row_allocation()[:2].any()


@pytest.mark.parametrize(
    ("axis", "said"),
    [([[0.0, 0.0, 2.0]] * 6, "no unit vector"), ([[0.0, 0.0, 1.0]] * 4, "axis has 4 entries for 6")],
)
def test_axes_that_cannot_be_are_refused(axis, said):
    with pytest.raises(BadInput, match=said):
        with_rotors(shipped("hexa"), axis=axis)


def test_a_flight_of_tilted_rotors_gives_the_vehicle_and_taken_for_upright_gives_another():
    made = flight(12.0, scale=1.5)
    vehicle = with_rotors(made.vehicle, **turned_ring())
    wrench = np.zeros((len(made.motors), 6))
    wrench[:, 2:] = made.vehicle.thrust(made.motors.values) @ made.vehicle.allocation().T
    thrust = wrench @ np.linalg.inv(vehicle.six_row_allocation()).T
    speed = np.sqrt(np.maximum(thrust, 0.01) / vehicle.rotors.thrust_coefficient_n_s2)
    motors = Stream(made.motors.t_s, speed, motor_columns("rotor_speed", 6), made.motors.received_s)
    flown = replace(made, vehicle=vehicle, motors=motors, truth=None)
    found = api.identify([flown])
    best = found.methods[found.best].parameters
    for name, value in {"mass_kg": 1.79, "ixx_kg_m2": 0.03, "iyy_kg_m2": 0.03, "izz_kg_m2": 0.04}.items():
        assert best[name].value == pytest.approx(value, rel=0.01), name
    upright = with_rotors(vehicle, axis=[[0.0, 0.0, 1.0]] * 6)
    other = api.identify([replace(flown, vehicle=upright)])
    assert other.methods[other.best].parameters["mass_kg"].value == pytest.approx(
        1.79 / np.cos(np.radians(20.0)), rel=0.02
    )


def test_sensitivities_of_tilted_rotors_are_the_slopes_of_the_model():
    axes = np.array([[0.3, 0.0, 0.95], [-0.2, 0.1, 0.97], [0.0, -0.3, 0.95], [0.1, 0.2, 0.97]])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    record = prepare(simulated(21, 1.0, {"speed_source": "command"})).record
    rotors = record.vehicle.rotors.model_copy(update={"axis": tuple(map(tuple, axes.tolist()))})
    model = RecordModel(replace(record, vehicle=record.vehicle.model_copy(update={"rotors": rotors})))
    options = FitOptions(channels=(0, 1, 2, 3, 4, 5))
    p = replace(declared_parameters(model.record.vehicle, lag_s=0.04), com_m=np.array([0.01, -0.02, 0.0]))
    _, found, names = model.evaluate(p, options)
    assert np.abs(model.residual(p)[:, 3:5]).max() > 0.4, "the rotors push sideways"
    scale = np.sqrt(np.mean(found**2, axis=(0, 1)))
    for index, name in enumerate(names):
        entry = parameters.table()[name]
        step = 1e-5 if entry.timing else 1e-6 * max(abs(entry.get(p)), 1e-3)
        slope = (model.residual(p) - model.residual(entry.put(p, entry.get(p) + step))) / step
        away = np.sqrt(np.mean((slope - found[:, :, index]) ** 2))
        assert away < (0.2 if entry.timing else 1e-3) * scale[index], name


def test_a_tricopter_whose_tilts_cancel_its_reactions_can_be_planned_for_and_an_upright_one_cannot():
    tricopter = shipped("tricopter")
    assert tricopter.turns_freely()
    assert np.allclose(tricopter.allocation()[:3] @ envelope(tricopter).mixing[:, :3], np.eye(3))
    with pytest.raises(BadInput, match="cannot make thrust and three torques"):
        envelope(with_rotors(tricopter, axis=[[0.0, 0.0, 1.0]] * 3))


def document_of(vehicle):
    values = {name: {"value": value, "std": 0.0} for name, value in vehicle.parameters().items()}
    named = {name: v for name, v in values.items() if name.startswith(("mass", "i"))}
    return {
        **{"schema": "groundstation.model/1", "flight": "f", "method": "PE", "vehicle": vehicle_to_dict(vehicle)},
        **{"parameters": named, "model": {}, "effects": {}, "not_identifiable": []},
    }


def elements(document, form, tag):
    return list(ET.fromstring(export(document, form)).iter(tag))  # noqa: S314 - our own output


def test_exports_hold_the_axes_or_refuse_by_name():
    vehicle = shipped("hexa-tilted")
    document = document_of(vehicle)
    place = np.array(vehicle.rotors.position_m)
    rows = np.array([e.attrib["gear"].split() for e in elements(document, "mjcf", "general")], dtype=float).T
    rows[3:] += np.cross(place, rows[:3].T).T  # MuJoCo applies them at the rotor's site
    assert np.allclose(rows, vehicle.six_row_allocation(), atol=1e-6)
    poses = [
        (e.findtext("pose") or "").split() for e in elements(document, "sdf", "link") if "rotor" in e.attrib["name"]
    ]
    turned = quat_rotate(quat_from_euler(*np.array(poses, dtype=float)[:, 3:].T), np.array([0.0, 0.0, 1.0]))
    assert np.allclose(turned, vehicle.rotors.axes(), atol=1e-6)
    assert "shaftAxis 0.342020" in export(document, "webots")
    for form in ("rotorpy", "px4-sih", "pybullet", "ardupilot-sitl"):
        with pytest.raises(BadInput, match=f"{form} has upright rotors only"):
            export(document, form)


def test_the_prediction_pushes_sideways_where_the_rotors_do():
    vehicle = shipped("hexa-tilted")
    tensor = vehicle.inertia_tensor()
    body = (vehicle.mass_kg, tensor, np.linalg.inv(tensor), np.zeros(3), np.zeros(3), 0.0, 0.0, 0.0)
    made = vehicle.six_row_allocation() @ np.array([5.0, 4.0, 4.0, 4.0, 4.0, 4.0])
    state, step_s = np.zeros((1, 13)), 1e-6
    state[0, 6] = 1.0
    turning = stepped(state, made[None], np.zeros((1, 3)), body, step_s)
    assert np.allclose(state[0, 3:6], step_s * made[:3] / vehicle.mass_kg, rtol=1e-4)
    assert np.allclose(turning[0], np.linalg.solve(tensor, made[3:]), rtol=1e-4)
    assert abs(made[0] / vehicle.mass_kg) > 0.1
