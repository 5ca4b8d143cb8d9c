"""What was flown against what was wanted, on one clock, for the report's figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.flightdata import FlightData, Stream
from groundstation.frames import euler_from_quat, quat_normalise
from groundstation.identification.results import Clock

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Flown:
    """Poses on the IMU's clock, and what was wanted at the same instants (NaN where nothing was asked for).

    Attributes:
        t_s: shape (k,).
        position_m, euler_rad: shape (k, 3), roll, pitch, yaw unwrapped.
        wanted: x, y, z, yaw, shape (k, 4), or None.
        source: "motion capture" or "the vehicle's own estimate".
    """

    t_s: Array
    position_m: Array
    euler_rad: Array
    wanted: Array | None
    source: str

    def tracking_error(self) -> Array | None:
        """Flown minus wanted: x, y, z in m and yaw in rad (shortest way round), shape (k, 4)."""
        if self.wanted is None:
            return None
        yaw = self.euler_rad[:, 2] - self.wanted[:, 3]
        return np.column_stack([self.position_m - self.wanted[:, :3], np.arctan2(np.sin(yaw), np.cos(yaw))])


def flown(flight: FlightData, clock: Clock | None) -> Flown | None:
    """Join poses and setpoints; None without any pose.

    Motion-capture stamps are shifted by the estimated offset and drift: t_imu = t_mocap - offset - drift (t - middle).
    """
    stream, source = (flight.mocap, "motion capture") if flight.mocap is not None else (flight.state, "own estimate")
    if stream is None or len(stream) < 2:
        return None
    t = stream.t_s
    if flight.mocap is not None and clock is not None:
        t = t - clock.mocap_minus_imu_s - clock.drift * (t - 0.5 * (t[0] + t[-1]))
    position = np.column_stack([stream.column(f"{axis}_m") for axis in "xyz"])
    quaternion = np.column_stack([stream.column(c) for c in ("qw", "qx", "qy", "qz")])
    euler = euler_from_quat(quat_normalise(quaternion))
    euler[:, 2] = np.unwrap(euler[:, 2])
    return Flown(t, position, euler, _wanted(flight, t), source)


def _wanted(flight: FlightData, t_s: Array) -> Array | None:
    """Recorded setpoints, else the plan from the start of the excitation."""
    if flight.setpoint is not None and len(flight.setpoint) > 1:
        return _held(flight.setpoint, t_s)
    if flight.plan is not None and flight.window_s is not None:
        series = flight.plan.series()
        flat = series.sample(t_s - flight.window_s[0])
        wanted = np.column_stack([flat.position[0], flat.yaw[0]])
        wanted[(t_s < flight.window_s[0]) | (t_s > flight.window_s[0] + series.duration_s)] = np.nan
        return wanted
    return None


def _held(setpoint: Stream, t_s: Array) -> Array:
    """Setpoints interpolated between their stamps; nothing outside them."""
    columns = []
    for name in ("x_m", "y_m", "z_m", "yaw_rad"):
        values = setpoint.column(name)
        values = np.unwrap(values) if name == "yaw_rad" else values
        columns.append(np.interp(t_s, setpoint.t_s, values, left=np.nan, right=np.nan))
    return np.column_stack(columns)
