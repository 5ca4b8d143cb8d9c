"""What is known of the vehicle from what it sent: modes, arming, state, ages, rates. No I/O, no clock of its own."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from math import inf, sqrt

from drivers.mavlink.codec import Received
from drivers.mavlink.dialect import Message, mavlink
from drivers.samples import Battery, Event, Imu, Pose, Sample, State, Vector3
from groundstation.flight.link.guard import Oscillation
from groundstation.flight.link.profiles import Profile, Version

_RATE_WINDOW_S = 2.0
_ON_GROUND = mavlink.MAV_LANDED_STATE_ON_GROUND
_SENSORS = {
    number: entry.name.removeprefix("MAV_SYS_STATUS_").removeprefix("SENSOR_").lower().replace("_", " ")
    for number, entry in mavlink.enums["MAV_SYS_STATUS_SENSOR"].items()
    if number.bit_count() == 1
}


class Meter:
    """Arrivals of one message: count and rate over the last seconds."""

    def __init__(self) -> None:
        self.count = 0
        self._times: deque[float] = deque()

    def add(self, now_s: float) -> None:
        """One came."""
        self.count += 1
        self._times.append(now_s)
        self._trim(now_s)

    def rate_hz(self, now_s: float) -> float:
        """Arrivals per second, as of now."""
        self._trim(now_s)
        return len(self._times) / _RATE_WINDOW_S

    def _trim(self, now_s: float) -> None:
        while self._times and now_s - self._times[0] > _RATE_WINDOW_S:
            self._times.popleft()


@dataclass(slots=True)
class VehicleView:
    """The newest of everything.

    Attributes:
        profile: how to read it.
        mode: by name.
        armed: as the heartbeat says; None before the first.
        on_ground: as EXTENDED_SYS_STATE says; None where it never came.
        serial: the autopilot's own number; empty where it tells none.
        unhealthy: what its SYS_STATUS says is wanted and not well, by name.
        logs: its onboard log works, where it tells (ArduPilot in SYS_STATUS).
        log_room_mib: room for it, where it tells (PX4 in STORAGE_INFORMATION; 0 without a card).
        checks_pass: the autopilot's own arming checks, where it tells (ArduPilot, PX4 in SYS_STATUS).
        state, pose, battery: newest samples with ``*_s``, the host time they came.
        pose_changed_s: host time of the newest pose that differs from the one before.
        estimator_flags: of ESTIMATOR_STATUS or EKF_STATUS_REPORT, which share them; None before the first.
        estimator_ratios: of its innovations to their gates: horizontal position, height, heading.
        jump_m: largest jump of the estimate since :meth:`take_jump`.
        texts: newest texts of the autopilot.
        restarts: how often its clock began again.
        resets: how often the estimator announced one.
    """

    profile: Profile
    mode: str = ""
    armed: bool | None = None
    on_ground: bool | None = None
    checks_pass: bool | None = None
    estimator_flags: int | None = None
    estimator_ratios: Vector3 = (0.0, 0.0, 0.0)
    vibration_m_s2: Vector3 | None = None
    unhealthy: tuple[str, ...] = ()
    logs: bool | None = None
    log_room_mib: float | None = None
    capabilities: int | None = None
    software: int | None = None
    serial: str = ""
    state: State | None = None
    state_s: float = -inf
    pose: Pose | None = None
    pose_s: float = -inf
    pose_changed_s: float = -inf
    battery: Battery | None = None
    battery_remaining: float | None = None
    heard_s: float = -inf
    heartbeat_s: float = -inf
    jump_m: float = 0.0
    restarts: int = 0
    resets: int = 0
    meters: dict[str, Meter] = field(default_factory=dict)
    texts: deque[str] = field(default_factory=lambda: deque(maxlen=30))
    oscillation: Oscillation = field(default_factory=Oscillation)
    _pace: deque[tuple[float, float]] = field(default_factory=deque)
    _reset_counter: int | None = None
    _boot_ms: int = 0

    def message(self, received: Received, now_s: float) -> None:
        """Take note of a message of the vehicle."""
        if (received.frame.system, received.frame.component) != (self.profile.system, self.profile.component):
            return
        self.heard_s = now_s
        name = received.name if received.message is not None else "UNKNOWN"  # their ids are without number
        self.meters.setdefault(name, Meter()).add(now_s)
        m = received.message
        if m is None:
            return
        self._note_restart(m)
        match received.name:
            case "HEARTBEAT":
                self._heartbeat(m, received.frame.component, now_s)
            case "CURRENT_MODE":
                self.mode = self.profile.mode_name(m.custom_mode)
            case "EXTENDED_SYS_STATE":
                if m.landed_state != mavlink.MAV_LANDED_STATE_UNDEFINED:
                    self.on_ground = m.landed_state == _ON_GROUND
            case "SYS_STATUS":
                bit = mavlink.MAV_SYS_STATUS_PREARM_CHECK
                if m.onboard_control_sensors_present & bit or self.profile.prearm_in_health_alone:
                    self.checks_pass = bool(m.onboard_control_sensors_health & bit)
                failed = m.onboard_control_sensors_enabled & ~m.onboard_control_sensors_health
                self.unhealthy = tuple(name for number, name in _SENSORS.items() if failed & number)
                log = mavlink.MAV_SYS_STATUS_LOGGING
                if m.onboard_control_sensors_present & log:
                    self.logs = bool(m.onboard_control_sensors_health & log)  # enabled only while it writes
            case "STORAGE_INFORMATION":
                self.log_room_mib = m.available_capacity if m.status else 0.0
            case "BATTERY_STATUS" if m.battery_remaining >= 0 and m.id == 0:
                self.battery_remaining = m.battery_remaining * 1e-2
            case "ESTIMATOR_STATUS":
                self.estimator_flags = m.flags
                self.estimator_ratios = (m.pos_horiz_ratio, m.pos_vert_ratio, m.mag_ratio)
            case "EKF_STATUS_REPORT":
                self.estimator_flags = m.flags
                self.estimator_ratios = (m.pos_horiz_variance, m.pos_vert_variance, m.compass_variance)
            case "VIBRATION":
                self.vibration_m_s2 = (m.vibration_x, m.vibration_y, m.vibration_z)
            case "AUTOPILOT_VERSION":
                self.capabilities, self.software = m.capabilities, m.flight_sw_version
                self.serial = bytes(m.uid2).hex().rstrip("0") or (f"{m.uid:x}" if m.uid else "")
            case "ODOMETRY":
                # Its reset counter is no alarm: PX4 counts the heading's alignment, a metre and a half after each
                # take-off. How far the position jumped is measured from the positions themselves.
                self.resets += self._reset_counter not in (None, m.reset_counter)
                self._reset_counter = m.reset_counter

    def sample(self, sample: Sample, now_s: float) -> None:
        """Take note of a sample."""
        if isinstance(sample, Imu):
            self.oscillation.add(sample.device_s, sample.gyro_rad_s)
        elif isinstance(sample, State):
            if self.state is None or sample.device_s > self.state.device_s:
                self.jump_m = max(self.jump_m, _jump(self.state, sample))
                self.state, self.state_s = sample, now_s
                self._pace.append((now_s, sample.device_s))
                while now_s - self._pace[0][0] > _RATE_WINDOW_S:
                    self._pace.popleft()
        elif isinstance(sample, Battery):
            self.battery = sample
        elif isinstance(sample, Pose):
            if self.pose is None or (sample.position_m, sample.quaternion) != (
                self.pose.position_m,
                self.pose.quaternion,
            ):
                self.pose_changed_s = now_s
            self.pose, self.pose_s = sample, now_s
        elif isinstance(sample, Event) and sample.kind == "statustext":
            self.texts.append(sample.text)

    def take_jump(self) -> float:
        """The largest jump since the last call."""
        jump, self.jump_m = self.jump_m, 0.0
        return jump

    @property
    def clock_rate(self) -> float | None:
        """The vehicle's time over ours in the last two seconds of states; None before one of them."""
        if not self._pace or self._pace[-1][0] - self._pace[0][0] < 0.5 * _RATE_WINDOW_S:
            return None
        (host_0, device_0), (host_1, device_1) = self._pace[0], self._pace[-1]
        return (device_1 - device_0) / (host_1 - host_0)

    def rate_hz(self, name: str, now_s: float) -> float:
        """Measured arrival rate of a message."""
        meter = self.meters.get(name)
        return 0.0 if meter is None else meter.rate_hz(now_s)

    @property
    def version(self) -> Version | None:
        """Major and minor of the firmware; None before it told."""
        return None if not self.software else (self.software >> 24 & 0xFF, self.software >> 16 & 0xFF)

    @property
    def key(self) -> str:
        """What this one vehicle is remembered by: its autopilot's serial number, else autopilot and system id."""
        return self.serial or f"{self.profile.name}-{self.profile.system}"

    @property
    def in_pilots_hands(self) -> bool:
        """A human's sticks fly it."""
        return self.mode in self.profile.pilot_modes

    def _heartbeat(self, m: Message, component: int, now_s: float) -> None:
        if component != self.profile.component or m.autopilot == mavlink.MAV_AUTOPILOT_INVALID:
            return
        self.heartbeat_s = now_s
        self.mode = self.profile.mode_name(m.custom_mode)
        self.armed = bool(m.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)

    def _note_restart(self, m: Message) -> None:
        boot_ms = getattr(m, "time_boot_ms", None)
        if not boot_ms or m.get_type() == "SYSTEM_TIME":
            return
        if boot_ms + 2000 < self._boot_ms:
            self.restarts += 1
            self._boot_ms = 0
            self.state, self.jump_m, self._reset_counter = None, inf, None
            self._pace.clear()
        self._boot_ms = max(self._boot_ms, boot_ms)


def _jump(before: State | None, after: State) -> float:
    """How far the estimate moved beyond what its own velocities explain; gaps over 0.2 s are the age limits'
    business.
    """
    if before is None or not 0.0 < after.device_s - before.device_s < 0.2:
        return 0.0
    dt = after.device_s - before.device_s
    pairs = zip(before.position_m, after.position_m, before.velocity_m_s, after.velocity_m_s, strict=True)
    return sqrt(sum((p1 - p0 - 0.5 * (v0 + v1) * dt) ** 2 for p0, p1, v0, v1 in pairs))
