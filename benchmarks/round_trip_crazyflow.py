"""An exported vehicle by crazyflow's first-principles dynamics. A place for `benchmarks.exports_round_trip`.

crazyflow is no dependency of the project: it goes into an environment of its own, with SCIPY_ARRAY_API=1.
"""

from __future__ import annotations

import importlib
import tomllib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.rotorpy_blind import STEP_S

Array = NDArray[np.float64]
RPM = 30.0 / np.pi
SUBSTEPS = 3
"""Of a step: a vehicle whose rotor speeds are measured has the least lag, 1 ms."""
NUMBERS = (
    "mass", "L", "prop_inertia", "J", "rpm2thrust", "rpm2torque", "mixing_matrix", "drag_matrix", "rotor_dyn_coef",
)  # fmt: skip


class InCrazyflow:
    """Its equations of motion, stepped by a Runge-Kutta rule of fourth order. Its origin is the centre of mass."""

    def __init__(self, text: str, start: Array, hover: float, gravity_m_s2: float):
        package: Any = importlib.import_module("crazyflow.dynamics.first_principles.dynamics")
        (told,) = tomllib.loads(text).values()
        self._numbers = {name: np.asarray(told[name], dtype=float) for name in NUMBERS}
        self._numbers["J_inv"] = np.linalg.inv(self._numbers["J"])
        self._gravity = np.array([0.0, 0.0, -gravity_m_s2])
        self._dynamics = package.dynamics
        still = [start, [0.0, 0.0, 0.0, 1.0], np.zeros(3), np.zeros(3), np.full(4, hover * RPM)]
        self._s: Array = np.concatenate(still)

    def state(self) -> dict[str, Array]:
        """Of the centre of mass, as the controller wants it."""
        s = self._s
        return {"x": s[:3], "q": s[3:7], "v": s[7:10], "w": s[10:13]}

    def _slope(self, s: Array, speeds: Array, push: Array, twist: Array) -> Array:
        turn = _matrix(s[3:7])
        slopes = self._dynamics(
            s[:3], s[3:7], s[7:10], s[10:13], speeds * RPM, s[13:], push, turn @ twist,
            gravity_vec=self._gravity, **self._numbers,
        )  # fmt: skip
        return np.concatenate([np.asarray(each) for each in slopes])

    def step(self, speeds: Array, push: Array, twist: Array) -> tuple[Array, Array, Array, Array]:
        """Sample at the start of a step (pose of the origin, rates, specific force, speeds), then step on."""
        s, h = self._s, STEP_S / SUBSTEPS
        k1 = self._slope(s, speeds, push, twist)
        pose = np.concatenate([s[:3], np.roll(s[3:7], 1)])
        sample = pose, s[10:13].copy(), _matrix(s[3:7]).T @ (k1[7:10] - self._gravity), s[13:] / RPM
        for _ in range(SUBSTEPS):
            k1 = self._slope(s, speeds, push, twist)
            k2 = self._slope(s + 0.5 * h * k1, speeds, push, twist)
            k3 = self._slope(s + 0.5 * h * k2, speeds, push, twist)
            k4 = self._slope(s + h * k3, speeds, push, twist)
            s = s + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            s[3:7] /= np.linalg.norm(s[3:7])
        self._s = s
        return sample


def _matrix(q: Array) -> Array:
    """Rotation matrix of a quaternion, scalar last."""
    v, w = q[:3], q[3]
    cross = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross
