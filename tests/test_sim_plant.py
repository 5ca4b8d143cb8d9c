"""What nature guarantees of the simulated plant."""

from __future__ import annotations

import numpy as np
import pytest
from sim_states import advance, matrix, plant_of, slope_of, state_of, vehicle_of

from groundstation import frames
from groundstation.errors import BadInput
from groundstation.vehicle import RotorLag
from sim.effects import ComOffset, MotorLag, PayloadChange, RotorDrag, RotorGyroscopic, SlungLoad
from sim.plant import ATTITUDE, LOAD, LOAD_VELOCITY, RATE, ROTOR, VELOCITY, specific_force
from sim.scenario import Truth


def _momentum(plant, history, rotor_momentum=0.0):
    """Angular momentum about the centre of mass in the world, shape (k, 3)."""
    spin = history[:, RATE : RATE + 3] @ matrix(plant.after.inertia)
    spin[:, 2] += rotor_momentum
    return frames.quat_rotate(history[:, ATTITUDE : ATTITUDE + 4], spin)


def test_free_spin_conserves_energy_and_angular_momentum_in_the_world():
    plant = plant_of(vehicle_of())
    history = advance(plant, state_of(plant, rate=(9.0, -7.0, 11.0)), 2.0, powered=False)
    momentum = _momentum(plant, history)
    energy = 0.5 * np.einsum("ki,ij,kj->k", history[:, 10:13], matrix(plant.after.inertia), history[:, 10:13])
    assert np.ptp(momentum, axis=0).max() < 1e-8 * np.linalg.norm(momentum[0])
    assert np.ptp(energy) < 1e-8 * energy[0]
    assert np.ptp(history[:, RATE]) > 1.0  # it does tumble: the conservation is no accident of a steady spin


def test_thrown_with_its_mass_off_centre_the_centre_of_mass_flies_a_parabola_and_energy_stays():
    plant = plant_of(vehicle_of(), com_offset=ComOffset((0.03, -0.02, 0.05)))
    history = advance(plant, state_of(plant, velocity=(1.0, 2.0, 3.0), rate=(9.0, -7.0, 11.0)), 1.0, powered=False)
    com = np.array(plant.after.com)
    q, w = history[:, ATTITUDE : ATTITUDE + 4], history[:, RATE : RATE + 3]
    centre = history[:, :3] + frames.quat_rotate(q, com)
    velocity = history[:, VELOCITY : VELOCITY + 3] + frames.quat_rotate(q, np.cross(w, com))
    t = np.arange(len(history))[:, None] * 0.001
    parabola = centre[0] + velocity[0] * t + 0.5 * np.array([0.0, 0.0, -plant.gravity]) * t**2
    assert np.abs(centre - parabola).max() < 1e-8
    turning = 0.5 * np.einsum("ki,ij,kj->k", w, matrix(plant.after.inertia), w)
    mass = plant.after.mass
    energy = turning + 0.5 * mass * np.sum(velocity**2, axis=1) + mass * plant.gravity * centre[:, 2]
    assert np.ptp(energy) < 1e-8 * energy[0]
    assert np.ptp(_momentum(plant, history), axis=0).max() < 1e-8


def test_rotors_with_an_inertia_do_not_change_their_speed_at_once():
    """Their momentum would: the reaction of a change in no time is not finite, and the simulator left it out."""
    at_once = Truth(lag=RotorLag(up_s=0.0, down_s=0.0))
    with pytest.raises(BadInput, match="rotor_gyroscopic"):
        plant_of(vehicle_of(), at_once, rotor_gyroscopic=RotorGyroscopic(2e-5))
    plant_of(vehicle_of(), at_once, rotor_gyroscopic=RotorGyroscopic(2e-5), motor_lag=MotorLag(hover_s=0.05))


def test_rotors_that_spin_up_turn_the_body_back_and_the_whole_keeps_its_angular_momentum():
    rotors = {"spin": [1, 1, 1, 1], "torque_to_thrust_m": 1e-12}
    vehicle = vehicle_of(**rotors)
    inertia = 5e-4
    plant = plant_of(vehicle, Truth(lag=RotorLag(up_s=0.05, down_s=0.05)), rotor_gyroscopic=RotorGyroscopic(inertia))
    start = state_of(plant, rate=(2.0, -1.0, 0.5), motors=100.0)
    history = advance(plant, start, 0.4, target=np.full(4, 700.0))
    rotor_momentum = inertia * history[:, ROTOR:].sum(axis=1)
    whole = _momentum(plant, history, rotor_momentum)
    body_alone = _momentum(plant, history)
    assert np.ptp(whole, axis=0).max() < 1e-7
    assert np.ptp(body_alone[:, 2]) > 0.5


@pytest.mark.parametrize("smooth", [{}, {"rotor_drag": RotorDrag(), "com_offset": ComOffset((0.02, 0.01, 0.0))}])
def test_halving_the_step_cuts_the_error_sixteenfold(smooth):
    plant = plant_of(vehicle_of(), Truth(lag=RotorLag(up_s=0.1, down_s=0.1)), **smooth)
    start = state_of(plant, velocity=(1.0, 0.5, 0.0), rate=(5.0, -4.0, 6.0))
    target = np.array([500.0, 520.0, 480.0, 510.0])
    ends = [advance(plant, start, 0.64, dt, target=target)[-1] for dt in (0.02, 0.01, 0.005, 0.0003125)]
    errors = [np.linalg.norm(end[:13] - ends[-1][:13]) for end in ends[:-1]]
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.2)
    assert errors[1] / errors[2] == pytest.approx(16.0, rel=0.2)


def test_at_hover_values_nothing_accelerates():
    plant = plant_of(vehicle_of())
    slope = slope_of(plant, state_of(plant))
    np.testing.assert_allclose(slope[VELOCITY : VELOCITY + 3], 0.0, atol=1e-12)
    np.testing.assert_allclose(slope[RATE : RATE + 3], 0.0, atol=1e-12)


def test_a_rotor_up_front_on_the_left_lifts_front_and_left_and_turns_against_its_spin():
    plant = plant_of(vehicle_of())
    motors = np.full(4, plant.rotors.hover_value)
    motors[2] *= 1.05  # front left, clockwise: its reaction is counter-clockwise
    slope = slope_of(plant, state_of(plant, motors=motors))
    tensor = matrix(plant.after.inertia)
    torque = tensor @ slope[RATE : RATE + 3]
    extra = plant.rotors.curve[2] * plant.rotors.hover_value**2 * (1.05**2 - 1.0)
    d = plant.rotors.position[2]
    np.testing.assert_allclose(torque, extra * np.array([d[1], -d[0], plant.rotors.torque_ratio]), rtol=1e-9)


def test_an_accelerometer_off_centre_feels_what_differentiating_its_path_twice_gives():
    plant = plant_of(vehicle_of(), com_offset=ComOffset((0.02, 0.01, -0.01)))
    lever = np.array([0.05, -0.04, 0.03])
    motors = plant.rotors.hover_value * np.array([1.1, 0.9, 1.0, 1.05])
    history = advance(plant, state_of(plant, rate=(3.0, -2.0, 4.0), motors=motors), 0.2)
    q = history[:, ATTITUDE : ATTITUDE + 4]
    path = history[:, :3] + frames.quat_rotate(q, lever)
    h, k = 0.001, 100
    stencil = (-path[k - 2] + 16 * path[k - 1] - 30 * path[k] + 16 * path[k + 1] - path[k + 2]) / (12 * h * h)
    expected = frames.quat_rotate_inverse(q[k], stencil + plant.gravity * np.array([0.0, 0.0, 1.0]))
    slope = slope_of(plant, history[k])
    felt = specific_force(
        tuple(slope[3:6]), tuple(slope[10:13]), tuple(history[k, 10:13]), tuple(q[k]), tuple(lever), plant.gravity
    )
    np.testing.assert_allclose(felt, expected, atol=1e-5)


def test_letting_a_load_go_keeps_every_point_of_the_body_moving_and_leaves_the_declared_mass():
    vehicle = vehicle_of()
    plant = plant_of(vehicle, payload_change=PayloadChange(mass_kg=0.3, time_s=5.0, position_m=(0.05, 0.0, -0.05)))
    assert plant.before.mass == pytest.approx(vehicle.mass_kg + 0.3)
    assert plant.after.mass == pytest.approx(vehicle.mass_kg)
    np.testing.assert_allclose(matrix(plant.after.inertia), vehicle.inertia_tensor())
    about_joint = matrix(plant.before.inertia) - vehicle.inertia_tensor()
    d = np.array([0.05, 0.0, -0.05])
    reduced = vehicle.mass_kg * 0.3 / (vehicle.mass_kg + 0.3)
    np.testing.assert_allclose(about_joint, reduced * (d @ d * np.eye(3) - np.outer(d, d)), atol=1e-12)
    before = slope_of(plant, state_of(plant), flight_s=4.999)[VELOCITY + 2]
    after = slope_of(plant, state_of(plant), flight_s=5.0)[VELOCITY + 2]
    assert before < -1.0
    assert abs(after) < 1e-9


def test_vehicle_and_slung_load_together_keep_their_momentum_in_free_fall():
    load = SlungLoad(mass_kg=0.4, length_m=0.5, attachment_m=(0.02, 0.0, -0.03), damping_1_s=0.0)
    plant = plant_of(vehicle_of(), slung_load=load)
    x = state_of(plant, velocity=(0.5, 0.0, 0.0), rate=(1.0, 2.0, 0.0), position=(0.0, 0.0, 50.0))
    x[LOAD : LOAD + 3] = (0.15, 0.1, 50.0 - 0.46)
    x[LOAD_VELOCITY : LOAD_VELOCITY + 3] = (-0.5, 0.4, -0.3)
    history = advance(plant, x, 1.0, powered=False)
    t = np.arange(len(history)) * 0.001
    momentum = plant.after.mass * history[:, 3:6] + 0.4 * history[:, LOAD_VELOCITY : LOAD_VELOCITY + 3]
    momentum[:, 2] += (plant.after.mass + 0.4) * plant.gravity * t
    assert np.ptp(momentum, axis=0).max() < 1e-6
    taut = np.linalg.norm(history[:, :3] - history[:, LOAD : LOAD + 3], axis=1).max()
    assert 0.5 < taut < 0.6


MJCF = """
<mujoco>
  <option gravity="0 0 -9.80665" integrator="RK4" timestep="0.001"/>
  <worldbody><body name="drone" pos="0 0 5"><freejoint/>
    <inertial pos="{com}" mass="{mass}" fullinertia="{inertia}"/>
    {sites}
  </body></worldbody>
  <actuator>{actuators}</actuator>
</mujoco>"""


def test_a_thrown_spinning_thrusting_body_agrees_with_mujoco():
    mujoco = pytest.importorskip("mujoco")
    vehicle = vehicle_of()
    com = (0.015, -0.01, 0.02)
    plant = plant_of(vehicle, com_offset=ComOffset(com))
    motors = plant.rotors.hover_value * np.array([1.05, 0.97, 1.1, 0.93])
    start = state_of(plant, velocity=(1.0, -0.5, 2.0), euler=(0.3, -0.2, 1.0), rate=(4.0, -3.0, 5.0), motors=motors)
    ours = advance(plant, start, 1.0)[-1]

    t = vehicle.inertia_kg_m2
    thrusts = plant.rotors.curve[2] * motors**2
    hubs = plant.rotors.position
    text = MJCF.format(
        com=" ".join(map(str, com)),
        mass=vehicle.mass_kg,
        inertia=f"{t.xx} {t.yy} {t.zz} {t.xy} {t.xz} {t.yz}",
        sites="".join(f'<site name="r{i}" pos="{h[0]} {h[1]} {h[2]}"/>' for i, h in enumerate(hubs)),
        actuators="".join(
            f'<general site="r{i}" gear="0 0 1 0 0 {-s * plant.rotors.torque_ratio}"/>'
            for i, s in enumerate(plant.rotors.spin)
        ),
    )
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:3], data.qpos[3:] = start[:3], start[6:10]
    data.qvel[:3], data.qvel[3:] = start[3:6], start[10:13]
    data.ctrl[:] = thrusts
    for _ in range(1000):
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(ours[:3], data.qpos[:3], atol=1e-6)
    np.testing.assert_allclose(ours[3:6], data.qvel[:3], atol=1e-6)
    np.testing.assert_allclose(ours[10:13], data.qvel[3:], atol=1e-6)
    assert abs(abs(ours[6:10] @ data.qpos[3:]) - 1.0) < 1e-10
