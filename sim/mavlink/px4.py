"""PX4's manners, as measured on its software-in-the-loop build (main of March 2026) and as its recorded traffic shows.

Where the recordings are silent the behaviour follows the firmware's documentation; docs/emulator.md says which is
which.
"""

from __future__ import annotations

import hashlib
import math
import time
from typing import ClassVar

from drivers.mavlink.geometry import flip
from sim.mavlink import messages, px4messages
from sim.mavlink.airframe import Vector
from sim.mavlink.autopilot import (
    ACCEPTED,
    CRITICAL,
    DENIED,
    FAILED,
    INFO,
    REJECTED,
    UNSUPPORTED,
    Autopilot,
    Mode,
    Sender,
)  # fmt: skip
from sim.mavlink.control import Setpoint
from sim.mavlink.estimator import EstimatorSettings
from sim.mavlink.guidance import GuidanceSettings, Kind
from sim.mavlink.logserver import LogFile
from sim.mavlink.outbox import Link
from sim.mavlink.parameters import Parameter
from sim.mavlink.px4failsafe import arming_obstacle, link_action, silent_for_s, standing_failsafe
from sim.mavlink.px4log import Px4Log
from sim.mavlink.wire import Message, mavlink, whole

FORCE = 21196.0
MAX_HEIGHT_M = 1000.0
_HEALTHY, _PREARM = 320915519 & ~0x10000000, 0x10000000


def _auto(sub: int) -> int:
    return 4 << 16 | sub << 24


class Px4(Autopilot):
    """A PX4 multicopter."""

    PARAMETER_TABLE = ("px4", True)
    DIRECTORIES = ("/fs/microsd/log", "/fs/microsd/etc", "/etc/logging", "/eeprom")
    FIRST_MODE = "LOITER"
    TICK_US, EMIT_US = 4000, 4000
    ALTITUDE_M, VTOL_STATE, RULE = 489.4, 0, "px4"
    MODES = (
        Mode("POSCTL", 3 << 16, 81, "hold", True),
        Mode("OFFBOARD", 6 << 16, 17, "follow", False),
        Mode("TAKEOFF", _auto(2), 29, "takeoff", True),
        Mode("LOITER", _auto(3), 29, "hold", True),
        Mode("RTL", _auto(5), 29, "return", True),
        Mode("LAND", _auto(6), 29, "land", True),
        Mode("DESCEND", _auto(6), 29, "blind", False),
    )
    TOPIC_HZ: ClassVar[dict[int, float]] = {31: 188.0, 32: 125.0, 331: 125.0, 147: 100.0, 24: 8.0}
    ESTIMATOR = EstimatorSettings(gps_error_m=0.08, gps_ready_s=4.0, vision_timeout_s=4.6)
    GUIDANCE = GuidanceSettings(climb_m_s=1.5, descend_m_s=0.7, crawl_m_s=0.3, crawl_below_m=1.0)
    COMMANDER_US, COMMANDER_PHASE_US = 100_000, 24_000
    NAVIGATOR_S = 0.05
    BUILDERS: ClassVar[dict[int, messages.Builder]] = {
        **messages.COMMON,
        8: px4messages.link_node_status,
        105: messages.highres_imu,
        261: messages.storage,
        141: messages.altitude,
        291: messages.esc_status,
        331: messages.odometry,
        375: messages.actuator_output,
        380: px4messages.time_estimate,
        411: px4messages.event_sequence,
        436: px4messages.current_mode,
    }

    def _powered_up(self) -> None:
        self.intention = "LOITER"
        self._log: Px4Log | None = None
        self._last_setpoint_s = -math.inf
        self._setpoints_lost = False
        self._latched: str | None = None
        self._rtl_announced = ""
        self._later: list[tuple[float, str]] = []
        self._next_text_id = 0
        self._intention_at_arming = "LOITER"
        self._rate_before: Vector = (0.0, 0.0, 0.0)
        self.angular_acceleration_frd: Vector = (0.0, 0.0, 0.0)
        self._origin_altitude_m = self.ALTITUDE_M
        self.last_vision: tuple[int, Vector, tuple[float, float, float, float]] | None = None
        self._declare_rotors()
        self.parameter_changed(self.parameters.all[0])

    def _declare_rotors(self) -> None:
        """The control allocator's geometry, in FRD, is that of the vehicle that flies."""
        rotors = self.vehicle.rotors
        self.parameters["CA_ROTOR_COUNT"] = rotors.count
        for i, ((x, y, z), spin) in enumerate(zip(rotors.position_m, rotors.spin, strict=True)):
            for name, value in (("PX", x), ("PY", -y), ("PZ", -z), ("KM", 0.05 * spin)):
                self.parameters[f"CA_ROTOR{i}_{name}"] = value

    # -- what it is -------------------------------------------------------------------------------------------------

    @property
    def intended_custom(self) -> int:
        """The custom mode number of the mode that was asked for."""
        return self.modes[self.intention].custom

    def _default_streams(self, kind: str) -> dict[int, int]:
        hz = {
            0: 1, 1: 5, 2: 1, 4: 1, 8: 1, 24: 8, 29: 1, 42: 1, 74: 10, 83: 10, 85: 10, 111: 10, 141: 10, 147: 0.5,
            230: 1, 241: 0.5, 242: 0.5, 245: 5, 380: 0.5, 411: 0.333, 436: 0.5,
        }  # fmt: skip
        if kind == "companion":
            hz |= {30: 100, 31: 50, 32: 30, 33: 50, 36: 10, 105: 50, 331: 30}
        else:
            hz |= {30: 50, 31: 50, 32: 30, 33: 10, 36: 50}
        return {number: round(1e6 / rate) for number, rate in hz.items()}

    def heartbeat(self) -> Message:
        """HEARTBEAT; disarmed and not ready to arm shows as uninitialised, a failsafe as critical."""
        if self.armed:
            status = 5 if self.failsafe else 4
        else:
            status = 3 if arming_obstacle(self) is None else 0
        base = self.mode.base | (128 if self.armed else 0)
        return mavlink.MAVLink_heartbeat_message(2, 12, base, self.mode.custom, status, 3)

    def system_status(self) -> Message:
        """SYS_STATUS with the sensors of the recorded simulation."""
        health = _HEALTHY | (_PREARM if arming_obstacle(self) is None else 0)
        return mavlink.MAVLink_sys_status_message(
            50348079, 50413615, health, 110, round(1000 * self.truth.voltage_v), round(100 * self.truth.current_a),
            self.battery.percent, 0, 0, 0, 0, 0, 0,
        )  # fmt: skip

    def autopilot_version(self) -> Message:
        """AUTOPILOT_VERSION of 1.17.0-dev."""
        return mavlink.MAVLink_autopilot_version_message(
            px4messages.CAPABILITIES, 0x01110040, 0x01110040, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0x5049583453494D31
        )

    @property
    def pulse_widths_us(self) -> list[int]:
        """1000 + 1000 u while armed, 900 otherwise and on unused outputs."""
        used = [round(1000 + 1000 * u) for u in self.commands] if self.armed else [900] * len(self.commands)
        return (used + [900] * 16)[:16]

    @property
    def imu_rate_hz(self) -> float:
        """Rate of the inertial sensor's driver."""
        return 1e6 / self.tick_us

    @property
    def gcs_alive(self) -> bool:
        """Whether any link has a live ground station."""
        return any(self.time_s - link.heard_s < self.parameters["COM_DL_LOSS_T"] for link in self.outbox.links.values())

    # -- requests ---------------------------------------------------------------------------------------------------

    def refuse_interval(self, message_id: int, interval_us: int) -> int | None:
        """Anything known is granted, whatever the rate; RAW_IMU and what else is not streamed fails."""
        return None if message_id in self.BUILDERS or message_id in (0, 1) else FAILED

    def unknown_parameter(self, link: Link, sender: Sender, name: str) -> None:
        """PARAM_ERROR; the hash of all parameters is one more name."""
        if name == "_HASH_CHECK":
            value = px4messages.parameters_hash(self.parameters.all)
            kind = mavlink.MAV_PARAM_TYPE_UINT32
            link.send(mavlink.MAVLink_param_value_message(name.encode(), value, kind, len(self.parameters), 65535))
            return
        error = mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST
        link.send(mavlink.MAVLink_param_error_message(*sender, name.encode(), -1, error))

    def accepts_parameter(self, link: Link, sender: Sender, parameter: Parameter, kind: int) -> bool:
        """Only its own type; another one leaves the value."""
        if kind == parameter.kind:
            return True
        error = mavlink.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE
        link.send(mavlink.MAVLink_param_error_message(*sender, parameter.name.encode(), -1, error))
        return False

    def parameter_changed(self, parameter: Parameter) -> None:
        """Take over what the emulation depends on: IMU rate, position source, and the trap of the height reference."""
        if not self.armed:
            self.tick_us = 1000 if self.parameters["IMU_INTEG_RATE"] >= 500 else 4000
        vision = int(self.parameters["EKF2_EV_CTRL"]) & 1 and not self.parameters["EKF2_GPS_CTRL"]
        gps = self.parameters["EKF2_GPS_CTRL"] and self.parameters["SYS_HAS_GPS"]
        self.estimator.source = "vision" if vision else "gps" if gps else "none"
        if parameter.name == "EKF2_HGT_REF" and not self.landed:
            self.estimator.jump((0.0, 0.0, -self.ALTITUDE_M))
        if self._log is not None:
            self._log.parameter(parameter.name, parameter.is_float, parameter.value)

    @property
    def vision_delay_s(self) -> float:
        """EKF2_EV_DELAY."""
        return 1e-3 * self.parameters["EKF2_EV_DELAY"]

    @property
    def vision_height_m(self) -> float:
        """Heights of external poses are altitudes to its filter: less that of the origin, which satellites have set by
        now.
        """
        return -self._origin_altitude_m

    def set_origin(self, altitude_m: float) -> None:
        """SET_GPS_GLOBAL_ORIGIN, answered with what holds then."""
        self._origin_altitude_m = altitude_m
        for link in self.outbox.links.values():
            link.send(*self.build(mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN))

    def vision_accepted(self, name: str, message: Message) -> bool:
        """With EKF2_EV_CTRL, and no ODOMETRY that says it is motion capture."""
        if not int(self.parameters["EKF2_EV_CTRL"]):
            return False
        accepted = name != "ODOMETRY" or message.estimator_type in (0, 2, 3)
        if accepted and name == "ODOMETRY":
            self.last_vision = (self.boot_us, (message.x, message.y, message.z), tuple(message.q))
        return accepted

    def command(self, number: int, p: list[float], link: Link, sender: Sender) -> int | None:
        """Commands of the vehicle itself."""
        if number == mavlink.MAV_CMD_DO_SET_MODE:
            return self._command_mode(whole(p[1]), whole(p[2]), link, sender)
        if number == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            return self._command_arm(forced=p[1] == FORCE) if p[0] == 1.0 else self._command_disarm(p[1] == FORCE)
        if number == mavlink.MAV_CMD_NAV_TAKEOFF:
            height = p[6] - self.ALTITUDE_M if math.isfinite(p[6]) else math.nan
            return self._command_takeoff(height if abs(height) < MAX_HEIGHT_M else math.nan)
        simple = {
            mavlink.MAV_CMD_NAV_LAND: "LAND",
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: "RTL",
            mavlink.MAV_CMD_DO_REPOSITION: "LOITER",
        }
        if number in simple:
            return self._intend(simple[number])
        if number == mavlink.MAV_CMD_DO_FLIGHTTERMINATION and p[0] > 0.5:
            self.disarm()
            return ACCEPTED
        if number == mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN:
            return DENIED
        if number in (mavlink.MAV_CMD_DO_SET_HOME, mavlink.MAV_CMD_PREFLIGHT_STORAGE):
            return ACCEPTED
        return UNSUPPORTED

    def _command_mode(self, main: int, sub: int, link: Link, sender: Sender) -> int:
        custom = main << 16 | (sub << 24 if main == 4 else 0)
        name = next((m.name for m in self.MODES if m.custom == custom), None)
        result = REJECTED if name is None else self._intend(name)
        if result == ACCEPTED:  # recorded: a change of mode is acknowledged twice
            set_mode = mavlink.MAV_CMD_DO_SET_MODE
            link.send(mavlink.MAVLink_command_ack_message(set_mode, ACCEPTED, 0, 0, *sender))
        return result

    def _intend(self, name: str) -> int:
        if self.modes[name].needs_position and not self.estimate.position_valid and self.armed:
            self.say(CRITICAL, f"Switching to mode '{name.title()}' is currently not possible")
            return REJECTED
        self.intention, self._latched = name, None
        if self._failsafe_mode() is None:
            self.enter(name)
        return ACCEPTED

    def _command_takeoff(self, height_m: float) -> int:
        result = self._intend("TAKEOFF")
        if result == ACCEPTED:
            ground = self.estimate.position_m[2]
            target = height_m if math.isfinite(height_m) else ground + self.parameters["MIS_TAKEOFF_ALT"]
            self.begin("takeoff", height_m=target)
        return result

    def _command_arm(self, *, forced: bool) -> int:
        if self.armed:
            return ACCEPTED
        obstacle = None if forced else arming_obstacle(self)
        if obstacle is not None:
            self.say(CRITICAL, "Arming denied: Resolve system health failures first")
            self.say(CRITICAL, f"Preflight Fail: {obstacle}")
            return REJECTED
        self.arm()
        self._intention_at_arming = self.intention
        self.enter(self.intention, again=True)
        begun = time.gmtime(self.unix_s)
        path = time.strftime("/fs/microsd/log/%Y-%m-%d/%H_%M_%S.ulg", begun)
        self.files[path] = bytearray()
        self._log = Px4Log(self, self.files[path])
        self._log_path = path
        self.say(INFO, "Armed by external command")
        return ACCEPTED

    def _command_disarm(self, forced: bool) -> int:
        if not self.armed:
            return ACCEPTED
        if not self.landed and not forced:
            self.say(CRITICAL, "Disarming denied: not landed")
            return REJECTED
        self.say(INFO, "Disarmed by external command")
        self.disarm()
        return ACCEPTED

    # -- flight -----------------------------------------------------------------------------------------------------

    @property
    def setpoints_fresh(self) -> bool:
        """Whether one came within COM_OF_LOSS_T."""
        return self.time_s - self._last_setpoint_s < self.parameters["COM_OF_LOSS_T"]

    def follow(self, setpoint: Setpoint) -> None:
        """A set-point keeps OFFBOARD alive, whatever the mode."""
        self._last_setpoint_s = self.time_s
        self._setpoints_lost = False
        super().follow(setpoint)

    def enter(self, name: str, *, again: bool = False) -> None:
        """Fly a mode; the intention stays."""
        if again:
            self.begin(self.modes[name].kind)
        self.set_mode(name)

    def begin(self, kind: Kind, *, height_m: float | None = None) -> None:
        """A take-off without a height uses MIS_TAKEOFF_ALT."""
        if kind == "takeoff" and height_m is None:
            height_m = self.estimate.position_m[2] + self.parameters["MIS_TAKEOFF_ALT"]
        super().begin(kind, height_m=height_m)

    def _supervise(self) -> None:
        rate = flip(self.imu.gyro_rad_s)
        x, y, z = ((now - before) / self.tick_s for now, before in zip(rate, self._rate_before, strict=True))
        self.angular_acceleration_frd, self._rate_before = (x, y, z), rate
        if (
            self.boot_us % self.COMMANDER_US == self.COMMANDER_PHASE_US
        ):  # a loss is seen at the commander's rate, a return at once
            self._setpoints_lost = not self.setpoints_fresh
        wanted = self._failsafe_mode() if self.armed else None
        if wanted is not None and not self.failsafe:
            self.say(CRITICAL, "Failsafe activated")
        self.failsafe = wanted is not None
        mode = wanted or self.intention
        if mode != self.mode.name:
            self.enter(mode)
        self._announce_return()
        if self.mode.name == "TAKEOFF" and self.guidance.done:
            self.intention = "LOITER"
        self._disarm_by_itself()

    def _disarm_by_itself(self) -> None:
        if not self.armed:
            return
        landed, waiting = self.parameters["COM_DISARM_LAND"], self.parameters["COM_DISARM_PRFLT"]
        if 0.0 < landed <= self.landed_for_s:
            self.say(INFO, "Disarmed by landing")
            self.disarm(by_landing=True)
        elif self.landed and not self.has_flown and 0.0 < waiting <= self.time_s - self.armed_s:
            self.say(INFO, "Disarmed by auto preflight disarming")
            self.disarm()

    def _announce_return(self) -> None:
        """The navigator's texts, one of its cycles after what they report; said even if the mode has changed again."""
        phase = self.guidance.phase if self.mode.name == "RTL" else ""
        if phase != self._rtl_announced and not (phase == "cruise" and self._rtl_announced == "descend"):
            begun = self._rtl_announced == ""
            self._rtl_announced = phase
            distance, above = self.distance_from_home
            if phase and begun:
                height = self.ALTITUDE_M + self.estimate.position_m[2]
                text = f"RTL: start return at {height:.0f} m ({above:.0f} m above destination)"
                self._later.append((self.time_s + self.NAVIGATOR_S, text))
            if phase == "descend" or (phase and distance < self.guidance.ARRIVED_M):
                self._later.append((self.time_s + 2.0 * self.NAVIGATOR_S, "RTL: land at destination"))
                self._rtl_announced = "descend"
        while self._later and self._later[0][0] <= self.time_s:
            self.say(INFO, self._later.pop(0)[1])

    def _failsafe_mode(self) -> str | None:
        """The mode a failsafe demands now; some stay once they have acted, loss of set-points and position do not."""
        if not self.armed:
            return None
        if self._latched is None:
            self._latched = standing_failsafe(self)
        if self._latched is not None:
            return self._latched
        if not self.landed and link_action(self, silent_for_s(self)) is not None:
            return "LOITER"  # for COM_FAIL_ACT_T, before what NAV_DLL_ACT says
        needs = self.modes[self.intention].needs_position or self.intention == "OFFBOARD"
        if needs and not self.estimate.position_valid and not self.landed:
            return "DESCEND"
        if self.intention == "OFFBOARD" and self._setpoints_lost:
            return {4: "LAND", 5: "LOITER"}.get(int(self.parameters["COM_OBL_RC_ACT"]), "RTL")
        return None

    def _landed_event(self, *, landed: bool) -> None:
        self.say(INFO, "Landing detected" if landed else "Takeoff detected")

    def _after_disarm(self, *, by_landing: bool) -> None:
        """Recorded: after a landing the mode shown is the one it was armed in."""
        if by_landing:
            self.intention = self._intention_at_arming
        self._latched = None
        self.failsafe = False
        if self._log is not None:
            self._log = None
            self._number_logs()

    def _number_logs(self) -> None:
        """Numbers follow the directory, not time (measured: ids are not in time order)."""
        paths = sorted((p for p in self.files if p.endswith(".ulg")), key=lambda p: hashlib.sha256(p.encode()).digest())
        begun = {log.path: log.begun_unix_s for log in self.logs.logs} | {self._log_path: round(self.unix_s)}
        self.logs.logs = [LogFile(number, begun.get(path, 0), path) for number, path in enumerate(paths)]

    def _record(self) -> None:
        if self._log is not None:
            self._log.tick(self)

    def _restarted(self) -> None:
        self.intention = self._intention_at_arming = self.FIRST_MODE
        self._last_setpoint_s, self._setpoints_lost, self._latched = -math.inf, False, None
        self._rtl_announced, self._next_text_id = "", 0
        self._later.clear()
        self._log = None

    def pilot_takes_over(self) -> None:
        """POSCTL, as when a pilot moves the sticks."""
        self._intend("POSCTL")

    # -- texts ------------------------------------------------------------------------------------------------------

    def say(self, severity: int, text: str) -> None:
        """PX4 ends the texts of its events with a tab."""
        self.text(severity, f"{text}\t")
        if self._log is not None:
            self._log.text(self.boot_us, text)

    def _text_number(self, text: str) -> int:
        number = self._next_text_id
        self._next_text_id += 1
        return number

    def text_eligible(self, link: Link) -> bool:
        """Only to a live ground station."""
        return self.time_s - link.heard_s < 2.5
