"""Angular damping: a moment against the body rates."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, blank
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

MOST_NMS = 50.0
"""A body of 1 kg m^2, as of 10 kg, would stop turning within 20 ms."""


def _wrench(signals: Signals, vehicle: Vehicle, settings: object) -> np.ndarray:
    out = blank(signals, 3)
    for axis in range(3):
        out[:, 3 + axis, axis] = -signals.rate_rad_s[:, axis]
    return out


EFFECT = Effect(
    identifier="angular_damping",
    equation="tau = -D omega",
    source="Leishman, Principles of Helicopter Aerodynamics, 2nd ed., sec. 4.9 (rotor damping)",
    parameters=tuple(
        ParameterInfo(f"damping_{axis}_nms", lambda v, i=i: 5.0 * float(v.inertia_tensor()[i, i]), (0.0, MOST_NMS))
        for i, axis in enumerate("xyz")
    ),
    wrench=_wrench,
    pointwise=True,
    sentence=(
        "Damping resists turning with {damping_x_nms:N m} in roll, {damping_y_nms:N m} in pitch and {damping_z_nms:N "
        "m} in yaw, per rad/s."
    ),
    confused_with=("motor_lag", "input_delay"),
    manoeuvre="fast roll, pitch and yaw reversals: damping follows the rate, lag the change of command",
)
