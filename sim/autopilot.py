r"""The simulated vehicle's own flight software: state estimate, PID law of the seed paper (eq. 28-32), mixer.

The law knows the *declared* vehicle. Corrections to the printed equations: (29)-(30) need no factor m once f_p is a
force, and virtual work with d(eta)/dt = W omega gives tau = W^T(...) in (31). The measured yaw stands where the paper
has the desired one in (29)-(30), so that a yaw error does not turn the thrust. The commanded tilt is differentiated by
20 s/(s + 20).
"""

from __future__ import annotations

from math import asin, atan, atan2, cos, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from sim.algebra import Quaternion, Vector, conjugate, exponential, multiply, normalise, scale, to_world
from sim.compiled import compiled
from sim.lanes import nearest, select

POSITION_SUM, ANGLE_SUM, TILT, FORCE, CONTROL_SIZE = 0, 3, 6, 8, 11
"""Controller state: integrals of position error and of attitude error, filtered commanded roll and pitch, held f_p."""

EST_POSITION, EST_VELOCITY, EST_ATTITUDE, EST_RATE, GYRO_BIAS, ACCEL_BIAS, ESTIMATE_SIZE = 0, 3, 6, 10, 13, 16, 19
"""Estimator state; the first 13 are the columns of a ``state`` stream. The acceleration bias is in the world."""

LEAD_RATIO = 0.35
"""What share of a known rotor lag is left in the loop after the lead; less would pass more sensor noise to the rotors.
"""

SETPOINT_SIZE = 11
"""Setpoint row: position (3), velocity (3), acceleration (3) in the world, yaw, yaw rate."""


class Law(NamedTuple):
    """Gains and declared constants of the control law.

    Attributes:
        mass, gravity: declared weight's factors.
        position_p, position_i, position_d, attitude_p, attitude_i, attitude_d: diagonals of eq. (31)-(32).
        filter_rad_s: of the derivative of commanded tilt.
        filter_share: what its state takes of a new value per control period.
        mixing: wrench to rotor thrusts, pseudo-inverse of the declared allocation, shape (n, 4).
        rotor_min, rotor_max: thrust of one rotor, N.
        thrust_max, torque_max: of the whole vehicle, N and N m.
        tilt_max: largest commanded tilt, rad.
        curve: declared c0, c1, c2 of thrust against motor value.
        value_max: largest motor value.
        lead_s: rotor lag that the law knows of and leads by; 0 for none.
        lead_share: what the lead's state takes of a new value per control period.
    """

    mass: float
    gravity: float
    position_p: Vector
    position_i: Vector
    position_d: Vector
    attitude_p: Vector
    attitude_i: Vector
    attitude_d: Vector
    filter_rad_s: float
    filter_share: float
    mixing: np.ndarray
    rotor_min: float
    rotor_max: float
    thrust_max: float
    torque_max: float
    tilt_max: float
    curve: Vector
    value_max: float
    lead_s: float
    lead_share: float


class Observer(NamedTuple):
    """Constants of the estimator.

    Attributes:
        imu_period: s.
        pose_period: s.
        bandwidth: of the position observer, rad/s; all its poles lie there.
        attitude_bandwidth: of the attitude observer.
        gravity: m/s^2.
    """

    imu_period: float
    pose_period: float
    bandwidth: float
    attitude_bandwidth: float
    gravity: float


@compiled
def clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@compiled
def euler_of(q: Quaternion) -> Vector:
    """ZYX Euler angles: roll, pitch, yaw."""
    roll = atan2(2.0 * (q[0] * q[1] + q[2] * q[3]), 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2]))
    pitch = asin(clip(2.0 * (q[0] * q[2] - q[3] * q[1]), -1.0, 1.0))
    yaw = atan2(2.0 * (q[0] * q[3] + q[1] * q[2]), 1.0 - 2.0 * (q[2] * q[2] + q[3] * q[3]))
    return (roll, pitch, yaw)


@compiled
def predict(observer: Observer, estimate, gyro: Vector, accel: Vector) -> None:
    """Carry the estimate over one IMU period."""
    dt = observer.imu_period
    q = (estimate[6], estimate[7], estimate[8], estimate[9])
    rate = (gyro[0] - estimate[13], gyro[1] - estimate[14], gyro[2] - estimate[15])
    push = to_world(q, accel)
    for i in range(3):
        acceleration = push[i] - estimate[ACCEL_BIAS + i] - (observer.gravity if i == 2 else 0.0)
        estimate[EST_POSITION + i] += dt * (estimate[EST_VELOCITY + i] + 0.5 * dt * acceleration)
        estimate[EST_VELOCITY + i] += dt * acceleration
        estimate[EST_RATE + i] = rate[i]
    q = normalise(multiply(q, exponential(scale(dt, rate))))
    for i in range(4):
        estimate[EST_ATTITUDE + i] = q[i]


@compiled
def correct(observer: Observer, estimate, then, pose) -> None:
    """Correct the estimate by a pose, compared with what was estimated when it was exposed.

    Args:
        observer: constants.
        estimate: estimator state now, changed in place.
        then: position and quaternion estimated at the exposure, shape (7,).
        pose: measured position and quaternion, shape (7,).
    """
    h = observer.bandwidth * observer.pose_period
    for i in range(3):
        error = pose[i] - then[i]
        estimate[EST_POSITION + i] += min(3.0 * h, 0.8) * error
        estimate[EST_VELOCITY + i] += 3.0 * h * observer.bandwidth * error
        estimate[ACCEL_BIAS + i] -= h * (observer.bandwidth * observer.bandwidth) * error
    old = (then[3], then[4], then[5], then[6])
    turn = multiply(conjugate(old), (pose[3], pose[4], pose[5], pose[6]))
    sign = select(turn[0] >= 0.0, 2.0, -2.0)
    k = observer.attitude_bandwidth * observer.pose_period
    step = (sign * turn[1], sign * turn[2], sign * turn[3])
    q = (estimate[6], estimate[7], estimate[8], estimate[9])
    q = normalise(multiply(q, exponential(scale(min(2.0 * k, 0.8), step))))
    for i in range(4):
        estimate[EST_ATTITUDE + i] = q[i]
    for i in range(3):
        estimate[GYRO_BIAS + i] -= k * observer.attitude_bandwidth * step[i]


@compiled
def position_loop(law: Law, control, estimate, setpoint, dt: float, standing: bool) -> None:
    """Eq. (32): the force wanted in the world, kept until the next call. The integral rests on the floor."""
    for i in range(3):
        error = setpoint[i] - estimate[EST_POSITION + i]
        rate = setpoint[3 + i] - estimate[EST_VELOCITY + i]
        largest = 0.5 * law.mass * law.gravity / max(law.position_i[i], 1e-9)
        total = clip(control[POSITION_SUM + i] + dt * error, -largest, largest)
        control[POSITION_SUM + i] = select(standing, control[POSITION_SUM + i], total)
        wanted = law.mass * (setpoint[6 + i] + (law.gravity if i == 2 else 0.0))
        wanted += law.position_p[i] * error + law.position_i[i] * control[POSITION_SUM + i] + law.position_d[i] * rate
        control[FORCE + i] = wanted
    weight = law.mass * law.gravity
    control[FORCE + 2] = clip(control[FORCE + 2], 0.2 * weight, max(0.95 * law.thrust_max, 1.05 * weight))


@compiled
def attitude_loop(law: Law, control, estimate, setpoint, dt: float, standing: bool) -> tuple[float, Vector]:
    """Eq. (28)-(31): total thrust and body torque that the law asks for."""
    angles = euler_of((estimate[6], estimate[7], estimate[8], estimate[9]))
    c_roll, s_roll = cos(angles[0]), sin(angles[0])
    c_pitch, s_pitch = cos(angles[1]), sin(angles[1])
    fx, fy, fz = control[FORCE], control[FORCE + 1], control[FORCE + 2]
    c_yaw, s_yaw = cos(angles[2]), sin(angles[2])
    pitch = clip(atan((fx * c_yaw + fy * s_yaw) / fz), -law.tilt_max, law.tilt_max)
    roll = clip(atan(cos(pitch) * (fx * s_yaw - fy * c_yaw) / fz), -law.tilt_max, law.tilt_max)
    thrust = fz / max(c_roll * c_pitch, 0.3)
    yaw_error = setpoint[9] - angles[2]
    yaw_error -= 2.0 * pi * nearest(yaw_error / (2.0 * pi))
    errors = (roll - angles[0], pitch - angles[1], clip(yaw_error, -0.5, 0.5))
    # Derivative filter a s/(s + a), zero-order hold: the state follows, the difference times a is the derivative.
    a = law.filter_rad_s
    slopes = (a * (roll - control[TILT]), a * (pitch - control[TILT + 1]), setpoint[10])
    share = law.filter_share
    control[TILT] += share * (roll - control[TILT])
    control[TILT + 1] += share * (pitch - control[TILT + 1])
    p, q, r = estimate[EST_RATE], estimate[EST_RATE + 1], estimate[EST_RATE + 2]
    t_pitch = s_pitch / max(c_pitch, 0.1)
    turning = q * s_roll + r * c_roll
    rates = (p + t_pitch * turning, q * c_roll - r * s_roll, turning / max(c_pitch, 0.1))
    u = (0.0, 0.0, 0.0)
    for i in range(3):
        largest = 0.3 * law.attitude_p[i] / max(law.attitude_i[i], 1e-9)
        total = clip(control[ANGLE_SUM + i] + dt * errors[i], -largest, largest)
        control[ANGLE_SUM + i] = select(standing, control[ANGLE_SUM + i], total)
        value = law.attitude_p[i] * errors[i] + law.attitude_i[i] * control[ANGLE_SUM + i]
        value += law.attitude_d[i] * (slopes[i] - rates[i])
        u = (value if i == 0 else u[0], value if i == 1 else u[1], value if i == 2 else u[2])
    torque = (
        u[0],
        s_roll * t_pitch * u[0] + c_roll * u[1] + s_roll / max(c_pitch, 0.1) * u[2],
        c_roll * t_pitch * u[0] - s_roll * u[1] + c_roll / max(c_pitch, 0.1) * u[2],
    )
    return thrust, torque


@compiled
def motor_value(law: Law, thrust: float) -> float:
    """Motor value that gives a thrust by the declared curve."""
    c = law.curve
    root = c[1] * c[1] - 4.0 * c[2] * (c[0] - thrust)
    curved = clip((-c[1] + sqrt(max(root, 0.0))) / (2.0 * c[2]), 0.0, law.value_max)
    return select(c[2] == 0.0, min((thrust - c[0]) / c[1], law.value_max), curved)


@compiled
def mix(law: Law, thrust: float, torque: Vector, values) -> None:
    """Wrench to motor values within the rotors' limits: tilt torque first, then thrust, then as much yaw as is left.

    Args:
        law: constants.
        thrust: N.
        torque: N m.
        values: motor values, written, shape (n,).
    """
    m = law.mixing
    n = len(values)
    total = clip(thrust, 0.0, law.thrust_max)
    tx = clip(torque[0], -law.torque_max, law.torque_max)
    ty = clip(torque[1], -law.torque_max, law.torque_max)
    tz = clip(torque[2], -law.torque_max, law.torque_max)
    least, most = 0.0, 0.0
    for i in range(n):
        tilt = m[i, 1] * tx + m[i, 2] * ty
        least, most = min(least, tilt), max(most, tilt)
    room = law.rotor_max - law.rotor_min
    keep = select(most - least > room, room / (most - least), 1.0)
    low, high = 1e30, -1e30
    for i in range(n):
        values[i] = m[i, 0] * total + keep * (m[i, 1] * tx + m[i, 2] * ty)
        low, high = min(low, values[i]), max(high, values[i])
    shift = max(law.rotor_min - low, 0.0) + min(law.rotor_max - high, 0.0)
    yaw_share = 1.0
    for i in range(n):
        values[i] += shift
        turn = m[i, 3] * tz
        above = min(yaw_share, max(law.rotor_max - values[i], 0.0) / turn)
        below = min(yaw_share, max(values[i] - law.rotor_min, 0.0) / -turn)
        yaw_share = select(turn > 0.0, above, select(turn < 0.0, below, yaw_share))
    for i in range(n):
        values[i] = motor_value(law, values[i] + yaw_share * m[i, 3] * tz)


@compiled
def lead(law: Law, state, values) -> None:
    """Lead motor values by (1 + T s)/(1 + r T s), r = LEAD_RATIO, which leaves a rotor lag of r T in the loop.

    Nothing is led where T is zero.

    Args:
        law: constants; T is ``lead_s``.
        state: lagged motor values, shape (n,), changed in place.
        values: motor values, changed in place and kept within the rotors' limits.
    """
    low, high = motor_value(law, law.rotor_min), motor_value(law, law.rotor_max)
    for i in range(len(values)):
        state[i] += law.lead_share * (values[i] - state[i])
        led = clip(state[i] + (values[i] - state[i]) / LEAD_RATIO, low, high)
        values[i] = select(law.lead_s > 0.0, led, values[i])
