"""Samples as named numbers, for the charts of a view. The recording holds them all; this is the newest of each."""

from __future__ import annotations

from collections.abc import Mapping

from drivers.samples import Battery, Imu, Motors, Pose, Sample, Setpoint, State
from groundstation.flightdata import BATTERY_COLUMNS, IMU_COLUMNS, MOCAP_COLUMNS, SETPOINT_COLUMNS, motor_columns

STATE_COLUMNS = tuple(f"velocity_{axis}_m_s" for axis in "xyz")


def stream_of(sample: Sample) -> str:
    """The stream that a sample belongs to; measured speeds and commands are two."""
    name = type(sample).__name__.lower()
    return sample.kind if isinstance(sample, Motors) else name


def signals(newest: Mapping[str, Sample]) -> dict[str, float]:
    """The numbers of the newest sample of each stream, as ``stream/column``."""
    found: dict[str, float] = {}
    for stream, sample in newest.items():
        columns, values = _numbers(sample)
        found |= {f"{stream}/{name}": float(value) for name, value in zip(columns, values, strict=False)}
    return found


def _numbers(sample: Sample) -> tuple[tuple[str, ...], tuple[float, ...]]:
    match sample:
        case Imu():
            return IMU_COLUMNS, (*sample.gyro_rad_s, *sample.accel_m_s2)
        case Pose():
            return MOCAP_COLUMNS, (*sample.position_m, *sample.quaternion)
        case Motors():
            return motor_columns(sample.kind, len(sample.values)), sample.values
        case Battery():
            return BATTERY_COLUMNS, (sample.voltage_v, sample.current_a)
        case Setpoint():
            return SETPOINT_COLUMNS, (*sample.position_m, sample.yaw_rad)
        case State():
            return STATE_COLUMNS, sample.velocity_m_s
        case _:
            return (), ()
