"""The wrench that the recorded motor values make by the declared constants, resampled onto a grid."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from groundstation.flightdata import Stream
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]


def declared_wrench(
    vehicle: Vehicle, motors: Stream, battery: Stream | None, t_s: Annotated[Array, "k"]
) -> Annotated[Array, "k 4"]:
    """[F_z, tau_x, tau_y, tau_z] at the grid times, N and N m about the declared origin, shape (k, 4).

    Measured rotor speeds are interpolated linearly; commands, speeds asked for and wrenches hold until the next value
    and are averaged over each grid cell, so that the mean wrench a motion has felt between two samples is kept. A
    declared lag is applied to what was commanded, in speed (or command, with a thrust curve).
    """
    stamps, values = motors.t_s, motors.values
    if vehicle.rotors.input == "wrench":
        return held_mean(t_s, stamps, values)
    measured = vehicle.rotors.measured
    if measured:
        columns: list[Array] = [np.interp(t_s, stamps, column) for column in values.T]
        return vehicle.thrust(np.stack(columns, axis=1)) @ vehicle.allocation().T
    if vehicle.rotors.input == "command":
        values = values * voltage_ratio(vehicle, battery, stamps)[:, None]
    lag = vehicle.rotors.lag
    if lag.up_s > 0.0 or lag.down_s > 0.0:
        from groundstation.model.rotors import motor_input

        fine = motor_input(stamps, values, measured=False)
        stamps, values = fine.t_s, fine.lagged(lag.up_s, lag.down_s)
    return held_mean(t_s, stamps, vehicle.thrust(values) @ vehicle.allocation().T)


def held_mean(
    t_s: Annotated[Array, "k"], stamps_s: Annotated[Array, "m"], values: Annotated[Array, "m d"]
) -> Annotated[Array, "k d"]:
    """Mean over each grid cell [t - T/2, t + T/2] of values that hold until the next stamp, shape (k, d).

    The integral of a held signal is piecewise linear in time, so two interpolations of it give the mean exactly.
    """
    half = 0.5 * float(t_s[1] - t_s[0]) if len(t_s) > 1 else 0.5e-3
    step = np.diff(stamps_s)
    integral = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values[:-1] * step[:, None], axis=0)])
    first = np.clip(t_s - half, stamps_s[0], stamps_s[-1])
    last = np.clip(t_s + half, stamps_s[0], stamps_s[-1])
    width = np.maximum(last - first, 1e-12)
    columns: list[Array] = [(np.interp(last, stamps_s, c) - np.interp(first, stamps_s, c)) / width for c in integral.T]
    return np.stack(columns, axis=1)


def voltage_ratio(vehicle: Vehicle, battery: Stream | None, t_s: Annotated[Array, "k"]) -> Annotated[Array, "k"]:
    """Voltage over the full battery's (declared, or the flight's highest) at given times; one without a battery
    stream.
    """
    if battery is None or len(battery) == 0:
        return np.ones(len(t_s))
    voltage = battery.column("voltage_v")
    good = np.isfinite(voltage)
    if not good.any():
        return np.ones(len(t_s))
    full = vehicle.battery.full_v or float(voltage[good].max())
    return np.interp(t_s, battery.t_s[good], voltage[good]) / full
