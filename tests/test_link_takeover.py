"""Aborts at arming, vehicles that are found in flight, and links that take over from others. On virtual time."""

from __future__ import annotations

import pytest
from mavlink_vehicle import Rig

from drivers.mavlink.codec import MavlinkCodec
from groundstation.flight.link.link_core import LinkCore, Options
from groundstation.flight.link.phase import Phase

BOTH = pytest.mark.parametrize("kind", ["px4", "arducopter"])


@BOTH
@pytest.mark.parametrize("armed", [False, True])
def test_an_abort_at_arming_disarms_and_nothing_arms_or_starts_afterwards(kind, armed):
    rig = Rig(kind)
    rig.prepare()
    assert rig.upload().ok
    arming = rig.core.order("arm", rig.now_s)
    if armed:
        rig.run(lambda: arming.ok is not None, 5.0)
        assert rig.phase is Phase.ARMED
    else:
        rig.step()  # the order is on its way
        assert arming.ok is None and rig._to_vehicle
    begun = rig.now_s
    answer = rig.order("abort")
    assert answer.ok, answer.reason
    assert rig.now_s - begun < 1.5
    assert not rig.vehicle.armed and rig.phase is Phase.UPLOADED
    assert "aborted" in rig.order("arm").reason and "aborted" in rig.order("start").reason
    rig.wait(3.0)
    assert not rig.vehicle.armed
    assert rig.upload().ok and rig.order("arm").ok, "a new upload is a new flight"


def successor(rig: Rig, take_over: str = "", **more) -> list[str]:
    """Another link on the same vehicle; the names of what it sends."""
    core = LinkCore(rig.core.vehicle, rig.core.station, Options(keep_raw=False, take_over=take_over), **more)  # type: ignore[arg-type]
    codec, names, step = MavlinkCodec(), [], core.step

    def watched(now_s, incoming):
        out = step(now_s, incoming)
        names.extend(r.name for data in out.send for r in codec.decode(data, datagram=True))
        return out

    core.step = watched  # type: ignore[method-assign]
    rig.core = core
    return names


@BOTH
def test_a_vehicle_found_in_flight_gets_no_heartbeat_and_no_word_until_somebody_takes_it_over(kind):
    rig = Rig(kind)
    rig.excite()
    names = successor(rig)
    rig.wait(4.0)
    assert rig.core.found_flying and not rig.core.ready
    assert names.count("HEARTBEAT") <= 1, "one may leave before it is heard"
    assert set(names) <= {"HEARTBEAT", "TIMESYNC"}


@BOTH
@pytest.mark.parametrize("how", ["land", "hold"])
def test_a_link_that_takes_over_lands_or_holds_from_the_first_heartbeat_on(kind, how):
    rig = Rig(kind)
    rig.excite()
    begun = rig.now_s
    names = successor(rig, how)
    wanted = (
        rig.core.vehicle
        and {"land": rig.vehicle.land, "hold": rig.vehicle.modes["AUTO.LOITER" if kind == "px4" else "BRAKE"]}[how]
    )
    assert rig.run(lambda: rig.vehicle.mode == wanted, 2.5)
    if how == "hold":
        rig.wait(5.0)
        assert rig.vehicle.mode == wanted and rig.vehicle.armed
        assert rig.order("abort").ok
    assert rig.finish()
    assert rig.setpoints_after(begun + 0.02) == 0
    assert "SET_POSITION_TARGET_LOCAL_NED" not in names and "taken over" in rig.reason
    assert rig.run(lambda: rig.phase is Phase.LANDED, 3.0)


@BOTH
def test_a_link_that_takes_over_leaves_a_vehicle_to_the_pilot_who_has_it(kind):
    rig = Rig(kind)
    rig.excite()
    rig.vehicle.set_mode("POSCTL" if kind == "px4" else "LOITER")
    mode = rig.vehicle.mode
    successor(rig, "land")
    rig.wait(5.0)
    assert rig.phase is Phase.RELEASED and rig.vehicle.mode == mode and rig.vehicle.armed


def test_a_successor_restores_what_the_flight_had_changed_once_it_is_down():
    rig = Rig("px4")
    rig.excite()
    rig.vehicle.parameters["NAV_DLL_ACT"] = (3.0, 6)
    successor(rig, "land", restore={"px4-1": {"NAV_DLL_ACT": 1.0}})
    assert rig.run(lambda: not rig.vehicle.armed, 30.0)
    rig.wait(2.0)
    rig.core.restore_parameters()
    assert rig.run(lambda: not rig.core.changed, 5.0)
    assert rig.vehicle.parameters["NAV_DLL_ACT"][0] == 1.0


def test_a_successor_of_a_vehicle_that_is_down_has_nothing_to_land():
    rig = Rig("px4")
    rig.prepare()
    successor(rig, "land")
    assert rig.run(lambda: rig.core.pilot is not None and rig.phase is Phase.LANDED, 2.0)
