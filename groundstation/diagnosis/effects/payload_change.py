"""Payload change: the mass steps in flight."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, Settings, blank, from_thrust
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle


def _wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> np.ndarray:
    after = (signals.t_s > settings["at_s"]).astype(float)
    lift = from_thrust(vehicle, signals.thrust_n)[:, 2]
    out = blank(signals)
    out[:, 2, 0] = -after * lift / vehicle.mass_kg
    return out


EFFECT = Effect(
    identifier="payload_change",
    equation="(m + dm H(t - t_0)) f = T e_z, so to first order F_z = -dm T / m after t_0",
    source="Newton's second law with a step in mass",
    parameters=(ParameterInfo("mass_change_kg", lambda v: 0.5 * v.mass_kg),),
    wrench=_wrench,
    sentence="At {at_s} s the vehicle's mass changed by {mass_change_kg} kg.",
    confused_with=("battery_sag", "rotor_degradation"),
    manoeuvre="hover before and after, at the same voltage",
    variants=lambda signals, vehicle: tuple(
        {"at_s": float(s)} for s in np.quantile(signals.t_s, np.linspace(0.08, 0.92, 43))
    ),
)
