"""Blade flapping: a moment that pitches the nose up when flying forward."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, blank, weight
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

MOST_NM_S_M = 100.0
"""At 1 m/s the weight of 10 kg on an arm of 1 m."""


def _wrench(signals: Signals, vehicle: Vehicle, settings: object) -> np.ndarray:
    velocity = signals.velocity_body_m_s()
    out = blank(signals)
    out[:, 3, 0] = velocity[:, 1]
    out[:, 4, 0] = -velocity[:, 0]
    return out


EFFECT = Effect(
    identifier="flapping_moment",
    equation="tau = k (v_y, -v_x, 0): nose up (negative pitch torque in FLU) when flying forward",
    source="Hoffmann et al. 2007, AIAA 2007-6461, sec. IV; Pounds et al. 2010",
    parameters=(ParameterInfo("k_nm_s_m", lambda v: 0.1 * weight(v) * v.arm_m(), (0.0, MOST_NM_S_M)),),
    wrench=_wrench,
    pointwise=True,
    sentence="Flying forward at 1 m/s raises the nose with a torque of {k_nm_s_m:N m}.",
    confused_with=("com_offset", "angular_damping"),
    manoeuvre="long straight legs at constant speed in four directions",
    bends_base=1,
)
