"""The guard: what it sees, what it does. Pure; it waits on nothing and reads no clock.

Each limit has its own timer: a limit must be passed for ``for_s`` without a break. What was once decided is never taken
back, only made stronger (hold, then land, then kill).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import acos, exp, hypot, inf, isnan, pi, sqrt

from drivers.mavlink.geometry import tilt_cosine
from drivers.samples import Quaternion, Vector3
from groundstation.flight.station import ActionName, Box, GuardLimits

_STRENGTH = {"hold": 0, "land": 1, "kill": 2}
_SLOW_CLOCK = 0.9
_KNOWN_FOR_SURE = {"core_silent": "the core is gone", "estimator_reset": "the vehicle reset its estimate"}


@dataclass(frozen=True, slots=True)
class Observations:
    """What is known at an instant. None: not applicable now, so not watched; an age says how old knowledge is.

    Attributes:
        position_m, velocity_m_s, quaternion: the vehicle's estimate in the plan's frame.
        target_m: where it should be.
        state_age_s, link_age_s: since the estimate, since anything arrived.
        pose_age_s: since a motion-capture pose that differs from the one before (frozen poses age).
        pose_disagreement_m: between what the poses and the estimate moved since the start.
        battery_remaining, battery_v: 0..1, volts.
        estimator_jump_m: largest jump of the estimate since the last step; infinite for a reset it announced.
        oscillation_rad_s: rms of the fast part of the body rates.
        core_age_s: since the core was heard.
        setpoint_age_s: since the last setpoint left.
        clock_rate: the vehicle's time over ours in the last seconds; it decides nothing and explains a tracking error.
        abort: the operator's reason; empty without.
    """

    position_m: Vector3 | None = None
    velocity_m_s: Vector3 | None = None
    quaternion: Quaternion | None = None
    target_m: Vector3 | None = None
    state_age_s: float | None = None
    link_age_s: float | None = None
    pose_age_s: float | None = None
    pose_disagreement_m: float | None = None
    battery_remaining: float | None = None
    battery_v: float | None = None
    estimator_jump_m: float | None = None
    oscillation_rad_s: float | None = None
    core_age_s: float | None = None
    setpoint_age_s: float | None = None
    clock_rate: float | None = None
    abort: str = ""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the guard decided.

    Attributes:
        action: hold, land or kill.
        limit: the name of the limit that was passed.
        reason: one sentence with the figures.
    """

    action: ActionName
    limit: str
    reason: str


class Guard:
    """Watches one flight.

    Args:
        limits: of the station file.
        box: where the vehicle may be.
        empty_v: the vehicle's declared empty voltage; None if it has none.
    """

    def __init__(self, limits: GuardLimits, box: Box, empty_v: float | None = None):
        self._limits, self._box, self._empty_v = limits, box, empty_v
        self._since: dict[str, float] = {}
        self.verdict: Verdict | None = None

    def step(self, now_s: float, seen: Observations) -> Verdict | None:
        """The strongest decision so far; None while all is well."""
        passed = dict(self._passed(seen))
        self._since = {name: self._since.get(name, now_s) for name in passed}
        for name, sentence in passed.items():
            limit = getattr(self._limits, name)
            if now_s - self._since[name] < limit.for_s:
                continue
            if self.verdict is None or _STRENGTH[limit.action] > _STRENGTH[self.verdict.action]:
                self.verdict = Verdict(limit.action, name, sentence)
        return self.verdict

    def _passed(self, seen: Observations) -> Iterator[tuple[str, str]]:
        """Limits passed at this instant, with the sentence that says so."""
        if seen.abort:
            yield "abort", f"aborted: {seen.abort}"
        if seen.position_m is not None:
            outside = _outside(self._box, seen.position_m)
            if not outside <= self._limits.box.limit:  # written so that NaN counts as outside
                x, y, z = seen.position_m
                yield "box", f"left the box by {outside:.2f} m at x {x:.2f}, y {y:.2f}, z {z:.2f} m"
        if seen.position_m is not None and seen.target_m is not None:
            error = sqrt(sum((a - b) ** 2 for a, b in zip(seen.position_m, seen.target_m, strict=True)))
            yield from self._above(
                "tracking", error, "is {:.2f} m from where it should be, more than {:.2f} m" + _late(seen)
            )
        if seen.velocity_m_s is not None:
            speed = sqrt(sum(v * v for v in seen.velocity_m_s))
            yield from self._above("speed", speed, "flies {:.2f} m/s, faster than {:.2f} m/s")
        if seen.quaternion is not None:
            tilt = acos(min(1.0, max(-1.0, tilt_cosine(seen.quaternion))))
            yield from self._above("tilt", tilt, "tilts {:.2f} rad, more than {:.2f} rad")
        for name, value, sentence in (
            ("pose_age", seen.pose_age_s, "no new motion-capture pose for {:.2f} s, longer than {:.2f} s"),
            ("pose_disagreement", seen.pose_disagreement_m, "poses and estimate differ by {:.2f} m, over {:.2f} m"),
            ("state_age", seen.state_age_s, "no position from the vehicle for {:.2f} s, longer than {:.2f} s"),
            ("link_age", seen.link_age_s, "nothing from the vehicle for {:.2f} s, longer than {:.2f} s"),
            ("estimator_reset", seen.estimator_jump_m, "the estimate jumped by {:.2f} m, more than {:.2f} m"),
            ("oscillation", seen.oscillation_rad_s, "body rates oscillate at {:.2f} rad/s rms, over {:.2f} rad/s"),
            ("core_silent", seen.core_age_s, "the core was silent for {:.1f} s, longer than {:.1f} s"),
            ("setpoint_age", seen.setpoint_age_s, "no setpoint left for {:.2f} s, longer than {:.2f} s"),
        ):
            if value is not None:
                yield from self._above(name, value, sentence)
        yield from self._battery(seen)

    def _above(self, name: str, value: float, sentence: str) -> Iterator[tuple[str, str]]:
        limit = getattr(self._limits, name).limit
        if not value <= limit:
            yield (
                name,
                _KNOWN_FOR_SURE[name] if value == inf and name in _KNOWN_FOR_SURE else sentence.format(value, limit),
            )

    def _battery(self, seen: Observations) -> Iterator[tuple[str, str]]:
        limit = self._limits.battery.limit
        if seen.battery_remaining is not None and seen.battery_remaining < limit:
            yield "battery", f"{100 * seen.battery_remaining:.0f} % battery left, less than {100 * limit:.0f} %"
        elif seen.battery_v is not None and self._empty_v is not None and seen.battery_v < self._empty_v:
            yield "battery", f"battery at {seen.battery_v:.2f} V, below its empty {self._empty_v:.2f} V"


def _late(seen: Observations) -> str:
    """What a vehicle whose clock falls behind ours adds to a tracking error.

    Crystals differ by far less than a tenth.
    """
    if seen.clock_rate is None or seen.clock_rate > _SLOW_CLOCK:
        return ""
    return (
        f"; its clock ran at {seen.clock_rate:.2f} of ours: a simulation behind real time, not a vehicle off its path"
    )


def _outside(box: Box, position: Vector3) -> float:
    """Distance to the box; 0 inside, NaN for a position that is not a number."""
    sides = zip(position, (box.x_m, box.y_m, box.z_m), strict=True)
    return hypot(*(p if isnan(p) else max(low - p, 0.0, p - high) for p, (low, high) in sides))


class Oscillation:
    """Root mean square of the body rates above a corner frequency, over the last half second or so.

    First-order high pass, then the mean square with an exponential window; a limit cycle of a loop tuned too hot
    (23 Hz, +-95 deg/s was seen) shows here while the position error stays small.
    """

    def __init__(self, corner_hz: float = 8.0, window_s: float = 0.5):
        self._corner_rad_s, self._window_s = 2 * pi * corner_hz, window_s
        self._last_s: float | None = None
        self._slow = [0.0, 0.0, 0.0]
        self._square = 0.0

    def add(self, device_s: float, rate_rad_s: Vector3) -> None:
        """One gyro sample."""
        if self._last_s is None or device_s - self._last_s > 0.5 or device_s < self._last_s:
            self._last_s, self._slow = device_s, list(rate_rad_s)
            return
        dt, self._last_s = device_s - self._last_s, device_s
        low, keep = 1.0 - exp(-self._corner_rad_s * dt), exp(-dt / self._window_s)
        self._slow = [s + low * (r - s) for s, r in zip(self._slow, rate_rad_s, strict=True)]
        fast = sum((r - s) ** 2 for s, r in zip(self._slow, rate_rad_s, strict=True))
        self._square = keep * self._square + (1.0 - keep) * fast

    @property
    def rms_rad_s(self) -> float:
        """Of the three axes together."""
        return sqrt(self._square)
