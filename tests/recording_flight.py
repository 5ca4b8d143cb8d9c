"""A short flight by kinematics alone, for the tests of recordings: what sensors would give on the published trajectory.

No simulator: attitude, rates and specific force follow from the trajectory, rotor speeds from the declared vehicle's
rigid-body equations. Every stream has its own clock, rate, offset and arrival times.
"""

from __future__ import annotations

import numpy as np

from groundstation.flightdata import (
    BATTERY_COLUMNS,
    IMU_COLUMNS,
    MOCAP_COLUMNS,
    SETPOINT_COLUMNS,
    STATE_COLUMNS,
    FlightData,
    Stream,
    motor_columns,
)
from groundstation.frames import quat_from_euler
from groundstation.paths import configs_dir
from groundstation.trajectory import load_plan, rigid_motion
from groundstation.vehicle import load_vehicle


def qball():
    return load_vehicle(configs_dir() / "vehicles" / "qball2.toml")


def flight(duration_s: float = 6.0, seed: int = 0, scale: float = 1.0) -> FlightData:
    """The flight; ``scale`` runs the trajectory that many times faster (rates grow with it, accelerations with its
    square).
    """
    rng = np.random.default_rng(seed)
    vehicle = qball()
    plan = load_plan(configs_dir() / "plans" / "paper_table2.toml")

    def motion(t_s):
        flat = plan.series().sample((t_s * scale) % 10.0)
        flat.position[:] *= scale ** np.arange(5)[:, None, None]
        flat.yaw[:] *= scale ** (np.arange(3)[:, None] - 2.0)  # as small a yaw as keeps its acceleration
        return rigid_motion(flat)

    def times(rate_hz):
        t_s = np.arange(0.0, duration_s, 1.0 / rate_hz)
        return t_s, 50.0 + t_s + 0.002 + rng.uniform(0.0, 0.001, len(t_s))

    t_s, received = times(250.0)
    m = motion(t_s)
    accel = np.column_stack([np.zeros((len(t_s), 2)), m.specific_thrust_m_s2])
    imu = np.hstack([m.angular_velocity_body_rad_s, accel]) + rng.normal(size=(len(t_s), 6)) * [
        *[0.005] * 3,
        *[0.05] * 3,
    ]
    inertia = vehicle.inertia_tensor()
    w = m.angular_velocity_body_rad_s
    torque = m.angular_acceleration_body_rad_s2 @ inertia.T + np.cross(w, w @ inertia.T)
    wrench = np.column_stack([vehicle.mass_kg * m.specific_thrust_m_s2, torque])
    thrust = np.linalg.lstsq(vehicle.allocation(), wrench.T, rcond=None)[0].T.clip(0.05)
    speed = np.sqrt(thrust / vehicle.rotors.thrust_coefficient_n_s2) + rng.normal(size=(len(t_s), 4))

    t_pose, received_pose = times(100.0)
    p = motion(t_pose)
    q = quat_from_euler(*p.euler_rad.T) + rng.normal(size=(len(t_pose), 4)) * 2e-4
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    xyz = p.position_m + rng.normal(size=(len(t_pose), 3)) * 3e-4
    state = np.hstack([p.position_m, p.velocity_world_m_s, q, p.angular_velocity_body_rad_s])
    t_slow, received_slow = times(10.0)
    battery = np.column_stack([12.4 - 0.01 * t_slow, 8.0 + rng.normal(size=len(t_slow))])
    s = motion(t_slow)
    return FlightData(
        name="kinematic",
        vehicle=vehicle,
        motors=Stream(t_s + 3.25, speed, motor_columns("rotor_speed", 4), received),
        imu=Stream(t_s + 3.25, imu, IMU_COLUMNS, received),
        mocap=Stream(t_pose * (1 + 2e-5) - 1.5, np.hstack([xyz, q]), MOCAP_COLUMNS, received_pose),
        battery=Stream(t_slow + 3.25, battery, BATTERY_COLUMNS, received_slow),
        setpoint=Stream(t_slow + 3.25, np.column_stack([s.position_m, s.euler_rad[:, 2]]), SETPOINT_COLUMNS),
        state=Stream(t_pose + 3.25, state, STATE_COLUMNS, received_pose),
        plan=plan,
        window_s=(3.25, 3.25 + duration_s),
        truth=vehicle,
        metadata={"scenario": "kinematic"},
    )


def changes_agree(flown, vehicle, lag_s, axes):
    """Correlation of the gyro's changes over 50 ms with those the rotors' torques make, per axis."""
    t = flown.imu.t_s
    held = np.clip(np.searchsorted(flown.motors.t_s + lag_s, t, side="right") - 1, 0, None)
    torque = (vehicle.thrust(flown.motors.values) @ vehicle.allocation().T)[held, 1:]
    predicted = np.cumsum(torque[:-1] * np.diff(t)[:, None], axis=0) / np.diag(vehicle.inertia_tensor())
    step = round(0.05 / np.median(np.diff(t)))
    made = flown.imu.values[1:, :3]
    return [
        float(np.corrcoef(made[step:, a] - made[:-step, a], predicted[step:, a] - predicted[:-step, a])[0, 1])
        for a in axes
    ]
