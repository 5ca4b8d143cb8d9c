"""PX4, as measured on its software in the loop (main of March 2026) and recorded in its traffic."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from drivers.mavlink.dialect import Message, mavlink
from drivers.samples import Pose
from groundstation.flight.link.profiles.base import ParameterRule, Profile, StreamWish, odometry_message


def _mode(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


class Px4(Profile):
    """Offboard by setpoints from the ground up; integers in parameters travel as bits."""

    name = "px4"
    autopilot = mavlink.MAV_AUTOPILOT_PX4
    imu = "HIGHRES_IMU"
    modes: ClassVar[dict[str, int]] = {
        "MANUAL": _mode(1),
        "ALTCTL": _mode(2),
        "POSCTL": _mode(3),
        "AUTO.READY": _mode(4, 1),
        "AUTO.TAKEOFF": _mode(4, 2),
        "AUTO.LOITER": _mode(4, 3),
        "AUTO.MISSION": _mode(4, 4),
        "AUTO.RTL": _mode(4, 5),
        "AUTO.LAND": _mode(4, 6),
        "ACRO": _mode(5),
        "OFFBOARD": _mode(6),
        "STABILIZED": _mode(7),
    }
    follow_mode = "OFFBOARD"
    land_mode = "AUTO.LAND"
    hold_mode = "AUTO.LOITER"
    pilot_modes = frozenset({"MANUAL", "ALTCTL", "POSCTL", "ACRO", "STABILIZED"})
    climbs_by_command = False
    bytewise_parameters = True
    setpoint_timeout_s = 1.0
    log_suffix = ".ulg"
    prearm_in_health_alone = True
    pose_delay = "EKF2_EV_DELAY"
    arms_led = True
    origin_altitude_mm = 0
    streams = (
        StreamWish("HIGHRES_IMU", 250.0, 20.0, "rates and specific force: the motion the inertia shows in"),
        StreamWish("ACTUATOR_OUTPUT_STATUS", 250.0, 0.0, "motor commands with full digits", "SERVO_OUTPUT_RAW"),
        StreamWish("SERVO_OUTPUT_RAW", 250.0, 20.0, "motor commands: what caused the motion"),
        StreamWish("ESC_STATUS", 250.0, 0.0, "rotor speeds, where the ESCs report them", "SERVO_OUTPUT_RAW"),
        StreamWish("ATTITUDE_QUATERNION", 100.0, 10.0, "tilt for the guard, attitude for the record"),
        StreamWish("LOCAL_POSITION_NED", 100.0, 10.0, "position for guard and record"),
        StreamWish(
            "ODOMETRY", 100.0, 0.0, "the whole state with one stamp, and estimator resets", "LOCAL_POSITION_NED"
        ),
        StreamWish("BATTERY_STATUS", 20.0, 2.0, "battery voltage for guard and thrust model"),
        StreamWish("EXTENDED_SYS_STATE", 10.0, 2.0, "landed or not"),
        StreamWish("SYS_STATUS", 4.0, 0.0, "whether the arming checks pass"),
        StreamWish("CURRENT_MODE", 20.0, 0.0, "a mode change seen within 50 ms instead of a heartbeat's second"),
        StreamWish("ESTIMATOR_STATUS", 5.0, 0.0, "estimator health"),
        StreamWish("VIBRATION", 2.0, 0.0, "vibration"),
    )
    parameters = (
        ParameterRule(
            "COM_OBL_RC_ACT", (4.0, 5.0, 7.0), settable=True,
            why="without setpoints PX4 shall land (4), not return: indoors a return climbs into the ceiling",
        ),
        ParameterRule(
            "COM_OF_LOSS_T", (0.5, 1.0), settable=True,
            why="lost setpoints shall be noticed within a second",
        ),
        ParameterRule(
            "NAV_DLL_ACT", (3.0, 1.0), settable=True,
            why="a station that is gone for good shall bring the vehicle down (3: land); the default does nothing",
        ),
        ParameterRule("COM_DISARM_LAND", (2.0, 1.0, 0.5, 3.0, 4.0, 5.0), required=False,
                      why="the vehicle shall disarm by itself after touch-down"),
        ParameterRule("GF_ACTION", (2.0, 1.0, 3.0, 5.0), required=False,
                      why="the vehicle's own geofence is the last resort when both link and station fail"),
        *(
            ParameterRule(name, (1.0,), required=False, or_more=True,
                          why="at 0 there is no geofence, whatever GF_ACTION says (a polygon on the vehicle is not "
                              "read)")
            for name in ("GF_MAX_HOR_DIST", "GF_MAX_VER_DIST")
        ),
        ParameterRule("EKF2_GPS_CTRL", (0.0,), settable=True, indoors=True, why="no satellites indoors"),
        ParameterRule("EKF2_MAG_TYPE", (5.0,), settable=True, indoors=True,
                      why="yaw shall come from the external poses alone: steel and cables turn the field indoors"),
        ParameterRule("EKF2_HGT_REF", (3.0,), settable=True, indoors=True,
                      why="height shall come from the external poses; never change it in flight"),
        ParameterRule("EKF2_EV_CTRL", (11.0, 15.0), settable=True, indoors=True,
                      why="the estimator shall fuse position and yaw of the external poses"),
        ParameterRule("SDLOG_PROFILE", (25.0, 27.0, 17.0, 19.0, 1.0), settable=True, required=False,
                      why="high-rate logging gives 250 Hz motor commands and IMU after landing"),
    )  # fmt: skip

    def set_mode(self, mode: str) -> Message:
        """DO_SET_MODE with main and sub mode apart, as PX4 wants it."""
        number = self.modes[mode]
        return self.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, float(number >> 16 & 0xFF), float(number >> 24))

    def external_pose(self, pose: Pose, stamp_s: float, std_m: float, std_rad: float, resets: int) -> Sequence[Message]:
        """ODOMETRY: 2 to 5 cm rms where VISION_POSITION_ESTIMATE gave 5 to 9."""
        return (odometry_message(pose, stamp_s, std_m, std_rad, resets),)
