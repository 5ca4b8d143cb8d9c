"""Payload change: the mass steps in flight. The vehicle's own mass is that without the load, taken up or let go."""

from __future__ import annotations

from functools import partial

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, Settings, lift_of, pushing, ramp, sharper
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

MOST_KG = 10.0
"""The heaviest vehicle's own mass."""


def _straight(signals: Signals, vehicle: Vehicle, settings: Settings) -> tuple[np.ndarray, np.ndarray]:
    carried = settings.get("carried_kg", 0.0)
    after = ramp(signals.t_s, settings["at_s"], settings["within_s"])
    up = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    return (float(carried > 0.0) - after) * lift_of(vehicle, signals.thrust_n) / (vehicle.mass_kg + carried), up


def _variants(signals: Signals, vehicle: Vehicle) -> tuple[Settings, ...]:
    instants: list[float] = np.linspace(float(signals.t_s[0]), float(signals.t_s[-1]), 25)[1:-1].tolist()
    return tuple({"at_s": s, "within_s": instants[1] - instants[0]} for s in instants)


def _settled(settings: Settings, values: np.ndarray) -> Settings:
    """A load that is let go during the flight was on board until then."""
    return {**settings, "carried_kg": float(-values[0])} if values[0] < 0.0 < settings["at_s"] else settings


EFFECT = Effect(
    identifier="payload_change",
    equation="(m + dm (H(t - t_0) - c)) f = T e_z, so F_z = -dm (H - c) T / (m - c dm); c = 1: carried at first, let "
    "go at t_0",
    source="Newton's second law with a step in mass",
    parameters=(ParameterInfo("mass_change_kg", lambda v: 0.5 * v.mass_kg, (-MOST_KG, MOST_KG)),),
    wrench=pushing(_straight),
    pointwise=True,
    straight=_straight,
    sentence="At {at_s:s} the vehicle became {mass_change_kg:g|heavier|lighter}.",
    confused_with=("battery_sag", "rotor_degradation"),
    manoeuvre="hover before and after, at the same voltage",
    variants=_variants,
    finer=partial(sharper, instant="at_s"),
    settled=_settled,
    instants=("at_s",),
)
