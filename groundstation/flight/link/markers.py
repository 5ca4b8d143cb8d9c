"""From the tracked markers to the vehicle's body, as the vehicle file places them. Pure."""

from __future__ import annotations

from drivers.mavlink.geometry import rotate
from drivers.samples import Pose, Quaternion
from groundstation.frames import quat_exp, quat_multiply
from groundstation.vehicle import Mocap


class Markers:
    """How the rigid body lies in the vehicle.

    Args:
        mocap: of the vehicle file.
    """

    def __init__(self, mocap: Mocap):
        self._at = mocap.position_m
        self._identity = not any(mocap.position_m) and not any(mocap.rotation_rad)
        w, x, y, z = (float(v) for v in quat_exp(mocap.rotation_rad))
        self._back: Quaternion = (w, -x, -y, -z)

    def body(self, pose: Pose) -> Pose:
        """The body's pose behind the markers': its origin and axes are those of the vehicle file."""
        if self._identity:
            return pose
        w, x, y, z = (float(v) for v in quat_multiply(pose.quaternion, self._back))
        at = rotate((w, x, y, z), self._at)
        px, py, pz = (p - a for p, a in zip(pose.position_m, at, strict=True))
        return Pose(pose.device_s, (px, py, pz), (w, x, y, z))
