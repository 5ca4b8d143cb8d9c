"""Centre of mass beside the declared origin."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, blank, from_thrust
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

MOST_M = 1.0
"""The rotors' circle of 10 kg: outside of it nothing flies."""


def _wrench(signals: Signals, vehicle: Vehicle, settings: object) -> np.ndarray:
    lift = from_thrust(vehicle, signals.thrust_n)[:, 2]
    out = blank(signals, 2)
    out[:, 4, 0] = lift  # -c x F with F along z: (-c_y F, c_x F, 0)
    out[:, 3, 1] = -lift
    rate = signals.rate_rad_s
    turning = np.gradient(rate, signals.t_s, axis=0) if len(rate) > 1 else np.zeros_like(rate)
    for axis in range(2):
        unit = np.eye(3)[axis]
        swung = np.cross(turning, unit) + np.cross(rate, np.cross(rate, unit))
        out[:, :3, axis] = -vehicle.mass_kg * swung  # the origin is carried round the centre of mass
    return out


EFFECT = Effect(
    identifier="com_offset",
    equation="tau = -c x F e_z; F_origin = -m (omega' x c + omega x (omega x c))",
    source="Newton and Euler about a point other than the centre of mass: Etkin & Reid 1996, sec. 4.3",
    parameters=(
        ParameterInfo("com_offset_x_m", lambda v: v.arm_m(), (-MOST_M, MOST_M)),
        ParameterInfo("com_offset_y_m", lambda v: v.arm_m(), (-MOST_M, MOST_M)),
    ),
    wrench=_wrench,
    pointwise=True,
    sentence=(
        "The centre of mass lies {com_offset_x_m:mm|forward|back} and {com_offset_y_m:mm|to the left|to the right} "
        "of the declared origin."
    ),
    confused_with=("weak_rotor", "constant_wrench"),
    manoeuvre="climb and sink hard: the torque of an offset grows with total thrust; yaw both ways to exclude a weak "
    "rotor",
    shared_by_healthy=0,
)
