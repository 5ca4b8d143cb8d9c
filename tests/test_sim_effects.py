"""Each effect's fingerprint: what theory says of its direction, size and growth, one by one."""

from __future__ import annotations

import numpy as np
import pytest
from sim_states import advance, change_of, plant_of, slope_of, state_of, vehicle_of, wrench_of

from groundstation import frames
from sim.build import build_instruments
from sim.effects import (
    AttractingWall,
    BatterySag,
    ClimbInflow,
    ClockOffset,
    ComOffset,
    ConstantWrench,
    Effects,
    FlappingMoment,
    GroundEffect,
    ImuMisalignment,
    InputDelay,
    Magnet,
    MocapMisalignment,
    MocapTilt,
    MotorLag,
    RotorDegradation,
    RotorDrag,
    SlungLoad,
    Tether,
    ThrustCurve,
    ThrustMemory,
    ThrustScale,
    TorqueScale,
    TranslationalLift,
    WeakRotor,
    Wind,
)
from sim.effects.airframe import gust_step
from sim.effects.angular_damping import AngularDamping
from sim.effects.attachments import cable
from sim.effects.body_drag import BodyDrag
from sim.effects.rotor_aerodynamics import axial_inflow, edgewise_inflow, ground_factor
from sim.effects.rotor_faults import play
from sim.measure import measure_imu, measure_pose
from sim.plant import ROTOR
from sim.scenario import Scenario
from sim.simulation import Simulation

VEHICLE = vehicle_of()
WEIGHT = VEHICLE.mass_kg * VEHICLE.gravity_m_s2


def _force(effect, **state):
    return change_of(VEHICLE, effect, **state)[0]


def _torque(effect, **state):
    return change_of(VEHICLE, effect, **state)[1]


# rotors in moving air


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.8, 0.0)])
def test_rotor_drag_opposes_slow_motion_with_its_stated_size_and_needs_turning_rotors(direction):
    effect = {"rotor_drag": RotorDrag(drag_kg_s=(0.3, 0.2))}
    v = 0.01 * np.array(direction)
    np.testing.assert_allclose(_force(effect, velocity=v), -np.array([0.3, 0.2, 0.0]) * v, rtol=1e-3, atol=1e-9)
    assert np.abs(_force(effect, velocity=v, motors=0.0)).max() < 1e-12


def test_rotor_drag_grows_with_rotor_speed_and_less_than_linearly_with_air_speed():
    effect = {"rotor_drag": RotorDrag()}
    hover = plant_of(VEHICLE).rotors.hover_value
    slow, fast = (-_force(effect, velocity=(v, 0.0, 0.0))[0] for v in (1.0, 6.0))
    spun_up = -_force(effect, velocity=(1.0, 0.0, 0.0), motors=1.2 * hover)[0]
    assert spun_up == pytest.approx(1.2 * slow, rel=1e-6)
    assert 3.0 * slow < fast < 6.0 * slow


def test_rotor_drag_takes_energy_from_a_vehicle_that_yaws_on_the_spot_and_from_one_that_flies_as_it_turns():
    effect = {"rotor_drag": RotorDrag(drag_kg_s=(0.3, 0.2), induced_share=0.0)}
    x, y = plant_of(VEHICLE).rotors.position[:, :2].T
    force, torque = change_of(VEHICLE, effect, rate=(0.0, 0.0, 2.0))
    np.testing.assert_allclose(force, 0.0, atol=1e-12)
    np.testing.assert_allclose(torque, [0.0, 0.0, -2.0 * np.mean(0.3 * y**2 + 0.2 * x**2)], atol=1e-12)
    hover, random = plant_of(VEHICLE).rotors.hover_value, np.random.default_rng(5)
    for _ in range(20):
        velocity, rate, motors = random.standard_normal(3), random.standard_normal(3), random.uniform(0.7, 1.3, len(x))
        force, torque = change_of(VEHICLE, effect, velocity=velocity, rate=rate, motors=hover * motors)
        assert force @ velocity + torque @ rate < 0.0


def test_the_induced_velocity_solves_glauerts_equation():
    for speed in (0.0, 0.5, 3.0):
        v = edgewise_inflow(speed)
        assert v == pytest.approx(1.0 / np.hypot(speed, v))
    for climb in (-0.5, 0.0, 1.0):
        through = axial_inflow(climb)
        assert through - climb == pytest.approx(1.0 / through)


def test_flapping_lifts_the_side_that_leads():
    effect = {"flapping_moment": FlappingMoment(k_nm_s_m=0.03)}
    forward = _torque(effect, velocity=(2.0, 0.0, 0.0))
    left = _torque(effect, velocity=(0.0, 2.0, 0.0))
    np.testing.assert_allclose(forward, [0.0, -0.06, 0.0], atol=1e-9)  # nose up is negative about y (left)
    np.testing.assert_allclose(left, [0.06, 0.0, 0.0], atol=1e-9)


def test_translational_lift_is_even_in_speed_and_starts_as_its_square():
    effect = {"translational_lift": TranslationalLift()}
    lift = {v: _force(effect, velocity=(v, 0.0, 0.0))[2] for v in (-0.2, 0.1, 0.2, 5.0)}
    assert lift[0.2] > 0.0
    assert lift[-0.2] == pytest.approx(lift[0.2])
    assert lift[0.2] == pytest.approx(4.0 * lift[0.1], rel=0.01)
    assert lift[5.0] < 0.7 * WEIGHT  # bounded by the blade's gain


def test_climbing_costs_thrust_and_sinking_gives_some_back():
    effect = {"climb_inflow": ClimbInflow()}
    up, down = (_force(effect, velocity=(0.0, 0.0, v))[2] for v in (0.2, -0.2))
    assert up < 0.0 < down
    assert up == pytest.approx(-down, rel=0.1)
    assert np.abs(_force(effect, velocity=(2.0, 0.0, 0.0))).max() < 1e-12


def test_ground_effect_is_cheeseman_and_bennetts_near_the_floor_and_gone_high_up():
    effect = {"ground_effect": GroundEffect()}
    radius = VEHICLE.rotors.radius_m
    near, high = (_force(effect, position=(0.0, 0.0, z))[2] / WEIGHT for z in (radius - 0.02, 20.0 * radius))
    assert near == pytest.approx(1.0 / (1.0 - 1.0 / 16.0) - 1.0, rel=1e-6)  # hubs sit 0.02 m above the origin
    assert 0.0 < high < 2e-4
    assert ground_factor(GroundEffect(), -1.0, radius) == ground_factor(GroundEffect(), 0.5 * radius, radius)


def test_tilted_over_the_floor_the_lower_rotors_lift_more():
    torque = _torque({"ground_effect": GroundEffect()}, position=(0.0, 0.0, 0.15), euler=(0.2, 0.0, 0.0))
    assert torque[0] < 0.0  # rolled right: the right side is low and is lifted


# frame and air


def test_body_drag_opposes_and_goes_with_the_square_of_speed():
    effect = {"body_drag": BodyDrag(area_m2=(0.02, 0.03, 0.05))}
    f1, f2 = (_force(effect, velocity=(v, 0.0, 0.0))[0] for v in (1.0, 2.0))
    assert f1 == pytest.approx(-0.5 * 1.2 * 0.02)
    assert f2 == pytest.approx(4.0 * f1)


def test_wind_moves_the_air_that_drag_is_felt_in_and_is_not_felt_without():
    drag = {"rotor_drag": RotorDrag()}
    still = _force(drag, velocity=(0.0, 0.0, 0.0), surroundings={"wind": (1.5, 0.0, 0.0)})
    moving = _force(drag, velocity=(-1.5, 0.0, 0.0))
    drifting = _force(drag, velocity=(1.5, 0.0, 0.0), surroundings={"wind": (1.5, 0.0, 0.0)})
    np.testing.assert_allclose(still, moving, atol=1e-12)
    assert still[0] > 0.0
    np.testing.assert_allclose(drifting, 0.0, atol=1e-12)
    bare = plant_of(VEHICLE)
    np.testing.assert_array_equal(slope_of(bare, state_of(bare), wind=(5.0, 0.0, 0.0)), slope_of(bare, state_of(bare)))


def test_gusts_have_their_stated_size_and_correlation_time():
    wind, random = Wind(velocity_m_s=(3.0, 0.0, 0.0), gust_m_s=0.4, scale_m=0.6), np.random.default_rng(3)
    state = random.standard_normal((2, 3))
    gusts = np.array([gust_step(wind, state, random.standard_normal(3), 0.005) for _ in range(40000)])
    np.testing.assert_allclose(gusts.mean(axis=0), wind.velocity_m_s, atol=0.05)
    np.testing.assert_allclose(gusts.std(axis=0), 0.4, rtol=0.1)
    along = gusts[:, 0] - 3.0
    lag = round(0.2 / 0.005)  # one time constant, L/V
    assert np.corrcoef(along[:-lag], along[lag:])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.06)


def test_angular_damping_takes_energy_from_every_rotation():
    effect = {"angular_damping": AngularDamping((0.01, 0.02, 0.03), (0.001, 0.0, 0.0))}
    torque = _torque(effect, rate=(2.0, 0.0, 0.0))
    assert torque[0] == pytest.approx(-(0.01 * 2.0 + 0.001 * 4.0))
    plant = plant_of(VEHICLE, **effect)
    history = advance(plant, state_of(plant, rate=(3.0, -2.0, 4.0)), 1.0, powered=False)
    energy = np.einsum("ki,ij,kj->k", history[:, 10:13], VEHICLE.inertia_tensor(), history[:, 10:13])
    assert (np.diff(energy) < 0.0).all()


# rotors that are not as declared


def test_a_weak_rotor_shows_in_force_tilt_and_yaw_in_its_own_pattern():
    force, torque = change_of(VEHICLE, {"weak_rotor": WeakRotor(rotor=3, loss=0.1)})
    lost = 0.1 * WEIGHT / 4.0
    x, y, _ = VEHICLE.rotors.position_m[2]
    assert force[2] == pytest.approx(-lost)
    np.testing.assert_allclose(torque[:2], [-lost * y, lost * x], rtol=1e-6)
    # Rotor 3 turns clockwise; what its reaction lacks, D^5 for D^4, turns the body clockwise.
    c = VEHICLE.rotors.torque_to_thrust_m
    assert torque[2] == pytest.approx(-c * WEIGHT / 4.0 * (1.0 - 0.9**1.25))


def test_a_rotor_degrades_at_its_time_and_not_before():
    effect = {"rotor_degradation": RotorDegradation(rotor=1, loss=0.2, start_s=10.0, spread_s=0.2)}
    shares = [change_of(VEHICLE, effect, surroundings={"flight_s": t})[0][2] * 4.0 / WEIGHT for t in (0.0, 10.0, 20.0)]
    np.testing.assert_allclose(shares, [0.0, -0.1, -0.2], atol=1e-9)


def test_thin_air_scales_all_thrusts_and_torque_scale_yaw_alone():
    motors = plant_of(VEHICLE).rotors.hover_value * np.array([1.1, 1.1, 0.9, 0.9])
    thin_force, _ = change_of(VEHICLE, {"thrust_scale": ThrustScale(0.9)}, motors=motors)
    force, torque = change_of(VEHICLE, {"torque_scale": TorqueScale(1.2)}, motors=motors)
    plant = plant_of(VEHICLE)
    before = wrench_of(plant, state_of(plant, motors=motors))
    assert thin_force[2] == pytest.approx(-0.1 * before[0][2])
    np.testing.assert_allclose(force, 0.0, atol=1e-12)
    np.testing.assert_allclose(torque, [0.0, 0.0, 0.2 * before[1][2]], atol=1e-9)


def test_another_thrust_law_agrees_at_hover_and_leaves_it_by_its_exponent():
    effect = {"thrust_curve": ThrustCurve(exponent=2.4)}
    hover = plant_of(VEHICLE).rotors.hover_value
    assert abs(_force(effect)[2]) < 1e-9
    thrust = WEIGHT * 1.2**2 + _force(effect, motors=1.2 * hover)[2]
    assert thrust == pytest.approx(WEIGHT * 1.2**2.4)


def test_thrust_with_memory_gives_another_thrust_on_the_way_up_than_on_the_way_down():
    p, memory, up, down = ThrustMemory(width_share=0.1), 0.0, {}, {}
    for t in np.arange(0.0, 2.01, 0.1):
        memory = up[round(t, 1)] = play(p, memory, t, 1.0)
    for t in np.arange(2.0, -0.01, -0.1):
        memory = down[round(t, 1)] = play(p, memory, t, 1.0)
    assert up[1.0] == pytest.approx(0.9)
    assert down[1.0] == pytest.approx(1.1)
    plant = plant_of(VEHICLE, thrust_memory=p)
    lifted = slope_of(plant, state_of(plant), memory=np.full(4, 1.1 * WEIGHT / 4.0))
    assert lifted[5] == pytest.approx(0.1 * plant.gravity)


def test_a_centre_of_mass_off_the_origin_turns_thrust_into_a_steady_torque_without_yaw():
    offset = np.array([0.01, -0.004, 0.02])
    torque = _torque({"com_offset": ComOffset(tuple(offset))})
    np.testing.assert_allclose(torque, np.cross(-offset, [0.0, 0.0, WEIGHT]), atol=1e-9)


# between command and speed


def test_a_motor_lags_by_its_time_constant_near_hover_and_brakes_more_slowly():
    plant = plant_of(VEHICLE, motor_lag=MotorLag(hover_s=0.06, propeller_share=0.3, braking_share=0.5))
    hover = plant.rotors.hover_value
    for sign, share in ((1.0, 1.0), (-1.0, None)):
        history = advance(plant, state_of(plant), 0.6, target=np.full(4, hover * (1.0 + 0.01 * sign)))
        rise = (history[:, ROTOR] - hover) / (0.01 * sign * hover)
        t63 = 0.001 * np.argmax(rise > 1.0 - np.exp(-1.0))
        assert rise[-1] == pytest.approx(1.0, abs=1e-3)
        if share:
            assert t63 == pytest.approx(0.06, abs=0.002)
    fully = plant_of(VEHICLE, motor_lag=MotorLag(hover_s=0.06, propeller_share=0.3, braking_share=1.0))
    goal = np.full(4, 0.6 * hover)
    braked, half_braked = (advance(p, state_of(p), 0.05, target=goal)[-1, ROTOR] for p in (fully, plant))
    coasting = hover / (1.0 + 0.05 * 0.5 * 0.3 / 0.06)  # dOmega/dt = -beta Omega^2, the propeller alone
    assert braked < half_braked - 0.03 * hover
    assert half_braked < coasting


def _idle_then_step(**effects):
    """Commands at hover, then 10 % more at 0.1 s: times and speeds as telemetry has them."""
    scenario = Scenario(effects=Effects()._replace(**effects))
    simulation = Simulation(VEHICLE, scenario, 1)
    hover = simulation.world.plant.rotors.hover_value
    chunks = [simulation.drive(100, np.full(4, hover)), simulation.drive(300, np.full(4, 1.1 * hover))]
    stamps = np.concatenate([c["motors"][0] for c in chunks])
    return stamps, np.concatenate([c["motors"][2] for c in chunks])[:, 0] / hover


def test_an_input_delay_shifts_the_answer_and_changes_nothing_else():
    stamps, speed = _idle_then_step(input_delay=InputDelay(0.034))
    assert stamps[np.argmax(speed > 1.05)] == pytest.approx(0.134, abs=0.0021)
    assert speed[-1] == pytest.approx(1.1)


def test_under_battery_sag_the_same_command_gives_the_speed_that_the_voltage_allows():
    _, speed = _idle_then_step(battery_sag=BatterySag())
    scenario = Scenario(effects=Effects()._replace(battery_sag=BatterySag()))
    simulation = Simulation(VEHICLE, scenario, 1)
    hover = simulation.world.plant.rotors.hover_value
    early = simulation.drive(1000, np.full(4, hover))
    late = [simulation.drive(1000, np.full(4, hover)) for _ in range(60)][-1]
    ratio = late["motors"][2][-1, 0] / hover
    volts = late["battery"][2][-1, 0] / simulation.world.supply.full_v
    assert ratio == pytest.approx(volts, rel=1e-3)
    assert ratio < early["motors"][2][-1, 0] / hover - 0.005
    assert speed.max() < 1.1


# attached, and in the room


def test_a_load_swings_as_the_pendulum_it_is():
    load = SlungLoad(mass_kg=0.05, length_m=0.6, damping_1_s=0.0)
    hook, position, velocity = (0.0, 0.0, 3.0), np.array([0.05, 0.0, 2.4]), np.zeros(3)
    crossings, pull = [], 0.0
    for step in range(6000):
        force, acceleration = cable(load, hook, (0.0, 0.0, 0.0), tuple(position), tuple(velocity), 9.80665)
        velocity += 0.001 * np.array(acceleration)
        before = position[0]
        position += 0.001 * velocity
        pull += force[2] / 6000
        if before > 0.0 >= position[0]:
            crossings.append(0.001 * step)
    assert np.mean(np.diff(crossings)) == pytest.approx(2.0 * np.pi * np.sqrt(0.6 / 9.80665), rel=0.01)
    assert pull == pytest.approx(-0.05 * 9.80665, rel=0.02)


def test_a_slack_cable_does_not_push():
    force, acceleration = cable(SlungLoad(length_m=0.6), (0.0, 0.0, 3.0), (0.0,) * 3, (0.0, 0.0, 2.7), (0.0,) * 3, 9.8)
    assert force == (0.0, 0.0, 0.0)
    assert acceleration == pytest.approx((0.0, 0.0, -9.8))


def test_a_tether_pulls_to_its_anchor_and_is_slack_within_its_length():
    effect = {"tether": Tether(anchor_m=(1.0, 0.0, 5.0), length_m=0.5, stiffness_n_m=2.0)}
    np.testing.assert_allclose(_force(effect, position=(-1.0, 0.0, 5.0)), [3.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(_force(effect, position=(0.6, 0.0, 5.0)), 0.0, atol=1e-12)
    turned = _force(effect, position=(-1.0, 0.0, 5.0), euler=(0.0, 0.0, np.pi / 2.0))
    np.testing.assert_allclose(turned, [0.0, -3.0, 0.0], atol=1e-9)


def test_a_steady_wrench_keeps_its_frame():
    effect = {"constant_wrench": ConstantWrench((0.5, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.01))}
    force, torque = change_of(VEHICLE, effect, euler=(0.0, 0.0, np.pi / 2.0))
    np.testing.assert_allclose(force, [0.0, 0.2 - 0.5, 0.0], atol=1e-9)
    np.testing.assert_allclose(torque, [0.0, 0.0, 0.01], atol=1e-9)


def test_the_wall_draws_in_and_more_so_nearby():
    effect = {"attracting_wall": AttractingWall(distance_m=1.5, azimuth_rad=np.pi / 2.0)}
    far, near = (_force(effect, position=(0.0, y, 2.0)) for y in (0.0, 1.0))
    assert near[1] > 5.0 * far[1] > 0.0
    assert abs(near[0]) < 1e-9


def test_the_magnet_pulls_with_the_fourth_power_and_turns_its_mate_towards_itself():
    magnet = Magnet(position_m=(1.0, 0.0, 5.0), strength_n_m4=0.1, moment_body=(0.0, 0.0, 1.0))
    effect = {"magnet": magnet}
    at_one, at_half = (change_of(VEHICLE, effect, position=(x, 0.0, 5.0)) for x in (0.0, 0.5))
    assert at_one[0][0] == pytest.approx(0.1)
    assert at_half[0][0] == pytest.approx(1.6)
    assert at_one[1][1] > 0.0  # turns z towards x
    aligned = change_of(VEHICLE, effect, position=(0.0, 0.0, 5.0), euler=(0.0, np.pi / 2.0, 0.0))
    np.testing.assert_allclose(aligned[1], 0.0, atol=1e-9)


# clocks and frames


def test_the_clock_effect_moves_stamps_of_poses_and_nothing_else():
    effect = Effects()._replace(clock_offset=ClockOffset(offset_s=0.03, drift_ppm=200.0))
    plain, shifted = (Simulation(VEHICLE, Scenario(effects=e), 1).idle(5000) for e in (Effects(), effect))
    true = np.arange(len(shifted["mocap"][0])) / 120.0 / 1.0002
    np.testing.assert_allclose(shifted["mocap"][0], true * 1.0002 + 0.03, atol=1e-12)
    np.testing.assert_allclose(shifted["mocap"][1], true, atol=1e-12)
    np.testing.assert_array_equal(shifted["imu"][0], plain["imu"][0])


def test_a_turned_imu_reads_the_same_vector_in_its_own_axes():
    turn = np.array([0.1, -0.05, 0.2])
    effect = ImuMisalignment(
        tuple(turn), gyro_bias_rad_s=(0.01, 0.0, 0.0), accel_scale=(1.0, 1.0, 1.02), gyro_scale=(1.0, 0.99, 1.0)
    )
    instruments = build_instruments(VEHICLE, Scenario(effects=Effects()._replace(imu_misalignment=effect)))
    out = np.zeros(6)
    measure_imu(instruments, np.zeros((2, 6)), (1.0, 2.0, 3.0), (0.0, 0.0, 9.8), np.zeros(6), out)
    q = frames.quat_exp(turn)
    rate, force = (frames.quat_rotate_inverse(q, v) for v in ([1.0, 2.0, 3.0], [0.0, 0.0, 9.8]))
    np.testing.assert_allclose(out[:3], rate * [1.0, 0.99, 1.0] + [0.01, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(out[3:], force * [1.0, 1.0, 1.02], atol=1e-12)


def _pose(position, q, **effects):
    instruments = build_instruments(VEHICLE, Scenario(effects=Effects()._replace(**effects)))
    out = np.zeros(7)
    measure_pose(instruments, np.zeros(7), tuple(position), tuple(map(float, q)), False, np.zeros(6), out)
    return out


def test_a_shifted_marker_body_swings_with_the_attitude_and_a_turned_one_differs_by_a_constant():
    effect = MocapMisalignment(rotation_rad=(0.02, 0.0, 0.0), offset_m=(0.0, 0.0, 0.1))
    for euler in ((0.0, 0.0, 0.0), (0.3, -0.2, 1.0)):
        q = frames.quat_from_euler(*euler)
        pose = _pose((1.0, 2.0, 3.0), q, mocap_misalignment=effect)
        np.testing.assert_allclose(pose[:3], np.array([1.0, 2.0, 3.0]) + frames.quat_rotate(q, [0.0, 0.0, 0.1]))
        difference = frames.quat_log(frames.quat_multiply(frames.quat_conjugate(q), pose[3:]))
        np.testing.assert_allclose(difference, [0.02, 0.0, 0.0], atol=1e-9)


def test_a_tilted_capture_world_turns_positions_and_attitudes_alike():
    q = frames.quat_from_euler(0.3, -0.2, 1.0)
    pose = _pose((1.0, 2.0, 3.0), q, mocap_tilt=MocapTilt(tilt_rad=(0.02, -0.01)))
    tilt = frames.quat_exp([-0.02, 0.01, 0.0])  # seen from a frame that is tilted the other way
    np.testing.assert_allclose(pose[:3], frames.quat_rotate(tilt, [1.0, 2.0, 3.0]))
    np.testing.assert_allclose(pose[3:], frames.quat_multiply(tilt, q))


def test_every_effect_has_a_test_here_or_among_the_conservation_laws():
    told = {name for name in Effects._fields if type(getattr(Effects(), name)).__name__ in globals()}
    assert set(Effects._fields) - told == {"payload_change", "rotor_gyroscopic"}  # tests/test_sim_plant.py


def test_nothing_is_on_unless_a_scenario_says_so():
    assert not any(getattr(Effects(), name).on for name in Effects._fields)
