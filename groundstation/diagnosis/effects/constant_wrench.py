"""A steady force or torque that nothing else accounts for."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, blank, weight
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

MOST_N = 1000.0
"""Ten times the weight of 10 kg: more than rotors hold against."""
MOST_NM = 1000.0
"""The same on an arm of 1 m."""


def _wrench(signals: Signals, vehicle: Vehicle, settings: object) -> np.ndarray:
    out = blank(signals, 5)
    for axis in range(2):
        out[:, :3, axis] = signals.axis_body(axis)
    for axis in range(3):
        out[:, 3 + axis, 2 + axis] = 1.0
    return out


EFFECT = Effect(
    identifier="constant_wrench",
    equation="F = constant and level in the world, tau = constant in the body",
    source="statics; a steady upward force is weight, a steady force in the body the accelerometer's bias",
    parameters=(
        *(ParameterInfo(f"force_world_{axis}_n", lambda v: 0.3 * weight(v), (-MOST_N, MOST_N)) for axis in "xy"),
        *(
            ParameterInfo(f"torque_{axis}_nm", lambda v: 0.3 * weight(v) * v.arm_m(), (-MOST_NM, MOST_NM))
            for axis in "xyz"
        ),
    ),
    wrench=_wrench,
    pointwise=True,
    sentence=(
        "A steady force of {force_world_x_n:N|toward +x|toward −x} and {force_world_y_n:N|toward +y|toward −y} of the "
        "room pushes the vehicle. Steady torques of {torque_x_nm:N m|roll right|roll left}, {torque_y_nm:N m|nose "
        "down|nose up} and {torque_z_nm:N m|yaw left|yaw right} turn it."
    ),
    confused_with=("com_offset", "weak_rotor", "wind"),
    manoeuvre="climb and sink hard: a torque that stays the same while thrust changes is not a centre of mass",
    shared_by_healthy=1,
)
