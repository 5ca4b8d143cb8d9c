"""Preflight: each check fails on what it is for, says figures and remedy, and none disappears."""

from __future__ import annotations

import math

import pytest
from mavlink_vehicle import Rig, small_plan

from groundstation.errors import BadInput
from groundstation.flight.link.preflight import Situation, failures, run_checks
from groundstation.flight.station import station_from_dict


@pytest.fixture(scope="module")
def ready() -> Rig:
    rig = Rig("px4")
    rig.prepare()
    return rig


def situation(rig: Rig, **changes) -> Situation:
    from dataclasses import replace

    given = Situation(
        rig.now_s, rig.core.view, rig.core.station, rig.core.vehicle, small_plan(), rig.core.parameters, 0.001
    )
    return replace(given, **changes)


def answer(rig: Rig, name: str, **changes):
    (found,) = [c for c in run_checks(situation(rig, **changes)) if c.name == name]
    return found


def changed(rig: Rig, **fields):
    """A copy of the view with some of it changed."""
    from copy import copy

    view = copy(rig.core.view)
    for name, value in fields.items():
        setattr(view, name, value)
    return view


def test_a_vehicle_that_is_ready_passes_everything(ready):
    checks = run_checks(situation(ready))
    assert failures(checks) == ""
    names = [c.name for c in checks]
    assert len(names) == len(set(names))
    assert {
        "link",
        "streams",
        "arming",
        "disarmed",
        "estimate",
        "clock",
        "battery",
        "log",
        "disk",
        "poses",
        "plan",
        "room",
        "vibration",
        "oscillation",
        "COM_OBL_RC_ACT",
    } <= set(names)
    assert all(c.reason for c in checks)


@pytest.mark.parametrize(
    ("name", "fields", "says"),
    [
        ("link", {"heartbeat_s": -math.inf}, "no heartbeat"),
        ("arming", {"checks_pass": False}, "would not arm"),
        ("disarmed", {"armed": True}, "armed: True"),
        ("disarmed", {"on_ground": False}, "on the ground: False"),
        ("estimate", {"state": None}, "no position"),
        ("battery", {"battery_remaining": 0.1}, "10 %"),
        ("battery", {"battery_remaining": None, "battery": None}, "no battery"),
        ("vibration", {"vibration_m_s2": (5.0, 70.0, 5.0)}, "70.0"),
        ("streams", {"meters": {}}, "needed 20 Hz"),
        ("log", {"logs": False}, "does not work"),
        ("log", {"log_room_mib": 0.0}, "0 MiB free"),
        ("log", {"log_room_mib": 30.0}, "43 MiB wanted"),
    ],
)
def test_each_check_fails_with_reason_and_remedy(ready, name, fields, says):
    found = answer(ready, name, view=changed(ready, **fields))
    assert not found.ok
    assert says in found.reason
    assert found.remedy


def test_a_full_disk_is_seen_before_the_flight(ready):
    assert not answer(ready, "disk", disk_free_bytes=20 << 20).ok
    assert answer(ready, "disk", disk_free_bytes=1 << 30).ok


def test_a_parameter_that_cannot_be_read_is_a_failure_not_a_silence(ready):
    assert not answer(ready, "COM_OBL_RC_ACT", parameters={}).ok
    assert answer(ready, "GF_ACTION", parameters={}).ok, "advice only"
    unfenced = answer(ready, "GF_MAX_HOR_DIST", parameters={"GF_MAX_HOR_DIST": 0.0})
    assert unfenced.ok and "no geofence" in unfenced.reason
    assert "no geofence" not in answer(ready, "GF_MAX_HOR_DIST", parameters={"GF_MAX_HOR_DIST": 4.0}).reason


def test_a_plan_that_leaves_the_room_or_exceeds_the_vehicle_is_refused(ready):
    low = station_from_dict({"box": {"z_m": [-0.5, 0.8]}})
    found = answer(ready, "room", station=low)
    assert not found.ok
    assert "z" in found.reason
    wild = small_plan(base_frequency_rad_s=8.0)
    wild = wild.model_copy(
        update={"coefficients": wild.coefficients.model_copy(
            update={"x": wild.coefficients.x.model_copy(update={"a": (4.0,), "b": (0.0,)})}
        )}
    )  # fmt: skip
    found = answer(ready, "plan", plan=wild)
    assert not found.ok
    assert "tilt" in found.reason


def test_the_clock_matters_where_poses_are_stamped_on_it(ready):
    assert answer(ready, "clock", clock_error_s=0.2).ok
    watched = station_from_dict({"mocap": {"system": "natnet"}})
    assert not answer(ready, "clock", clock_error_s=0.2, station=watched).ok
    assert not answer(ready, "clock", clock_error_s=math.inf, station=watched).ok


def test_motion_capture_without_poses_is_refused(ready):
    watched = station_from_dict({"mocap": {"system": "natnet", "host": "10.0.0.7"}})
    found = answer(ready, "poses", station=watched)
    assert not found.ok
    assert "10.0.0.7" in found.reason
    assert not answer(ready, "frames", station=watched).ok


def test_force_answers_for_the_named_check_alone(ready):
    view = changed(ready, battery_remaining=0.1, checks_pass=False)
    checks = {c.name: c for c in run_checks(situation(ready, view=view), force=("battery",))}
    assert checks["battery"].ok
    assert checks["battery"].forced
    assert not checks["arming"].ok
    with pytest.raises(BadInput, match="no such check"):
        run_checks(situation(ready), force=("battrey",))


def test_a_trajectory_the_autopilot_would_smooth_is_refused_and_the_limit_named():
    """Seen on ArduCopter's firmware: at its default jerk limit of 5 m/s^3 it flew another path, 0.65 m off after 3
    s.
    """
    rig = Rig("arducopter")
    rig.prepare()
    quick = small_plan(base_frequency_rad_s=6.2832, periods=10.0)  # jerk of 0.3 m/s * (6.28 rad/s)^2 = 11.8 m/s^3
    slow = {"PSC_JERK_NE": 5.0, "PSC_JERK_D": 5.0, "WP_ACC": 2.5}
    found = answer(rig, "plan", plan=quick, parameters=slow)
    assert not found.ok and "horizontal jerk 11.8 m/s^3" in found.reason and "to 5.0" in found.reason
    assert answer(rig, "plan", plan=small_plan(), parameters=slow).ok
    assert answer(rig, "plan", plan=quick, parameters={"PSC_JERK_NE": 50.0, "PSC_JERK_D": 50.0, "WP_ACC": 10.0}).ok
    before = {"PSC_JERK_XY": 20.0, "PSC_JERK_Z": 20.0, "WPNAV_ACCEL": 250.0}  # until 4.6: cm/s^2
    assert "to 10.8" in answer(rig, "plan", plan=quick, parameters=before).reason


@pytest.mark.parametrize(
    ("version", "name", "other"), [((4, 7), "WP_ACC", "WPNAV_ACCEL"), ((4, 6), "WPNAV_ACCEL", "WP_ACC")]
)
def test_parameters_that_were_renamed_are_asked_for_by_the_version_s_name(version, name, other):
    from groundstation.flight.link.profiles import PROFILES

    rules = {r.name: r for r in PROFILES["arducopter"].parameters}
    assert rules[name].concerns(version, indoors=False) and not rules[other].concerns(version, indoors=False)
    assert rules[name].holds(2 * rules[name].accepted[0]) and not rules[name].holds(0.5 * rules[name].accepted[0])


def test_what_the_autopilot_says_against_arming_stands_alone(ready):
    texts = ["critical: Scripting: restarted", "critical: PreArm: Compass not healthy"]
    view = changed(ready, checks_pass=False, texts=texts)
    assert answer(ready, "arming", view=view).reason.startswith(
        "the autopilot would not arm: critical: PreArm: Compass not healthy"
    )
    view = changed(ready, checks_pass=False, texts=texts[:1])
    assert "Scripting: restarted" in answer(ready, "arming", view=view).reason


def test_px4_tells_in_its_health_bits_alone_whether_it_would_arm():
    """Seen on its firmware: SYS_STATUS never says that the arming check is present."""
    from drivers.mavlink.codec import MavlinkCodec
    from drivers.mavlink.dialect import mavlink
    from groundstation.flight.link.profiles import PROFILES
    from groundstation.flight.link.view import VehicleView

    for health, passes in ((52463679, False), (52463679 | 1 << 28, True)):
        view = VehicleView(PROFILES["px4"]())
        sent = mavlink.MAVLink_sys_status_message(50380815, 50446351, health, 0, 16200, -1, 100, 0, 0, 0, 0, 0, 0)
        for received in MavlinkCodec().decode(MavlinkCodec(1, 1).encode(sent), datagram=True):
            view.message(received, 1.0)
        assert view.checks_pass is passes
        assert set(view.unhealthy) == {"xy position control", "rc receiver"}


def test_an_estimator_that_announces_a_reset_without_a_jump_does_not_end_a_flight():
    """PX4 counts its heading's alignment a metre and a half after each take-off."""
    from drivers.mavlink.codec import MavlinkCodec
    from drivers.mavlink.dialect import mavlink
    from groundstation.flight.link.profiles import PROFILES
    from groundstation.flight.link.view import VehicleView

    view, codec, sender = VehicleView(PROFILES["px4"]()), MavlinkCodec(), MavlinkCodec(1, 1)
    for n in range(4):
        sent = mavlink.MAVLink_odometry_message(
            1_000_000 + 10_000 * n, 1, 12, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0, 0, 0, 0, [0] * 21, [0] * 21, n // 2
        )
        for received in codec.decode(sender.encode(sent), datagram=True):
            view.message(received, 1.0)
    assert view.resets == 1 and view.take_jump() == 0.0
