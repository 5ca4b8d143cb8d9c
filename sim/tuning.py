"""Gains for a vehicle whose file has no ``[control]``: from mass, tensor and the delay of its loops."""

from __future__ import annotations

import numpy as np

from groundstation.vehicle import Control, Vehicle


def tuned_control(vehicle: Vehicle, delay_s: float) -> Control:
    """Gains of eq. (31)-(32) such that roll and pitch have Butterworth poles in spite of the delay.

    With rotors of time constant T, unit inertia and torque -k_p eta - k_d d(eta)/dt the characteristic polynomial is
    T s^3 + s^2 + k_d s + k_p. Third-order Butterworth poles at b = 1/(2 T) need k_d = b and k_p = b^2/2: the bandwidth is bounded by the rotors, and T counts the loop's other delays too. Yaw gets half of that (its actuation is
    weak), position a quarter, each critically damped; integrals act five to ten times slower.

    Args:
        vehicle: the declared vehicle.
        delay_s: rotor time constant plus the other delays of the attitude loop, s.
    """
    bandwidth = 0.5 / max(delay_s, 0.025)
    stiffness, damping = 0.5 * bandwidth**2, bandwidth
    yaw = min(0.5 * bandwidth, 4.0)
    position = min(0.25 * bandwidth, 3.0)
    inertia = np.diag(vehicle.inertia_tensor())
    mass = vehicle.mass_kg

    def triple(values: np.ndarray | list[float]) -> tuple[float, float, float]:
        x, y, z = (float(v) for v in values)
        return x, y, z

    proportional = inertia * np.array([stiffness, stiffness, yaw**2])
    return Control(
        position_p=triple([mass * position**2] * 3),
        position_i=triple([0.2 * mass * position**3] * 3),
        position_d=triple([2.0 * mass * position] * 3),
        attitude_p=triple(proportional),
        attitude_i=triple(0.1 * bandwidth * proportional * np.array([1.0, 1.0, 0.5])),
        attitude_d=triple(inertia * np.array([damping, damping, 2.0 * yaw])),
    )
