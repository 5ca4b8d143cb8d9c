r"""A load on a rod without mass below a vehicle that moves as recorded: what it pulls with, by its own nonlinear motion.

With the unit vector n from hook to load, length l, air that holds the load back at c v, and a hook that moves with velocity v_h,

.. math::
   l \ddot n = (1 - n n^T) (g - \dot v_h - c v_l) - l |\dot n|^2 n, \qquad
   F / m_l = n \left(n^T (g - \dot v_h - c v_l) + l |\dot n|^2\right)

F acts on the vehicle at the hook (Bisgaard 2008, thesis Aalborg, ch. 3; Sreenath, Lee, Kumar 2013). Where the rod would have to push, a cable
is slack, and pulls with nothing. The load begins at rest below the hook. What swings it is the hook's motion; how strongly it pulls on
the rod is taken from the rotors' thrust, which holds both up, so that the noise of an acceleration enters no column.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True, error_model="numpy")
def swung(hook_m_s: Array, felt_m_s2: Array, step_s: float, length_m: float, damping_1_s: float, gravity_m_s2: float) -> Array:
    """Pull on the hook in the world for each kilogram of load, m/s^2, shape (k, 3).

    Args:
        hook_m_s: velocity of the hook in the world, (k, 3).
        felt_m_s2: what the vehicle feels instead of gravity, in the world: its acceleration less gravity, (k, 3).
        step_s: between rows; damping_1_s: c.
    """
    count = len(hook_m_s)
    out = np.zeros((count, 3))
    n, w = np.array([0.0, 0.0, -1.0]), np.zeros(3)  # direction, and how it changes
    drive, middle, turn = np.zeros(3), np.zeros(3), np.zeros(3)
    for k in range(count):
        speed = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
        along = length_m * speed
        for i in range(3):
            along += n[i] * (-felt_m_s2[k, i] - damping_1_s * (hook_m_s[k, i] + length_m * w[i]))
        along = max(along, 0.0)
        for i in range(3):
            out[k, i] = along * n[i]
        if k + 1 == count:
            break
        # The midpoint rule: half a step by the slope here, a whole one by the slope there.
        for half in range(2):
            h = step_s * (0.5 if half == 0 else 1.0)
            at = n if half == 0 else middle
            rate = w if half == 0 else turn
            lead = 0.0
            square = 0.0
            for i in range(3):
                drive[i] = -(hook_m_s[k + 1, i] - hook_m_s[k, i]) / step_s - damping_1_s * (hook_m_s[k, i] + length_m * rate[i])
            drive[2] -= gravity_m_s2
            for i in range(3):
                lead += at[i] * drive[i]
                square += rate[i] * rate[i]
            if half == 0:
                for i in range(3):
                    middle[i] = n[i] + h * w[i]
                    turn[i] = w[i] + h * ((drive[i] - lead * n[i]) / length_m - square * n[i])
            else:
                for i in range(3):
                    n[i] += h * turn[i]
                    w[i] += h * ((drive[i] - lead * middle[i]) / length_m - square * middle[i])
        size = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        lead = 0.0
        for i in range(3):
            n[i] /= size
            lead += n[i] * w[i]
        for i in range(3):
            w[i] -= lead * n[i]
    return out
