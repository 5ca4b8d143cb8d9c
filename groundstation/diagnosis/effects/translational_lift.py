"""Translational lift: thrust grows with horizontal speed squared."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, blank, from_inflow, has_rotors
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

MOST_S2_M2 = 1.0
"""1 / (4 v_h^2) in momentum theory for an induced speed v_h of 0.5 m/s; rotors hover at several m/s."""


def _wrench(signals: Signals, vehicle: Vehicle, settings: object) -> np.ndarray:
    velocity = signals.velocity_body_m_s()
    speed2 = (velocity[:, :2] ** 2).sum(axis=1, keepdims=True)
    out = blank(signals)
    out[:, :, 0] = from_inflow(vehicle, signals.thrust_n * speed2)
    return out


EFFECT = Effect(
    identifier="translational_lift",
    equation="T = T_0 (1 + c v_xy^2)",
    source="Svacha, Mohta and Kumar 2017 (thrust rises with the square of horizontal speed)",
    parameters=(ParameterInfo("lift_s2_m2", lambda v: 0.1, (0.0, MOST_S2_M2)),),
    wrench=_wrench,
    pointwise=True,
    sentence="A horizontal speed of 1 m/s adds {lift_s2_m2:%} of thrust; the gain grows with the square of speed.",
    confused_with=("ground_effect", "body_drag"),
    manoeuvre="level legs at clearly different speeds, at one height",
    applies=has_rotors,
)
