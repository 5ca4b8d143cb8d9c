"""ArduCopter, as measured on its software in the loop (4.8-dev) and recorded in its traffic."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf, radians, sqrt
from typing import ClassVar

from drivers.mavlink.dialect import Message, mavlink
from drivers.mavlink.geometry import flip
from drivers.samples import Pose
from groundstation.flight.link.profiles.base import ParameterRule, Profile, StreamWish, pose_covariance
from groundstation.frames import euler_from_quat


class ArduCopter(Profile):
    """GUIDED after a take-off command; silent until asked; integers in parameters travel as values."""

    name = "arducopter"
    autopilot = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    imu = "RAW_IMU"
    modes: ClassVar[dict[str, int]] = {
        "STABILIZE": 0,
        "ACRO": 1,
        "ALT_HOLD": 2,
        "AUTO": 3,
        "GUIDED": 4,
        "LOITER": 5,
        "RTL": 6,
        "CIRCLE": 7,
        "LAND": 9,
        "DRIFT": 11,
        "SPORT": 13,
        "FLIP": 14,
        "POSHOLD": 16,
        "BRAKE": 17,
        "THROW": 18,
        "GUIDED_NOGPS": 20,
        "SMART_RTL": 21,
    }
    follow_mode = "GUIDED"
    land_mode = "LAND"
    hold_mode = "BRAKE"
    pilot_modes = frozenset({"STABILIZE", "ACRO", "ALT_HOLD", "LOITER", "DRIFT", "SPORT", "POSHOLD", "FLIP"})
    climbs_by_command = True
    bytewise_parameters = False
    setpoint_timeout_s = 3.0
    log_suffix = ".bin"
    scripting = "SCR_ENABLE"
    pose_delay = "VISO_DELAY_MS"
    origin_altitude_mm = 100_000
    streams = (
        StreamWish("RAW_IMU", 300.0, 20.0, "rates and specific force: the motion the inertia shows in"),
        StreamWish("SERVO_OUTPUT_RAW", 300.0, 20.0, "motor commands; the onboard log has them at 10 Hz only"),
        StreamWish("ESC_TELEMETRY_1_TO_4", 100.0, 0.0, "rotor speeds, where the ESCs report them", "SERVO_OUTPUT_RAW"),
        StreamWish("ATTITUDE_QUATERNION", 100.0, 10.0, "tilt for the guard, attitude for the record"),
        StreamWish("LOCAL_POSITION_NED", 100.0, 10.0, "position for guard and record"),
        StreamWish("BATTERY_STATUS", 10.0, 2.0, "battery voltage for guard and thrust model"),
        StreamWish("EXTENDED_SYS_STATE", 10.0, 2.0, "landed or not"),
        StreamWish("SYS_STATUS", 4.0, 1.0, "whether the arming checks pass"),
        StreamWish("EKF_STATUS_REPORT", 5.0, 0.0, "estimator health"),
        StreamWish("VIBRATION", 2.0, 0.0, "vibration"),
    )
    parameters = (
        ParameterRule("FS_GCS_ENABLE", (5.0, 1.0, 2.0, 3.0, 4.0), settable=True,
                      why="a station that is gone shall bring the vehicle down (5: land)"),
        ParameterRule("FS_EKF_ACTION", (1.0, 3.0), settable=True, why="a lost estimate shall land the vehicle"),
        ParameterRule("GUID_TIMEOUT", (1.0, 3.0, 2.0, 0.5), required=False, settable=True,
                      why="lost setpoints shall stop the vehicle soon"),
        ParameterRule("FENCE_ENABLE", (1.0,), required=False,
                      why="the vehicle's own geofence is the last resort when both link and station fail"),
        *(
            ParameterRule(name, (value,), settable=True, required=False, or_more=True, since=since, before=before,
                          why="the autopilot smooths a trajectory to this limit, and then flies another one")
            for name, value, since, before in (
                ("PSC_JERK_NE", 50.0, (4, 7), (255, 0)), ("PSC_JERK_D", 50.0, (4, 7), (255, 0)),
                ("WP_ACC", 10.0, (4, 7), (255, 0)),
                ("PSC_JERK_XY", 20.0, (0, 0), (4, 7)), ("PSC_JERK_Z", 50.0, (0, 0), (4, 7)),
                ("WPNAV_ACCEL", 1000.0, (0, 0), (4, 7)),
            )
        ),
        *(
            ParameterRule(name, (value,), settable=True, required=False, or_less=True, since=since, before=before,
                          why="the take-off climbs at this speed, and overshoots by half a metre at the default of 2.5 "
                              "m/s")
            for name, value, since, before in (
                ("WP_SPD_UP", 1.0, (4, 7), (255, 0)), ("WPNAV_SPEED_UP", 100.0, (0, 0), (4, 7)),
            )
        ),
        ParameterRule("SCR_ENABLE", (1.0, 0.0), required=False,
                      why="with scripting the trajectory is flown on board, without a radio in the loop"),
        ParameterRule("VISO_TYPE", (1.0,), settable=True, indoors=True, restart=True,
                      why="external poses shall be taken from MAVLink"),
        ParameterRule("GPS1_TYPE", (0.0,), settable=True, indoors=True, restart=True, why="no satellites indoors"),
        *(
            ParameterRule(name, (value,), settable=True, indoors=True, why=f"{what} shall come from the external poses")
            for name, value, what in (
                ("EK3_SRC1_POSXY", 6.0, "position"), ("EK3_SRC1_POSZ", 6.0, "height"), ("EK3_SRC1_YAW", 6.0, "yaw"),
            )
        ),
        *(
            ParameterRule(name, (0.0, 6.0), settable=True, indoors=True, why="the external poses bring no velocity")
            for name in ("EK3_SRC1_VELXY", "EK3_SRC1_VELZ")
        ),
        ParameterRule("INS_RAW_LOG_OPT", (9.0, 1.0, 13.0), settable=True, required=False,
                      why="raw IMU logging gives the onboard log 1 kHz instead of 25 Hz"),
    )  # fmt: skip

    def jerk_limits_m_s3(self, parameters: Mapping[str, float | None]) -> tuple[float, float]:
        """Of its input shaping: the parameters', and horizontally what half the root of acceleration times snap allows.

        The snap is that of the roll and pitch acceleration it permits itself, at its default of 1100 deg/s^2.
        """
        horizontal, vertical, acceleration = (
            next((p for name in names if (p := parameters.get(name)) is not None), inf)
            for names in (("PSC_JERK_NE", "PSC_JERK_XY"), ("PSC_JERK_D", "PSC_JERK_Z"), ("WP_ACC", "WPNAV_ACCEL"))
        )
        if parameters.get("WP_ACC") is None:
            acceleration *= 0.01
        return min(horizontal, 0.5 * sqrt(acceleration * radians(1100.0) * 9.80665)), vertical

    def set_mode(self, mode: str) -> Message:
        """DO_SET_MODE with the custom mode's number."""
        return self.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, float(self.modes[mode]))

    def take_off(self, height_m: float) -> Message:
        """NAV_TAKEOFF straight up; ArduCopter reads the last parameter alone."""
        return self.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height_m)

    def external_pose(self, pose: Pose, stamp_s: float, std_m: float, std_rad: float, resets: int) -> Sequence[Message]:
        """VISION_POSITION_ESTIMATE; pitch and yaw change sign between FLU, z up and FRD, NED; roll does not."""
        x, y, z = flip(pose.position_m)
        roll, pitch, yaw = (float(a) for a in euler_from_quat(pose.quaternion))
        covariance = pose_covariance(std_m, std_rad)
        return (
            mavlink.MAVLink_vision_position_estimate_message(
                int(stamp_s * 1e6), x, y, z, roll, -pitch, -yaw, covariance, resets & 0xFF
            ),
        )
