"""Rotor drag: the rotors resist air speed in proportion to speed and rotor speed, sideways or (isotropic) in all
directions.
"""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, Settings, blank
from groundstation.model.signals import Signals, hover_share
from groundstation.vehicle import Vehicle

MOST_KG_S = 100.0
"""It would stop 10 kg within 0.1 s."""


def _wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> np.ndarray:
    velocity = signals.velocity_body_m_s()
    share = hover_share(signals, vehicle)
    out = blank(signals, 2)
    out[:, 0, 0] = -velocity[:, 0] * share
    out[:, 1, 1] = -velocity[:, 1] * share
    if settings.get("isotropic"):
        out[:, 2, :] = -0.5 * (velocity[:, 2] * share)[:, None]
    return out


EFFECT = Effect(
    identifier="rotor_drag",
    equation="F_xy = -d v_xy sum|Omega| / (sum|Omega| at hover); isotropic: F_z = -d_mean v_z likewise",
    source="Mahony, Kumar, Corke 2012, IEEE RAM 19(3), eq. 10; Faessler et al. 2018",
    parameters=(
        ParameterInfo("d_x_kg_s", lambda v: v.mass_kg, (0.0, MOST_KG_S)),
        ParameterInfo("d_y_kg_s", lambda v: v.mass_kg, (0.0, MOST_KG_S)),
    ),
    wrench=_wrench,
    pointwise=True,
    sentence="Rotors resist motion through the air with {d_x_kg_s:N} forward and {d_y_kg_s:N} sideways at 1 m/s.",
    variants=lambda signals, vehicle: ({}, {"isotropic": 1.0}),
    confused_with=("wind", "body_drag", "tether"),
    manoeuvre="fly back and forth at several speeds, both axes, and hover in between",
    shared_by_healthy=2,
)
