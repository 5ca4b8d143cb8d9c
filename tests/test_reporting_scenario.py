"""An identified model as a scenario: every effect finds a form, what is lost is said, and a flight in it shows it
again.
"""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from flights import rest_to_rest_plan

from groundstation.diagnosis.augmented import is_among, known_candidates
from groundstation.diagnosis.effect import library
from groundstation.paths import find_config
from groundstation.reporting.exports import export
from groundstation.reporting.scenario import MAPPERS
from groundstation.vehicle import load_vehicle, vehicle_to_dict
from sim.effects import Effects
from sim.flight import simulate
from sim.plant import Plant
from sim.scenario import scenario_from_dict
from studies.flown import flight_data

SETTINGS = {"rotor": 2.0, "at_s": 20.0, "from_s": 20.0, "within_s": 1.0, "length_m": 0.7}
SENSORS = {
    "input_delay": {"input_delay_s": 0.02},
    "clock_offset": {"mocap_minus_imu_s": 0.015, "clock_drift": 2e-5},
    "imu_misalignment": {f"rotation_{a}_rad": 0.01 for a in "xyz"},
    "mocap_misalignment": {f"rotation_{a}_rad": 0.01 for a in "xyz"},
    "mocap_tilt": {"tilt_x_rad": 0.01, "tilt_y_rad": 0.0},
    "motor_lag": {"rotor_lag_up_s": 0.04, "rotor_lag_down_s": 0.05},
}


def model(**effects: dict[str, float]) -> dict:
    def stated(values: dict[str, float]) -> dict:
        return {name: {"value": value, "std": 0.01} for name, value in values.items()}

    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    return {
        "schema": "groundstation.model/1",
        "flight": "last",
        "method": "OE",
        "vehicle": vehicle_to_dict(vehicle),
        "parameters": stated({"mass_kg": 1.83, "ixx_kg_m2": 0.036}),
        "model": {},
        "effects": {name: stated(values) for name, values in effects.items()},
        "not_identifiable": [],
    }


def scenario(**effects: dict[str, float]):
    text = export(model(**effects), "scenario")
    return text, scenario_from_dict(tomllib.loads(text))


@pytest.mark.parametrize("name", sorted({*library(), *SENSORS}))
def test_every_effect_the_diagnosis_can_name_is_switched_on_in_the_simulator(name):
    if name in SENSORS:
        values = SENSORS[name]
    else:
        values = {n: 0.05 for n in library()[name].names()} | SETTINGS
    _, found = scenario(**{name: values})
    if name == "motor_lag":
        assert found.truth.lag is not None and (found.truth.lag.up_s, found.truth.lag.down_s) == (0.04, 0.05)
        return
    on = [field for field in Effects._fields if getattr(found.effects, field).on]
    assert on == ["constant_wrench" if name == "wind" else name]


def test_a_lag_that_goes_with_the_speed_is_the_simulators_motor_with_its_propeller():
    table = {"rotor_lag_up_s": 0.05, "rotor_lag_down_s": 0.0625, "rotor_lag_slope": 0.4}
    text, found = scenario(motor_lag=table)
    assert found.truth.lag is None and found.effects.motor_lag.on
    motor = found.effects.motor_lag
    assert (motor.hover_s, motor.propeller_share) == (0.05, 0.4)
    assert motor.braking_share == pytest.approx((0.8 - 0.4) / 0.6)
    assert "Lost: motor_lag" in text


def test_every_form_is_of_an_effect_that_can_be_found():
    assert set(MAPPERS) == {*library(), *SENSORS, "thrust_scale", "torque_scale"}


def test_mass_tensor_and_what_got_lost_are_in_the_file():
    text, found = scenario(weak_rotor={"loss": 0.05, "rotor": 2.0}, **{"weak_rotor/2": {"loss": 0.03, "rotor": 4.0}})
    assert found.truth.mass_kg == 1.83 and found.truth.inertia_kg_m2.xx == 0.036
    assert found.effects.weak_rotor == Effects().weak_rotor._replace(rotor=2, loss=0.05, on=True)
    assert "# Lost: weak_rotor/2: the simulator holds one weak_rotor only" in text
    assert "cut propeller" in text


def test_wind_blows_as_fast_as_the_drag_it_is_felt_through_needs():
    drag = {"d_x_kg_s": 0.2, "d_y_kg_s": 0.2}
    _, found = scenario(rotor_drag=drag, wind={"force_world_x_n": 0.1, "force_world_y_n": -0.2})
    assert found.effects.wind.velocity_m_s == pytest.approx((0.5, -1.0, 0.0))


def test_lift_and_inflow_give_the_same_force_to_first_order_where_the_vehicle_flies():
    """The simulator's own forms, evaluated by its own code, against the diagnosis' linear ones."""
    from sim.build import build_plant
    from sim.effects.rotor_aerodynamics import inflow_factor

    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    weight = 1.83 * vehicle.gravity_m_s2
    for values, speed, expected in (
        ({"climb_inflow": {"k_kg_s": 0.3}}, (0.0, 0.0, 0.3), -0.3 * 0.3 / weight),
        ({"translational_lift": {"lift_s2_m2": 0.02}}, (0.6, 0.0, 0.0), 0.02 * 0.36),
    ):
        _, found = scenario(**values)
        plant: Plant = build_plant(vehicle, found)
        inflow = plant.rotors.hover_inflow
        effects = found.effects
        factor = inflow_factor(effects.translational_lift, effects.climb_inflow, speed, inflow)
        assert factor - 1.0 == pytest.approx(expected, rel=0.15)


def test_drag_put_into_the_scenario_slows_the_vehicle_by_as_much():
    """A flight in the exported scenario: the force that the accelerometer feels sideways is -d v."""
    _, found = scenario(rotor_drag={"d_x_kg_s": 0.4, "d_y_kg_s": 0.4})
    quiet = found.model_copy(
        update={"imu": type(found.imu)(), "disturbance": type(found.disturbance)(), "mocap": type(found.mocap)()}
    )
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    flight = flight_data(simulate(vehicle, rest_to_rest_plan(periods=1.0), quiet, 1))
    assert flight.imu is not None and flight.state is not None and flight.window_s is not None
    t = flight.imu.t_s
    inside = (t > flight.window_s[0]) & (t < flight.window_s[1])
    from groundstation.frames import quat_rotate_inverse

    velocity = quat_rotate_inverse(flight.state.values[:, 6:10], flight.state.values[:, 3:6])
    for axis in range(2):
        speed = np.interp(t, flight.state.t_s, velocity[:, axis])[inside]
        felt = flight.imu.values[inside, 3 + axis]
        slope = float(speed @ felt / (speed @ speed))
        assert slope == pytest.approx(-0.4 / 1.83, rel=0.1)


def test_a_model_that_is_known_leaves_its_effects_out_of_the_suspects():
    document = model(weak_rotor={"loss": 0.05, "rotor": 2.0}, rotor_drag={"d_x_kg_s": 0.2, "d_y_kg_s": 0.2})
    known = known_candidates(document["effects"])
    assert [k.identifier for k in known] == ["weak_rotor", "rotor_drag"] and dict(known[0].settings) == {"rotor": 2.0}
    assert is_among(known[0], known)
    other = known_candidates(model(weak_rotor={"loss": 0.05, "rotor": 3.0})["effects"])
    assert not is_among(other[0], known)
