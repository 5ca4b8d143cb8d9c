"""The emulated autopilot's own idea of where it is: right on GPS, as good as what it is fed on external vision.

No filter is run. The estimate is the truth plus an error that moves as the source in use makes it move: a wandering
error on GPS; pulled to the poses that arrive on vision; growing by a velocity error once they stop. That is all a
ground station can see of an estimator: offsets, frames, time-outs, flags.
"""

from __future__ import annotations

import math
import random
from collections import deque
from dataclasses import dataclass
from typing import Literal

from sim.mavlink.airframe import AirframeState, Quaternion, Vector, euler

Source = Literal["gps", "vision", "none"]

# ESTIMATOR_STATUS_FLAGS (MAVLink common)
ATTITUDE, VELOCITY_HORIZONTAL, VELOCITY_VERTICAL = 1, 2, 4
POSITION_RELATIVE, POSITION_ABSOLUTE, POSITION_VERTICAL = 8, 16, 32
ABOVE_GROUND, CONSTANT_POSITION, PREDICTED_RELATIVE, PREDICTED_ABSOLUTE = 64, 128, 256, 512


@dataclass(frozen=True, slots=True)
class Estimate:
    """World z up, body FLU. ``position_valid`` says whether position-controlled modes may use it."""

    position_m: Vector
    velocity_m_s: Vector
    quaternion: Quaternion
    rate_rad_s: Vector
    position_valid: bool


@dataclass(frozen=True, slots=True)
class EstimatorSettings:
    """How a firmware's estimator behaves towards the outside.

    Attributes:
        gps_error_m: standard deviation of the wandering position error on GPS.
        gps_ready_s: time after boot at which GPS gives a position.
        vision_timeout_s: without poses for this long the position is no longer valid.
        vision_gain: share of a pose's deviation taken over per message.
        drift_m_s2: growth of the velocity error once poses have stopped.
    """

    gps_error_m: float = 0.1
    gps_ready_s: float = 4.0
    vision_timeout_s: float = 4.6
    vision_gain: float = 0.2
    drift_m_s2: float = 0.03


class Estimator:
    """Follows the truth with the error of its source.

    Args:
        settings: the firmware's behaviour.
        seed: of the GPS error and the direction of drift.
    """

    HISTORY_S = 0.5
    GPS_CORRELATION_S, GPS_VELOCITY_S = 5.0, 1.0

    def __init__(self, settings: EstimatorSettings, *, seed: int = 0):
        self.settings = settings
        self.source: Source = "gps"
        self._random = random.Random(seed)
        self._error = [0.0, 0.0, 0.0]
        self._error_rate = [0.0, 0.0, 0.0]
        self._drive = [0.0, 0.0, 0.0]
        self._yaw_error = 0.0
        self._history: deque[tuple[float, Vector, float]] = deque()
        self._last_vision_s = -math.inf
        self._now_s = 0.0
        heading = self._random.uniform(-math.pi, math.pi)
        self._drift = (math.cos(heading), math.sin(heading), 0.2)
        self.reset_count = 0

    @property
    def position_valid(self) -> bool:
        """Whether the source in use gives a position now."""
        if self.source == "gps":
            return self._now_s >= self.settings.gps_ready_s
        return self.source == "vision" and self.vision_age_s < self.settings.vision_timeout_s

    @property
    def vision_age_s(self) -> float:
        """Seconds since the last pose arrived."""
        return self._now_s - self._last_vision_s

    @property
    def flags(self) -> int:
        """ESTIMATOR_STATUS flags."""
        base = ATTITUDE | VELOCITY_VERTICAL | POSITION_VERTICAL | ABOVE_GROUND
        if not self.position_valid:
            return base | CONSTANT_POSITION
        flags = base | VELOCITY_HORIZONTAL | POSITION_RELATIVE | PREDICTED_RELATIVE
        return flags | POSITION_ABSOLUTE | PREDICTED_ABSOLUTE if self.source == "gps" else flags

    def update(self, dt: float, now_s: float, truth: AirframeState, gyro: Vector) -> Estimate:
        """Advance the error and return the estimate at ``now_s`` of the autopilot's clock."""
        self._now_s = now_s
        self._history.append((now_s, truth.position_m, euler(truth.quaternion)[2]))
        while self._history[0][0] < now_s - self.HISTORY_S:
            self._history.popleft()
        if self.source == "gps":
            self._wander(dt)
        elif self.vision_age_s > 0.2:
            for axis in range(3):
                self._error_rate[axis] += self.settings.drift_m_s2 * self._drift[axis] * dt
                self._error[axis] += self._error_rate[axis] * dt
        half = 0.5 * self._yaw_error
        w, x, y, z = truth.quaternion
        c, s = math.cos(half), math.sin(half)
        turned = (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)
        px, py, pz = truth.position_m
        vx, vy, vz = truth.velocity_m_s
        ex, ey, ez = self._error
        fx, fy, fz = self._error_rate
        return Estimate((px + ex, py + ey, pz + ez), (vx + fx, vy + fy, vz + fz), turned, gyro, self.position_valid)

    def _wander(self, dt: float) -> None:
        """Position error e on GPS: e' = v - e/T with v a Gauss-Markov process of correlation time T_v.

        Its standard deviation is sd(v) T sqrt(T_v / (T + T_v)); the velocity error reported is e', so that position and
        velocity belong together as in a filter's output.
        """
        long, short = self.GPS_CORRELATION_S, self.GPS_VELOCITY_S
        decay = dt / short
        kick = self.settings.gps_error_m / (long * math.sqrt(short / (long + short))) * math.sqrt(2.0 * decay)
        for axis in range(3):
            self._drive[axis] += -decay * self._drive[axis] + kick * self._random.gauss(0.0, 1.0)
            self._error_rate[axis] = self._drive[axis] - self._error[axis] / long
            self._error[axis] += self._error_rate[axis] * dt

    def vision(self, position_m: Vector, yaw_rad: float, stamp_s: float) -> None:
        """Take a pose of the external vision, stamped on the autopilot's clock."""
        first = self._last_vision_s == -math.inf or self.vision_age_s > self.settings.vision_timeout_s
        self._last_vision_s = self._now_s
        if self.source != "vision" or not self._history:
            return
        then, truth, yaw = min(self._history, key=lambda item: abs(item[0] - stamp_s))
        if abs(then - stamp_s) > self.HISTORY_S:
            _, truth, yaw = self._history[-1]  # a stamp of another clock: taken as just arrived
        gain = 1.0 if first else self.settings.vision_gain
        self.reset_count += int(first)
        for axis in range(3):
            self._error[axis] += gain * (position_m[axis] - truth[axis] - self._error[axis])
            self._error_rate[axis] = 0.0
        self._yaw_error += gain * math.remainder(yaw_rad - yaw - self._yaw_error, 2.0 * math.pi)

    def restart(self) -> None:
        """Begin again after a reboot: nothing has been received yet."""
        self._history.clear()
        self._last_vision_s, self._now_s = -math.inf, 0.0
        self._error, self._error_rate, self._drive, self._yaw_error = [0.0] * 3, [0.0] * 3, [0.0] * 3, 0.0

    def jump(self, offset_m: Vector) -> None:
        """A reset of the estimator: the position steps, and the reset counter with it."""
        self._error = [e + o for e, o in zip(self._error, offset_m, strict=True)]
        self.reset_count += 1
