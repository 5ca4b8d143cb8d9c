"""Flight-path reconstruction and clock alignment on exact kinematics with planted errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest
from flights import rest_to_rest_plan

from groundstation.errors import Refused
from groundstation.frames import quat_exp, quat_from_euler, quat_multiply, quat_rotate, quat_rotate_inverse
from groundstation.identification import position_fit
from groundstation.identification.attitude_fit import Recording
from groundstation.identification.clock import coarse_offset
from groundstation.identification.reconstruction import Compatibility, body_motion, reconstruct
from groundstation.identification.smoothing import position_filter
from groundstation.recording.blemishes import frozen, jumps
from groundstation.trajectory import rigid_motion

GRAVITY = 9.80665
PLANTED = {
    "mocap_minus_imu_s": -0.0312,
    "clock_drift": 4.0e-5,
    "gyro_bias_x_rad_s": 0.011, "gyro_bias_y_rad_s": -0.007, "gyro_bias_z_rad_s": 0.004,
    "mocap_rotation_x_rad": 0.02, "mocap_rotation_y_rad": -0.03, "mocap_rotation_z_rad": 0.015,
    "accel_bias_x_m_s2": 0.06, "accel_bias_y_m_s2": -0.04, "accel_bias_z_m_s2": 0.08,
    "mocap_position_x_m": 0.03, "mocap_position_y_m": -0.02, "mocap_position_z_m": 0.025,
}  # fmt: skip


@dataclass(frozen=True)
class Recorded:
    """What IMU and motion capture would record of an exact motion, and the motion at the IMU's stamps."""

    t_imu: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray
    t_pose: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    true_quaternion: np.ndarray
    true_position: np.ndarray
    true_velocity: np.ndarray


def record(seed: int, error: Mapping[str, float] = PLANTED, *, noise: float = 1.0) -> Recorded:
    """40 s of a fast random excitation at 250 Hz, poses at 100 Hz, ``noise`` times that of a consumer IMU and
    capture.
    """
    random = np.random.default_rng(seed)
    series = rest_to_rest_plan(amplitude_m=1.0, periods=4.0, seed=7).series()

    def three(name: str, unit: str) -> np.ndarray:
        return np.array([error.get(f"{name}_{axis}_{unit}", 0.0) for axis in "xyz"])

    t = np.arange(0.0, 40.0, 1 / 250.0)
    motion = rigid_motion(series.sample(t))
    q = quat_from_euler(*motion.euler_rad.T)
    gyro = (
        motion.angular_velocity_body_rad_s
        + three("gyro_bias", "rad_s")
        + 1e-3 * noise * random.standard_normal((len(t), 3))
    )
    force = motion.specific_thrust_m_s2[:, None] * [0.0, 0.0, 1.0]
    accel = force + three("accel_bias", "m_s2") + 0.02 * noise * random.standard_normal((len(t), 3))
    at = np.arange(0.3, 39.7, 1 / 100.0)
    seen = rigid_motion(series.sample(at))
    q_seen = quat_from_euler(*seen.euler_rad.T)
    marker = quat_multiply(q_seen, quat_exp(three("mocap_rotation", "rad") + np.zeros(3)))
    marker = quat_multiply(marker, quat_exp(1e-3 * noise * random.standard_normal((len(at), 3))))
    place = seen.position_m + quat_rotate(q_seen, three("mocap_position", "m"))
    place = place + 2e-4 * noise * random.standard_normal((len(at), 3))
    stamp = at + error.get("mocap_minus_imu_s", 0.0) + error.get("clock_drift", 0.0) * (at - 20.0)
    return Recorded(t, gyro, accel, stamp, place, marker, q, motion.position_m, motion.velocity_world_m_s)


def found_of(data: Recorded, offset_s: float) -> Compatibility:
    """Reconstruct from a coarse offset."""
    recording = Recording(
        data.t_imu, data.gyro, data.accel, data.t_pose, data.position, data.quaternion, mocap_rotation_rad=np.zeros(3)
    )
    return reconstruct(recording, offset_s=offset_s, gravity_m_s2=GRAVITY)


@pytest.fixture(scope="module")
def several() -> list[Compatibility]:
    """Reconstructions of two noise realisations, from a coarse offset that is 4 ms wrong."""
    return [found_of(record(seed), -0.035) for seed in range(2)]


@pytest.mark.parametrize("name", PLANTED)
def test_every_planted_kinematic_error_is_found_within_its_interval(several: list[Compatibility], name: str) -> None:
    z = np.array([(found.values[name] - PLANTED[name]) / found.std[name] for found in several])
    assert np.max(np.abs(z)) < 3.3, f"{name}: {z}"  # once in a thousand by chance


def test_the_jitter_of_the_stamps_is_found() -> None:
    data = record(1)
    jitter_s = 0.0015
    shaken = data.t_pose + jitter_s * np.random.default_rng(0).standard_normal(len(data.t_pose))
    found = found_of(replace(data, t_pose=shaken), -0.035)
    assert abs(found.values["stamp_jitter_s"] - jitter_s) < 3.3 * found.std["stamp_jitter_s"]
    assert found.std["stamp_jitter_s"] < 0.25 * jitter_s


def test_even_stamps_have_no_jitter(several: list[Compatibility]) -> None:
    for found in several:
        assert found.values["stamp_jitter_s"] < 3.3 * found.std["stamp_jitter_s"]


def test_the_intervals_say_something(several: list[Compatibility]) -> None:
    std = several[0].std
    assert std["mocap_minus_imu_s"] < 1e-3
    assert max(std[f"gyro_bias_{a}_rad_s"] for a in "xyz") < 1e-3
    assert max(std[f"mocap_rotation_{a}_rad"] for a in "xyz") < 2e-3
    assert max(std[f"mocap_position_{a}_m"] for a in "xy") < 0.02


def test_poses_without_any_noise_do_not_make_the_filter_singular() -> None:
    random = np.random.default_rng(0)
    dt = np.concatenate([[0.0], np.full(999, 0.01)])
    error = 1e-15 * random.standard_normal((1000, 3)) + np.linspace(0.0, 1e-12, 1000)[:, None]
    noise = position_fit._position_noise(error, dt)
    _, variance, _, _, predicted = position_filter(error, dt, noise, True)
    assert np.all(variance[3:] > 0.0)
    assert np.min(np.linalg.eigvalsh(predicted[3:])) > 0.0


def test_the_smoothed_motion_is_the_true_one() -> None:
    data = record(0, {k: v for k, v in PLANTED.items() if "position" not in k and "rotation" not in k})
    found = found_of(data, -0.035)
    inside = (data.t_imu > 1.0) & (data.t_imu < 39.0)
    error = found.position_m[inside] - data.true_position[inside]
    assert np.sqrt(np.mean((error - error.mean(axis=0)) ** 2)) < 1e-3
    assert np.sqrt(np.mean((found.velocity_m_s[inside] - data.true_velocity[inside]) ** 2)) < 0.01
    tilt = quat_rotate_inverse(found.quaternion[inside], np.array([0.0, 0.0, 1.0]))
    assert np.max(np.abs(tilt - quat_rotate_inverse(data.true_quaternion[inside], np.array([0.0, 0.0, 1.0])))) < 5e-3


@pytest.mark.parametrize("offset", [-0.124, 0.0, 0.05, 3.2])
def test_the_coarse_offset_is_within_a_few_milliseconds(offset: float) -> None:
    data = record(2, {"mocap_minus_imu_s": offset, "gyro_bias_x_rad_s": 0.02})
    value, correlation = coarse_offset(data.t_imu, data.gyro, data.t_pose, data.quaternion, expected_s=offset * 0.9)
    assert value == pytest.approx(offset, abs=4e-3)
    assert correlation > 0.8


def test_the_clock_survives_frozen_poses_drop_outs_and_jumps() -> None:
    data = record(3, PLANTED | {"mocap_minus_imu_s": -0.124})
    position, q = data.position.copy(), data.quaternion.copy()
    random = np.random.default_rng(0)
    for start in random.integers(0, len(q) - 60, 25):  # about a third of the poses, as measured data have it
        position[start : start + 58], q[start : start + 58] = position[start], q[start]
    position[1500:1510] += 0.4
    q[1500:1510] = quat_multiply(q[1500:1510], quat_exp(np.tile([0.0, 0.0, 0.7], (10, 1))))
    bad = frozen(data.t_pose, position, q)
    keep = ~bad & (random.random(len(q)) > 0.1)
    keep[keep] &= ~jumps(data.t_pose[keep], position[keep], q[keep])
    spoilt = replace(data, t_pose=data.t_pose[keep], position=position[keep], quaternion=q[keep])
    coarse, _ = coarse_offset(spoilt.t_imu, spoilt.gyro, spoilt.t_pose, spoilt.quaternion)
    assert coarse == pytest.approx(-0.124, abs=0.03)
    found = found_of(spoilt, coarse)
    assert abs(found.values["mocap_minus_imu_s"] + 0.124) < min(3.3 * found.std["mocap_minus_imu_s"], 4e-3)


def test_clocks_without_a_common_motion_are_refused() -> None:
    data = record(0)
    noise = 0.01 * np.random.default_rng(5).standard_normal(data.gyro.shape)
    with pytest.raises(Refused, match="cannot be aligned"):
        coarse_offset(data.t_imu, noise, data.t_pose, data.quaternion)


def test_the_declared_origin_moves_with_the_lever_arm() -> None:
    data = record(0, {})
    found = found_of(data, 0.0)
    arm = np.array([0.1, 0.0, 0.0])
    q, p, v = body_motion(found, data.gyro, arm)
    np.testing.assert_allclose(np.linalg.norm(p - found.position_m, axis=1), 0.1, atol=1e-9)
    slope = np.gradient(p - found.position_m, data.t_imu, axis=0)
    np.testing.assert_allclose(v[500:-500] - found.velocity_m_s[500:-500], slope[500:-500], atol=0.03)
    np.testing.assert_array_equal(q, found.quaternion)
