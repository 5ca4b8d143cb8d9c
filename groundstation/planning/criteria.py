"""The regression matrix along a planned motion, and what its singular values say (seed paper eq. 12, 20, 21)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from groundstation.trajectory import RigidMotion, Trajectory, rigid_motion
from groundstation.vehicle import INERTIA_NAMES

Array = NDArray[np.float64]

PARAMETERS = ("mass_kg", *(f"i{name}_kg_m2" for name in INERTIA_NAMES))
"""Theta of eq. (12): mass and the six entries of the inertia tensor."""

CRITERIA = ("condition", "D", "A", "E")
"""What a plan can be made for; see ``docs/planning.md``."""

SAMPLE_STEP_S = 0.002
"""Sampling period of W in the seed paper."""


def inertia_regressor(
    rate: Annotated[Array, "k 3"], acceleration: Annotated[Array, "k 3"]
) -> Annotated[Array, "k 3 6"]:
    """Y with I dw/dt + w x I w = Y [Ixx, Ixy, Ixz, Iyy, Iyz, Izz], shape (k, 3, 6) (rows 2-4 of eq. 12).

    Args:
        rate: body rates w, shape (k, 3), rad/s.
        acceleration: their derivatives, shape (k, 3), rad/s^2.
    """
    p, q, r = np.moveaxis(rate, -1, 0)
    dp, dq, dr = np.moveaxis(acceleration, -1, 0)
    rows = [
        [dp, dq - p * r, dr + p * q, -q * r, q * q - r * r, q * r],
        [p * r, dp + q * r, r * r - p * p, dq, dr - p * q, -p * r],
        [-p * q, p * p - q * q, dp - q * r, p * q, dq + p * r, dr],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def regressor(motion: RigidMotion) -> Annotated[Array, "k 4 7"]:
    """Phi of eq. (12) along a motion: [F_z, tau_x, tau_y, tau_z] = Phi Theta, shape (k, 4, 7).

    Along a planned motion thrust carries acceleration plus gravity, so the mass column is the specific thrust.
    """
    phi = np.zeros((len(motion.position_m), 4, 7))
    phi[:, 0, 0] = motion.specific_thrust_m_s2
    phi[:, 1:, 1:] = inertia_regressor(motion.angular_velocity_body_rad_s, motion.angular_acceleration_body_rad_s2)
    return phi


def stacked_regressor(
    trajectory: Trajectory, gravity_m_s2: float, step_s: float = SAMPLE_STEP_S
) -> Annotated[Array, "n 7"]:
    """W of eq. (20): Phi at every step of the trajectory, the end excluded, shape (4 k, 7)."""
    count = max(round(trajectory.duration_s / step_s), 1)
    t = np.arange(count) * (trajectory.duration_s / count)
    return regressor(rigid_motion(trajectory.sample(t), gravity_m_s2)).reshape(-1, len(PARAMETERS))


def condition_number(trajectory: Trajectory, gravity_m_s2: float = 9.80665) -> float:
    """cond(W), the seed paper's cost (eq. 21): largest over smallest singular value of the stacked regressor."""
    return float(np.linalg.cond(stacked_regressor(trajectory, gravity_m_s2)))
