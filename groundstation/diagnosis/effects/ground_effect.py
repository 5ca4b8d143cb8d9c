"""Ground effect: thrust rises near the floor."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, blank, from_inflow
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

MOST = 10.0
"""Eleven times the thrust at one radius; an image source under the rotor gives 1/16."""


def _wrench(signals: Signals, vehicle: Vehicle, settings: object) -> np.ndarray:
    height = np.maximum(signals.position_m[:, 2:3], 0.5 * vehicle.rotors.radius_m)
    out = blank(signals)
    out[:, :, 0] = from_inflow(vehicle, signals.thrust_n * (vehicle.rotors.radius_m / height) ** 2)
    return out


EFFECT = Effect(
    identifier="ground_effect",
    equation="T = T_0 (1 + k (R / z)^2)",
    source="Sanchez-Cuevas, Heredia, Ollero 2017, eq. 4 (first term)",
    parameters=(ParameterInfo("strength", lambda v: 3.0, (0.0, MOST)),),
    wrench=_wrench,
    pointwise=True,
    sentence="One rotor radius above the floor thrust is {strength:%} higher; the gain falls with the square of "
    "height.",
    confused_with=("battery_sag", "translational_lift", "tether"),
    manoeuvre="descend to one rotor radius and climb again, early and late in the flight",
)
