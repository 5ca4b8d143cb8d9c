"""The emulated ArduCopter: silence until asked, arming, GUIDED, take-off, failsafes, external vision."""

from __future__ import annotations

import math

import pytest

from drivers.mavlink.dialect import mavlink
from sim.mavlink.arducopter import ArduCopter
from tests.emulated import RigidAirframe, Station, position_setpoint, quadrotor

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
SET_MODE, ARM = mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_CMD_COMPONENT_ARM_DISARM
TAKEOFF, LAND = mavlink.MAV_CMD_NAV_TAKEOFF, mavlink.MAV_CMD_NAV_LAND
INTERVAL = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
GUIDED = 4


def station(boot_s: float = 60.0) -> Station:
    vehicle = quadrotor()
    return Station(ArduCopter(vehicle, RigidAirframe(vehicle), boot_s=boot_s), step_s=0.005)


def set_parameter(s: Station, name: str, value: float):
    kind = mavlink.MAV_PARAM_TYPE_REAL32
    return s.request(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, kind), "PARAM_VALUE")


def stored(s: Station, name: str, value: float) -> float | None:
    told = set_parameter(s, name, value)
    return None if told is None else told.param_value


def airborne(s: Station, height_m: float = 1.5) -> None:
    assert s.command(SET_MODE, 1, GUIDED) == ACCEPTED
    assert s.command(ARM, 1) == ACCEPTED
    assert s.command(TAKEOFF, 0, 0, 0, 0, 0, 0, height_m) == ACCEPTED
    assert s.run(12.0, lambda: s.autopilot.guidance.done)
    s.run(1.0)


def test_it_sends_only_its_heartbeat_until_asked():
    s = station()
    s.run(5.0)
    assert {r.name for _, r in s.heard} == {"HEARTBEAT", "TIMESYNC"}, "the latter every ten seconds"


def test_300_hz_comes_at_333_and_400_is_denied():
    s = station()
    assert s.command(INTERVAL, 31, 3333) == ACCEPTED
    assert s.command(INTERVAL, 36, 2500) == DENIED
    assert s.command(INTERVAL, 331, 20000) == DENIED, "ODOMETRY is not sent"
    since = s.now_s
    s.run(2.0)
    assert s.rate_hz("ATTITUDE_QUATERNION", since) == pytest.approx(333.3, rel=0.01)


def test_the_local_position_is_acknowledged_but_silent_until_the_estimator_has_one():
    s = station(boot_s=38.0)
    assert s.command(INTERVAL, 32, 20000) == ACCEPTED
    s.run(2.0)
    assert not s.named("LOCAL_POSITION_NED")
    assert s.command(ARM, 1) == FAILED
    assert s.texts()[-1] == "Arm: Need Position Estimate"
    s.run(2.0)
    assert s.named("LOCAL_POSITION_NED")
    assert s.command(ARM, 1) == ACCEPTED


def test_take_off_needs_guided_and_arming_and_reaches_its_height():
    s = station()
    assert s.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 1.5) == FAILED
    airborne(s)
    s.run(3.0)
    assert s.autopilot.truth.position_m[2] == pytest.approx(1.5, abs=0.1)


def test_guided_follows_position_and_yaw_and_lands_and_disarms_by_itself():
    s = station()
    s.command(INTERVAL, 32, 20000)
    airborne(s)
    s.repeating = lambda _: position_setpoint(0.6, 0.3, 1.2, yaw=-0.4)
    s.run(8.0)
    position = s.named("LOCAL_POSITION_NED")[-1]
    assert (position.x, -position.y, -position.z) == pytest.approx((0.6, 0.3, 1.2), abs=0.1)
    assert s.command(LAND) == ACCEPTED
    assert s.named("HEARTBEAT")[-1].custom_mode == 9
    assert s.run(15.0, lambda: not s.autopilot.armed)
    assert "Disarming motors" in s.texts()


def test_without_a_yaw_command_it_turns_to_face_along_the_path():
    s = station()
    airborne(s)

    def sideways(_: float):
        return mavlink.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, 1, 7 | 448 | 1024 | 2048, 0.0, 0.0, 0.0, 0.0, 0.8, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        )

    s.repeating = sideways
    s.run(3.0)
    w, x, y, z = s.autopilot.estimate.quaternion
    assert math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) == pytest.approx(-math.pi / 2, abs=0.15)


def test_setpoints_that_stop_leave_it_hovering_after_the_timeout():
    s = station()
    airborne(s)

    def moving(_: float):
        return mavlink.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, 1, 7 | 448 | 2048, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        )

    s.repeating = moving
    s.run(2.0)
    s.repeating = None
    s.run(2.5)
    assert s.autopilot.truth.velocity_m_s[0] == pytest.approx(0.5, abs=0.1)
    s.run(3.5)
    assert s.autopilot.truth.velocity_m_s[0] == pytest.approx(0.0, abs=0.05)
    assert s.autopilot.mode.name == "GUIDED"


def test_it_disarms_after_ten_idle_seconds_on_the_ground():
    s = station()
    s.command(SET_MODE, 1, GUIDED)
    s.command(ARM, 1)
    armed = s.now_s
    assert s.run(12.0, lambda: not s.autopilot.armed)
    assert s.now_s - armed == pytest.approx(10.0, abs=0.2)


def test_external_vision_needs_its_settings_and_an_origin_and_8_seconds_without_it_land():
    s = station()
    for name, value in (("VISO_TYPE", 1), ("EK3_SRC1_POSXY", 6), ("GPS1_TYPE", 0)):
        assert stored(s, name, value) == value
    assert stored(s, "VISO_DELAY_MS", 20) is None, "hidden until it starts with a VISO_TYPE"
    s.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0)
    assert stored(s, "VISO_DELAY_MS", 20) == 20

    def pose(_: float):
        x, y, z = s.autopilot.truth.position_m
        return mavlink.MAVLink_vision_position_estimate_message(0, x, -y, -z, 0.0, 0.0, 0.0)

    s.repeating = pose
    s.run(1.0)
    assert not s.autopilot.estimate.position_valid, "no origin yet"
    s.send(mavlink.MAVLink_set_gps_global_origin_message(1, 473977420, 85455940, 488100))
    s.run(1.0)
    assert s.autopilot.estimate.position_valid
    airborne(s, 1.0)
    stopped, s.repeating = s.now_s, None
    assert s.run(10.0, lambda: s.autopilot.mode.name == "LAND")
    assert s.now_s - stopped == pytest.approx(8.0, abs=0.1)
    assert s.run(15.0, lambda: not s.autopilot.armed), "it comes down without a position"


def test_a_silent_station_lands_it_when_the_failsafe_says_so():
    s = station()
    set_parameter(s, "FS_GCS_ENABLE", 5)
    airborne(s)
    s.heartbeats, silent = False, s.now_s
    assert s.run(8.0, lambda: s.autopilot.mode.name == "LAND")
    assert 4.0 < s.now_s - silent < 6.1


def test_the_fence_lands_it():
    s = station()
    for name, value in (("FENCE_ENABLE", 1), ("FENCE_TYPE", 2), ("FENCE_RADIUS", 1.0), ("FENCE_ACTION", 2)):
        set_parameter(s, name, value)
    airborne(s)
    s.repeating = lambda _: position_setpoint(3.0, 0.0, 1.5)
    assert s.run(8.0, lambda: s.autopilot.mode.name == "LAND")
    assert s.autopilot.distance_from_home[0] > 1.0


def test_a_parameter_takes_any_type_and_an_unknown_one_is_met_with_silence():
    s = station()
    integer = mavlink.MAVLink_param_set_message(1, 1, b"GUID_TIMEOUT", 5.0, mavlink.MAV_PARAM_TYPE_INT8)
    told = s.request(integer, "PARAM_VALUE")
    assert told is not None and told.param_value == 5.0
    unknown = mavlink.MAVLink_param_request_read_message(1, 1, b"NO_SUCH_PARAM", -1)
    assert s.request(unknown, "PARAM_VALUE") is None


def test_1362_parameters_in_0_9_seconds():
    s = station()
    s.send(mavlink.MAVLink_param_request_list_message(1, 1))
    s.run(0.95)
    assert len(s.named("PARAM_VALUE")) == 1362
