"""What differs between autopilots, as data and a few messages. A further autopilot is one more file beside this one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf, nan
from typing import ClassVar

from drivers.mavlink.dialect import Message, mavlink
from drivers.mavlink.geometry import flip, flip_quaternion
from drivers.samples import Pose, Vector3

FORCE_DISARM = 21196.0
"""Magic second parameter of MAV_CMD_COMPONENT_ARM_DISARM: stop the motors in the air too."""
PLACE = (473977418, 85455939)
"""Latitude and longitude of an origin that satellites do not tell, 1e-7 degrees: ArduPilot takes none at 0, 0."""

Version = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Target:
    """Where the vehicle should be at an instant, world z up, yaw counter-clockwise from above."""

    position_m: Vector3
    velocity_m_s: Vector3
    acceleration_m_s2: Vector3
    yaw_rad: float
    yaw_rate_rad_s: float


@dataclass(frozen=True, slots=True)
class StreamWish:
    """A message to ask for.

    Attributes:
        name: of the message.
        rate_hz: asked for; what comes is measured, because a request is accepted also when nothing follows.
        needed_hz: below this the flight is refused (0: nice to have).
        why: what it is for.
        instead_of: tells better what this other message tells; on a line that cannot carry all it is not asked for.
    """

    name: str
    rate_hz: float
    needed_hz: float
    why: str
    instead_of: str = ""


@dataclass(frozen=True, slots=True)
class ParameterRule:
    """A parameter of the autopilot and the values a flight from here wants.

    Attributes:
        name: as the autopilot spells it.
        accepted: any of these is right; the first is what we would set.
        why: in one sentence.
        settable: offered to be set for the flight and restored afterwards; otherwise the operator must.
        indoors: only without satellites, when poses come from motion capture.
        restart: takes effect when the autopilot starts; where it is set for the flight, it is restarted on the ground.
        required: preflight fails on another value; else it only says so.
        or_more, or_less: a value above, or below, the first is right too.
        since, before: firmware versions (major, minor) that know it by this name and in this unit.
    """

    name: str
    accepted: tuple[float, ...]
    why: str
    settable: bool = False
    indoors: bool = False
    restart: bool = False
    required: bool = True
    or_more: bool = False
    or_less: bool = False
    since: Version = (0, 0)
    before: Version = (255, 0)

    def holds(self, value: float) -> bool:
        """Whether a value is right."""
        first = self.accepted[0]
        beyond = (self.or_more and value >= first) or (self.or_less and value <= first)
        return beyond or any(abs(value - a) < 1e-6 for a in self.accepted)

    def concerns(self, version: Version | None, *, indoors: bool) -> bool:
        """Whether this firmware and this station have to do with it; an untold version is taken for the newest."""
        return (indoors or not self.indoors) and self.since <= (version or (254, 0)) < self.before


@dataclass(frozen=True)
class Profile:
    """One autopilot's manners.

    Attributes:
        name: as in ``--profile``.
        autopilot: MAV_AUTOPILOT of its heartbeat.
        imu: message its IMU is taken from.
        modes: custom mode numbers by name.
        follow_mode, land_mode, hold_mode: names of the modes we command.
        pilot_modes: modes in which a human's sticks fly; seen at any time, the station is silent.
        climbs_by_command: needs a take-off command; otherwise the setpoints themselves lift it.
        bytewise_parameters: integers travel as their bits inside the float (PX4) or as their value (ArduPilot).
        streams: messages to ask for.
        parameters: what to check or set.
        arms_led: without satellites it arms in no mode but the one that follows setpoints, while they flow.
        origin_altitude_mm: of an origin that satellites do not tell.
        pose_delay: the parameter that tells its estimator how late external poses are stamped, ms.
        pwm_us: servo output at command 0 and 1.
        setpoint_timeout_s: how long after the last setpoint the autopilot reacts by itself.
        log_suffix: of its onboard log.
        prearm_in_health_alone: SYS_STATUS tells whether it would arm in the health bits, and never that it tells so.
        scripting: the parameter that says (1) whether it runs our script; empty where it has none.
    """

    name: ClassVar[str]
    autopilot: ClassVar[int]
    imu: ClassVar[str]
    modes: ClassVar[dict[str, int]]
    follow_mode: ClassVar[str]
    land_mode: ClassVar[str]
    hold_mode: ClassVar[str]
    pilot_modes: ClassVar[frozenset[str]]
    climbs_by_command: ClassVar[bool]
    bytewise_parameters: ClassVar[bool]
    streams: ClassVar[tuple[StreamWish, ...]]
    parameters: ClassVar[tuple[ParameterRule, ...]]
    pwm_us: ClassVar[tuple[float, float]] = (1000.0, 2000.0)
    setpoint_timeout_s: ClassVar[float]
    log_suffix: ClassVar[str]
    scripting: ClassVar[str] = ""
    arms_led: ClassVar[bool] = False
    pose_delay: ClassVar[str]
    origin_altitude_mm: ClassVar[int]
    prearm_in_health_alone: ClassVar[bool] = False

    system: int = 1
    component: int = 1
    _names: dict[int, str] = field(init=False, repr=False, compare=False, default_factory=dict)

    def __post_init__(self) -> None:
        self._names.update({number: name for name, number in self.modes.items()})

    def mode_name(self, custom_mode: int) -> str:
        """Name of a custom mode; its number where it has none here."""
        return self._names.get(custom_mode, f"mode {custom_mode:#x}")

    def command(self, number: int, *parameters: float, confirmation: int = 0) -> Message:
        """COMMAND_LONG; parameters left out are 0."""
        values = (*parameters, *(0.0,) * (7 - len(parameters)))
        return mavlink.MAVLink_command_long_message(self.system, self.component, number, confirmation, *values)

    def set_mode(self, mode: str) -> Message:
        """Command a mode."""
        raise NotImplementedError

    def arm(self) -> Message:
        """Ask to arm, all checks on."""
        return self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    def disarm(self) -> Message:
        """Ask to disarm; refused in the air."""
        return self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)

    def kill(self) -> Message:
        """Stop the motors now, wherever the vehicle is. It will fall."""
        return self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, FORCE_DISARM)

    def take_off(self, height_m: float) -> Message:
        """Climb to a height above the ground (where the profile climbs by command)."""
        return self.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, nan, 0.0, 0.0, height_m)

    def interval(self, message_id: int, rate_hz: float) -> Message:
        """Ask for a message at a rate; 0 turns it off."""
        period_us = 1e6 / rate_hz if rate_hz > 0.0 else -1.0
        return self.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, float(message_id), period_us)

    def jerk_limits_m_s3(self, parameters: Mapping[str, float | None]) -> tuple[float, float]:
        """Horizontal and vertical jerk above which the autopilot reshapes a trajectory; infinite where it does not."""
        return inf, inf

    def setpoint(self, target: Target, device_s: float) -> Message:
        """Position, velocity, acceleration, yaw and yaw rate in one message: nothing is ignored, so nothing is chosen
        for us.

        Without a yaw ArduCopter turns to face along the path; without velocity and acceleration the controller lags.
        """
        x, y, z = flip(target.position_m)
        vx, vy, vz = flip(target.velocity_m_s)
        ax, ay, az = flip(target.acceleration_m_s2)
        return mavlink.MAVLink_set_position_target_local_ned_message(
            int(max(0.0, device_s) * 1e3) & 0xFFFFFFFF, self.system, self.component, mavlink.MAV_FRAME_LOCAL_NED, 0,
            x, y, z, vx, vy, vz, ax, ay, az, -target.yaw_rad, -target.yaw_rate_rad_s,
        )  # fmt: skip

    def rules(self, version: Version | None, *, indoors: bool, pose_latency_s: float) -> list[ParameterRule]:
        """What this firmware shall be set to for this station."""
        rules = [rule for rule in self.parameters if rule.concerns(version, indoors=indoors)]
        if indoors:
            why = "the estimator shall know how late the poses are stamped (latency_s of the station file)"
            rules.append(ParameterRule(self.pose_delay, (float(round(1e3 * pose_latency_s)),), why, settable=True))
        return rules

    def origin(self) -> Message:
        """SET_GPS_GLOBAL_ORIGIN, for a position that satellites do not tell.

        ArduCopter has no position without one, and takes an altitude of 0 for none, so that it resets its height every
        second. PX4 takes the height of a pose for an altitude, and tells its own as what that is above the origin's:
        one that satellites set before would put the vehicle hundreds of metres under the floor.
        """
        return mavlink.MAVLink_set_gps_global_origin_message(self.system, *PLACE, self.origin_altitude_mm)

    def external_pose(self, pose: Pose, stamp_s: float, std_m: float, std_rad: float, resets: int) -> Sequence[Message]:
        """A motion-capture pose for the estimator, stamped with its capture time on the clock we answer TIMESYNC
        with.
        """
        raise NotImplementedError


def pose_covariance(std_m: float, std_rad: float) -> list[float]:
    """Upper triangle of a diagonal 6 by 6 covariance (x, y, z, roll, pitch, yaw), row by row."""
    values = []
    for row in range(6):
        variance = std_m**2 if row < 3 else std_rad**2
        values += [variance if column == row else 0.0 for column in range(row, 6)]
    return values


def odometry_message(pose: Pose, stamp_s: float, std_m: float, std_rad: float, resets: int) -> Message:
    """ODOMETRY with a pose and no velocity; the estimator type is VISION because PX4 does not fuse MOCAP."""
    x, y, z = flip(pose.position_m)
    unknown = [nan] + [0.0] * 20
    return mavlink.MAVLink_odometry_message(
        int(stamp_s * 1e6), mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_BODY_FRD, x, y, z,
        list(flip_quaternion(pose.quaternion)), nan, nan, nan, nan, nan, nan,
        pose_covariance(std_m, std_rad), unknown, resets & 0xFF, mavlink.MAV_ESTIMATOR_TYPE_VISION,
    )  # fmt: skip
