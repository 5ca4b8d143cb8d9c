"""The excitation flown on board: our script in a Lua interpreter, alone and on the emulated ArduCopter."""

from __future__ import annotations

import numpy as np
import pytest
from mavlink_vehicle import small_plan
from test_link_emulated import Pair

from drivers.mavlink.ftp import Ftp
from drivers.samples import Event
from groundstation.flight.link.phase import IN_AIR, Phase
from groundstation.flight.link.placement import Placement, target_at
from groundstation.flight.link.profiles import PROFILES
from groundstation.flight.link.upload import SCRIPT, coefficients_text
from groundstation.trajectory import FourierSeries, Sequence

lua53 = pytest.importorskip("lupa.lua53", reason="lupa, a Lua interpreter, is not installed")
RNG = np.random.default_rng(3)
SERIES = FourierSeries(RNG.normal(0, 0.3, (4, 3)), RNG.normal(0, 0.3, (4, 3)), np.array([0.1, -0.2, 1.2, 0.3]), 0.7)
PLACED = Placement((4.0, -3.0, 0.5), 0.8)

BINDINGS = """
sent, texts, floats, mode, armed, flying, now = {}, {}, {}, 4, true, true, 0
parameters = {SCR_USER1 = 0, SCR_USER2 = 4.0, SCR_USER3 = 3.0, SCR_USER4 = -0.5, SCR_USER5 = -0.8}
local V = {}
V.__index = V
for _, k in ipairs({"x", "y", "z"}) do V[k] = function(self, v) if v then self["_" .. k] = v end return self["_" .. k] \
end end
function Vector3f() return setmetatable({}, V) end
function millis() return {tofloat = function() return now end} end
vehicle = {get_mode = function() return mode end, get_likely_flying = function() return flying end,
  set_target_posvelaccel_NED = function(_, p, v, a, use_yaw, yaw, use_rate, rate)
    sent[#sent + 1] = {now, p:x(), p:y(), p:z(), v:x(), v:y(), v:z(), a:x(), a:y(), a:z(), math.rad(yaw), \
math.rad(rate)}
    return true end}
arming = {is_armed = function() return armed end}
param = {get = function(_, name) return parameters[name] end}
gcs = {send_text = function(_, s, t) texts[#texts + 1] = t end,
       send_named_float = function(_, n, v) floats[#floats + 1] = v end}
io = {open = function() return {read = function() return plan_text end, close = function() end} end}
"""


def interpreter(text: str | None = None, ordered: int = 0):
    lua = lua53.LuaRuntime()
    lua.globals().plan_text = coefficients_text(SERIES) if text is None else text
    lua.execute(BINDINGS)
    lua.execute(f"parameters.SCR_USER1 = {ordered}")
    lua.execute(SCRIPT.read_text())
    run(lua, 0.05)
    lua.execute("parameters.SCR_USER1 = 1")
    return lua


def run(lua, seconds: float) -> None:
    for _ in range(round(seconds * 100)):
        lua.globals().now += 10
        lua.globals().update()


def values(table) -> list:
    return list(table.values())


def test_the_script_commands_the_very_setpoints_the_link_would_send():
    lua = interpreter()
    run(lua, 3.0)
    rows = [values(row) for row in values(lua.globals().sent)]
    assert len(rows) > 250
    begin = rows[0][0] - 10
    profile = PROFILES["arducopter"]()
    for now, *numbers in rows[::25]:
        m = profile.setpoint(PLACED.to_vehicle(target_at(Sequence((SERIES,)), (now - begin) / 1000)), 0.0)
        expected = [m.x, m.y, m.z, m.vx, m.vy, m.vz, m.afx, m.afy, m.afz, m.yaw, m.yaw_rate]
        np.testing.assert_allclose(numbers, expected, atol=1e-5)


def test_it_ends_by_itself_and_says_so():
    lua = interpreter()
    run(lua, SERIES.duration_s + 1.0)
    assert values(lua.globals().texts) == ["excitation: started", "excitation: complete"]
    assert values(lua.globals().floats)[-1] == -2


@pytest.mark.parametrize(
    ("change", "why"),
    [("mode = 9", "mode change"), ("armed = false", "mode change"), ("parameters.SCR_USER1 = 0", "station")],
)
def test_a_mode_change_or_the_station_ends_it_at_once_and_it_does_not_come_back(change, why):
    lua = interpreter()
    run(lua, 2.0)
    lua.execute(change)
    before = len(lua.globals().sent)
    run(lua, 0.5)
    lua.execute("mode, armed = 4, true")
    run(lua, 2.0)
    assert len(lua.globals().sent) == before
    assert why in values(lua.globals().texts)[-1]


def test_an_order_left_over_from_an_earlier_flight_is_none():
    """SCR_USER1 is kept through a restart; a vehicle armed in GUIDED by somebody else must not fly our plan."""
    lua = interpreter(ordered=1)
    run(lua, 2.0)
    assert len(lua.globals().sent) == 0
    lua.execute("parameters.SCR_USER1 = 0")
    run(lua, 0.1)
    lua.execute("parameters.SCR_USER1 = 1")
    run(lua, 0.1)
    assert len(lua.globals().sent) > 0


def test_nothing_is_flown_from_the_ground():
    lua = interpreter()
    lua.execute("flying = false")
    run(lua, 1.0)
    assert len(lua.globals().sent) == 0
    assert values(lua.globals().floats)[-1] == -3


@pytest.mark.parametrize("text", ["", "nonsense", "3 0.7 9.0 0 0 0 0 1 2"])
def test_coefficients_that_are_not_whole_are_not_flown(text):
    lua = interpreter(text)
    run(lua, 1.0)
    assert len(lua.globals().sent) == 0
    assert "cannot be read" in values(lua.globals().texts)[-1]


class Scripted(Pair):
    """An emulated ArduCopter that runs scripts; every setpoint of the link is counted."""

    def __init__(self, **station):
        super().__init__("arducopter", **station)
        self.autopilot.enable_scripting()
        self.events: list[str] = []
        self.setpoints: list[float] = []
        follow, step = self.autopilot.follow, self.core.step

        def stepped(now_s, incoming, **kwargs):
            out = step(now_s, incoming, **kwargs)
            self.events += [s.text for s, _ in out.samples if isinstance(s, Event)]
            self.setpoints += [now_s for m in out.send if m[7] == 84]
            return out

        self.core.step, self.autopilot.follow = stepped, follow

    def to_excitation(self) -> Scripted:
        answer = self.core.upload(small_plan(), self.now_s)
        assert self.run(lambda: answer.ok is not None, 5.0) and answer.ok, answer.reason
        armed = self.core.order("arm", self.now_s)
        assert self.run(lambda: armed.ok is not None, 10.0) and armed.ok, armed.reason
        self.core.order("start", self.now_s)
        assert self.run(lambda: self.core.pilot.exciting, 40.0), (self.core.pilot.phase, self.core.pilot.reason)
        return self


def test_the_excitation_is_flown_on_board_and_the_link_sends_no_setpoint_meanwhile():
    pair = Scripted().ready()
    pair.to_excitation()
    assert any(" on board: " in e and "checksum" in e for e in pair.events)
    pilot = pair.core.pilot
    begun_s, count = pair.now_s, len(pair.setpoints)
    worst, meanwhile = 0.0, count

    def follow() -> bool:
        nonlocal worst, meanwhile
        if pilot.exciting:
            meanwhile = len(pair.setpoints)
            there = pair.autopilot.truth.position_m
            worst = max(
                worst,
                max(abs(a - b) for a, b in zip(pilot.placement.to_plan(there), pilot.target.position_m, strict=True)),
            )
        return not pilot.exciting

    assert pair.run(follow, 60.0)
    assert meanwhile == count
    assert worst < 0.4  # the reports carry the plan's time: where it should be is known while the script flies
    lasted = small_plan().series().duration_s
    assert pair.now_s - begun_s == pytest.approx(lasted, abs=0.3)
    assert pair.run(lambda: pilot.phase not in IN_AIR, 60.0)
    assert (pilot.phase, pilot.reason) == (Phase.LANDED, "")
    assert len(pair.setpoints) > count, "the hover after the excitation is led from the link again"


@pytest.mark.parametrize("how", ["abort", "script dies", "pilot"])
def test_an_end_before_the_end_stops_the_script_too(how):
    pair = Scripted().ready().to_excitation()
    pilot = pair.core.pilot
    pair.run(lambda: False, 1.0)
    count = len(pair.setpoints)
    if how == "abort":
        pair.core.order("abort", pair.now_s, "Ctrl-C")
    elif how == "pilot":
        pair.autopilot.pilot_takes_over()
    else:
        pair.autopilot._scripts = None
    assert pair.run(lambda: pilot.phase in (Phase.LANDING, Phase.RELEASED), 4.0)
    assert pilot.phase is (Phase.RELEASED if how == "pilot" else Phase.LANDING)
    pair.run(lambda: False, 2.0)
    assert len(pair.setpoints) == count
    if how != "pilot":
        assert pair.run(lambda: pilot.phase is Phase.LANDED, 30.0)


def test_coefficients_damaged_on_their_way_are_flown_by_setpoints_instead():
    pair = Scripted().ready()
    ftp = pair.autopilot.ftp
    handle = ftp.handle
    ftp.handle = lambda payload: handle(payload.replace(b"e-0", b"e+0").replace(b"0.", b"9."))
    answer = pair.core.upload(small_plan(), pair.now_s)
    assert pair.run(lambda: answer.ok is not None, 10.0) and answer.ok, answer.reason
    pair.run(lambda: False, 0.1)
    assert any(" by setpoints " in e and "damaged on its way" in e for e in pair.events)


def test_script_and_coefficients_arrive_whole_and_the_script_is_sent_once():
    pair = Scripted().ready()
    assert pair.core.preparation.way.kind == "onboard"
    assert pair.ask(Ftp(1, 1).read("APM/scripts/excitation.lua")) == SCRIPT.read_bytes()
    answer = pair.core.upload(small_plan(), pair.now_s)
    assert pair.run(lambda: answer.ok is not None, 5.0)
    there = pair.ask(Ftp(1, 1).read("APM/scripts/excitation.txt")).decode()
    assert there == coefficients_text(small_plan().series())


@pytest.mark.parametrize(("kind", "why"), [("px4", "no script of ours"), ("arducopter", "scripting is off")])
def test_without_scripting_setpoints_fly_it_and_it_is_said_why(kind, why):
    way = Pair(kind).ready().core.preparation.way
    assert way.kind == "setpoints" and why in way.why
