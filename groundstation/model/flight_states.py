"""Where a flight was, for a prediction to start from and to be judged by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.model.rotors import MotorInput
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FlightStates:
    """Where a flight was, at stamps t: starts (from the past alone) and references to judge by; NaN where unknown.

    Windows lie within ``window_s``, and within one of its ``stretches`` where these are given.
    """

    t_s: Array
    start_position_m: Array
    start_velocity_m_s: Array
    start_quaternion: Array
    start_rate_rad_s: Array
    position_m: Array
    velocity_m_s: Array
    quaternion: Array
    rate_rad_s: Array
    motors: MotorInput
    voltage_v: Array
    window_s: tuple[float, float]
    vehicle: Vehicle
    stretches: tuple[tuple[float, float], ...] = ()
