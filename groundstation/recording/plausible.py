"""Units and frames that cannot be: what no flight of any quadrotor looks like is refused with the likely cause.

Each test compares with something the flight itself fixes (gravity, the poses, the declared rotors), so that a fast
flight is never mistaken for degrees. What no such comparison reaches is left alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.flightdata import Stream
from groundstation.frames import quat_conjugate, quat_log, quat_multiply
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

_DEGREES = 180.0 / np.pi
_SUSPICIOUS = 12.0  # between 1 and 57.3: a wrong nominal vehicle or noise does not come near it from below
_WINDOW_S = 0.1
_LAGS_S = (0.0, 0.03, 0.06, 0.09, 0.12)  # of rotors and drivers
_LONGEST_STEP_S = 0.45  # of a stream that tells motion: slower ones show none; milliseconds make 0.5 of a 2 kHz stream
_TIME_UNITS = (("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9))
_FASTEST_RAD_S = 100.0  # 5700 degrees/s: beyond the range of the gyros that fly (2000 to 4000 degrees/s)


def check_times(stream: Stream, name: str) -> None:
    """Raise where a stream that samples motion has steps no such stream has: its stamps count another unit than
    seconds.
    """
    if len(stream) < 100:
        return
    step = float(np.median(np.diff(stream.t_s)))
    if step < _LONGEST_STEP_S:
        return
    unit, factor = next((unit for unit in _TIME_UNITS if step / unit[1] < _LONGEST_STEP_S), _TIME_UNITS[-1])
    raise BadInput(
        f"{name}: t_s cannot be in seconds: its median step is {step:.4g}, where motion is sampled every 0.0002 to 0.2 "
        f"s; is it in {unit}? Divide by {factor:.0e}."
    )


def check_quaternions(stream: Stream, name: str) -> None:
    """Raise where quaternions are far from unit length throughout."""
    first = stream.columns.index("qw")
    norms = np.linalg.norm(stream.values[:, first : first + 4], axis=1)
    norms = norms[np.isfinite(norms)]
    if len(norms) and abs(float(np.median(norms)) - 1.0) > 0.1:
        raise BadInput(
            f"{name}: quaternion qw, qx, qy, qz is far from unit length throughout (median {np.median(norms):.3g}); "
            "give unit quaternions, scalar first, body to world."
        )


def check_accelerometer(stream: Stream, gravity_m_s2: float) -> None:
    """Raise where the specific force is not in m/s^2, lacks gravity, or is upside down."""
    accel = _finite(stream.values[:, 3:6])
    if not len(accel):
        return
    size = float(np.median(np.linalg.norm(accel, axis=1)))
    vertical = float(np.median(accel[:, 2]))
    if size < 0.4 * gravity_m_s2:
        cause = "in g (multiply by 9.80665)" if 0.7 < size < 1.4 else "without gravity, or in another unit"
        raise BadInput(
            f"imu: accel_x_m_s2, accel_y_m_s2, accel_z_m_s2 cannot be specific force in m/s^2: its median size is "
            f"{size:.3g}, where hover gives {gravity_m_s2:.4g}; it looks {cause}."
        )
    if size > 10.0 * gravity_m_s2:
        raise BadInput(
            f"imu: accel_x_m_s2, accel_y_m_s2, accel_z_m_s2 cannot be in m/s^2: the median size is {size:.4g}, where "
            f"hover gives {gravity_m_s2:.4g}; convert it (milli-g or cm/s^2?)."
        )
    if vertical < -0.5 * gravity_m_s2:
        raise BadInput(
            f"imu: gravity is upside down: accel_z_m_s2 has the median {vertical:.3g}, where a vehicle upright shows "
            f"{gravity_m_s2:+.4g}; give specific force in a body frame with z up (from FRD: change the sign of y and "
            "z)."
        )


def check_gyro(imu: Stream, attitude: Stream | None, motors: Stream, vehicle: Vehicle) -> None:
    """Raise where the gyro cannot be in rad/s.

    With poses: the vehicle turned as much as they say. Without: it turned as the declared rotors can turn it. And in
    any case no faster than gyros measure, for five samples in a row.
    """
    gyro = imu.values[:, :3]
    good = np.isfinite(gyro).all(axis=1)
    t_s, gyro = imu.t_s[good], gyro[good]
    if len(t_s) < 100:
        return
    size = np.linalg.norm(gyro, axis=1)
    lasting = float(np.min(np.stack([size[i : len(size) - 4 + i] for i in range(5)]), axis=0).max())
    if lasting > _FASTEST_RAD_S:
        raise BadInput(
            f"imu: gyro_x_rad_s, gyro_y_rad_s, gyro_z_rad_s cannot be in rad/s: they reach {lasting:.0f}, beyond any "
            "gyro's range; are they in degrees per second? Divide by 57.29578."
        )
    if attitude is not None:
        ratio = _ratio_to_poses(t_s, gyro, attitude)
    else:
        ratio = _ratio_to_rotors(t_s, gyro, motors, vehicle) if vehicle.rotors.input != "wrench" else None
    if ratio is not None and ratio > _SUSPICIOUS:
        raise BadInput(
            f"imu: gyro_x_rad_s, gyro_y_rad_s, gyro_z_rad_s cannot be in rad/s: they are {ratio:.0f} times what the "
            f"{'poses' if attitude is not None else 'rotors'} say; are they in degrees per second? Divide by 57.29578."
        )


def _window_means(t_s: Array, values: Array) -> Array:
    """Means over windows of 0.1 s that hold samples, shape (m, ...)."""
    window = np.floor((t_s - t_s[0]) / _WINDOW_S).astype(np.int64)
    starts = np.flatnonzero(np.concatenate([[True], np.diff(window) != 0]))
    return np.add.reduceat(values, starts, axis=0) / np.diff(np.append(starts, len(t_s)))[:, None]


def _ratio_to_poses(t_s: Array, gyro: Array, attitude: Stream) -> float | None:
    """RMS turn rate of the gyro over that of the poses, both over 0.1 s; None where the gyro shows too little to
    judge.
    """
    first = attitude.columns.index("qw")
    q = attitude.values[:, first : first + 4]
    norm = np.linalg.norm(q, axis=1)
    good = np.isfinite(norm) & (np.abs(norm - 1.0) < 0.1) & np.isfinite(attitude.t_s)
    q, when = q[good] / norm[good, None], attitude.t_s[good]
    if len(when) < 20:
        return None
    step = max(1, round(_WINDOW_S / max(float(np.median(np.diff(when))), 1e-6)))
    turn = np.linalg.norm(quat_log(quat_multiply(quat_conjugate(q[:-step]), q[step:])), axis=1)
    span = when[step:] - when[:-step]
    moving = (span > 0.0) & (turn > 0.0)  # a frozen pose says nothing
    posed = turn[moving] / span[moving]
    measured = np.linalg.norm(_window_means(t_s, gyro), axis=1)
    if not len(posed) or _rms(measured) < 1.0:
        return None
    return _rms(measured) / max(_rms(posed), 1e-3)


def _ratio_to_rotors(t_s: Array, gyro: Array, motors: Stream, vehicle: Vehicle) -> float | None:
    """Slope of measured on predicted changes of rate over 0.1 s, roll and pitch; None unless they go together.

    Prediction: the declared rotors' torques over the declared inertia, at the lag at which they go together best. Noise
    and friction lower the slope, a wrong nominal vehicle moves it by a small factor; degrees raise it by 57.
    """
    values = motors.values
    good = np.isfinite(values).all(axis=1) & np.isfinite(motors.t_s)
    if good.sum() < 100:
        return None
    torque = (vehicle.thrust(values[good]) @ vehicle.allocation().T)[:, 1:3]
    inertia = np.diag(vehicle.inertia_tensor())[:2]
    measured = _changes(t_s[1:], gyro[1:, :2])
    best, slope = 0.5, None
    for lag_s in _LAGS_S:
        rate = np.cumsum(_hold(motors.t_s[good] + lag_s, torque, t_s[:-1]) * np.diff(t_s)[:, None], axis=0) / inertia
        predicted = _changes(t_s[1:], rate)
        size = float(np.sum(predicted**2)) * float(np.sum(measured**2))
        cross = float(np.sum(predicted * measured))
        if size > 0.0 and cross / np.sqrt(size) > best:
            best, slope = cross / np.sqrt(size), cross / float(np.sum(predicted**2))
    return slope


def _changes(t_s: Array, values: Array) -> Array:
    """Changes from one 0.1 s mean to the next, less their median."""
    changes = np.diff(_window_means(t_s, values), axis=0)
    return changes - np.median(changes, axis=0) if len(changes) else changes


def _hold(t_s: Array, values: Array, at_s: Array) -> Array:
    return values[np.clip(np.searchsorted(t_s, at_s, side="right") - 1, 0, len(t_s) - 1)]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def check_motors(stream: Stream, vehicle: Vehicle) -> None:
    """Raise where motor values cannot be what their columns say."""
    values = _finite(stream.values)
    if not len(values) or vehicle.rotors.input == "wrench":
        return
    strongest = float(np.median(np.max(np.abs(values), axis=1)))
    if vehicle.rotors.input == "command" and strongest > 2.0:
        raise BadInput(
            f"motors: {stream.columns[0]} ... {stream.columns[-1]} cannot be commands from 0 to 1: the median of the "
            f"largest is {strongest:.4g}; divide by full scale (65535, 100 or, less 1000, 1000 for microseconds)."
        )
    if vehicle.rotors.input == "rotor_speed":
        _check_speeds(stream, values, vehicle)


_PER_RAD_S = 60.0 / (2.0 * np.pi)  # rpm


def _check_speeds(stream: Stream, values: Array, vehicle: Vehicle) -> None:
    """Lift of all rotors at the middle rotor's median speed against the declared weight: rpm lift 91 times too much."""
    speeds = [np.median(column[column != 0.0]) for column in np.abs(values).T if np.any(column != 0.0)]
    if not speeds:
        return
    lift = float(np.sum(vehicle.thrust(np.full(len(values.T), np.median(speeds)))))
    ratio = min(lift / (vehicle.mass_kg * vehicle.gravity_m_s2), 1e12)  # the largest numbers overflow when squared
    if ratio <= 25.0:
        return
    excess = ratio**0.5  # a vehicle hovers at about its own weight, so the speeds are about this much too large
    pairs = round(excess / _PER_RAD_S)
    what = "are they in rpm? Divide by 9.549297."
    if excess > 2.0 * _PER_RAD_S:
        what = (
            f"are they electrical rpm? Divide by 9.549297 and by the motor's pole pairs (about {pairs} would fit; half "
            "the number of magnets, which is on the motor's data sheet)."
        )
    raise BadInput(
        f"motors: {stream.columns[0]} ... {stream.columns[-1]} cannot be rotor speeds in rad/s: with the declared "
        f"thrust coefficient they lift {ratio:.0f} times the vehicle's weight; {what}"
    )


def check_positions(stream: Stream, name: str) -> None:
    """Raise where positions cannot be in metres: sustained speeds of more than 150 m/s (millimetres give such)."""
    good = np.isfinite(stream.values[:, :3]).all(axis=1) & np.isfinite(stream.t_s)
    t_s, position = stream.t_s[good], stream.values[good, :3]
    dt = np.diff(t_s)
    if not np.any(dt > 0.0):
        return
    speed = np.linalg.norm(np.diff(position, axis=0)[dt > 0.0], axis=1) / dt[dt > 0.0]
    if float(np.median(speed)) > 150.0:
        raise BadInput(
            f"{name}: x_m, y_m, z_m cannot be in metres: the median speed is {np.median(speed):.4g} m/s; "
            "divide millimetres by 1000."
        )


def check_battery(stream: Stream) -> None:
    """Raise where the voltage cannot be in volts."""
    volts = stream.values[:, 0][np.isfinite(stream.values[:, 0])]
    if len(volts) and float(np.median(volts)) > 200.0:
        raise BadInput(
            f"battery: voltage_v cannot be in volts: its median is {np.median(volts):.4g}; divide millivolts by 1000."
        )


def _finite(values: Array) -> Array:
    return values[np.isfinite(values).all(axis=1)]
