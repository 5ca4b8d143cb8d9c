"""Angular momentum of the rotors: spin-up reaction about their axes, and coupling of roll and pitch."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, blank, has_rotors
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle


def _speed_known(vehicle: Vehicle) -> bool:
    """Momentum asks for speeds: measured or commanded ones, or commands whose top speed is declared."""
    return has_rotors(vehicle) and (vehicle.rotors.input == "rotor_speed" or bool(vehicle.rotors.speed_max_rad_s))


def _wrench(signals: Signals, vehicle: Vehicle, settings: object) -> np.ndarray:
    scale = vehicle.rotors.speed_max_rad_s or 1.0 if vehicle.rotors.input == "command" else 1.0
    spins = np.ascontiguousarray((np.asarray(vehicle.rotors.spin, dtype=float)[:, None] * vehicle.rotors.axes()).T)
    momentum, change = (
        scale * np.column_stack([values @ axis for axis in spins]) for values in (signals.lagged, signals.lagged_rate)
    )
    out = blank(signals)
    out[:, 3:, 0] = -change - np.cross(signals.rate_rad_s, momentum)
    return out


EFFECT = Effect(
    identifier="rotor_gyroscopic",
    equation="tau = -J_r (sum s_i dOmega_i/dt a_i + omega x sum s_i Omega_i a_i), a_i the axes",
    source="Bouabdallah 2007, thesis EPFL 3727, eq. 2.13",
    parameters=(ParameterInfo("rotor_inertia_kg_m2", lambda v: 0.05 * float(v.inertia_tensor()[2, 2]), (0.0, np.inf)),),
    wrench=_wrench,
    pointwise=True,
    sentence="The spin of the rotors shows: each has an inertia of {rotor_inertia_kg_m2:g cm²} about its axis.",
    confused_with=("motor_lag", "angular_damping"),
    manoeuvre="brisk yaw reversals: spin-up reaction leads the aerodynamic torque",
    applies=_speed_known,
    bends_base=0,
)
