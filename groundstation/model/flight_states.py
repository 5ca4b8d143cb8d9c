"""Where a flight was, for a prediction to start from and to be judged by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

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

    t_s: Annotated[Array, "k"]
    start_position_m: Annotated[Array, "k 3"]
    start_velocity_m_s: Annotated[Array, "k 3"]
    start_quaternion: Annotated[Array, "k 4"]
    start_rate_rad_s: Annotated[Array, "k 3"]
    position_m: Annotated[Array, "k 3"]
    velocity_m_s: Annotated[Array, "k 3"]
    quaternion: Annotated[Array, "k 4"]
    rate_rad_s: Annotated[Array, "k 3"]
    motors: MotorInput
    voltage_v: Annotated[Array, "k"]
    window_s: tuple[float, float]
    vehicle: Vehicle
    stretches: tuple[tuple[float, float], ...] = ()
