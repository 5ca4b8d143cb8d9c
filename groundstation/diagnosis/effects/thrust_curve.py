"""Thrust curve: thrust is not the declared function of speed or command."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, Settings, blank, from_thrust, has_rotors
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

EXPONENTS = np.linspace(-1.0, 1.0, 21)
"""Errors about which a closer look is taken."""
STALLED = 0.05
"""Share of the speed at hover below which a rotor's curve does not matter."""


def _wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> np.ndarray:
    hover = vehicle.mass_kg * vehicle.gravity_m_s2 / vehicle.rotors.count
    speed = np.maximum(np.sqrt(np.maximum(signals.thrust_n, 0.0) / hover), STALLED)
    about = settings.get("about", 0.0)
    slope = np.log(speed) if about == 0.0 else (speed**about - 1.0) / about
    out = blank(signals)
    out[:, :, 0] = from_thrust(vehicle, signals.thrust_n * slope)
    return out


EFFECT = Effect(
    identifier="thrust_curve",
    equation="T = T_declared (x / x_hover)^e, x = sqrt(T_declared), linear in e by the secant through e_0: exact for e "
    "= e_0",
    source="power law about hover; Bangura et al. 2016 measure such departures",
    parameters=(ParameterInfo("exponent_error", lambda v: 1.5, (-2.0, 2.0)),),
    wrench=_wrench,
    pointwise=True,
    sentence="Near hover the exponent of the thrust curve is {exponent_error:|above|below} the declared one.",
    confused_with=("climb_inflow", "motor_lag"),
    manoeuvre="hard climbs and drops: thrust far from hover, with little speed",
    applies=has_rotors,
    finer=lambda settings: tuple({"about": float(e)} for e in EXPONENTS),
    shared_by_healthy=4,
)
