"""The telemetry both firmwares send, built from the emulated autopilot's state; north-east-down begins here."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from drivers.mavlink.dialect import EscStatus
from drivers.mavlink.geometry import flip, flip_quaternion
from sim.mavlink.airframe import Vector, euler
from sim.mavlink.wire import Message, mavlink

if TYPE_CHECKING:
    from sim.mavlink.autopilot import Autopilot

Builder = Callable[["Autopilot"], "Message | list[Message] | None"]

LATITUDE_DEG, LONGITUDE_DEG = 47.3977420, 8.5455940
EARTH_RADIUS_M = 6_371_000.0
_RPM = 60.0 / (2.0 * math.pi)


def geodetic(position_m: Vector, altitude_m: float) -> tuple[int, int, float]:
    """Latitude and longitude in 1e-7 deg and altitude of a point of the local world (x north, y west)."""
    north, east, down = flip(position_m)
    latitude = LATITUDE_DEG + math.degrees(north / EARTH_RADIUS_M)
    longitude = LONGITUDE_DEG + math.degrees(east / (EARTH_RADIUS_M * math.cos(math.radians(LATITUDE_DEG))))
    return round(latitude * 1e7), round(longitude * 1e7), altitude_m - down


def _euler_ned(a: Autopilot) -> Vector:
    return euler(flip_quaternion(a.estimate.quaternion))


def attitude(a: Autopilot) -> Message:
    """ATTITUDE."""
    return mavlink.MAVLink_attitude_message(a.boot_ms, *_euler_ned(a), *flip(a.estimate.rate_rad_s))


def attitude_quaternion(a: Autopilot) -> Message:
    """ATTITUDE_QUATERNION."""
    q = flip_quaternion(a.estimate.quaternion)
    return mavlink.MAVLink_attitude_quaternion_message(a.boot_ms, *q, *flip(a.estimate.rate_rad_s))


def local_position(a: Autopilot) -> Message | None:
    """LOCAL_POSITION_NED, silent until there is a position."""
    if not a.estimate.position_valid:
        return None
    e = a.estimate
    return mavlink.MAVLink_local_position_ned_message(a.boot_ms, *flip(e.position_m), *flip(e.velocity_m_s))


def global_position(a: Autopilot) -> Message | None:
    """GLOBAL_POSITION_INT."""
    if not a.estimate.position_valid:
        return None
    latitude, longitude, altitude = geodetic(a.estimate.position_m, a.ALTITUDE_M)
    north, east, down = (round(100 * v) for v in flip(a.estimate.velocity_m_s))
    heading = round(100 * math.degrees(_euler_ned(a)[2] % (2 * math.pi))) % 36000
    above = round(1000 * (a.estimate.position_m[2] - a.home_m[2]))
    return mavlink.MAVLink_global_position_int_message(
        a.boot_ms, latitude, longitude, round(1000 * altitude), above, north, east, down, heading
    )


def highres_imu(a: Autopilot) -> Message:
    """HIGHRES_IMU: specific force and rates of the newest sample, FRD."""
    field = (0.23, 0.01, 0.45)
    return mavlink.MAVLink_highres_imu_message(
        a.boot_us, *flip(a.imu.accel_m_s2), *flip(a.imu.gyro_rad_s), *field, 955.7, 0.0, a.ALTITUDE_M, 15.0, 63, 0
    )


def raw_imu(a: Autopilot) -> Message:
    """RAW_IMU as ArduPilot fills it: milli-g, mrad/s, mgauss."""
    fx, fy, fz = (round(1000 * f / 9.80665) for f in flip(a.imu.accel_m_s2))
    gx, gy, gz = (round(1000 * r) for r in flip(a.imu.gyro_rad_s))
    return mavlink.MAVLink_raw_imu_message(a.boot_us, fx, fy, fz, gx, gy, gz, 217, 12, 429, 0, 2514)


def servo_output(a: Autopilot) -> Message:
    """SERVO_OUTPUT_RAW: pulse widths."""
    return mavlink.MAVLink_servo_output_raw_message(a.boot_us & 0xFFFFFFFF, 0, *a.pulse_widths_us)


def actuator_output(a: Autopilot) -> Message:
    """ACTUATOR_OUTPUT_STATUS."""
    widths = [float(w) for w in a.pulse_widths_us]
    return mavlink.MAVLink_actuator_output_status_message(a.boot_us, 16, widths + [0.0] * 16)


def esc_status(a: Autopilot) -> list[Message] | None:
    """ESC_STATUS, four ESCs a message; silent where the ESCs report nothing."""
    if not a.has_esc_telemetry:
        return None
    rpm = [round(w * _RPM) for w in a.truth.rotor_speed_rad_s]
    count, out = len(rpm), []
    share = a.truth.current_a / max(count, 1)
    for first in range(0, count, 4):
        used = rpm[first : first + 4]
        pad = 4 - len(used)
        voltage = [a.truth.voltage_v] * len(used) + [0.0] * pad
        out.append(EscStatus(first, a.boot_us, used + [0] * pad, voltage, [share] * len(used) + [0.0] * pad))
    return out


def esc_telemetry(a: Autopilot) -> Message:
    """ESC_TELEMETRY_1_TO_4."""
    rpm = [min(65535, round(abs(w) * _RPM)) for w in a.truth.rotor_speed_rad_s[:4]]
    rpm += [0] * (4 - len(rpm))
    volt, amp = round(100 * a.truth.voltage_v), round(25 * a.truth.current_a)
    return mavlink.MAVLink_esc_telemetry_1_to_4_message([32] * 4, [volt] * 4, [amp] * 4, [1] * 4, rpm, [a.counter] * 4)


def battery_status(a: Autopilot) -> Message:
    """BATTERY_STATUS: the pack's voltage in the first cell's place, as PX4 does when cells are not measured."""
    cells = [round(1000 * a.truth.voltage_v)] + [65535] * 9
    return mavlink.MAVLink_battery_status_message(
        0,
        1,
        1,
        32767,
        cells,
        round(100 * a.truth.current_a),
        round(a.battery.used_mah),
        -1,
        a.battery.percent,
        0,
        a.battery.charge_state,
    )


def odometry(a: Autopilot) -> Message | None:
    """ODOMETRY in the local NED frame, velocity too (recorded: child frame 1)."""
    e = a.estimate
    if not e.position_valid:
        return None
    variance = [0.0] * 21
    for index, value in zip((0, 6, 11, 15, 18, 20), (0.04, 0.04, 0.005, 4e-4, 4e-4, 2e-2), strict=True):
        variance[index] = value
    return mavlink.MAVLink_odometry_message(
        a.boot_us, 1, 1, *flip(e.position_m), flip_quaternion(e.quaternion), *flip(e.velocity_m_s), *flip(e.rate_rad_s),
        variance, [0.01] + [0.0] * 20, a.estimator.reset_count % 256, 8, 0,
    )  # fmt: skip


def estimator_status(a: Autopilot) -> Message:
    """ESTIMATOR_STATUS."""
    accuracy = 0.28 if a.estimator.source == "gps" else 0.02
    ratio = 0.03 if a.estimate.position_valid else 1.5
    return mavlink.MAVLink_estimator_status_message(
        a.boot_us, a.estimator.flags, ratio, ratio, ratio / 3, 0.08, 0.002, math.nan, accuracy, accuracy / 4
    )


def ekf_status(a: Autopilot) -> Message:
    """EKF_STATUS_REPORT (ArduPilot); its flag for a constant-position mode is the same bit."""
    return mavlink.MAVLink_ekf_status_report_message(a.estimator.flags, 0.03, 0.03, 0.01, 0.08, 0.0)


def extended_state(a: Autopilot) -> Message:
    """EXTENDED_SYS_STATE."""
    return mavlink.MAVLink_extended_sys_state_message(a.VTOL_STATE, a.landed_state)


def system_time(a: Autopilot) -> Message:
    """SYSTEM_TIME."""
    return mavlink.MAVLink_system_time_message(round(a.unix_s * 1e6), a.boot_ms)


def vfr_hud(a: Autopilot) -> Message:
    """VFR_HUD."""
    x, y, z = a.estimate.velocity_m_s
    heading = round(math.degrees(_euler_ned(a)[2])) % 360
    throttle = round(100 * sum(a.commands) / max(1, len(a.commands)))
    return mavlink.MAVLink_vfr_hud_message(
        math.nan, math.hypot(x, y), heading, throttle, a.ALTITUDE_M + a.estimate.position_m[2], z
    )


def gps_raw(a: Autopilot) -> Message:
    """GPS_RAW_INT: a fix of the true position, or none when GPS is not in use."""
    if a.estimator.source != "gps":
        return mavlink.MAVLink_gps_raw_int_message(a.boot_us, 0, 0, 0, 0, 65535, 65535, 65535, 65535, 0)
    latitude, longitude, altitude = geodetic(a.truth.position_m, a.ALTITUDE_M)
    speed = round(100 * math.hypot(*a.truth.velocity_m_s[:2]))
    return mavlink.MAVLink_gps_raw_int_message(
        a.boot_us, 3, latitude, longitude, round(1000 * altitude), 70, 110, speed, 0, 10, round(1000 * altitude), 900,
        1780, 400, 0, 0,
    )  # fmt: skip


def altitude(a: Autopilot) -> Message:
    """ALTITUDE."""
    z = a.estimate.position_m[2]
    above = z - a.home_m[2]
    return mavlink.MAVLink_altitude_message(a.boot_us, a.ALTITUDE_M + z, a.ALTITUDE_M + z, z, above, above, above)


def attitude_target(a: Autopilot) -> Message:
    """ATTITUDE_TARGET."""
    thrust = sum(a.commands) / max(1, len(a.commands))
    return mavlink.MAVLink_attitude_target_message(
        a.boot_ms, 0, flip_quaternion(a.cascade.attitude_setpoint), *flip(a.cascade.rate_setpoint), thrust
    )


def position_target(a: Autopilot) -> Message:
    """POSITION_TARGET_LOCAL_NED: what is being followed."""
    s = a.setpoint
    return mavlink.MAVLink_position_target_local_ned_message(
        a.boot_ms, 1, 0, *flip(s.position_m), *flip(s.velocity_m_s), *flip(s.acceleration_m_s2), -s.yaw_rad,
        0.0 if math.isnan(s.yaw_rate_rad_s) else -s.yaw_rate_rad_s,
    )  # fmt: skip


CARD_MIB = 30000.0


def storage(a: Autopilot) -> Message:
    """STORAGE_INFORMATION: a card, formatted, with what its files leave of it."""
    used = sum(len(content) for content in a.files.values()) / (1 << 20)
    return mavlink.MAVLink_storage_information_message(a.boot_ms, 1, 1, 2, CARD_MIB, used, CARD_MIB - used, 0.0, 0.0)


def vibration(a: Autopilot) -> Message:
    """VIBRATION: RMS of the accelerometer's fast part."""
    return mavlink.MAVLink_vibration_message(a.boot_us, *a.vibration_m_s2, 0, 0, 0)


def home_position(a: Autopilot) -> Message:
    """HOME_POSITION."""
    latitude, longitude, height = geodetic(a.home_m, a.ALTITUDE_M)
    return mavlink.MAVLink_home_position_message(
        latitude, longitude, round(1000 * height), *flip(a.home_m), [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, a.boot_us
    )


def global_origin(a: Autopilot) -> Message:
    """GPS_GLOBAL_ORIGIN."""
    latitude, longitude, height = geodetic((0.0, 0.0, 0.0), a.ALTITUDE_M)
    return mavlink.MAVLink_gps_global_origin_message(latitude, longitude, round(1000 * height), a.boot_us)


def timesync(a: Autopilot) -> Message:
    """TIMESYNC request: the autopilot asks too."""
    return mavlink.MAVLink_timesync_message(0, a.boot_us * 1000)


def scaled_pressure(a: Autopilot) -> Message:
    """SCALED_PRESSURE."""
    return mavlink.MAVLink_scaled_pressure_message(a.boot_ms, 955.8 - 0.11 * a.truth.position_m[2], 0.0, 1182)


def mission_current(a: Autopilot) -> Message:
    """MISSION_CURRENT."""
    total = len(a.mission.items) or 65535
    return mavlink.MAVLink_mission_current_message(0, total, 1 if total == 65535 else 2, 1 if a.armed else 2)


def ping(a: Autopilot) -> Message:
    """PING."""
    return mavlink.MAVLink_ping_message(a.boot_us, a.counter, 0, 0)


def sim_state(a: Autopilot) -> Message:
    """SIM_STATE: the truth, as ArduPilot's simulator reports it."""
    t = a.truth
    q = flip_quaternion(t.quaternion)
    latitude, longitude, height = geodetic(t.position_m, a.ALTITUDE_M)
    return mavlink.MAVLink_sim_state_message(
        *q,
        *euler(q),
        *flip(t.specific_force_m_s2),
        *flip(t.rate_rad_s),
        float(latitude),
        float(longitude),
        height,
        0.0,
        0.0,
        *flip(t.velocity_m_s),
        latitude,
        longitude,
    )


COMMON: dict[int, Builder] = {
    2: system_time,
    4: ping,
    24: gps_raw,
    29: scaled_pressure,
    30: attitude,
    31: attitude_quaternion,
    32: local_position,
    33: global_position,
    36: servo_output,
    42: mission_current,
    49: global_origin,
    74: vfr_hud,
    83: attitude_target,
    85: position_target,
    111: timesync,
    147: battery_status,
    230: estimator_status,
    241: vibration,
    242: home_position,
    245: extended_state,
}
"""Builders by message id of what both firmwares send."""
