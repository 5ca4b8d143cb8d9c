"""Sensors of the simulated vehicle: rates, noise, clocks and losses are what the scenario says, and one seed is one
flight.
"""

from __future__ import annotations

import numpy as np
import pytest
from sim_states import vehicle_of

from groundstation import frames
from groundstation.errors import BadInput
from groundstation.vehicle import Imu, Mocap
from sim.background import Disturbance, drift_step, open_circuit_ratio
from sim.build import build_world, low_pass
from sim.effects import Effects
from sim.noise import Outages, Ticker
from sim.scenario import (
    BatteryModel,
    Clock,
    DisturbanceModel,
    ImuModel,
    MocapModel,
    MotorModel,
    Scenario,
    StreamRate,
)
from sim.simulation import Simulation

VEHICLE = vehicle_of()
NOISY = Scenario(
    imu=ImuModel(
        gyro_density=2e-4,
        accel_density=3e-3,
        gyro_bias_std=0.01,
        accel_bias_std=0.05,
        gyro_walk=1e-4,
        clock=Clock(offset_s=0.5, drift_ppm=40.0, jitter_s=1e-5, latency_s=0.003, latency_jitter_s=0.001, phase=None),
    ),
    mocap=MocapModel(
        position_std_m=3e-4,
        attitude_std_rad=2e-3,
        dropouts_per_minute=6.0,
        dropout_s=0.2,
        clock=Clock(offset_s=-0.02, latency_s=0.01, latency_jitter_s=0.002, phase=None),
    ),
    motors=MotorModel(noise_share=0.003),
    battery=BatteryModel(voltage_std_v=0.02),
    state=StreamRate(rate_hz=100.0),
    disturbance=DisturbanceModel(force_share=0.003, torque_share=0.003),
)


def _idle(scenario: Scenario, seconds: float, seed: int = 1, vehicle=VEHICLE):
    return Simulation(vehicle, scenario, seed).idle(round(1000 * seconds))


def test_at_rest_the_accelerometer_reads_plus_g_up_and_the_gyro_nothing():
    _, _, imu = _idle(Scenario(), 1.0)["imu"]
    np.testing.assert_allclose(imu, np.tile([0, 0, 0, 0, 0, VEHICLE.gravity_m_s2], (500, 1)), atol=1e-12)


def test_the_imus_noise_has_its_stated_density_and_its_bias_walks():
    scenario = NOISY.model_copy(update={"imu": NOISY.imu.model_copy(update={"gyro_walk": 0.0})})
    _, _, imu = _idle(scenario, 60.0)["imu"]
    white = np.diff(imu, axis=0).std(axis=0) / np.sqrt(2.0)
    np.testing.assert_allclose(white[:3], 2e-4 * np.sqrt(250.0), rtol=0.03)
    np.testing.assert_allclose(white[3:], 3e-3 * np.sqrt(250.0), rtol=0.03)
    biases = np.array([_idle(scenario, 1.0, seed)["imu"][2].mean(axis=0) for seed in range(60)])
    np.testing.assert_allclose(biases[:, :3].std(axis=0), 0.01, rtol=0.35)
    walking = scenario.model_copy(update={"imu": ImuModel(gyro_walk=1e-3)})
    ends = np.array([_idle(walking, 4.0, seed)["imu"][2][-1, :3] for seed in range(60)])
    assert ends.std() == pytest.approx(1e-3 * np.sqrt(4.0), rel=0.2)


def test_the_drivers_filter_is_a_butterworth_of_unit_gain_and_half_power_at_its_cut_off():
    b0, b1, b2, a1, a2 = low_pass(80.0, 500.0)
    z = np.exp(-2j * np.pi * np.array([1e-6, 80.0, 249.0]) / 500.0)
    gain = np.abs((b0 + b1 * z + b2 * z**2) / (1.0 + a1 * z + a2 * z**2))
    np.testing.assert_allclose(gain, [1.0, np.sqrt(0.5), 0.0], atol=1e-3)
    filtered = VEHICLE.model_copy(update={"imu": Imu(filter_hz=40.0)})
    loud = ImuModel(gyro_density=1e-3)
    raw, smooth = (_idle(Scenario(imu=loud), 20.0, vehicle=v)["imu"][2][100:, :3].std() for v in (VEHICLE, filtered))
    # Noise bandwidth of a second-order Butterworth is 1.11 times its cut-off; the raw one's is half the rate.
    assert smooth / raw == pytest.approx(np.sqrt(1.11 * 40.0 / 250.0), rel=0.06)
    with pytest.raises(BadInput, match="filter_hz"):
        low_pass(250.0, 500.0)


def test_a_device_clock_is_offset_drifts_and_samples_faster_when_it_is_fast():
    clock = Clock(offset_s=0.7, drift_ppm=1000.0)
    true, stamps, arrivals = Ticker(clock, 100.0, np.random.default_rng(1)).until(100.0)
    assert len(true) == 10010
    np.testing.assert_allclose(np.diff(stamps), 0.01, atol=1e-12)
    np.testing.assert_allclose(stamps - true, 0.7 + 1e-3 * true, atol=1e-9)
    np.testing.assert_array_equal(arrivals, true)


def test_stamps_jitter_and_arrivals_are_late_by_their_stated_amounts_and_never_overtake():
    clock = Clock(jitter_s=2e-4, latency_s=0.005, latency_jitter_s=0.002)
    true, stamps, arrivals = Ticker(clock, 100.0, np.random.default_rng(1)).until(200.0)
    assert (stamps - true).std() == pytest.approx(2e-4, rel=0.03)
    assert abs((stamps - true).mean()) < 1e-5
    late = arrivals - true
    assert late.min() >= 0.005
    assert late.mean() == pytest.approx(0.007, rel=0.05)
    assert (np.diff(arrivals) >= 0.0).all()


def test_outages_take_their_share_of_the_time():
    times = np.arange(0.0, 6000.0, 0.02)
    out = Outages(6.0, 0.5, np.random.default_rng(2)).during(times)
    starts = np.sum(out[1:] & ~out[:-1])
    assert starts / 100.0 == pytest.approx(6.0, rel=0.15)
    assert out.mean() == pytest.approx(0.05 / 1.05, rel=0.2)
    assert not Outages(0.0, 0.5, np.random.default_rng(2)).during(times).any()


def test_poses_have_their_noise_get_lost_and_freeze():
    lossy = MocapModel(position_std_m=3e-4, attitude_std_rad=2e-3, dropouts_per_minute=30.0, freezes_per_minute=30.0)
    stamps, _, poses = _idle(Scenario(mocap=lossy), 60.0)["mocap"]
    frozen = (np.diff(poses, axis=0) == 0.0).all(axis=1)
    gaps = np.diff(stamps)
    assert 0.01 < frozen.mean() < 0.1
    assert np.sum(gaps > 1.5 / 120.0) > 10
    fresh = poses[1:][~frozen]
    np.testing.assert_allclose(fresh[:, :3].std(axis=0), 3e-4, rtol=0.05)
    turns = frames.quat_log(fresh[:, 3:])
    np.testing.assert_allclose(turns.std(axis=0), 2e-3, rtol=0.05)
    np.testing.assert_allclose(np.linalg.norm(poses[:, 3:], axis=1), 1.0, atol=1e-12)


def test_a_declared_marker_offset_is_in_the_poses_and_the_vehicle_knows_of_it():
    vehicle = VEHICLE.model_copy(update={"mocap": Mocap(position_m=(0.1, 0.0, 0.05), rotation_rad=(0.0, 0.0, 0.3))})
    simulation = Simulation(vehicle, Scenario(), 1)
    _, _, poses = simulation.idle(3000)["mocap"]
    np.testing.assert_allclose(poses[-1, :3], [0.1, 0.0, 0.15], atol=1e-9)
    assert frames.euler_from_quat(poses[-1, 3:])[2] == pytest.approx(0.3)
    np.testing.assert_allclose(simulation.estimate[:3], [0.0, 0.0, 0.1], atol=1e-6)


def test_rotor_telemetry_is_noisy_only_while_a_rotor_turns_and_commands_are_exact():
    noisy = Scenario(motors=MotorModel(noise_share=0.01))
    simulation = Simulation(VEHICLE, noisy, 1)
    hover = simulation.world.plant.rotors.hover_value
    still = simulation.idle(500)["motors"][2]
    turning = simulation.drive(4000, np.full(4, hover))["motors"][2]
    assert not still.any()
    assert turning.std() == pytest.approx(0.01 * hover, rel=0.05)
    told = Simulation(vehicle_of(speed_source="command"), noisy, 1).drive(1000, np.full(4, 444.0))
    assert (told["motors"][2] == 444.0).all()
    assert len(told["motors"][0]) == 500  # the control rate


def test_a_wrench_vehicle_records_the_wrench_it_asked_for():
    vehicle = vehicle_of(input="wrench")
    chunk = Simulation(vehicle, Scenario(), 1).drive(1000, np.array([1.0, 2.0, 3.0, 4.0]))
    np.testing.assert_allclose(chunk["motors"][2][-1], vehicle.allocation() @ [1.0, 2.0, 3.0, 4.0])


def test_the_battery_falls_with_charge_and_with_current():
    simulation = Simulation(VEHICLE, Scenario(), 1)
    hover = simulation.world.plant.rotors.hover_value
    resting = simulation.idle(1000)["battery"][2]
    loaded = simulation.drive(1000, np.full(4, hover))["battery"][2]
    later = [simulation.drive(30000, np.full(4, hover))["battery"][2] for _ in range(4)][-1]
    supply = simulation.world.supply
    assert resting[-1, 0] == pytest.approx(supply.full_v, rel=0.005)
    assert resting[-1, 0] - loaded[-1, 0] == pytest.approx(
        supply.resistance * (loaded[-1, 1] - resting[-1, 1]), rel=0.05
    )
    assert later[-1, 0] < loaded[-1, 0] - 0.02 * supply.full_v
    ratios = [open_circuit_ratio(left) for left in np.linspace(0.0, 1.0, 101)]
    assert (np.diff(ratios) > 0.0).all()
    assert ratios[-1] == pytest.approx(1.0)


def test_the_disturbance_has_its_size_and_its_correlation_time():
    random = np.random.default_rng(4)
    for order, at_one in ((1, np.exp(-1.0)), (2, 2.0 * np.exp(-1.0))):  # autocorrelation at one time constant
        process = Disturbance(force_n=0.2, torque_nm=0.03, correlation=0.05, order=order)
        state = np.zeros((2, 6))
        rows = np.array([np.ravel(drift_step(process, state, random.standard_normal(6), 0.001)) for _ in range(60000)])
        np.testing.assert_allclose(rows.std(axis=0), np.repeat([0.2, 0.03], 3), rtol=0.12)
        seen = np.mean([np.corrcoef(row[:-50], row[50:])[0, 1] for row in rows.T])
        assert seen == pytest.approx(at_one, abs=0.05)
    model = DisturbanceModel(force_share=0.01, torque_share=0.01)
    world = build_world(VEHICLE, Scenario(disturbance=model))
    weight = VEHICLE.mass_kg * VEHICLE.gravity_m_s2
    assert world.disturbance.force_n == pytest.approx(0.01 * weight)
    assert world.disturbance.torque_nm == pytest.approx(0.01 * weight * VEHICLE.arm_m())


def _all(simulation, cuts):
    hover = np.full(4, simulation.world.plant.rotors.hover_value)
    parts = [simulation.drive(n, hover) for n in cuts]
    return {k: [np.concatenate([p[k][i] for p in parts]) for i in range(3)] for k in parts[0]}


def test_one_seed_is_one_flight_however_time_is_cut_and_another_seed_another():
    whole = _all(Simulation(VEHICLE, NOISY, 5), [3000])
    cut = _all(Simulation(VEHICLE, NOISY, 5), [1, 49, 50, 7, 893, 2000])
    other = _all(Simulation(VEHICLE, NOISY, 6), [3000])
    for name, parts in whole.items():
        for one, two in zip(parts, cut[name], strict=True):
            np.testing.assert_allclose(one, two, rtol=0.0, atol=1e-12)
    assert not np.array_equal(whole["imu"][2], other["imu"][2])


def test_an_effect_changes_what_it_does_and_no_noise():
    """Switching something on leaves every other source of randomness as it was."""
    from sim.effects import ClockOffset

    plain = _idle(NOISY, 2.0)
    shifted = _idle(NOISY.model_copy(update={"effects": Effects()._replace(clock_offset=ClockOffset(0.01))}), 2.0)
    for name in ("imu", "motors", "battery"):
        np.testing.assert_array_equal(plain[name][2], shifted[name][2])
    np.testing.assert_allclose(shifted["mocap"][0] - plain["mocap"][0], 0.01, atol=1e-12)
