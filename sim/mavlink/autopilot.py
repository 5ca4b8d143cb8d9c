"""The emulated autopilot without I/O: bytes and a time in, bytes out.

:class:`Autopilot` holds what both firmwares share: the control cycle, the protocols, take-off and landing. Their
manners (modes, arming, acknowledgements, failsafes, texts, rates, logs) are in :mod:`sim.mavlink.px4` and
:mod:`sim.mavlink.arducopter`. It lives on its own clock, which advances in whole control cycles as the firmware's does
in simulation, runs at its own speed against the host's, and starts at the time since boot.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import ClassVar

from drivers.mavlink.codec import MavlinkCodec
from groundstation.vehicle import Vehicle
from sim.mavlink import inbound, messages
from sim.mavlink.airframe import Airframe, ImuSample, Vector
from sim.mavlink.battery import BatteryGauge
from sim.mavlink.control import Cascade, Gains, Setpoint
from sim.mavlink.estimator import Estimator, EstimatorSettings
from sim.mavlink.ftp import FtpServer
from sim.mavlink.guidance import Guidance, GuidanceSettings, Kind, braked, wants_up
from sim.mavlink.logserver import LogServer
from sim.mavlink.mission import MissionServer
from sim.mavlink.outbox import TEXT_LENGTH, Link, Outbox
from sim.mavlink.parameters import Parameter, ParameterStore
from sim.mavlink.streams import Rule, Streams
from sim.mavlink.wire import Message, mavlink

ON_GROUND, IN_AIR, TAKING_OFF, LANDING = 1, 2, 3, 4
ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
INFO, CRITICAL = mavlink.MAV_SEVERITY_INFO, mavlink.MAV_SEVERITY_CRITICAL
Sender = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Mode:
    """A flight mode: what HEARTBEAT says of it and what is flown in it."""

    name: str
    custom: int
    base: int
    kind: Kind
    needs_position: bool


class Autopilot(ABC):
    """One vehicle with its firmware.

    Args:
        vehicle: the declared vehicle, for which the firmware was tuned.
        airframe: the physics it flies.
        boot_s: the autopilot's time since boot when the emulation begins.
        clock_drift: how much faster its clock runs than the host's (-0.012: 1.2 % slow).
        unix_s: wall-clock time at the beginning, for logs and SYSTEM_TIME.
        seed: of the estimator's errors.
    """

    PARAMETER_TABLE: ClassVar[tuple[str, bool]]
    DIRECTORIES: ClassVar[tuple[str, ...]]
    FIRST_MODE: ClassVar[str]
    SYSTEM = 1
    TICK_US: ClassVar[int]
    EMIT_US: ClassVar[int]
    ALTITUDE_M: ClassVar[float]
    VTOL_STATE: ClassVar[int]
    RULE: ClassVar[Rule]
    TOPIC_HZ: ClassVar[dict[int, float]] = {}
    MODES: ClassVar[tuple[Mode, ...]]
    BUILDERS: ClassVar[dict[int, messages.Builder]]
    ESTIMATOR = EstimatorSettings()
    GUIDANCE = GuidanceSettings()
    GAINS = Gains()
    SPOOL_S = 1.0
    RAMP_S = 3.0
    CONTACT_S = 1.4
    IDLE = 0.1
    PARAMETERS_PER_TICK = 4
    LOG_PIECES_PER_TICK = 40
    READ_BY_NAME_INDEX: ClassVar[int | None] = None

    def __init__(
        self,
        vehicle: Vehicle,
        airframe: Airframe,
        *,
        boot_s: float = 60.0,
        clock_drift: float = 0.0,
        unix_s: float = 1_780_000_000.0,
        seed: int = 0,
    ):
        self.vehicle, self.airframe = vehicle, airframe
        table, bytewise = self.PARAMETER_TABLE
        self.parameters = ParameterStore(table, bytewise=bytewise)
        self.estimator = Estimator(self.ESTIMATOR, seed=seed)
        self.cascade = Cascade(vehicle, self.GAINS)
        self.guidance = Guidance(self.GUIDANCE)
        self.files: dict[str, bytearray] = {}
        self.ftp = FtpServer(self.files, self.DIRECTORIES)
        self.logs = LogServer(self.files, pieces_per_tick=self.LOG_PIECES_PER_TICK)
        latitude, longitude, _ = messages.geodetic((0.0, 0.0, 0.0), 0.0)
        self.mission = MissionServer(self.RULE, (latitude, longitude, self.ALTITUDE_M))
        self.outbox = Outbox()
        self.modes = {mode.name: mode for mode in self.MODES}
        self._clock_rate = 1.0 + clock_drift
        self._unix_offset_s = unix_s - boot_s
        self._start_host_s: float | None = None
        self.tick_us = self.TICK_US
        self._elapsed_us, self._boot_us = 0, round(boot_s * 1e6)
        self.boot_us = self._boot_us
        self.counter = 0
        self.truth = airframe.state
        self.imu = ImuSample((0.0, 0.0, 0.0), self.truth.specific_force_m_s2)
        self.estimate = self.estimator.update(self.tick_s, self.time_s, self.truth, self.imu.gyro_rad_s)
        self._on_the_ground()
        self.mode = self.modes[self.FIRST_MODE]
        self._powered_up()

    def _on_the_ground(self) -> None:
        """Disarmed, nothing asked of it and nothing flown."""
        self.setpoint = Setpoint()
        self.commands: tuple[float, ...] = (0.0,) * self.vehicle.rotors.count
        self.vibration_m_s2: Vector = (0.0, 0.0, 0.0)
        self.home_m: Vector = self.truth.position_m
        self.battery = BatteryGauge(self.vehicle.battery)
        self.silent = False
        self.armed = False
        self.armed_s = -math.inf
        self._spooled_s = math.inf
        self.landed = True
        self.failsafe = False
        self.deny_arming: str | None = None
        self._landed_s = -math.inf
        self._contact_s = 0.0
        self._ramp: float | None = None
        self.clock_offset_s: float | None = None  # the station's clock minus ours

    @abstractmethod
    def _powered_up(self) -> None:
        """What a firmware's own state begins with; called once, when everything else is there."""

    @property
    def intended_custom(self) -> int:
        """Custom mode number of what was asked for, where a failsafe may fly another."""
        return self.mode.custom

    @abstractmethod
    def _default_streams(self, kind: str) -> dict[int, int]: ...

    @abstractmethod
    def heartbeat(self) -> Message:
        """HEARTBEAT as this firmware fills it."""

    @abstractmethod
    def system_status(self) -> Message:
        """SYS_STATUS as this firmware fills it."""

    @abstractmethod
    def autopilot_version(self) -> Message:
        """AUTOPILOT_VERSION as this firmware fills it."""

    @property
    @abstractmethod
    def pulse_widths_us(self) -> list[int]:
        """The sixteen servo outputs."""

    @abstractmethod
    def command(self, number: int, p: list[float], link: Link, sender: Sender) -> int | None:
        """Carry out a command; its MAV_RESULT, or None when it has been acknowledged otherwise."""

    @abstractmethod
    def refuse_interval(self, message_id: int, interval_us: int) -> int | None:
        """The result that refuses a message interval, None when it is granted."""

    @abstractmethod
    def _supervise(self) -> None:
        """Failsafes and mode logic, once per cycle, after the estimate."""

    @abstractmethod
    def vision_accepted(self, name: str, message: Message) -> bool:
        """Whether the estimator takes a pose of this message."""

    @property
    @abstractmethod
    def vision_delay_s(self) -> float:
        """How late the estimator takes external poses to be stamped."""

    @abstractmethod
    def unknown_parameter(self, link: Link, sender: Sender, name: str) -> None:
        """Answer a request for a parameter that does not exist."""

    @abstractmethod
    def accepts_parameter(self, link: Link, sender: Sender, parameter: Parameter, kind: int) -> bool:
        """Whether PARAM_SET with this type may change the parameter; a refusal is answered here."""

    @abstractmethod
    def _record(self) -> None:
        """Write this cycle to the onboard log."""

    @abstractmethod
    def text_eligible(self, link: Link) -> bool:
        """Whether status texts go out on this link now."""

    @abstractmethod
    def _landed_event(self, *, landed: bool) -> None:
        """Take-off or landing was detected."""

    @abstractmethod
    def _after_disarm(self, *, by_landing: bool) -> None: ...

    def parameters_requested(self, link: Link) -> None:
        """PARAM_REQUEST_LIST: all of them, paced."""
        link.parameters = deque(range(len(self.parameters)))

    @abstractmethod
    def _restarted(self) -> None:
        """The firmware's own part of a restart."""

    @abstractmethod
    def pilot_takes_over(self) -> None:
        """Somebody at the sticks changes the mode and holds."""

    @abstractmethod
    def set_origin(self, altitude_m: float) -> None:
        """SET_GPS_GLOBAL_ORIGIN."""

    @property
    def vision_height_m(self) -> float:
        """What is added to the height of external poses."""
        return 0.0

    def mission_stored(self, link: Link) -> None:  # noqa: B027 - an event most may ignore
        """An upload is complete."""

    @abstractmethod
    def parameter_changed(self, parameter: Parameter) -> None:
        """A parameter was set from outside."""

    @property
    def tick_s(self) -> float:
        """The control cycle."""
        return self.tick_us * 1e-6

    @property
    def boot_ms(self) -> int:
        """Time since boot, ms."""
        return self.boot_us // 1000

    @property
    def time_s(self) -> float:
        """Time since boot, s."""
        return self.boot_us * 1e-6

    @property
    def unix_s(self) -> float:
        """The autopilot's idea of UTC."""
        return self._unix_offset_s + self.time_s

    def add_link(
        self, name: str, kind: str = "companion", *, bytes_per_s: float = math.inf, codec: MavlinkCodec | None = None
    ) -> None:
        """Open a link. ``kind`` chooses what is streamed unasked; ``bytes_per_s`` what the wire carries."""
        codec = codec or MavlinkCodec(self.SYSTEM, 1, gated=False)
        self.outbox.links[name] = Link(name, kind, codec, self._new_streams(kind), bytes_per_s)

    def _new_streams(self, kind: str) -> Streams:
        streams = Streams(self.RULE, dict(self.TOPIC_HZ))
        for message_id, interval_us in self._default_streams(kind).items():
            streams.set(message_id, interval_us)
        return streams

    def text(self, severity: int, text: str) -> None:
        """STATUSTEXT to whoever listens."""
        self.outbox.text(self.time_s, severity, text, self._text_number(text))

    def _text_number(self, text: str) -> int:
        """The number that holds the pieces of a long text together; 0 for a short one."""
        return int(len(text) > TEXT_LENGTH)

    def step(self, now_s: float, incoming: Iterable[tuple[str, bytes]] = ()) -> list[tuple[str, bytes]]:
        """Advance to a host time and answer what has arrived by then.

        Args:
            now_s: the host's monotonic time.
            incoming: (link, bytes) in order of arrival.

        Returns:
            (link, frame) in order of departure.
        """
        if self._start_host_s is None:
            self._start_host_s = now_s
        due_us = (now_s - self._start_host_s) * self._clock_rate * 1e6
        while self._elapsed_us + self.tick_us <= due_us + 1e-3:
            self._tick()
        for name, data in incoming:
            link = self.outbox.links[name]
            for received in link.codec.decode(data):
                if received.message is not None:
                    inbound.handle(self, link, received.message)
        out = self.outbox.drain()
        return [] if self.silent else out

    def set_mode(self, name: str) -> None:
        """Change the flight mode and begin what is flown in it."""
        if name == self.mode.name:
            return
        self.mode = self.modes[name]
        self.begin(self.mode.kind)

    def begin(self, kind: Kind, *, height_m: float | None = None) -> None:
        """Start a kind of flight from here."""
        target = None
        if kind == "return":
            target = self.home_m
        elif kind == "takeoff":
            x, y, z = self.estimate.position_m
            target = (x, y, z if height_m is None else height_m)
        self.guidance.enter(kind, self.estimate, target=target)

    def follow(self, setpoint: Setpoint) -> None:
        """Take a set-point from the station."""
        self.guidance.external = setpoint

    def arm(self) -> None:
        """Start the rotors."""
        self.armed, self.armed_s = True, self.time_s
        self._spooled_s = self.time_s + self.SPOOL_S
        self.home_m = self.estimate.position_m
        self.guidance.ground_m = self.home_m[2]
        self._ramp = self.estimate.position_m[2]
        self.cascade.reset()

    def disarm(self, *, by_landing: bool = False) -> None:
        """Stop the rotors."""
        if not self.armed:
            return
        self.armed = False
        self._after_disarm(by_landing=by_landing)

    def reboot(self) -> None:
        """The firmware starts again in flight: rotors stop, what was asked for is forgotten, time begins at zero."""
        self._unix_offset_s += self.time_s
        self._boot_us = -self._elapsed_us
        self.boot_us = 0
        self.armed, self.failsafe = False, False
        self.armed_s, self._spooled_s, self._landed_s = -math.inf, math.inf, -math.inf
        self.clock_offset_s = None
        self.estimator.restart()
        self.outbox.restart(self._new_streams)
        self.mode = self.modes[self.FIRST_MODE]
        self._restarted()

    # -- the cycle --------------------------------------------------------------------------------------------------

    def _tick(self) -> None:
        self._elapsed_us += self.tick_us
        self.boot_us = self._boot_us + self._elapsed_us
        dt = self.tick_s
        before = self.imu
        self.truth, self.imu = self.airframe.state, self.airframe.imu()
        self.battery.measure(self.truth.voltage_v, self.truth.current_a, dt)
        self._follow_vibration(before)
        self.estimate = self.estimator.update(dt, self.time_s, self.truth, self.imu.gyro_rad_s)
        self._detect(dt)
        self._supervise()
        self.commands = self._motors(dt)
        self.airframe.step(dt, self.commands)
        self._record()
        if self.boot_us % self.EMIT_US == 0:
            self.counter = (self.counter + 1) % 65536
            self.outbox.emit(self)

    def _follow_vibration(self, before: ImuSample) -> None:
        """First-order mean of the change of the accelerometer from sample to sample, per axis."""
        pairs = zip(self.vibration_m_s2, self.imu.accel_m_s2, before.accel_m_s2, strict=True)
        x, y, z = (0.99 * v + 0.01 * abs(new - old) for v, new, old in pairs)
        self.vibration_m_s2 = (x, y, z)

    def _motors(self, dt: float) -> tuple[float, ...]:
        count = self.vehicle.rotors.count
        if not self.armed:
            return (0.0,) * count
        self.setpoint = self._ramped(dt, self.guidance.setpoint(dt, self.estimate))
        e = self.estimate
        spooling = self.time_s < self._spooled_s
        if self.truth.on_ground and (spooling or not wants_up(self.setpoint, e)):
            self.cascade.reset()
            return (self.IDLE,) * count
        return self.cascade.update(dt, self.setpoint, e.position_m, e.velocity_m_s, e.quaternion, e.rate_rad_s)

    def _ramped(self, dt: float, wanted: Setpoint) -> Setpoint:
        """After arming the commanded height may not leave the ground faster than the take-off ramp."""
        if self._ramp is None:
            return wanted
        since = self.time_s - self._spooled_s
        height = wanted.position_m[2]
        rate = self.GUIDANCE.climb_m_s * min(1.0, max(0.0, since) / self.RAMP_S)
        rate = braked(rate, height - self._ramp)
        if math.isnan(height) or height <= self._ramp + 0.01:
            if since > self.RAMP_S and not self.landed:
                self._ramp = None
            return wanted
        self._ramp += rate * dt if since > 0.0 else 0.0
        (x, y, _), (u, v, _) = wanted.position_m, wanted.velocity_m_s
        return replace(
            wanted, position_m=(x, y, self._ramp), velocity_m_s=(u, v, rate), acceleration_m_s2=(math.nan,) * 3
        )

    def _detect(self, dt: float) -> None:
        """Take-off: off the ground under thrust. Landing: some time on the ground without asking to rise."""
        if not self.armed:
            self.landed, self._contact_s = True, 0.0
            return
        if self.landed:
            if not self.truth.on_ground and self.truth.position_m[2] - self.home_m[2] > 0.1:
                self.landed, self._contact_s = False, 0.0
                self._landed_event(landed=False)
            return
        resting = self.truth.on_ground and not wants_up(self.setpoint, self.estimate)
        self._contact_s = self._contact_s + dt if resting else 0.0
        if self._contact_s > self.CONTACT_S:
            self.landed, self._landed_s = True, self.time_s
            self._landed_event(landed=True)

    @property
    def has_flown(self) -> bool:
        """Whether it has landed since it was armed."""
        return self._landed_s > self.armed_s

    @property
    def landed_for_s(self) -> float:
        """Seconds since a landing was detected; 0 in the air or when there has been none since arming."""
        return self.time_s - self._landed_s if self.landed and self.has_flown else 0.0

    @property
    def landed_state(self) -> int:
        """MAV_LANDED_STATE."""
        if self.landed:
            return ON_GROUND
        descending = self.guidance.kind in ("land", "blind") or self.guidance.phase == "descend"
        climbing = self.guidance.kind == "takeoff" and not self.guidance.done
        return LANDING if descending else TAKING_OFF if climbing else IN_AIR

    @property
    def has_esc_telemetry(self) -> bool:
        """Whether the vehicle's ESCs report their speed."""
        return self.vehicle.rotors.measured

    @property
    def distance_from_home(self) -> tuple[float, float]:
        """Horizontal distance and height over home, by the estimate, m."""
        dx, dy, dz = (p - h for p, h in zip(self.estimate.position_m, self.home_m, strict=True))
        return math.hypot(dx, dy), dz

    def build(self, message_id: int) -> list[Message]:
        """The messages of a stream now; empty while there is nothing to say."""
        if message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            return [self.heartbeat()]
        if message_id == mavlink.MAVLINK_MSG_ID_SYS_STATUS:
            return [self.system_status()]
        built = self.BUILDERS[message_id](self)
        return [] if built is None else built if isinstance(built, list) else [built]

    def own_time_s(self, station_us: int) -> float:
        """A stamp of the station's clock on ours; now, until TIMESYNC has told the difference."""
        return self.time_s if self.clock_offset_s is None else station_us * 1e-6 - self.clock_offset_s
