"""Weak rotor: one rotor gives less thrust (and torque) than its speed or command says."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, Settings, has_rotors, pushing, rotor_wrench
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle


def _straight(signals: Signals, vehicle: Vehicle, settings: Settings) -> tuple[np.ndarray, np.ndarray]:
    rotor = int(settings["rotor"]) - 1
    lost = -signals.thrust_n[:, rotor]
    return lost, rotor_wrench(vehicle, rotor)


EFFECT = Effect(
    identifier="weak_rotor",
    equation="T_i = (1 - loss) k_i Omega_i^2, Q_i likewise",
    source="Freddi, Lanzon, Longhi 2011, IFAC 44(1), sec. 2 (rotor effectiveness factor)",
    parameters=(ParameterInfo("loss", lambda v: 0.5, (-0.5, 1.0)),),
    wrench=pushing(_straight),
    pointwise=True,
    straight=_straight,
    sentence="Rotor {rotor} gives {loss:%|less|more} thrust than declared.",
    confused_with=("com_offset", "constant_wrench"),
    manoeuvre="turn in yaw both ways and climb hard: a weak rotor shows in yaw torque, an offset centre of mass does "
    "not",
    variants=lambda signals, vehicle: tuple({"rotor": float(i)} for i in range(1, vehicle.rotors.count + 1)),
    applies=has_rotors,
    of_one_rotor=True,
)
