"""Rotor drag: each rotor resists its hub's air speed sideways, in proportion to that and to its own speed. So a yaw is
damped, and rotors that turn at different speeds turn the vehicle as it flies along.

One that is alike in all directions (isotropic) is no rotor's alone: it acts at the origin.
"""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, Settings, blank
from groundstation.model.signals import Signals, hover_share
from groundstation.vehicle import Vehicle

MOST_KG_S = 100.0
"""It would stop 10 kg within 0.1 s."""


def _wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> np.ndarray:
    out = blank(signals, 2)
    if settings.get("isotropic") or vehicle.rotors.input == "wrench":
        against = -signals.velocity_body_m_s() * hover_share(signals, vehicle)[:, None]
        out[:, 0, 0], out[:, 1, 1] = against[:, 0], against[:, 1]
        if settings.get("isotropic"):
            out[:, 2, :] = 0.5 * against[:, 2:]
        return out
    rotors = vehicle.rotors
    hover = np.sqrt(rotors.count * vehicle.mass_kg * vehicle.gravity_m_s2)
    shares = np.sqrt(np.maximum(signals.thrust_n, 0.0)) / hover
    for hub, share in zip(np.asarray(rotors.position_m, dtype=float), shares.T, strict=True):
        against = -(signals.velocity_body_m_s() + np.cross(signals.rate_rad_s, hub)) * share[:, None]
        for axis in range(2):
            out[:, axis, axis] += against[:, axis]
            out[:, 3:, axis] += against[:, axis : axis + 1] * np.cross(hub, np.eye(3)[axis])
    return out


EFFECT = Effect(
    identifier="rotor_drag",
    equation="F_i,xy = -d |Omega_i| / (sum|Omega| at hover) (v + omega x r_i)_xy at each hub r_i; isotropic: F = -d v "
    "sum|Omega| / (sum|Omega| at hover) at the origin",
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
