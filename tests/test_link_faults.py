"""Faults of the link, the vehicle and the station on virtual time: each flight ends on the ground, disarmed, and
silent.
"""

# pyright: reportOptionalMemberAccess=false, reportAttributeAccessIssue=false, reportOptionalOperand=false,
# reportOperatorIssue=false A rig has its pilot and view once it is prepared.

from __future__ import annotations

import pytest
from mavlink_vehicle import Rig, lossy, small_plan

from drivers.samples import Event, Pose
from groundstation.flight.link.phase import Phase

BOTH = pytest.mark.parametrize("kind", ["px4", "arducopter"])
MOCAP = {"indoors": False, "mocap": {"system": "natnet"}, "policy": {"placement": "world"}}


def mask(message) -> int:
    return message.type_mask


def poses(rig: Rig, change=lambda p: p, alive=lambda: True) -> None:
    """Feed poses at 125 Hz that see what the vehicle is."""
    count = 0

    def hook() -> None:
        nonlocal count
        count += 1
        if count % 2 == 0 and alive():
            n, e, d = rig.vehicle.position
            jitter = 1e-5 * (count % 7)
            out = rig.core.pose(Pose(rig.now_s, change((n + jitter, -e, -d)), (1.0, 0.0, 0.0, 0.0)), rig.now_s)
            rig._to_vehicle += out.send

    rig.hooks.append(hook)


@BOTH
def test_a_flight_without_faults_climbs_excites_lands_and_disarms(kind):
    rig = Rig(kind)
    rig.excite()
    assert rig.vehicle.height_m == pytest.approx(1.0, abs=0.1)
    assert rig.finish()
    assert rig.phase is Phase.LANDED
    assert rig.reason == ""
    begun, ended = rig.core.pilot.excitation_s
    assert ended - begun == pytest.approx(small_plan().series().duration_s, abs=0.05)
    assert rig.vehicle.height_m < 0.05


@BOTH
def test_setpoints_leave_at_their_rate_with_position_velocity_acceleration_and_yaw(kind):
    rig = Rig(kind, {"policy": {"setpoint_hz": 50.0}})
    rig.excite()
    before = len(rig.vehicle.setpoints)
    rig.wait(2.5)
    sent = rig.vehicle.setpoints[before:]
    assert len(sent) / 2.5 == pytest.approx(50.0, rel=0.03)
    assert {mask(m) for _, m in sent} == {0}
    assert max(abs(m.vx) for _, m in sent) > 0.2
    assert max(abs(m.afx) for _, m in sent) > 0.2


def test_a_plan_is_placed_where_the_vehicle_stands():
    rig = Rig("px4")
    rig.vehicle.offset = [5.0, -2.0, -1.0]
    rig.excite()
    north = [m.x for _, m in rig.vehicle.setpoints]
    assert min(north) > 4.3
    assert rig.finish()
    assert rig.reason == ""


@BOTH
def test_a_gap_of_a_fifth_of_a_second_is_forgiven(kind):
    rig = Rig(kind)
    rig.excite()
    end = rig.now_s + 0.2
    rig.up = rig.down = lambda frames: [] if rig.now_s < end else frames
    assert rig.finish()
    assert rig.reason == ""


@BOTH
@pytest.mark.parametrize("gap_s", [1.0, 5.0])
def test_a_longer_gap_ends_in_a_landing_and_no_setpoint_ever_again(kind, gap_s):
    rig = Rig(kind)
    rig.excite()
    cut = rig.now_s
    rig.up = rig.down = lambda frames: [] if rig.now_s < cut + gap_s else frames
    assert rig.finish()
    assert "nothing from the vehicle" in rig.reason
    rig.wait(5.0)
    assert rig.setpoints_after(cut + 0.9) == 0
    assert rig.phase is Phase.LANDED


@BOTH
def test_a_link_cut_for_ever_leaves_the_landing_to_the_vehicle_and_is_noticed(kind):
    rig = Rig(kind)
    rig.excite()
    cut = rig.now_s
    rig.up = rig.down = lambda _frames: []
    assert rig.run(lambda: rig.phase is Phase.LANDING, 2.0)
    assert rig.now_s - cut < 0.9
    rig.wait(20.0)
    if kind == "px4":
        assert not rig.vehicle.armed
        assert rig.vehicle.height_m < 0.05


@BOTH
def test_a_way_up_that_is_cut_alone_is_the_vehicles_own_failsafe_and_the_station_lets_go(kind):
    rig = Rig(kind)
    rig.excite()
    cut = rig.now_s
    rig.up = lambda frames: [] if rig.now_s < cut + 4.0 else frames
    assert rig.finish(90.0)
    if kind == "px4":
        assert "did not ask for" in rig.reason
        assert rig.setpoints_after(cut + 2.5) == 0


@BOTH
@pytest.mark.parametrize("seed", [1, 2])
def test_a_tenth_of_all_frames_lost_doubled_shuffled_and_corrupted_is_survived(kind, seed):
    rig = Rig(kind)
    rig.down, rig.up = lossy(0.1, seed), lossy(0.1, seed + 100)
    rig.excite()
    assert rig.finish(90.0)
    assert rig.reason == ""
    _, lost = rig.core.lost_frames()
    assert lost > 100


@BOTH
def test_the_pilots_mode_switch_silences_the_station_at_once(kind):
    rig = Rig(kind)
    rig.excite()
    rig.vehicle.set_mode("POSCTL" if kind == "px4" else "LOITER")
    rig.vehicle.heartbeat()
    taken = rig.now_s
    rig.wait(10.0)
    assert rig.phase is Phase.RELEASED
    assert rig.setpoints_after(taken + 0.02) == 0
    assert not [c for c in rig.vehicle.commands if c[0] > taken + 0.02]
    assert not rig.order("abort").ok, "an abort must not take the vehicle out of the pilot's hands"


def test_a_pilot_who_takes_over_during_our_landing_keeps_it():
    rig = Rig("px4")
    rig.excite()
    rig.core.order("abort", rig.now_s, "test")
    assert rig.run(lambda: rig.vehicle.mode == rig.vehicle.land, 1.0)
    rig.vehicle.set_mode("POSCTL")
    rig.vehicle.heartbeat()
    taken = rig.now_s
    rig.wait(5.0)
    assert rig.phase is Phase.RELEASED
    assert not [c for c in rig.vehicle.commands if c[0] > taken + 0.02]


@BOTH
def test_an_abort_lands_and_a_second_abort_is_still_one(kind):
    rig = Rig(kind)
    rig.excite()
    for _ in range(2):
        rig.core.order("abort", rig.now_s, "Ctrl-C")
        rig.wait(0.1)
    assert rig.finish()
    assert "Ctrl-C" in rig.reason


@BOTH
def test_a_silent_core_brings_the_vehicle_down(kind):
    rig = Rig(kind)
    rig.excite()
    rig.core_beats, silent = False, rig.now_s
    assert rig.run(lambda: rig.phase is Phase.LANDING, 10.0)
    assert rig.now_s - silent == pytest.approx(3.0, abs=0.1)
    assert rig.finish()


def test_a_core_known_dead_brings_it_down_at_once():
    rig = Rig("px4")
    rig.excite()
    rig.core_beats = False
    rig.core.core_lost()
    rig.wait(0.05)
    assert rig.phase is Phase.LANDING


def test_a_silent_core_may_be_outlived_where_the_station_says_so():
    rig = Rig("px4", {"policy": {"when_core_is_silent": "complete"}})
    rig.excite()
    rig.core_beats = False
    assert rig.finish()
    assert rig.reason == ""


def test_a_stalled_link_process_lands_instead_of_resuming_its_setpoints():
    rig = Rig("px4")
    rig.excite()
    rig.link_runs = False
    rig.wait(0.9)
    rig.link_runs, back = True, rig.now_s
    rig.wait(0.02)
    assert rig.phase in (Phase.LANDING, Phase.RELEASED)
    assert rig.finish()
    assert rig.setpoints_after(back + 0.01) == 0


def test_an_autopilot_that_restarts_in_the_air_gets_no_setpoint_afterwards():
    rig = Rig("px4")
    rig.excite()
    rig.vehicle.reboot()
    when = rig.now_s
    rig.wait(5.0)
    assert rig.phase in (Phase.LANDED, Phase.LANDING)
    assert rig.setpoints_after(when + 0.9) == 0


def test_a_restarted_clock_does_not_disturb_the_map_between_the_clocks():
    rig = Rig("px4")
    rig.prepare()
    rig.vehicle.reboot()
    rig.wait(4.0)
    assert rig.core.clock.resets == 1
    assert rig.core.device_s(rig.now_s) == pytest.approx(rig.vehicle.device_s, abs=0.01)


@BOTH
def test_denied_arming_says_the_vehicles_own_words(kind):
    rig = Rig(kind)
    rig.vehicle.deny_arming = "Arm: Need Position Estimate"
    rig.prepare()
    assert rig.upload().ok
    answer = rig.order("arm")
    assert not answer.ok
    assert "Need Position Estimate" in answer.reason
    assert rig.phase is Phase.UPLOADED


def test_a_mode_that_is_acknowledged_but_does_not_come_is_no_take_off():
    rig = Rig("px4")
    rig.prepare()
    rig.upload()
    rig.order("arm")
    rig.vehicle.ignores_mode = rig.vehicle.follow
    rig.core.order("start", rig.now_s)
    assert rig.finish(20.0)
    assert "acknowledged, but did not happen" in rig.reason
    assert rig.vehicle.height_m < 0.05


@BOTH
def test_a_low_battery_lands(kind):
    rig = Rig(kind)
    rig.excite()
    rig.vehicle.battery = 10
    assert rig.finish()
    assert "10 % battery" in rig.reason


def test_a_jump_of_the_estimate_lands():
    rig = Rig("px4")
    rig.excite()
    rig.vehicle.offset = [0.0, 0.8, 0.0]
    assert rig.run(lambda: rig.phase is Phase.LANDING, 0.5)
    assert "jumped" in rig.reason


def test_a_position_that_stops_coming_lands_although_the_link_lives():
    rig = Rig("px4")
    rig.excite()
    rig.vehicle.intervals.pop(32)
    assert rig.finish()
    assert "no position" in rig.reason


@pytest.mark.parametrize("fault", ["stopped", "frozen", "jumped"])
def test_poses_that_stop_freeze_or_jump_land(fault):
    rig = Rig("px4", MOCAP)
    broken = False
    frozen = (0.0, 0.0, 1.0)

    def change(p):
        if not broken or fault == "stopped":
            return p
        return frozen if fault == "frozen" else (p[0] + 0.7, p[1], p[2])

    poses(rig, change, alive=lambda: not (broken and fault == "stopped"))
    rig.excite()
    broken = True
    assert rig.run(lambda: rig.phase is Phase.LANDING, 1.5)
    assert ("pose" in rig.reason) == (fault != "jumped") or "poses" in rig.reason
    assert rig.finish()


def test_a_vehicle_that_never_settles_is_not_excited():
    rig = Rig("px4", {"policy": {"settle_timeout_s": 3.0, "settled_error_m": 0.05}})
    rig.start()
    rig.vehicle.bias = [0.3, 0.0, 0.0]
    assert rig.run(lambda: rig.core.pilot.progress_s()[0] > 0.0 and rig.core.pilot._waiting_since_s is not None, 30.0)
    assert all(type(seconds) is float for seconds in rig.core.pilot.progress_s()), "the bus encodes no numpy number"
    assert rig.finish()
    assert "did not settle" in rig.reason
    assert rig.core.pilot.excitation_s == (None, None)


def test_kill_stops_the_motors_in_the_air():
    rig = Rig("px4", {"guard": {"battery": {"limit": 0.15, "action": "kill"}}})
    rig.excite()
    rig.vehicle.battery = 5
    assert rig.run(lambda: not rig.vehicle.armed, 1.0)


@pytest.mark.parametrize("profile", ["px4", "arducopter"])
def test_the_operators_kill_stops_the_motors_in_the_air(profile):
    rig = Rig(profile)
    rig.excite()
    assert rig.order("kill").ok
    assert rig.run(lambda: not rig.vehicle.armed, 1.0)
    assert "operator stopped the rotors" in rig.reason


def test_hold_becomes_a_landing():
    rig = Rig("px4", {"guard": {"battery": {"limit": 0.15, "action": "hold", "for_s": 0.1}}, "policy": {"hold_s": 2.0}})
    rig.excite()
    rig.vehicle.battery, low = 5, rig.now_s
    assert rig.run(lambda: rig.vehicle.mode == rig.vehicle.modes["AUTO.LOITER"], 2.0)
    held = rig.now_s
    assert rig.finish()
    assert rig.setpoints_after(held + 0.02) == 0
    assert rig.now_s - low > 2.0


def test_orders_out_of_turn_are_refused_with_the_reason():
    rig = Rig("px4")
    assert "not ready" in rig.upload().reason
    assert "no autopilot" in rig.order("arm").reason
    rig.prepare()
    assert "uploaded plan" in rig.order("arm").reason
    assert "armed vehicle" in rig.order("start").reason
    assert "no order" in rig.order("dance").reason
    rig.upload()
    rig.order("arm")
    assert "disarm it" in rig.upload().reason


def test_a_second_flight_follows_the_first():
    rig = Rig("px4")
    for _ in range(2):
        rig.excite()
        assert rig.finish()
        assert rig.reason == ""


def test_settable_parameters_are_journalled_before_they_are_set_and_restored_after():
    rig = Rig("px4", set_parameters=True)
    rig.vehicle.parameters["COM_OBL_RC_ACT"] = (0.0, 6)
    written = []
    real = rig.vehicle.handle

    def handle(m) -> None:
        if m.get_type() == "PARAM_SET":
            written.append((m.param_id, [c[0] for c in rig.changed]))
        real(m)

    rig.vehicle.handle = handle
    rig.prepare()
    assert rig.vehicle.parameters["COM_OBL_RC_ACT"][0] == 4.0
    assert written[0] == ("COM_OBL_RC_ACT", ["COM_OBL_RC_ACT"])
    rig.core.restore_parameters()
    assert rig.run(lambda: not rig.core.changed, 5.0)
    assert rig.vehicle.parameters["COM_OBL_RC_ACT"][0] == 0.0


def test_what_a_crashed_station_left_changed_is_restored_by_the_next():
    from groundstation.flight.link.link_core import LinkCore

    rig = Rig("px4")
    rig.vehicle.parameters["NAV_DLL_ACT"] = (3.0, 6)
    rig.core = LinkCore(rig.core.vehicle, rig.core.station, rig.core.options, restore={"px4-1": {"NAV_DLL_ACT": 1.0}})
    rig.prepare()
    assert rig.vehicle.parameters["NAV_DLL_ACT"][0] == 1.0
    assert ("NAV_DLL_ACT", 1.0, 1.0) in rig.changed


def test_a_wrong_failsafe_refuses_the_upload_and_force_is_recorded():
    rig = Rig("px4")
    rig.vehicle.parameters["COM_OBL_RC_ACT"] = (3.0, 6)
    rig.prepare()
    answer = rig.upload()
    assert not answer.ok
    assert "COM_OBL_RC_ACT" in answer.reason and "set it to 4" in answer.reason
    forced = Rig("px4", force=("COM_OBL_RC_ACT",))
    forced.vehicle.parameters["COM_OBL_RC_ACT"] = (3.0, 6)
    forced.prepare()
    assert forced.upload().ok
    forced.wait(0.1)
    events = [s.text for s, _ in forced.samples if isinstance(s, Event) and s.kind == "preflight"]
    assert any(text.startswith("COM_OBL_RC_ACT forced") for text in events)


def test_frames_of_another_vehicle_on_the_same_link_are_not_ours():
    from drivers.mavlink.codec import MavlinkCodec
    from drivers.mavlink.dialect import mavlink

    rig = Rig("px4")
    rig.excite()
    stranger = MavlinkCodec(2, 1)
    rig.down = lambda frames: [*frames, stranger.encode(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 0, 3))]
    assert rig.finish()
    assert rig.reason == ""


@BOTH
def test_a_vehicle_whose_time_runs_slow_is_seen_as_such(kind):
    rig = Rig(kind)
    rig.excite()
    assert rig.core.view.clock_rate == pytest.approx(1.0, abs=0.02)
    ahead_s, began_s = rig.now_s, rig.vehicle.device_s

    def slowly() -> None:  # from here on a simulated second takes one and a half
        rig.vehicle.boot_s = rig.now_s - (began_s + (rig.now_s - ahead_s) / 1.5)

    rig.hooks.append(slowly)
    rig.wait(2.5)
    assert rig.core.view.clock_rate == pytest.approx(1 / 1.5, abs=0.05)
