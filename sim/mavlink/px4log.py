"""PX4's onboard log of an emulated flight: the topics, their fields and their rates by SDLOG_PROFILE and
IMU_INTEG_RATE.

Rates are those measured on the firmware (default, and profile 25 = default + high rate + system identification). Field
definitions follow PX4's uORB messages; topics are logged with the fields an importer reads.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from drivers.mavlink.geometry import flip, flip_quaternion
from sim.mavlink.ulog import ULogWriter

if TYPE_CHECKING:
    from sim.mavlink.px4 import Px4

_LOCAL_POSITION = (
    "uint64_t timestamp;uint64_t timestamp_sample;float x;float y;float z;float vx;float vy;float vz;bool "
    "xy_valid;bool z_valid;"
)
FORMATS = {
    "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;int32_t "
                       "accelerometer_timestamp_relative;float[3] accelerometer_m_s2;uint32_t "
                       "accelerometer_integral_dt;uint8_t accelerometer_clipping;uint8_t gyro_clipping;uint8_t "
                       "accel_calibration_count;uint8_t gyro_calibration_count;",
    "vehicle_angular_velocity": "uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz;float[3] xyz_derivative;",
    "vehicle_acceleration": "uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz;",
    "actuator_motors": "uint64_t timestamp;uint64_t timestamp_sample;float[12] control;uint16_t reversible_flags;",
    "actuator_outputs": "uint64_t timestamp;uint32_t noutputs;float[16] output;",
    "battery_status": "uint64_t timestamp;float voltage_v;float current_a;float discharged_mah;float remaining;bool "
                      "connected;uint8_t cell_count;uint8_t id;uint8_t warning;",
    "vehicle_attitude": "uint64_t timestamp;uint64_t timestamp_sample;float[4] q;float[4] delta_q_reset;uint8_t "
                        "quat_reset_counter;",
    "vehicle_local_position": _LOCAL_POSITION,
    "vehicle_attitude_groundtruth": "uint64_t timestamp;uint64_t timestamp_sample;float[4] q;float[4] "
                                    "delta_q_reset;uint8_t quat_reset_counter;",
    "vehicle_angular_velocity_groundtruth": "uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz;float[3] "
                                            "xyz_derivative;",
    "vehicle_local_position_groundtruth": _LOCAL_POSITION,
    "trajectory_setpoint": "uint64_t timestamp;float[3] position;float[3] velocity;float[3] acceleration;float[3] "
                           "jerk;float yaw;float yawspeed;",
    "vehicle_status": "uint64_t timestamp;uint8_t arming_state;uint8_t nav_state_user_intention;uint8_t nav_state;bool "
                      "failsafe;bool gcs_connection_lost;",
    "vehicle_land_detected": "uint64_t timestamp;bool landed;bool ground_contact;bool maybe_landed;",
    "vehicle_visual_odometry": "uint64_t timestamp;uint64_t timestamp_sample;float[3] position;float[4] q;",
    "esc_report": "uint64_t timestamp;uint32_t esc_errorcount;int32_t esc_rpm;float esc_voltage;float "
                  "esc_current;float esc_temperature;int16_t motor_temperature;uint16_t failures;uint8_t "
                  "esc_address;uint8_t esc_cmdcount;uint8_t esc_state;uint8_t actuator_function;int8_t "
                  "esc_power;uint8_t[3] _padding0;",
    "esc_status": "uint64_t timestamp;uint16_t counter;uint8_t esc_count;uint8_t esc_connectiontype;uint8_t "
                  "esc_online_flags;uint8_t esc_armed_flags;uint8_t[2] _padding0;esc_report[8] esc;",
}  # fmt: skip

# nav_state of vehicle_status by mode name
_NAV_STATE = {"POSCTL": 2, "LOITER": 4, "RTL": 5, "DESCEND": 12, "OFFBOARD": 14, "TAKEOFF": 17, "LAND": 18}
_HIGH_RATE_PROFILES = 8 | 16  # SDLOG_PROFILE: system identification, high rate


def rates_hz(profile: int, imu_hz: float) -> dict[str, float]:
    """Topic rates by profile; with a high-rate profile the inertial and motor topics follow the IMU."""
    fast = bool(profile & _HIGH_RATE_PROFILES)
    return {
        "sensor_combined": imu_hz,
        "vehicle_angular_velocity": imu_hz if fast else 100.0,
        "vehicle_acceleration": imu_hz if fast else 20.0,
        "actuator_motors": imu_hz if fast else 10.0,
        "actuator_outputs": 10.0,
        "battery_status": 5.0,
        "vehicle_attitude": 250.0 if fast else 20.0,
        "vehicle_local_position": 125.0 if fast else 10.0,
        "vehicle_attitude_groundtruth": 100.0,
        "vehicle_angular_velocity_groundtruth": 100.0,
        "vehicle_local_position_groundtruth": 50.0,
        "trajectory_setpoint": 5.0,
        "vehicle_status": 2.0,
        "vehicle_land_detected": 1.0,
        "vehicle_visual_odometry": 30.0,
        "esc_status": 250.0 if fast else 4.0,
    }


class Px4Log:
    """One log from arming to disarming.

    Args:
        a: the autopilot whose state is written.
        data: where the bytes go; readable at any time.
    """

    def __init__(self, a: Px4, data: bytearray):
        formats = dict(FORMATS)
        self._rates = rates_hz(int(a.parameters["SDLOG_PROFILE"]), a.imu_rate_hz)
        if not a.has_esc_telemetry:
            del formats["esc_status"], formats["esc_report"]
        info = {"sys_name": "PX4", "ver_hw": "PX4_SITL", "ver_sw_release": 17891392, "ver_sw_branch": "emulated"}
        parameters = [(p.name, p.is_float, p.value) for p in a.parameters.all]
        self._ulog = ULogWriter(a.boot_us, formats, info, parameters, data)
        self._next = {topic: -1.0 for topic in self._rates if topic in formats}

    def text(self, time_us: int, text: str) -> None:
        """A logged string."""
        self._ulog.text(time_us, 6, text)

    def parameter(self, name: str, is_float: bool, value: float) -> None:
        """A parameter that changed."""
        self._ulog.parameter(name, is_float, value)

    def _due(self, topic: str, time_s: float) -> bool:
        if topic not in self._next or time_s < self._next[topic]:
            return False
        period = 1.0 / self._rates[topic]
        self._next[topic] = max(self._next[topic] + period, time_s + 0.5 * period)
        return True

    def tick(self, a: Px4) -> None:
        """Whatever is due in this cycle."""
        t, add = a.boot_us, self._ulog.add
        due = [topic for topic in self._next if self._due(topic, a.time_s)]
        gyro, force = flip(a.imu.gyro_rad_s), flip(a.imu.accel_m_s2)
        period_us = round(1e6 / a.imu_rate_hz)
        controls = [*a.commands, *[math.nan] * (12 - len(a.commands))] if a.armed else [math.nan] * 12
        for topic in due:
            match topic:
                case "sensor_combined":
                    add(topic, t, *gyro, period_us, 0, *force, period_us, 0, 0, 1, 1)
                case "vehicle_angular_velocity":
                    add(topic, t, t, *gyro, *a.angular_acceleration_frd)
                case "vehicle_acceleration":
                    add(topic, t, t, *force)
                case "actuator_motors":
                    add(topic, t, t, *controls, 0)
                case "actuator_outputs":
                    add(topic, t, 16, *a.pulse_widths_us)
                case "battery_status":
                    left = a.battery.percent / 100
                    add(
                        topic,
                        t,
                        a.truth.voltage_v,
                        a.truth.current_a,
                        a.battery.used_mah,
                        left,
                        True,
                        4,
                        1,
                        a.battery.charge_state - 1,
                    )
                case "vehicle_attitude":
                    add(topic, t, t, *flip_quaternion(a.estimate.quaternion), 1.0, 0.0, 0.0, 0.0, 0)
                case "vehicle_local_position":
                    e = a.estimate
                    add(topic, t, t, *flip(e.position_m), *flip(e.velocity_m_s), e.position_valid, True)
                case "vehicle_attitude_groundtruth":
                    add(topic, t, t, *flip_quaternion(a.truth.quaternion), 1.0, 0.0, 0.0, 0.0, 0)
                case "vehicle_angular_velocity_groundtruth":
                    add(topic, t, t, *flip(a.truth.rate_rad_s), 0.0, 0.0, 0.0)
                case "vehicle_local_position_groundtruth":
                    add(topic, t, t, *flip(a.truth.position_m), *flip(a.truth.velocity_m_s), True, True)
                case "trajectory_setpoint":
                    s = a.setpoint
                    vectors = (*flip(s.position_m), *flip(s.velocity_m_s), *flip(s.acceleration_m_s2))
                    add(topic, t, *vectors, math.nan, math.nan, math.nan, -s.yaw_rad, -s.yaw_rate_rad_s)
                case "vehicle_status":
                    state, wanted = _NAV_STATE[a.mode.name], _NAV_STATE[a.intention]
                    add(topic, t, 2 if a.armed else 1, wanted, state, a.failsafe, not a.gcs_alive)
                case "vehicle_land_detected":
                    add(topic, t, a.landed, a.truth.on_ground, a.landed)
                case "vehicle_visual_odometry":
                    if a.last_vision is not None:
                        add(topic, t, a.last_vision[0], *a.last_vision[1], *a.last_vision[2])
                case "esc_status":
                    self._esc(a, t)

    def _esc(self, a: Px4, t: int) -> None:
        count = len(a.truth.rotor_speed_rad_s)
        share = a.truth.current_a / count
        reports: list[float] = []
        for index in range(8):
            on = index < count
            rpm = round(a.truth.rotor_speed_rad_s[index] * 30.0 / math.pi) if on else 0
            volt, amp = (a.truth.voltage_v, share) if on else (0.0, 0.0)
            reports += [
                t if on else 0,
                0,
                rpm,
                volt,
                amp,
                30.0,
                0,
                0,
                index,
                0,
                0,
                101 + index if on else 0,
                0,
                0,
                0,
                0,
            ]
        self._ulog.add("esc_status", t, a.counter, count, 0, (1 << count) - 1, (1 << count) - 1, 0, 0, *reports)
