"""A steady torque that nothing else accounts for."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, blank, weight
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle


def _wrench(signals: Signals, vehicle: Vehicle, settings: object) -> np.ndarray:
    out = blank(signals, 3)
    for axis in range(3):
        out[:, 3 + axis, axis] = 1.0
    return out


EFFECT = Effect(
    identifier="constant_wrench",
    equation="tau = constant in the body",
    source="effects.md; a steady force is wind's or the tether's column in the world frame",
    parameters=tuple(ParameterInfo(f"torque_{axis}_nm", lambda v: 0.3 * weight(v) * v.arm_m()) for axis in "xyz"),
    wrench=_wrench,
    sentence="A steady torque of {torque_x_nm}, {torque_y_nm} and {torque_z_nm} N m acts in roll, pitch and yaw.",
    confused_with=("com_offset", "weak_rotor"),
    manoeuvre="climb and sink hard: a torque that stays the same while thrust changes is not a centre of mass",
)
