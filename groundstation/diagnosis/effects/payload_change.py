"""Payload change: the mass steps in flight."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, Settings, blank, from_thrust
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

OFFSETS = np.linspace(-0.6, 0.6, 7)
"""Where a closer look is taken, in spacings of the first one."""
MOST_KG = 10.0
"""The heaviest vehicle's own mass."""


def _wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> np.ndarray:
    after = np.clip((signals.t_s - settings["at_s"]) / settings["within_s"] + 0.5, 0.0, 1.0)
    lift = from_thrust(vehicle, signals.thrust_n)[:, 2]
    out = blank(signals)
    out[:, 2, 0] = -after * lift / vehicle.mass_kg
    return out


def _variants(signals: Signals, vehicle: Vehicle) -> tuple[Settings, ...]:
    instants = np.linspace(signals.t_s[0], signals.t_s[-1], 25)[1:-1]
    return tuple({"at_s": float(s), "within_s": float(instants[1] - instants[0])} for s in instants)


def _finer(settings: Settings) -> tuple[Settings, ...]:
    width = settings["within_s"]
    return tuple({"at_s": settings["at_s"] + share * width, "within_s": 0.25 * width} for share in OFFSETS)


EFFECT = Effect(
    identifier="payload_change",
    equation="(m + dm H(t - t_0)) f = T e_z, so to first order F_z = -dm T / m after t_0",
    source="Newton's second law with a step in mass",
    parameters=(ParameterInfo("mass_change_kg", lambda v: 0.5 * v.mass_kg, (-MOST_KG, MOST_KG)),),
    wrench=_wrench,
    sentence="At {at_s} s the vehicle's mass changed by {mass_change_kg} kg.",
    confused_with=("battery_sag", "rotor_degradation"),
    manoeuvre="hover before and after, at the same voltage",
    variants=_variants,
    finer=_finer,
)
