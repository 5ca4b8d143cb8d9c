"""An exported vehicle in Bullet, with forces as gym-pybullet-drones applies them.

A place for `benchmarks.exports_round_trip`.
"""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pybullet as bullet
from numpy.typing import NDArray

from benchmarks.rotorpy_blind import STEP_S

Array = NDArray[np.float64]
SUBSTEPS = 8
"""Of a step: Bullet's integrator is of first order."""
RPM = 30.0 / np.pi


def _matrix(q: tuple[float, ...]) -> Array:
    """Rotation matrix of a quaternion, scalar last."""
    return np.array(bullet.getMatrixFromQuaternion(q)).reshape(3, 3)


class InPyBullet:
    """Bullet's multi-body; thrust at each propeller's link, its reaction torque at the centre of mass, kf and km per
    squared RPM.
    """

    def __init__(self, text: str, com: Array, start: Array, spin: tuple[int, ...], gravity_m_s2: float):
        self._client = bullet.connect(bullet.DIRECT)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "vehicle.urdf"
            path.write_text(text, encoding="utf-8")
            self._body = bullet.loadURDF(str(path), flags=bullet.URDF_USE_INERTIA_FROM_FILE)
        properties = ET.fromstring(text).find("properties")  # noqa: S314 - a file that this program wrote
        assert properties is not None
        self._kf, self._km = (float(properties.get(name) or 0.0) for name in ("kf", "km"))
        self._spin, self._com, self._gravity = spin, com, gravity_m_s2
        bullet.setGravity(0.0, 0.0, -gravity_m_s2)
        bullet.setTimeStep(STEP_S / SUBSTEPS)
        for link in range(-1, bullet.getNumJoints(self._body)):
            bullet.changeDynamics(self._body, link, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0)
        info = bullet.getDynamicsInfo(self._body, -1)
        self._inertial = _matrix(info[4])
        bullet.resetBasePositionAndOrientation(self._body, (start + com).tolist(), info[4])

    def state(self) -> dict[str, Array]:
        """Of the centre of mass, as the controller wants it."""
        position, turn, v, w = self._motion()
        q = np.array(bullet.getBasePositionAndOrientation(self._body)[1])
        local = np.array(bullet.getDynamicsInfo(self._body, -1)[4])
        body = np.array(bullet.multiplyTransforms([0, 0, 0], q, [0, 0, 0], [*(-local[:3]), local[3]])[1])
        return {"x": position, "v": v, "q": body, "w": turn.T @ w}

    def _motion(self) -> tuple[Array, Array, Array, Array]:
        """Centre of mass, axes of the body in the world, velocity of the centre, rates in the world."""
        position, q = bullet.getBasePositionAndOrientation(self._body)
        v, w = bullet.getBaseVelocity(self._body)
        return np.array(position), _matrix(q) @ self._inertial.T, np.array(v), np.array(w)

    def step(self, speeds: Array, push: Array, twist: Array) -> tuple[Array, Array, Array, Array]:
        """Sample at the start of a step (pose of the origin, rates, specific force, speeds), then step on."""
        position, turn, v, w = self._motion()
        pose = np.concatenate([position - turn @ self._com, np.roll(self.state()["q"], 1)])
        for number in range(SUBSTEPS):
            self._push(speeds, push, twist)
            bullet.stepSimulation()
            if number == 0:
                _, _, v1, w1 = self._motion()
        slope = SUBSTEPS / STEP_S
        rates, turning = turn.T @ w, turn.T @ ((w1 - w) * slope)
        arm = -self._com
        force = turn.T @ ((v1 - v) * slope + np.array([0.0, 0.0, self._gravity]))
        force += np.cross(turning, arm) + np.cross(rates, np.cross(rates, arm))
        return pose, rates, force, speeds.copy()

    def _push(self, speeds: Array, push: Array, twist: Array) -> None:
        position, turn, _, _ = self._motion()
        rpm = speeds * RPM
        for i, squared in enumerate(rpm**2):
            at = position + turn @ self._inertial @ np.array(bullet.getJointInfo(self._body, i)[14])
            force = turn @ np.array([0.0, 0.0, self._kf * squared])
            bullet.applyExternalForce(self._body, -1, force.tolist(), at.tolist(), bullet.WORLD_FRAME)
        torque = turn @ (np.array([0.0, 0.0, -self._km * float(np.dot(self._spin, rpm**2))]) + twist)
        bullet.applyExternalTorque(self._body, -1, torque.tolist(), bullet.WORLD_FRAME)
        bullet.applyExternalForce(self._body, -1, push.tolist(), position.tolist(), bullet.WORLD_FRAME)
