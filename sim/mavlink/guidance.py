"""Where the emulated autopilot wants to go in each kind of flight: hold, follow, take off, land, return."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from sim.mavlink.airframe import Vector, euler
from sim.mavlink.control import Setpoint
from sim.mavlink.estimator import Estimate

Kind = Literal["idle", "hold", "follow", "takeoff", "land", "blind", "return"]


@dataclass(frozen=True, slots=True)
class GuidanceSettings:
    """Speeds of the automatic flight phases, m/s; below ``crawl_below_m`` over home a landing slows to
    ``crawl_m_s``.
    """

    climb_m_s: float = 1.5
    descend_m_s: float = 0.7
    crawl_m_s: float = 0.7
    crawl_below_m: float = 0.0
    cruise_m_s: float = 2.0


class Guidance:
    """The set-point generator; one kind of flight at a time.

    Attributes:
        kind: what is flown.
        phase: of a return, "cruise" or "descend".
        done: the take-off has reached its height.
        external: the station's latest set-point.
        ground_m: height of home.
    """

    ARRIVED_M = 0.4

    def __init__(self, settings: GuidanceSettings):
        self.settings = settings
        self.kind: Kind = "idle"
        self.phase = ""
        self.done = False
        self._target: Vector = (0.0, 0.0, 0.0)
        self._point = [0.0, 0.0, 0.0]
        self._yaw = 0.0
        self.external = Setpoint()
        self.ground_m = 0.0

    def enter(self, kind: Kind, estimate: Estimate, *, target: Vector | None = None) -> None:
        """Begin a kind of flight here. ``target``: height of a take-off, or the home of a return."""
        self.kind, self.done = kind, False
        self.phase = "cruise" if kind == "return" else ""
        velocity = estimate.velocity_m_s
        self._point = [p + 0.4 * v for p, v in zip(estimate.position_m, velocity, strict=True)]
        self._yaw = euler(estimate.quaternion)[2]
        self._target = target if target is not None else (self._point[0], self._point[1], self._point[2])

    def setpoint(self, dt: float, estimate: Estimate) -> Setpoint:
        """The set-point of this cycle."""
        if self.kind == "follow":
            return self._followed(estimate)
        if self.kind == "takeoff":
            return self._climbing(dt, estimate)
        if self.kind == "return":
            return self._returning(dt, estimate)
        if self.kind == "land":
            return self._sinking(estimate)
        if self.kind == "blind":
            return Setpoint(velocity_m_s=(math.nan, math.nan, -self.settings.descend_m_s), yaw_rad=self._yaw)
        return Setpoint(self._here(), yaw_rad=self._yaw)

    def _here(self) -> Vector:
        return (self._point[0], self._point[1], self._point[2])

    def _followed(self, estimate: Estimate) -> Setpoint:
        """The station's set-point; without a yaw the heading of when it began is kept."""
        wanted = self.external
        if math.isnan(wanted.yaw_rad) and math.isnan(wanted.yaw_rate_rad_s):
            return replace(wanted, yaw_rad=self._yaw)
        self._yaw = wanted.yaw_rad if math.isfinite(wanted.yaw_rad) else euler(estimate.quaternion)[2]
        return wanted

    def _climbing(self, dt: float, estimate: Estimate) -> Setpoint:
        rate = braked(self.settings.climb_m_s, self._target[2] - self._point[2])
        self._point[2] += rate * dt
        self.done = self._target[2] - self._point[2] < 0.05 and abs(estimate.position_m[2] - self._target[2]) < 0.2
        return Setpoint(self._here(), (0.0, 0.0, rate), yaw_rad=self._yaw)

    def _sinking(self, estimate: Estimate) -> Setpoint:
        x, y, _ = self._point
        near = estimate.position_m[2] - self.ground_m < self.settings.crawl_below_m
        speed = self.settings.crawl_m_s if near else self.settings.descend_m_s
        return Setpoint((x, y, math.nan), (0.0, 0.0, -speed), yaw_rad=self._yaw)

    def _returning(self, dt: float, estimate: Estimate) -> Setpoint:
        if self.phase == "descend":
            return self._sinking(estimate)
        dx, dy = self._target[0] - self._point[0], self._target[1] - self._point[1]
        distance = math.hypot(dx, dy)
        step = self.settings.cruise_m_s * dt
        if distance > step:
            self._point[0] += step * dx / distance
            self._point[1] += step * dy / distance
        else:
            self._point[0], self._point[1] = self._target[0], self._target[1]
            x, y, _ = estimate.position_m
            if math.hypot(x - self._target[0], y - self._target[1]) < self.ARRIVED_M:
                self.phase = "descend"
        return Setpoint(self._here(), yaw_rad=self._yaw)


def braked(speed_m_s: float, distance_m: float) -> float:
    """Speed towards a point so far away that a deceleration of 1 m/s^2 still stops there: min(v, sqrt(2 a d))."""
    return min(speed_m_s, math.sqrt(2.0 * max(0.0, distance_m)))


def wants_up(setpoint: Setpoint, estimate: Estimate) -> bool:
    """Whether a set-point asks a vehicle on the ground to leave it."""
    height = setpoint.position_m[2] - estimate.position_m[2]
    return height > 0.1 or setpoint.velocity_m_s[2] > 0.05 or setpoint.acceleration_m_s2[2] > 0.5
