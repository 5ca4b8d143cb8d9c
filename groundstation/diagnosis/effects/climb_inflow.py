"""Climb inflow: thrust falls with climb speed through the disc."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, blank, hover_share
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle


def _wrench(signals: Signals, vehicle: Vehicle, settings: object) -> np.ndarray:
    out = blank(signals)
    out[:, 2, 0] = -signals.velocity_body_m_s()[:, 2] * hover_share(signals, vehicle)
    return out


EFFECT = Effect(
    identifier="climb_inflow",
    equation="T = T_0 - k w sum|Omega| / (sum|Omega| at hover)",
    source="Leishman 2006, sec. 2.13 (thrust slope with axial inflow); Svacha et al. 2017, eq. 9",
    parameters=(ParameterInfo("k_kg_s", lambda v: v.mass_kg, (0.0, np.inf)),),
    wrench=_wrench,
    sentence="Climbing costs thrust: {k_kg_s} N per m/s.",
    confused_with=("body_drag", "thrust_curve"),
    manoeuvre="climb and sink at several speeds, away from the floor",
)
