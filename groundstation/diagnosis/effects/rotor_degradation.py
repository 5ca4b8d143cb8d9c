"""Rotor degradation: a rotor loses thrust during the flight."""

from __future__ import annotations

from functools import partial

import numpy as np

from groundstation.diagnosis.effect import (
    Effect,
    ParameterInfo,
    Settings,
    has_rotors,
    pushing,
    ramp,
    rotor_wrench,
    sharper,
)
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle


def _straight(signals: Signals, vehicle: Vehicle, settings: Settings) -> tuple[np.ndarray, np.ndarray]:
    rotor = int(settings["rotor"]) - 1
    lost = -signals.thrust_n[:, rotor] * ramp(signals.t_s, settings["from_s"], settings["within_s"])
    return lost, rotor_wrench(vehicle, rotor)


def _variants(signals: Signals, vehicle: Vehicle) -> tuple[Settings, ...]:
    instants: list[float] = np.linspace(float(signals.t_s[0]), float(signals.t_s[-1]), 17)[2:-2].tolist()
    width = instants[1] - instants[0]
    return tuple(
        {"rotor": float(i), "from_s": s, "within_s": width}
        for i in range(1, vehicle.rotors.count + 1)
        for s in instants
    )


EFFECT = Effect(
    identifier="rotor_degradation",
    equation="T_i = (1 - loss H(t - t_0)) k_i Omega_i^2",
    source="Freddi, Lanzon, Longhi 2011 (abrupt loss of effectiveness)",
    parameters=(ParameterInfo("loss", lambda v: 0.5, (-0.5, 1.0)),),
    wrench=pushing(_straight),
    pointwise=True,
    straight=_straight,
    sentence="From {from_s:s} on, rotor {rotor} gives {loss:%|less|more} thrust than before.",
    confused_with=("weak_rotor", "payload_change"),
    manoeuvre="repeat the same manoeuvre early and late",
    variants=_variants,
    finer=partial(sharper, instant="from_s"),
    applies=has_rotors,
    instants=("from_s",),
    of_one_rotor=True,
)
