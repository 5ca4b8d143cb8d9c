"""ArduCopter's manners, as measured on its software-in-the-loop build (4.8) and as its recorded traffic shows.

Where the recordings are silent the behaviour follows the firmware's documentation; docs/emulator.md says which is
which.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

from sim.mavlink import messages
from sim.mavlink.airframe import Vector
from sim.mavlink.apmlog import ArduCopterLog
from sim.mavlink.arducopterfailsafe import arming_obstacle, battery_mode, fence_breached, fence_mode, station_mode
from sim.mavlink.autopilot import (
    ACCEPTED,
    CRITICAL,
    DENIED,
    FAILED,
    INFO,
    UNSUPPORTED,
    Autopilot,
    Mode,
    Sender,
)  # fmt: skip
from sim.mavlink.control import NAN3, Setpoint
from sim.mavlink.estimator import EstimatorSettings
from sim.mavlink.guidance import GuidanceSettings
from sim.mavlink.logserver import LogFile
from sim.mavlink.outbox import Link, parameter_value
from sim.mavlink.parameters import Parameter
from sim.mavlink.scripting import SWITCHES, ScriptHost
from sim.mavlink.wire import Message, mavlink, whole

FORCE_DISARM, FORCE_ARM = 21196.0, 2989.0
VISION = 6
_CAPABILITIES = 64495  # recorded
_PRESENT, _ENABLED, _HEALTH = 1399979023, 1380031503, 1196530703 & ~0x10000000
_FASTEST_US = 3000
_BASE = 1 | 16 | 64
ORIGIN_S = 20.0
MAX_HEIGHT_M = 1000.0
STARTUP = (
    (4.45, "EKF3 IMU0 initialised"), (4.45, "EKF3 IMU1 initialised"), (4.46, "AHRS: EKF3 active"),
    (5.79, "EKF3 IMU0 tilt alignment complete"), (5.79, "EKF3 IMU1 tilt alignment complete"),
    (5.89, "EKF3 IMU0 MAG0 initial yaw alignment complete"), (5.89, "EKF3 IMU1 MAG0 initial yaw alignment complete"),
    (9.81, "GPS 1: probing for u-blox at 230400 baud"), (9.82, "GPS 1: detected u-blox"),
    (20.01, "EKF3 IMU0 origin set"), (20.04, "Field Elevation Set: 488m"), (20.21, "EKF3 IMU1 origin set"),
)  # fmt: skip
"""Texts after boot, seconds since boot, as recorded."""


def _guided_target(a: messages.Autopilot) -> Message | None:
    """POSITION_TARGET_LOCAL_NED, only in GUIDED."""
    if a.mode.name != "GUIDED":
        return None
    if a.guidance.kind != "follow":
        return mavlink.MAVLink_position_target_local_ned_message(a.boot_ms, 1, 3079, *([0.0] * 11))
    return messages.position_target(a)


class ArduCopter(Autopilot):
    """An ArduCopter quadrotor."""

    PARAMETER_TABLE = ("arducopter", False)
    DIRECTORIES = ("/APM/LOGS", "/APM/scripts")
    FIRST_MODE = "STABILIZE"
    VERSION = "V4.8.0-dev (64a9c787)"
    TICK_US, EMIT_US = 2500, 2500
    ALTITUDE_M, VTOL_STATE, RULE = 488.1, 3, "ardupilot"
    MODES = (
        Mode("STABILIZE", 0, _BASE, "hold", False),
        Mode("ALT_HOLD", 2, _BASE, "hold", False),
        Mode("GUIDED", 4, _BASE | 8, "hold", True),
        Mode("LOITER", 5, _BASE | 8, "hold", True),
        Mode("RTL", 6, _BASE | 8, "return", True),
        Mode("LAND", 9, _BASE | 8, "land", False),
        Mode("POSHOLD", 16, _BASE | 8, "hold", True),
        Mode("BRAKE", 17, _BASE | 8, "hold", True),
    )
    ESTIMATOR = EstimatorSettings(gps_error_m=0.01, gps_ready_s=41.4, vision_timeout_s=8.0)
    GUIDANCE = GuidanceSettings(climb_m_s=1.15, descend_m_s=0.5)
    SPOOL_S, RAMP_S, CONTACT_S = 2.0, 0.5, 1.59
    THROTTLE_RAMP_S, DISARM_LANDED_S = 1.0, 0.5
    PREARM_FIRST_S, PREARM_EVERY_S = 26.45, 30.0
    PARAMETERS_PER_TICK = 4
    LOG_PIECES_PER_TICK = 4
    READ_BY_NAME_INDEX = 65535
    BUILDERS: ClassVar[dict[int, messages.Builder]] = {
        **messages.COMMON,
        27: messages.raw_imu,
        85: _guided_target,
        108: messages.sim_state,
        193: messages.ekf_status,
        11030: messages.esc_telemetry,
    }

    def _powered_up(self) -> None:
        self._log: ArduCopterLog | None = None
        self._log_path = ""
        self._startup: list[tuple[float, str]] = []
        self._origin_set = False
        self._using_announced = False
        self._vision_origin = self._viso_runs = False
        self._last_setpoint_s = -math.inf
        self._prearm_s = self.PREARM_FIRST_S
        self._ekf_failsafe = False
        self._station_failsafe = False
        self._scripts: ScriptHost | None = None
        self._declare_frame()
        self._startup = [(t, text) for t, text in STARTUP if t > self.time_s]
        self._origin_set = self.time_s > ORIGIN_S
        self._using_announced = self.time_s > self.ESTIMATOR.gps_ready_s
        while self._prearm_s < self.time_s:
            self._prearm_s += self.PREARM_EVERY_S

    def _declare_frame(self) -> None:
        """An X frame of as many motors as fly, on as many outputs."""
        count = self.vehicle.rotors.count
        self.parameters["FRAME_CLASS"], self.parameters["FRAME_TYPE"] = {4: 1, 6: 2, 8: 3}.get(count, 0), 1
        for output in range(min(count, 8)):
            self.parameters[f"SERVO{output + 1}_FUNCTION"] = 33 + output

    def enable_scripting(self) -> None:
        """As a build with scripting, switched on: its parameters are there, and scripts run."""
        self.parameters.add(*SWITCHES)
        self.parameters["SCR_ENABLE"] = 1
        self._load_scripts()

    def _load_scripts(self) -> int:
        """Start what lies in the scripts folder anew."""
        if "SCR_ENABLE" not in self.parameters or not self.parameters["SCR_ENABLE"]:
            return UNSUPPORTED
        try:
            self._scripts = ScriptHost(self)
        except ImportError:
            return UNSUPPORTED
        return ACCEPTED

    # -- what it is -------------------------------------------------------------------------------------------------

    def _default_streams(self, kind: str) -> dict[int, int]:
        return {0: 1_000_000, 111: 10_000_000}

    def heartbeat(self) -> Message:
        """HEARTBEAT; standby until it flies, armed or not."""
        base = self.mode.base | (128 if self.armed else 0)
        status = 5 if self.failsafe else 3 if self.landed else 4
        return mavlink.MAVLink_heartbeat_message(2, 3, base, self.mode.custom, status, 3)

    def system_status(self) -> Message:
        """SYS_STATUS with the sensors of the recorded simulation; the pre-arm bit says whether it would arm."""
        health = _HEALTH | (0x10000000 if arming_obstacle(self) is None else 0)
        return mavlink.MAVLink_sys_status_message(
            _PRESENT, _ENABLED, health, 0, round(1000 * self.truth.voltage_v), round(100 * self.truth.current_a),
            self.battery.percent, 0, 0, 0, 0, 0, 0,
        )  # fmt: skip

    def autopilot_version(self) -> Message:
        """AUTOPILOT_VERSION as recorded."""
        commit = [54, 52, 97, 57, 99, 55, 56, 55]
        return mavlink.MAVLink_autopilot_version_message(
            _CAPABILITIES, 67633152, 0, 0, 0, commit, [0] * 8, [0] * 8, 0, 0, 0
        )

    @property
    def pulse_widths_us(self) -> list[int]:
        """1000 + 1000 u while armed, 1000 at rest; unused outputs 0."""
        used = [round(1000 + 1000 * u) for u in self.commands]
        return (used + [0] * 16)[:16]

    def geodetic(self, position_m: Vector) -> tuple[float, float, float]:
        """Latitude and longitude in degrees and altitude of a local position."""
        latitude, longitude, altitude = messages.geodetic(position_m, self.ALTITUDE_M)
        return latitude * 1e-7, longitude * 1e-7, altitude

    # -- requests ---------------------------------------------------------------------------------------------------

    def refuse_interval(self, message_id: int, interval_us: int) -> int | None:
        """Denied for what it does not send (ODOMETRY among it) and for less than 3 ms."""
        known = message_id in self.BUILDERS or message_id in (0, 1)
        return None if known and (interval_us <= 0 or interval_us >= _FASTEST_US) else DENIED

    def unknown_parameter(self, link: Link, sender: Sender, name: str) -> None:
        """Silence."""

    def accepts_parameter(self, link: Link, sender: Sender, parameter: Parameter, kind: int) -> bool:
        """Any type; the value is converted to the parameter's own."""
        return True

    def parameters_requested(self, link: Link) -> None:
        """All parameters, and the banner."""
        super().parameters_requested(link)
        self.text(INFO, f"ArduCopter {self.VERSION}")
        self.text(INFO, "3d1219c7c4c5404aaa1f6d2a48adfda4")
        self.text(INFO, "Frame: QUAD/PLUS")

    def parameter_changed(self, parameter: Parameter) -> None:
        """Take over what the emulation depends on: the position source."""
        if parameter.name in ("EK3_SRC1_POSXY", "VISO_TYPE", "GPS1_TYPE"):
            vision = self.parameters["EK3_SRC1_POSXY"] == VISION
            if vision:
                self.estimator.source = "vision" if self._viso_runs and self._vision_origin else "none"
            else:
                self.estimator.source = "gps" if self.parameters["GPS1_TYPE"] else "none"
        if self._log is not None:
            self._log.parameter(self, parameter.name, parameter.value)

    def set_origin(self, altitude_m: float) -> None:
        """SET_GPS_GLOBAL_ORIGIN: without GPS the estimator needs to be told where it is."""
        self._vision_origin = True
        index = self.parameters.index("VISO_TYPE") or 0
        self.parameter_changed(self.parameters.all[index])
        self._send_origin()

    @property
    def vision_delay_s(self) -> float:
        """VISO_DELAY_MS."""
        return 1e-3 * self.parameters["VISO_DELAY_MS"]

    def vision_accepted(self, name: str, message: Message) -> bool:
        """With a VISO_TYPE that was there when it started."""
        if not self._viso_runs:
            return False
        if self._log is not None and name == "VISION_POSITION_ESTIMATE":
            self._log.vision(self, (message.x, message.y, message.z), message.yaw)
        return True

    def mission_stored(self, link: Link) -> None:
        """The new count goes out as a parameter too."""
        self.text(INFO, "Flight plan received")
        index = self.parameters.index("MIS_TOTAL")
        if index is not None:
            self.parameters["MIS_TOTAL"] = len(self.mission.items)
            link.send(parameter_value(self, index, shown=self.READ_BY_NAME_INDEX))

    def command(self, number: int, p: list[float], link: Link, sender: Sender) -> int | None:
        """Commands of the vehicle itself."""
        if number == mavlink.MAV_CMD_DO_SET_MODE:
            return self._command_mode(whole(p[1]), link, sender)
        if number == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            return self._command_arm(p[1] == FORCE_ARM) if p[0] == 1.0 else self._command_disarm(p[1] == FORCE_DISARM)
        if number == mavlink.MAV_CMD_NAV_TAKEOFF:
            return self._command_takeoff(p[6])
        if number in (mavlink.MAV_CMD_NAV_LAND, mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH):
            return self._acknowledged(number, "LAND" if number == mavlink.MAV_CMD_NAV_LAND else "RTL", link, sender)
        if number == mavlink.MAV_CMD_CONDITION_YAW:
            return ACCEPTED if self.mode.name == "GUIDED" else FAILED
        if number == mavlink.MAV_CMD_DO_FLIGHTTERMINATION and p[0] > 0.5:
            self.disarm()
            return ACCEPTED
        if number in (mavlink.MAV_CMD_DO_SET_HOME, mavlink.MAV_CMD_DO_CHANGE_SPEED):
            return ACCEPTED
        if number == mavlink.MAV_CMD_SCRIPTING and p[0] == mavlink.SCRIPTING_CMD_STOP_AND_RESTART:
            return self._load_scripts()
        if number == mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN:
            return FAILED if self.armed else self._command_reboot(link, sender)
        return UNSUPPORTED

    def _command_reboot(self, link: Link, sender: Sender) -> None:
        """Acknowledged before it starts again."""
        number = mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN
        link.send(mavlink.MAVLink_command_ack_message(number, ACCEPTED, 0, 0, *sender))
        self.reboot()

    def _command_mode(self, custom: int, link: Link, sender: Sender) -> int | None:
        name = next((m.name for m in self.MODES if m.custom == custom), None)
        return FAILED if name is None else self._acknowledged(mavlink.MAV_CMD_DO_SET_MODE, name, link, sender)

    def _acknowledged(self, command: int, mode: str, link: Link, sender: Sender) -> int | None:
        """Change the mode; recorded: the heartbeat follows the acknowledgement at once."""
        result = self._change(mode)
        if result != ACCEPTED:
            return result
        link.send(mavlink.MAVLink_command_ack_message(command, result, 0, 0, *sender), self.heartbeat())
        return None

    def _change(self, name: str) -> int:
        if self.modes[name].needs_position and self.armed and not self.estimate.position_valid:
            self.text(CRITICAL, f"Mode change to {name} failed: requires position")
            return FAILED
        self.failsafe = False
        self.set_mode(name)
        if self._log is not None:
            self._log.mode(self)
        return ACCEPTED

    def _command_takeoff(self, height_m: float) -> int:
        """Only armed, in GUIDED, and upwards; the height counts from home."""
        upwards = 0.0 < height_m < MAX_HEIGHT_M
        if self.mode.name != "GUIDED" or not self.armed or not self.landed or not upwards:
            return FAILED
        self.begin("takeoff", height_m=self.home_m[2] + height_m)
        self._spooled_s = max(self._spooled_s, self.time_s) + self.THROTTLE_RAMP_S
        return ACCEPTED

    # -- arming -----------------------------------------------------------------------------------------------------

    def _command_arm(self, forced: bool) -> int:
        if self.armed:
            return ACCEPTED
        obstacle = None if forced else arming_obstacle(self)
        if obstacle is not None:
            self.text(CRITICAL, f"Arm: {obstacle}")
            return FAILED
        self.arm()
        self.begin("hold")
        number = len(self.logs.logs) + 1
        self._log_path = f"/APM/LOGS/{number:08d}.BIN"
        self.files[self._log_path] = bytearray()
        self._log = ArduCopterLog(self, self.files[self._log_path])
        self._log.event(self, 10)
        self.text(INFO, "Arming motors")
        self._send_origin()
        return ACCEPTED

    def _command_disarm(self, forced: bool) -> int:
        if self.armed and not self.landed and not forced:
            return FAILED
        if self.armed:
            self.text(INFO, "Disarming motors")
            self.disarm()
        return ACCEPTED

    def _after_disarm(self, *, by_landing: bool) -> None:
        self.failsafe = self._ekf_failsafe = self._station_failsafe = False
        if self._log is not None:
            self._log.event(self, 11)
            self._log = None
            number = len(self.logs.logs) + 1
            self.logs.logs.append(LogFile(number, round(self.unix_s), self._log_path))

    def _landed_event(self, *, landed: bool) -> None:
        if self._log is not None:
            self._log.event(self, 18 if landed else 28)

    # -- flight -----------------------------------------------------------------------------------------------------

    def follow(self, setpoint: Setpoint) -> None:
        """Obeyed in GUIDED and in the air only; a position without velocity is flown to, with it followed."""
        if self.mode.name != "GUIDED" or not self.armed or self.landed:
            return
        self._last_setpoint_s = self.time_s
        if self.guidance.kind != "follow":
            self.begin("follow")
        super().follow(self._with_heading(setpoint))

    def _with_heading(self, setpoint: Setpoint) -> Setpoint:
        """Without a yaw command it turns to face along its path."""
        x, y, _ = setpoint.velocity_m_s
        if math.isnan(setpoint.yaw_rad) and math.isnan(setpoint.yaw_rate_rad_s) and math.hypot(x, y) > 0.2:
            return replace(setpoint, yaw_rad=math.atan2(y, x))
        return setpoint

    def _supervise(self) -> None:
        self._announce()
        if self._scripts is not None:
            self._scripts.step()
        if not self.armed:
            return
        if self.guidance.kind == "follow" and self.time_s - self._last_setpoint_s > self.parameters["GUID_TIMEOUT"]:
            held = self.guidance.external
            stop = held.position_m if math.isfinite(held.position_m[0]) else NAN3
            self.guidance.external = replace(
                held, position_m=stop, velocity_m_s=(0.0, 0.0, 0.0), acceleration_m_s2=NAN3, yaw_rate_rad_s=math.nan
            )
        if not self.landed:
            self._failsafes()
        if self.mode.name == "LAND" and not self.estimate.position_valid and self.guidance.kind != "blind":
            self.begin("blind")
        landed_long = (
            self.has_flown
            and self.landed_for_s > self.DISARM_LANDED_S
            and self.guidance.kind in ("land", "blind", "return")
        )
        waiting = self.parameters["DISARM_DELAY"]
        idle_long = self.landed and 0.0 < waiting < self.time_s - max(self.armed_s, self._landed_s)
        if landed_long or idle_long:
            self.text(INFO, "Disarming motors")
            self.disarm(by_landing=landed_long)

    def _failsafes(self) -> None:
        needs = self.mode.needs_position
        if needs and not self.estimate.position_valid and not self._ekf_failsafe:
            self._ekf_failsafe = True
            self.text(CRITICAL, "EKF Failsafe: changed to LAND Mode")
            self._land_now()
        if not self._station_failsafe and (mode := station_mode(self)) is not None:
            self._station_failsafe = True
            self._act("GCS Failsafe", mode)
        if not self.failsafe and (mode := battery_mode(self)) is not None:
            self._act("Battery 1 is low", mode)
        if fence_breached(self):
            self.text(CRITICAL, "Fence Breached")
            if (mode := fence_mode(self)) is not None:
                self._change(mode)

    def _act(self, text: str, mode: str) -> None:
        self.text(CRITICAL, text)
        self._change(mode)
        self.failsafe = True

    def _land_now(self) -> None:
        self.set_mode("LAND")
        self.failsafe = True
        if self._log is not None:
            self._log.mode(self)

    def _announce(self) -> None:
        """Start-up texts, the position source, and every half minute what keeps it from arming."""
        while self._startup and self._startup[0][0] <= self.time_s:
            _, text = self._startup.pop(0)
            self.text(INFO, text)
        if not self._origin_set and self.estimator.source == "gps" and self.time_s > ORIGIN_S:
            self._origin_set = True
            self._send_origin()
        if not self._using_announced and self.estimate.position_valid:
            self._using_announced = True
            source = "GPS" if self.estimator.source == "gps" else "external nav data"
            for imu in (0, 1):
                self.text(INFO, f"EKF3 IMU{imu} is using {source}")
        if self.time_s >= self._prearm_s:
            self._prearm_s += self.PREARM_EVERY_S
            obstacle = arming_obstacle(self)
            if not self.armed and obstacle is not None:
                self.text(CRITICAL, f"PreArm: {obstacle}")

    def _send_origin(self) -> None:
        """Origin and home, unasked, to everybody."""
        self.outbox.broadcast(*self.build(49), *self.build(242))

    def _record(self) -> None:
        if self._log is not None:
            self._log.tick(self)

    def _restarted(self) -> None:
        self._viso_runs, self._vision_origin = bool(self.parameters["VISO_TYPE"]), False
        if self._viso_runs and "VISO_DELAY_MS" not in self.parameters:  # hidden while VISO_TYPE is 0
            self.parameters.add(Parameter("VISO_DELAY_MS", mavlink.MAV_PARAM_TYPE_INT16, 10))
        self._startup = list(STARTUP)
        self._origin_set = self._using_announced = False
        self._prearm_s = self.PREARM_FIRST_S
        self._last_setpoint_s = -math.inf
        self._ekf_failsafe = self._station_failsafe = False
        self._log = None

    def pilot_takes_over(self) -> None:
        """LOITER, by the mode switch."""
        self._change("LOITER")

    def text_eligible(self, link: Link) -> bool:
        """Always."""
        return True
