"""The emulated PX4: offboard and its traps, arming, failsafes, parameters, estimator, logs."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from drivers.mavlink.dialect import mavlink
from sim.mavlink.px4 import Px4
from tests.emulated import RigidAirframe, Station, position_setpoint, quadrotor

OFFBOARD, LAND, RTL, LOITER, POSCTL = 6 << 16, 4 << 16 | 6 << 24, 4 << 16 | 5 << 24, 4 << 16 | 3 << 24, 3 << 16
ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
SET_MODE, ARM = mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_CMD_COMPONENT_ARM_DISARM
INTERVAL = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL


def station(**vehicle) -> Station:
    declared = quadrotor(**vehicle)
    return Station(Px4(declared, RigidAirframe(declared), boot_s=30.0))


def set_parameter(s: Station, name: str, value: float, kind: int = mavlink.MAV_PARAM_TYPE_INT32):
    field = struct.unpack("<f", struct.pack("<i", int(value)))[0] if kind == mavlink.MAV_PARAM_TYPE_INT32 else value
    return s.request(mavlink.MAVLink_param_set_message(1, 1, name.encode(), field, kind), "PARAM_VALUE")


def airborne(s: Station, height_m: float = 1.5) -> None:
    """In OFFBOARD at a height, set-points flowing."""
    s.repeating = lambda _: position_setpoint(0.0, 0.0, height_m)
    s.run(0.5)
    assert s.command(SET_MODE, 1, 6) == ACCEPTED
    assert s.command(ARM, 1) == ACCEPTED
    assert s.run(12.0, lambda: abs(s.autopilot.truth.position_m[2] - height_m) < 0.2)
    s.run(2.0)


def test_offboard_is_accepted_disarmed_and_without_setpoints_but_does_not_arm():
    s = station()
    assert s.command(SET_MODE, 1, 6) == ACCEPTED
    s.run(1.2)
    assert s.named("HEARTBEAT")[-1].custom_mode == OFFBOARD
    assert s.named("HEARTBEAT")[-1].system_status == mavlink.MAV_STATE_UNINIT
    assert s.command(ARM, 1) == REJECTED
    s.run(0.1)
    assert "Arming denied: Resolve system health failures first" in s.texts()


def test_lost_setpoints_fail_safe_between_1_000_and_1_1_seconds():
    s = station()
    airborne(s)
    stopped, s.repeating = s.now_s, None
    s.run(1.5, lambda: "Failsafe activated" in s.texts(stopped))
    assert 0.98 <= s.now_s - stopped <= 1.13
    s.run(1.1)
    beat = s.named("HEARTBEAT")[-1]
    assert (beat.custom_mode, beat.system_status) == (RTL, mavlink.MAV_STATE_CRITICAL)


def test_resumed_setpoints_re_enter_offboard_without_a_mode_command():
    s = station()
    airborne(s)
    s.repeating = None
    s.run(1.5)
    assert s.autopilot.mode.name == "RTL"
    s.send(position_setpoint(0.0, 0.0, 1.5))
    s.run(0.024)
    assert s.autopilot.mode.name == "OFFBOARD"
    assert not s.autopilot.failsafe


def test_a_vehicle_on_the_ground_still_armed_takes_off_again_on_resumed_setpoints():
    s = station()
    set_parameter(s, "COM_DISARM_LAND", -1.0, mavlink.MAV_PARAM_TYPE_REAL32)
    airborne(s, 1.0)
    s.repeating = None
    assert s.run(15.0, lambda: "Landing detected" in s.texts(2.0))
    assert s.autopilot.armed
    s.repeating = lambda _: position_setpoint(0.0, 0.0, 1.0)
    assert s.run(5.0, lambda: s.autopilot.truth.position_m[2] > 0.5), "the trap the station must not step into"


def test_after_a_commanded_landing_it_disarms_2_seconds_after_touch_down_and_shows_offboard_again():
    s = station()
    airborne(s, 1.0)
    assert s.command(SET_MODE, 1, 4, 6) == ACCEPTED
    s.repeating = None
    assert s.run(15.0, lambda: "Landing detected" in s.texts(2.0))
    landed = s.now_s
    assert s.run(3.0, lambda: not s.autopilot.armed)
    assert s.now_s - landed == pytest.approx(2.0, abs=0.05)
    s.run(1.2)
    assert s.named("HEARTBEAT")[-1].custom_mode == OFFBOARD
    assert "Disarmed by landing" in s.texts()


def test_no_setpoint_after_a_commanded_landing_brings_offboard_back():
    s = station()
    airborne(s)
    s.command(SET_MODE, 1, 4, 6)
    s.run(3.0)  # set-points go on
    assert s.autopilot.mode.name == "LAND"


def test_disarming_in_the_air_is_denied_and_forced_disarming_is_not():
    s = station()
    airborne(s)
    assert s.command(ARM, 0) == REJECTED
    s.run(0.1)
    assert "Disarming denied: not landed" in s.texts()
    assert s.command(ARM, 0, 21196) == ACCEPTED
    assert not s.autopilot.armed


def test_it_goes_where_offboard_tells_it():
    s = station()
    airborne(s)
    s.repeating = lambda _: position_setpoint(0.7, -0.4, 1.2, yaw=0.5)
    s.run(8.0)
    position = s.named("LOCAL_POSITION_NED")[-1]
    assert (position.x, -position.y, -position.z) == pytest.approx((0.7, -0.4, 1.2), abs=0.15)
    assert -s.named("ATTITUDE")[-1].yaw == pytest.approx(0.5, abs=0.03)


def test_a_lost_station_holds_after_12_4_seconds_and_returns_5_seconds_later_for_good():
    s = station()
    set_parameter(s, "NAV_DLL_ACT", 2)
    airborne(s)
    s.heartbeats, silent = False, s.now_s
    assert s.run(14.0, lambda: s.autopilot.mode.name == "LOITER")
    assert 11.3 < s.now_s - silent <= 12.6
    held = s.now_s
    assert s.run(6.0, lambda: s.autopilot.mode.name == "RTL")
    assert s.now_s - held == pytest.approx(5.0, abs=0.1)
    s.heartbeats = True
    s.run(1.0)
    assert s.autopilot.mode.name == "RTL"


def test_the_geofence_acts_as_its_parameter_says():
    s = station()
    set_parameter(s, "GF_ACTION", 5)
    set_parameter(s, "GF_MAX_HOR_DIST", 1.0, mavlink.MAV_PARAM_TYPE_REAL32)
    airborne(s)
    s.repeating = lambda _: position_setpoint(2.5, 0.0, 1.5)
    assert s.run(8.0, lambda: s.autopilot.mode.name == "LAND")
    assert s.autopilot.distance_from_home[0] > 1.0


def test_a_parameter_of_the_wrong_type_keeps_its_value_and_an_unknown_one_is_an_error():
    s = station()
    wrong = mavlink.MAVLink_param_set_message(1, 1, b"NAV_DLL_ACT", 3.0, mavlink.MAV_PARAM_TYPE_REAL32)
    assert s.request(wrong, "PARAM_ERROR") is not None
    read = mavlink.MAVLink_param_request_read_message(1, 1, b"NAV_DLL_ACT", -1)
    answer = s.request(read, "PARAM_VALUE")
    assert struct.unpack("<i", struct.pack("<f", answer.param_value))[0] == 0
    unknown = mavlink.MAVLink_param_request_read_message(1, 1, b"NO_SUCH_PARAM", -1)
    assert s.request(unknown, "PARAM_ERROR").error == mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST


def test_all_888_parameters_come_in_the_firmwares_order():
    s = station()
    s.send(mavlink.MAVLink_param_request_list_message(1, 1))
    s.run(1.5)
    got = [m for m in s.named("PARAM_VALUE") if m.param_index < 888]
    assert [m.param_index for m in got] == list(range(888))
    assert next(m.param_index for m in got if m.param_id == "MPC_XY_VEL_MAX") == 623  # as recorded


@pytest.mark.parametrize(
    ("name", "number", "asked_us", "hz"),
    [
        ("HIGHRES_IMU", 105, 4000, 250.0),
        ("HIGHRES_IMU", 105, 5000, 125.0),
        ("ATTITUDE_QUATERNION", 31, 1000, 186.0),
        ("LOCAL_POSITION_NED", 32, 1000, 123.0),
        ("SERVO_OUTPUT_RAW", 36, 10000, 100.0),
        ("BATTERY_STATUS", 147, 1000, 99.0),
    ],
)
def test_a_message_comes_no_faster_than_measured_whatever_is_granted(name, number, asked_us, hz):
    s = station()
    assert s.command(INTERVAL, number, asked_us) == ACCEPTED
    since = s.now_s
    s.run(2.0)
    assert s.rate_hz(name, since) == pytest.approx(hz, rel=0.02)
    interval = s.request(
        mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, 0, number, 0, 0, 0, 0, 0, 0),
        "MESSAGE_INTERVAL",
    )
    assert interval.interval_us == asked_us, "what is reported is what was asked for, not what comes"


def test_raw_imu_is_refused_and_esc_status_granted_but_silent_where_escs_do_not_report():
    s = station()
    assert s.command(INTERVAL, 27, 20000) == FAILED
    assert s.command(INTERVAL, 291, 20000) == ACCEPTED
    s.run(1.0)
    assert not s.named("ESC_STATUS")


def test_esc_status_tells_the_rotor_speeds_where_escs_report():
    s = station(input="rotor_speed", thrust_coefficient_n_s2=8e-6, speed_max_rad_s=790.0, thrust_curve=None)
    assert s.command(INTERVAL, 291, 20000) == ACCEPTED
    airborne(s)
    report = s.named("ESC_STATUS")[-1]
    hover = math.sqrt(9.80665 / 4 / 8e-6)
    assert np.array(report.rpm) * math.pi / 30 == pytest.approx([hover] * 4, rel=0.05)


def test_texts_go_only_to_links_with_a_live_ground_station():
    s = station()
    s.heartbeats = False
    s.run(3.0)
    s.command(SET_MODE, 1, 6)
    s.command(ARM, 1)
    s.run(1.0)
    assert not s.texts()
    s.heartbeats = True
    s.run(1.2)
    assert s.texts(), "what is younger than five seconds is told when the station appears"


def test_timesync_answers_with_its_own_clock_in_steps_of_4_ms():
    s = station()
    answer = s.request(mavlink.MAVLink_timesync_message(0, 123456789), "TIMESYNC")
    s.run(0.01)
    replies = [m for m in s.named("TIMESYNC") if m.tc1]
    assert answer is not None
    assert replies[0].ts1 == 123456789
    assert replies[0].tc1 % 4_000_000 == 0
    assert replies[0].tc1 * 1e-9 == pytest.approx(30.0, abs=0.1)


def test_its_clock_drifts_against_the_hosts():
    vehicle = quadrotor()
    s = Station(Px4(vehicle, RigidAirframe(vehicle), boot_s=30.0, clock_drift=-0.012))
    s.run(10.0)
    assert s.autopilot.time_s - 30.0 == pytest.approx(10.0 * 0.988, abs=0.01)


def vision(s: Station, offset=(0.0, 0.0, 0.0), swap: bool = False):
    def message(_: float):
        x, y, z = (a + b for a, b in zip(s.autopilot.truth.position_m, offset, strict=True))
        x, y = (y, x) if swap else (x, y)
        stamp = round(s.autopilot.time_s * 1e6)
        return mavlink.MAVLink_vision_position_estimate_message(stamp, x, -y, -z, 0.0, 0.0, 0.0)

    return message


def test_on_external_vision_the_position_is_that_of_the_poses_and_lost_4_6_seconds_after_them():
    s = station()
    for name, value in (("EKF2_GPS_CTRL", 0), ("EKF2_EV_CTRL", 15), ("SYS_HAS_GPS", 0)):
        set_parameter(s, name, value)
    s.run(1.0)
    since = s.now_s
    s.run(0.5)
    assert not s.named("LOCAL_POSITION_NED", since), "no position before the first pose"
    s.repeating = vision(s, offset=(0.3, 0.2, 0.0))
    s.run(2.0)
    position = s.named("LOCAL_POSITION_NED")[-1]
    assert (position.x, position.y) == pytest.approx((0.3, -0.2), abs=0.02)
    stopped, s.repeating = s.now_s, None
    assert s.run(6.0, lambda: not s.autopilot.estimate.position_valid)
    assert s.now_s - stopped == pytest.approx(4.6, abs=0.1)


def test_odometry_of_a_motion_capture_type_is_not_fused():
    s = station()
    for name, value in (("EKF2_GPS_CTRL", 0), ("EKF2_EV_CTRL", 15), ("SYS_HAS_GPS", 0)):
        set_parameter(s, name, value)

    def odometry(kind: int):
        zero = [0.0] * 21
        return lambda _: mavlink.MAVLink_odometry_message(
            0, 1, 1, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, zero, zero, 0, kind, 100
        )

    s.repeating = odometry(mavlink.MAV_ESTIMATOR_TYPE_MOCAP)
    s.run(1.0)
    assert not s.autopilot.estimate.position_valid
    s.repeating = odometry(mavlink.MAV_ESTIMATOR_TYPE_VISION)
    s.run(1.0)
    assert s.autopilot.estimate.position_valid


def test_reboot_is_denied_and_an_unknown_command_unsupported():
    s = station()
    assert s.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1) == DENIED
    assert s.command(60000) == UNSUPPORTED


def test_a_slow_wire_carries_what_it_can_and_answers_still_come():
    vehicle = quadrotor()
    s = Station(Px4(vehicle, RigidAirframe(vehicle), boot_s=30.0), bytes_per_s=5760.0)
    s.run(5.0)
    carried = sum(len(r.frame.raw) for t, r in s.heard if t > 1.0)
    assert 0.8 * 5760.0 * 4.0 < carried < 1.1 * 5760.0 * 4.0
    assert s.command(SET_MODE, 1, 6) == ACCEPTED
