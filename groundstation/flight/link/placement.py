"""Where the plan's frame lies in the vehicle's, and the path as a target at an instant. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin

from drivers.samples import Vector3
from groundstation.flight.link.profiles import Target
from groundstation.trajectory import Sequence


@dataclass(frozen=True, slots=True)
class Placement:
    """How the plan's frame lies in the vehicle's: moved by ``origin_m`` and turned by ``yaw_rad`` about the
    vertical.
    """

    origin_m: Vector3 = (0.0, 0.0, 0.0)
    yaw_rad: float = 0.0

    def to_vehicle(self, target: Target) -> Target:
        """A target of the plan in the vehicle's frame."""
        x, y, z = self._turn(target.position_m, self.yaw_rad)
        a, b, c = self.origin_m
        return Target(
            (x + a, y + b, z + c),
            self._turn(target.velocity_m_s, self.yaw_rad),
            self._turn(target.acceleration_m_s2, self.yaw_rad),
            target.yaw_rad + self.yaw_rad,
            target.yaw_rate_rad_s,
        )

    def to_plan(self, position_m: Vector3) -> Vector3:
        """A position of the vehicle in the plan's frame."""
        x, y, z = (p - o for p, o in zip(position_m, self.origin_m, strict=True))
        return self._turn((x, y, z), -self.yaw_rad)

    @staticmethod
    def _turn(vector: Vector3, angle: float) -> Vector3:
        x, y, z = vector
        return (cos(angle) * x - sin(angle) * y, sin(angle) * x + cos(angle) * y, z)


def target_at(path: Sequence, t_s: float) -> Target:
    """The path at one instant."""
    flat = path.sample([t_s])
    p, v, a = (tuple(float(c) for c in flat.position[n, 0]) for n in range(3))
    return Target(p, v, a, float(flat.yaw[0, 0]), float(flat.yaw[1, 0]))  # type: ignore[arg-type]
