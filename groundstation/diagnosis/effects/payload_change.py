"""Payload change: the mass steps in flight. The vehicle's own mass is that without the load, taken up or let go.

Where a load sits nobody declares: the centre of mass steps, too, by the load's share of the way from the vehicle's own
centre to the load. It is estimated along, so that a centre of mass beside the origin is the vehicle's own.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from groundstation.diagnosis.effect import (
    Effect,
    ParameterInfo,
    Settings,
    about_centre,
    lift_of,
    pushing,
    ramp,
    sharper,
)
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

MOST_KG = 10.0
"""The heaviest vehicle's own mass."""
MOST_M = 1.0
"""The rotors' circle of 10 kg."""
CARRIED = "carried_kg"
"""On board until the instant, as far as values that were found tell: none where the load was taken up."""


def _straight(signals: Signals, vehicle: Vehicle, settings: Settings) -> tuple[np.ndarray, np.ndarray]:
    carried = settings.get(CARRIED, 0.0)
    after = ramp(signals.t_s, settings["at_s"], settings["within_s"])
    up = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    return (float(carried > 0.0) - after) * lift_of(vehicle, signals.thrust_n) / (vehicle.mass_kg + carried), up


def _placed(signals: Signals, vehicle: Vehicle, settings: Settings) -> np.ndarray:
    after = ramp(signals.t_s, settings["at_s"], settings["within_s"])
    on_board = 1.0 - after if settings.get(CARRIED, 0.0) > 0.0 else after
    shifted = about_centre(vehicle, signals) * on_board[:, None, None]
    return np.concatenate([pushing(_straight)(signals, vehicle, settings), shifted], axis=2)


def _variants(signals: Signals, vehicle: Vehicle) -> tuple[Settings, ...]:
    instants: list[float] = np.linspace(float(signals.t_s[0]), float(signals.t_s[-1]), 25)[1:-1].tolist()
    return tuple({"at_s": s, "within_s": instants[1] - instants[0]} for s in instants)


def _settled(settings: Settings, values: np.ndarray) -> Settings:
    """A load that is let go during the flight was on board until then."""
    return {**settings, CARRIED: float(-values[0]) if values[0] < 0.0 < settings["at_s"] else 0.0}


EFFECT = Effect(
    identifier="payload_change",
    equation="(m + dm (H(t - t_0) - c)) f = T e_z, so F_z = -dm (H - c) T / (m - c dm); c = 1: carried at first, let "
    "go at t_0; tau = -s x T e_z while it is on board, s = dm / (m + dm) (r - c)",
    source="Newton's second law with a step in mass",
    parameters=(
        ParameterInfo("mass_change_kg", lambda v: 0.5 * v.mass_kg, (-MOST_KG, MOST_KG)),
        ParameterInfo("shift_x_m", lambda v: v.arm_m(), (-MOST_M, MOST_M), companion=True),
        ParameterInfo("shift_y_m", lambda v: v.arm_m(), (-MOST_M, MOST_M), companion=True),
    ),
    wrench=_placed,
    pointwise=True,
    sentence="At {at_s:s} the vehicle became {mass_change_kg:g|heavier|lighter}.",
    confused_with=("battery_sag", "rotor_degradation"),
    manoeuvre="hover before and after, at the same voltage",
    variants=_variants,
    finer=partial(sharper, instant="at_s"),
    settled=_settled,
    among=lambda settings: EFFECT if CARRIED in settings else STEP,
    instants=("at_s",),
)

STEP = replace(EFFECT, parameters=EFFECT.parameters[:1], wrench=pushing(_straight), straight=_straight)
"""Of a load of which no more is known yet than that it may be there: its mass."""
