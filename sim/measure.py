"""What IMU and motion capture read, in compiled code: frames, scale, bias, the driver's filter; noise is handed in."""

from __future__ import annotations

from typing import NamedTuple

from sim.algebra import Quaternion, Vector, add, conjugate, copy, exponential, multiply, normalise, to_body, to_world
from sim.compiled import compiled
from sim.lanes import any_of, negate, select


class Instruments(NamedTuple):
    """Constants of the IMU and of the motion-capture body.

    Attributes:
        lever: IMU in the body, m.
        imu_turn: v_body = turn v_imu.
        gyro_scale, accel_scale, gyro_bias, accel_bias: per IMU axis.
        low_pass: b0, b1, b2, a1, a2 of the driver's filter at the IMU's rate.
        point: tracked point in the body, m.
        marker_turn: v_body = turn v_marker.
        world_turn: turns true world vectors into those of motion capture.
        latency: pose age the flight software assumes, s.
        known_point, known_marker_turn: what the flight software takes ``point`` and ``marker_turn`` for.
    """

    lever: Vector
    imu_turn: Quaternion
    gyro_scale: Vector
    accel_scale: Vector
    gyro_bias: Vector
    accel_bias: Vector
    low_pass: tuple[float, float, float, float, float]
    point: Vector
    marker_turn: Quaternion
    world_turn: Quaternion
    latency: float
    known_point: Vector
    known_marker_turn: Quaternion


@compiled
def measure_imu(p: Instruments, state, w: Vector, felt: Vector, noise, out) -> None:
    """One IMU sample in its own axes with scale, bias, noise and the driver's filter, written into ``out``."""
    rate, force = to_body(p.imu_turn, w), to_body(p.imu_turn, felt)
    b0, b1, b2, a1, a2 = p.low_pass
    for i in range(3):
        out[i] = p.gyro_scale[i] * rate[i] + p.gyro_bias[i] + noise[i]
        out[3 + i] = p.accel_scale[i] * force[i] + p.accel_bias[i] + noise[3 + i]
    for i in range(6):  # transposed direct form II
        raw = out[i]
        out[i] = b0 * raw + state[0, i]
        state[0, i] = b1 * raw - a1 * out[i] + state[1, i]
        state[1, i] = b2 * raw - a2 * out[i]


@compiled
def measure_pose(p: Instruments, last, position: Vector, q: Quaternion, frozen: bool, noise, out) -> None:
    """One pose of the marker body, written into ``out``."""
    if any_of(negate(frozen)):
        seen = to_world(p.world_turn, add(position, to_world(q, p.point)))
        turn = multiply(multiply(p.world_turn, q), p.marker_turn)
        turn = normalise(multiply(turn, exponential((noise[3], noise[4], noise[5]))))
        for i in range(3):
            last[i] = select(frozen, last[i], seen[i] + noise[i])
        for i in range(4):
            last[3 + i] = select(frozen, last[3 + i], turn[i])
    copy(last, out)


@compiled
def body_pose(p: Instruments, pose, out) -> None:
    """Pose of the body as the flight software takes it, from the pose of the marker body."""
    q = multiply((pose[3], pose[4], pose[5], pose[6]), conjugate(p.known_marker_turn))
    shift = to_world(q, p.known_point)
    for i in range(3):
        out[i] = pose[i] - shift[i]
    for i in range(4):
        out[3 + i] = q[i]
