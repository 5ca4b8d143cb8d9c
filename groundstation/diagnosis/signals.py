"""The signals effects are computed from, as the plan made them, and at some of the instants only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.frames import quat_normalise, quat_rotate
from groundstation.identification.parts import by_parts, kept, parts_of
from groundstation.identification.preparation import Prepared
from groundstation.model.parameters import Parameters
from groundstation.model.rotors import thrusts_for
from groundstation.model.signals import Signals

Array = NDArray[np.float64]


SERIES = ("position_m", "velocity_world_m_s", "quaternion", "rate_rad_s", "motor", "lagged", "lagged_rate", "thrust_n")
"""Signals of several columns."""


def planned_signals(prepared: Prepared, p: Parameters) -> Signals | None:
    """The signals the plan made the vehicle have: thrusts by inverse dynamics at ``p``; time and charge as they were.

    Of the voltage its slow course: its samples' noise, and what a sample misses of a drop under load, stand in both
    sides of an equation.
    """
    plan = prepared.planned
    if plan is None:
        return None
    vehicle = prepared.record.vehicle
    plan = plan.part(slice(None))
    rate = plan.rate_rad_s
    torque = plan.angular_acceleration_rad_s2 @ p.tensor + np.cross(rate, rate @ p.tensor)
    wrench = np.concatenate([p.mass_kg * plan.specific_thrust_m_s2[:, None], torque], axis=1)
    thrust = wrench @ thrusts_for(vehicle).T
    motor = thrust if vehicle.rotors.input == "wrench" else vehicle.motor_for_thrust(thrust)
    quaternion = quat_normalise(plan.quaternion)
    return Signals(
        t_s=prepared.record.t_s - prepared.record.t_s[0],
        position_m=plan.position_m,
        velocity_world_m_s=quat_rotate(quaternion, plan.velocity_body_m_s),
        quaternion=quaternion,
        rate_rad_s=rate,
        motor=motor,
        lagged=motor,
        lagged_rate=np.gradient(motor, prepared.record.t_s, axis=0),
        thrust_n=thrust,
        voltage_v=_slow(prepared.record.t_s, prepared.voltage_v),
        charge_as=prepared.charge_as,
    )


def held(signals: Signals) -> Signals:
    """Signals to hold: of a long flight all but the times in single precision; :meth:`.Signals.at` gives doubles."""
    return replace(signals, **{name: kept(getattr(signals, name)) for name in SERIES})


def _slow(t_s: Array, values: Array) -> Array:
    """A polygon through a signal with corners ``voltage_knot_s`` apart, by least squares, shape (k,)."""
    begin, end = float(t_s[0]), float(t_s[-1])
    corners = np.linspace(begin, end, max(3, round((end - begin) / THRESHOLDS.voltage_knot_s)) + 1)
    gram, moment = np.zeros((len(corners), len(corners))), np.zeros(len(corners))
    for part in parts_of(len(t_s)):
        own, peaks = _own_hats(t_s[part], corners)
        gram[own, own] += peaks.T @ peaks
        moment[own] += peaks.T @ values[part]
    heights = np.linalg.solve(gram, moment)

    def slow(part: slice) -> Array:
        own, peaks = _own_hats(t_s[part], corners)
        return peaks @ heights[own]

    return by_parts(slow, len(t_s))


def _own_hats(t_s: Array, corners: Array) -> tuple[slice, Array]:
    """Corners that times lie between, and the hat functions there, (k, corners)."""
    first, last = np.searchsorted(corners, (t_s[0], t_s[-1]))
    own = slice(max(int(first) - 1, 0), int(last) + 1)
    return own, np.ascontiguousarray(hat_functions(t_s, corners)[:, own])


def hat_functions(values: Array, knots: Array) -> Array:
    """Hat functions over ascending knots: one at a knot, zero at those beside it, held beyond the ends, (k, knots)."""
    first = np.clip(np.searchsorted(knots, values, "right") - 1, 0, len(knots) - 2)
    slope, beyond = (1.0 / np.diff(knots))[first], np.clip(values, knots[0], knots[-1]) - knots[first]
    out = np.zeros((len(values), len(knots)))
    rows = np.arange(len(values))
    last = values >= knots[-1]
    out[rows, first] = np.where(last, 0.0, 1.0 - slope * beyond)
    out[rows, first + 1] = np.where(last, 1.0, slope * beyond)
    out[np.isnan(values)] = np.nan
    return out
