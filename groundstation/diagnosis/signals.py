"""The signals effects are computed from, as a flight's evidence takes them: at its rate, without sample noise, and as planned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.frames import quat_normalise, quat_rotate
from groundstation.identification.preparation import Prepared
from groundstation.identification.record_model import Parameters
from groundstation.model.rotors import wrench_matrix
from groundstation.model.signals import Signals

QUIET_S = 0.06
"""Over which measured rotor speeds are smoothed."""


def planned_signals(prepared: Prepared, p: Parameters, stride: int) -> Signals | None:
    """The signals the plan made the vehicle have: thrusts by inverse dynamics at ``p``; time and battery as they were."""
    plan = prepared.planned
    if plan is None:
        return None
    vehicle = prepared.record.vehicle
    rate = plan.rate_rad_s
    torque = plan.angular_acceleration_rad_s2 @ p.tensor + np.cross(rate, rate @ p.tensor)
    wrench = np.concatenate([p.mass_kg * plan.specific_thrust_m_s2[:, None], torque], axis=1)
    thrust = wrench @ np.linalg.pinv(wrench_matrix(vehicle)).T
    motor = thrust if vehicle.rotors.input == "wrench" else vehicle.motor_for_thrust(thrust)
    quaternion = quat_normalise(plan.quaternion)
    signals = Signals(
        t_s=prepared.record.t_s - prepared.record.t_s[0],
        position_m=plan.position_m,
        velocity_world_m_s=quat_rotate(quaternion, plan.velocity_body_m_s),
        quaternion=quaternion,
        rate_rad_s=rate,
        motor=motor,
        lagged=motor,
        lagged_rate=np.gradient(motor, prepared.record.t_s, axis=0),
        thrust_n=thrust,
        voltage_v=prepared.voltage_v,
        charge_as=prepared.charge_as,
    )
    return thinned(signals, slice(None, None, stride))


def quietened(signals: Signals) -> Signals:
    """Measured rotor speeds without the noise of single samples (Savitzky and Golay 1964: cubics over QUIET_S keep what is slower than 15 Hz).

    Their derivative turns a spinning rotor's momentum into torque: its noise would be larger than most torques.
    """
    from scipy.signal import savgol_filter

    window = round(QUIET_S / float(np.median(np.diff(signals.t_s)))) | 1
    if window < 5 or window > len(signals.t_s):
        return signals
    fields = ("motor", "lagged", "lagged_rate", "thrust_n")
    return replace(signals, **{name: savgol_filter(getattr(signals, name), window, 3, axis=0) for name in fields})


def thinned(signals: Signals, rows: slice | NDArray[np.bool_]) -> Signals:
    """Some of the instants."""
    return Signals(*(getattr(signals, name)[rows] for name in Signals.__slots__))
