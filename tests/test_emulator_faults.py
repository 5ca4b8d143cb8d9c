"""Faults of the emulated vehicle show on the wire as a real vehicle's would."""

from __future__ import annotations

import pytest

from drivers.mavlink.dialect import mavlink
from groundstation.errors import BadInput
from sim.mavlink.arducopter import ArduCopter
from sim.mavlink.faults import FAULTS, FaultSchedule, parse_fault
from sim.mavlink.px4 import Px4
from tests.emulated import RigidAirframe, Station, position_setpoint, quadrotor

SET_MODE, ARM = mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_CMD_COMPONENT_ARM_DISARM


def flying(kind) -> Station:
    vehicle = quadrotor()
    s = Station(kind(vehicle, RigidAirframe(vehicle), boot_s=60.0))
    s.repeating = lambda _: position_setpoint(0.0, 0.0, 1.0)
    s.run(0.2)
    assert s.command(SET_MODE, 1, 6 if kind is Px4 else 4) == 0
    assert s.command(ARM, 1) == 0
    if kind is ArduCopter:
        s.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 1.0)
    assert s.run(10.0, lambda: s.autopilot.truth.position_m[2] > 0.8)
    return s


@pytest.mark.parametrize("kind", [Px4, ArduCopter])
def test_a_reboot_in_flight_stops_the_rotors_forgets_the_streams_and_starts_the_clock_anew(kind):
    s = flying(kind)
    s.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 105 if kind is Px4 else 27, 5000)
    FAULTS["reboot"](s.autopilot)
    since = s.now_s
    s.run(2.0)
    beat = s.named("HEARTBEAT", since)[-1]
    assert not beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert s.autopilot.time_s == pytest.approx(2.0, abs=0.01)
    assert s.autopilot.truth.on_ground, "it fell"
    assert s.rate_hz("HIGHRES_IMU" if kind is Px4 else "RAW_IMU", since) < 60.0
    s.run(3.0)
    assert not s.autopilot.armed, "set-points alone do not start it again"


@pytest.mark.parametrize(("kind", "mode"), [(Px4, "POSCTL"), (ArduCopter, "LOITER")])
def test_a_pilot_who_takes_over_keeps_it_though_setpoints_go_on(kind, mode):
    s = flying(kind)
    FAULTS["pilot"](s.autopilot)
    s.repeating = lambda _: position_setpoint(2.0, 0.0, 1.0)
    s.run(3.0)
    assert s.autopilot.mode.name == mode
    assert abs(s.autopilot.truth.position_m[0]) < 0.5


def test_arming_is_denied_with_a_text():
    vehicle = quadrotor()
    s = Station(Px4(vehicle, RigidAirframe(vehicle), boot_s=60.0))
    FAULTS["deny-arming"](s.autopilot)
    assert s.command(ARM, 1) == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    s.run(0.1)
    assert any("Compass" in text for text in s.texts())


def test_a_low_battery_returns_px4_home_and_shows_in_its_status():
    s = flying(Px4)
    FAULTS["battery-low"](s.autopilot)
    assert s.run(1.0, lambda: s.autopilot.mode.name == "RTL")
    s.run(1.0)
    assert s.named("SYS_STATUS")[-1].battery_remaining == 6


def test_an_estimator_reset_jumps_and_counts():
    s = flying(Px4)
    before = s.named("ODOMETRY")[-1]
    FAULTS["estimator-reset"](s.autopilot)
    s.run(0.1)
    after = s.named("ODOMETRY")[-1]
    assert after.x - before.x == pytest.approx(0.5, abs=0.1)
    assert after.reset_counter == before.reset_counter + 1


def test_a_silent_vehicle_sends_nothing_and_flies_on():
    s = flying(Px4)
    FAULTS["silent"](s.autopilot)
    since = s.now_s
    s.run(1.0)
    assert not [t for t, _ in s.heard if t > since]
    assert s.autopilot.armed


def test_faults_come_in_order_once_and_unknown_ones_are_named():
    vehicle = quadrotor()
    a = Px4(vehicle, RigidAirframe(vehicle))
    schedule = FaultSchedule([parse_fault("battery-low@5"), parse_fault("deny-arming@2")])
    schedule.apply(a, 2.5)
    assert a.deny_arming is not None
    assert a.battery.stuck_percent is None
    schedule.apply(a, 6.0)
    assert a.battery.stuck_percent == 6
    with pytest.raises(BadInput, match=r"there is no fault 'gremlin'; there are deny-arming, pilot"):
        parse_fault("gremlin@3")
    with pytest.raises(BadInput, match="pilot@SECONDS"):
        parse_fault("pilot")
