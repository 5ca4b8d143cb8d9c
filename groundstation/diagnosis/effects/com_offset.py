"""Centre of mass beside the declared origin."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, blank, from_thrust
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle


def _wrench(signals: Signals, vehicle: Vehicle, settings: object) -> np.ndarray:
    lift = from_thrust(vehicle, signals.thrust_n)[:, 2]
    out = blank(signals, 2)
    out[:, 4, 0] = lift  # -c x F with F along z: (-c_y F, c_x F, 0)
    out[:, 3, 1] = -lift
    return out


EFFECT = Effect(
    identifier="com_offset",
    equation="tau = -c x F e_z",
    source="rigid-body statics about the centre of mass",
    parameters=(
        ParameterInfo("com_offset_x_m", lambda v: v.arm_m()),
        ParameterInfo("com_offset_y_m", lambda v: v.arm_m()),
    ),
    wrench=_wrench,
    sentence="The centre of mass lies {com_offset_x_m} m forward and {com_offset_y_m} m left of the declared origin.",
    confused_with=("weak_rotor", "constant_wrench"),
    manoeuvre="climb and sink hard: the torque of an offset grows with total thrust; yaw both ways to exclude a weak rotor",
)
