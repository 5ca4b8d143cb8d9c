"""Gains for a vehicle whose file has no ``[control]``: from mass, tensor and the delay of its loops."""

from __future__ import annotations

import numpy as np

from groundstation.vehicle import Control, Vehicle


def tuned_control(vehicle: Vehicle, delay_s: float) -> Control:
    """Gains of eq. (31)-(32) that stay damped in spite of the delay of the attitude loop.

    With rotors of time constant T and unit inertia the attitude loop's polynomial is T s^3 + s^2 + k_d s + k_p. The
    rotors bound the bandwidth: k_d = b = 1/(2 T), where they cost a quarter of a right angle at crossover; k_p = b^2/5
    keeps the oscillating pair well damped, also with the derivative of the commanded tilt fed forward and with inertias
    30 % off. Position gets b/6 with damping 0.7 (at most 3 rad/s, for poses at 30 Hz), yaw b/5 critically damped;
    integrals are ten times slower.

    Args:
        vehicle: the declared vehicle.
        delay_s: T, the rotors' time constant left after the lead plus the other delays of the attitude loop, s.
    """
    bandwidth = 0.5 / max(delay_s, 0.025)
    yaw = min(0.2 * bandwidth, 4.0)
    position = min(bandwidth / 6.0, 3.0)
    inertia = np.diag(vehicle.inertia_tensor())
    mass = vehicle.mass_kg

    def triple(values: np.ndarray | list[float]) -> tuple[float, float, float]:
        x, y, z = (float(v) for v in values)
        return x, y, z

    proportional = inertia * np.array([0.2 * bandwidth**2, 0.2 * bandwidth**2, yaw**2])
    return Control(
        position_p=triple([mass * position**2] * 3),
        position_i=triple([0.1 * mass * position**3] * 3),
        position_d=triple([1.4 * mass * position] * 3),
        attitude_p=triple(proportional),
        attitude_i=triple(0.05 * bandwidth * proportional),
        attitude_d=triple(inertia * np.array([bandwidth, bandwidth, 2.0 * yaw])),
    )
