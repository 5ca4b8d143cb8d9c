"""A flight computed from a trajectory in closed form: no simulator, no integrator, no controller."""

from __future__ import annotations

import numpy as np

from groundstation.flightdata import IMU_COLUMNS, MOCAP_COLUMNS, WRENCH_COLUMNS, FlightData, Stream, motor_columns
from groundstation.frames import matrix_from_quat, quat_from_euler
from groundstation.trajectory import FourierSeries, rigid_motion
from groundstation.vehicle import Vehicle, vehicle_from_dict, vehicle_to_dict

# Table 2 of the seed paper: a and b of x, y, z, yaw; offsets.
TABLE_2_A = [
    [-0.1000, -0.0386, -0.0828, -0.0698, 0.2911],
    [-0.0163, 0.0418, -0.0079, 0.0147, -0.0322],
    [-0.0338, -0.1039, 0.2224, -0.0738, -0.0108],
    [0.1959, 0.1709, -0.0586, -0.2600, -0.0483],
]
TABLE_2_B = [
    [-0.0712, 0.0290, 0.0218, 0.0249, -0.0304],
    [0.2112, 0.0830, 0.0954, 0.1418, -0.2462],
    [0.0833, 0.0414, 0.2020, -0.1457, -0.0379],
    [0.1136, -0.2140, 0.1724, -0.0428, -0.0063],
]
TABLE_2_C = [-0.0784, 0.4310, 0.9026, 0.0830]


def table_2(periods: float = 5.0) -> FourierSeries:
    return FourierSeries(np.array(TABLE_2_A), np.array(TABLE_2_B), np.array(TABLE_2_C), np.deg2rad(36.0), periods)


def true_vehicle(declared: Vehicle, *, mass_kg: float = 1.83, **inertia: float) -> Vehicle:
    """The declared vehicle with another mass and tensor."""
    document = vehicle_to_dict(declared)
    document["vehicle"]["mass_kg"] = mass_kg
    document["vehicle"]["inertia_kg_m2"] |= inertia
    return vehicle_from_dict(document)


def exact_flight(
    declared: Vehicle,
    truth: Vehicle,
    *,
    series: FourierSeries | None = None,
    imu_hz: float = 500.0,
    mocap_hz: float = 30.0,
    rng: np.random.Generator | None = None,
    gyro_noise: float = 0.0,
    accel_noise: float = 0.0,
    position_noise: float = 0.0,
    mocap_minus_imu_s: float = 0.0,
    wrench_noise: np.ndarray | None = None,
) -> FlightData:
    """Streams that a vehicle with the true parameters gives when it follows ``series`` exactly."""
    series = series or table_2()
    g = declared.gravity_m_s2
    rng = rng or np.random.default_rng(0)

    def motion(t):
        return rigid_motion(series.sample(t), g)

    t = np.arange(0.0, series.duration_s, 1.0 / imu_hz)
    m = motion(t)
    w, dw = m.angular_velocity_body_rad_s, m.angular_acceleration_body_rad_s2
    tensor = truth.inertia_tensor()
    torque = dw @ tensor + np.cross(w, w @ tensor)
    wrench = np.column_stack([truth.mass_kg * m.specific_thrust_m_s2, torque])
    if wrench_noise is not None:
        wrench = wrench + wrench_noise
    accel = np.zeros_like(w)
    accel[:, 2] = m.specific_thrust_m_s2
    imu = np.column_stack([w + gyro_noise * rng.normal(size=w.shape), accel + accel_noise * rng.normal(size=w.shape)])
    tm = np.arange(0.0, series.duration_s, 1.0 / mocap_hz)
    mm = motion(tm)
    pose = np.column_stack(
        [mm.position_m + position_noise * rng.normal(size=(len(tm), 3)), quat_from_euler(*mm.euler_rad.T)]
    )
    if declared.rotors.input == "wrench":
        motors = Stream(t, wrench, WRENCH_COLUMNS)
    else:
        speeds = truth.motor_for_thrust(wrench @ np.linalg.pinv(truth.allocation()).T)
        motors = Stream(t, speeds, motor_columns(declared.rotors.input, declared.rotors.count))
    return FlightData(
        name="exact",
        vehicle=declared,
        motors=motors,
        imu=Stream(t, imu, IMU_COLUMNS),
        mocap=Stream(tm + mocap_minus_imu_s, pose, MOCAP_COLUMNS),
        window_s=(0.0, series.duration_s),
        truth=truth,
    )


def body_to_world(euler_rad: np.ndarray) -> np.ndarray:
    return matrix_from_quat(quat_from_euler(*euler_rad.T))
