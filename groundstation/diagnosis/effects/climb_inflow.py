"""Climb inflow: thrust falls with climb speed through the disc."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, Settings, blank, from_inflow, has_rotors
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

CURVATURES_S_M = np.linspace(-0.1, 0.2, 13)
"""Second-order terms that a closer look tries; 1 / (4 v_h) in momentum theory, v_h the induced speed at hover (4 to 8
m/s).
"""

MOST_KG_S = 100.0
"""At 1 m/s the lift of 10 kg would be gone."""


def _wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> np.ndarray:
    climb = signals.velocity_body_m_s()[:, 2]
    climb = climb * (1.0 + settings.get("curvature_s_m", 0.0) * climb)
    out = blank(signals)
    if not has_rotors(vehicle):
        out[:, 2, 0] = -climb
        return out
    hover = vehicle.mass_kg * vehicle.gravity_m_s2 / vehicle.rotors.count
    speed = np.sqrt(np.maximum(signals.thrust_n, 0.0) / hover) / vehicle.rotors.count
    out[:, :, 0] = from_inflow(vehicle, -climb[:, None] * speed)
    return out


EFFECT = Effect(
    identifier="climb_inflow",
    equation="T_i = T_0i - (k/n) (w + b w^2) Omega_i / Omega_hover, roll and pitch with them",
    source="Svacha, Mohta and Kumar 2017 (thrust falls with vertical speed); its second order: Johnson, Helicopter "
    "Theory, 1994",
    parameters=(ParameterInfo("k_kg_s", lambda v: v.mass_kg, (0.0, MOST_KG_S)),),
    wrench=_wrench,
    pointwise=True,
    sentence="Climbing at 1 m/s, the rotors give {k_kg_s:N|less|more} thrust.",
    confused_with=("body_drag", "thrust_curve"),
    manoeuvre="climb and sink at several speeds, away from the floor",
    finer=lambda settings: tuple({"curvature_s_m": float(b)} for b in CURVATURES_S_M),
    shared_by_healthy=3,
)
