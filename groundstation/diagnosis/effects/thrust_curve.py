"""Thrust curve: thrust is not the declared function of speed or command."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, blank, from_thrust, has_rotors
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle


def _wrench(signals: Signals, vehicle: Vehicle, settings: object) -> np.ndarray:
    hover = vehicle.mass_kg * vehicle.gravity_m_s2 / vehicle.rotors.count
    level = np.sqrt(np.maximum(signals.thrust_n, 0.0) / hover) - 1.0
    out = blank(signals)
    out[:, :, 0] = from_thrust(vehicle, signals.thrust_n * level)
    return out


EFFECT = Effect(
    identifier="thrust_curve",
    equation="T = T_declared (1 + e (x / x_hover - 1)), x = sqrt(T_declared): the exponent is 2 + e near hover",
    source="first-order expansion about hover; Bangura et al. 2016 measure such departures",
    parameters=(ParameterInfo("exponent_error", lambda v: 1.5, (-2.0, 2.0)),),
    wrench=_wrench,
    sentence="Thrust does not follow the declared curve: near hover its exponent is off by {exponent_error}.",
    confused_with=("climb_inflow", "motor_lag"),
    manoeuvre="hard climbs and drops: thrust far from hover, with little speed",
    applies=has_rotors,
)
