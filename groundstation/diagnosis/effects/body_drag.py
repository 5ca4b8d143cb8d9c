"""Body drag: air resistance of the frame, with the square of speed."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, blank
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

MOST_KG_M = 5.0
"""A flat plate of 4 m^2, rho C_d A / 2 with C_d = 2."""


def _wrench(signals: Signals, vehicle: Vehicle, settings: object) -> np.ndarray:
    velocity = signals.velocity_body_m_s()
    out = blank(signals)
    out[:, :3, 0] = -np.linalg.norm(velocity, axis=1, keepdims=True) * velocity
    return out


EFFECT = Effect(
    identifier="body_drag",
    equation="F = -c |v| v",
    source="McCormick, Aerodynamics, Aeronautics and Flight Mechanics, 2nd ed. 1995, ch. 4 (drag with the square of "
    "speed)",
    parameters=(ParameterInfo("c_kg_m", lambda v: v.mass_kg, (0.0, MOST_KG_M)),),
    wrench=_wrench,
    pointwise=True,
    sentence="Air resistance of the frame is {c_kg_m:N} at 1 m/s and grows with the square of speed.",
    confused_with=("rotor_drag", "climb_inflow"),
    manoeuvre="fly straight at clearly different speeds: linear and square drag part at twice the speed",
)
