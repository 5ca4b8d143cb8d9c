"""The script that flies the plan on board, run in a Lua interpreter against a stand-in for the autopilot's bindings."""

from __future__ import annotations

import numpy as np
import pytest
from test_link_emulated import Pair

from drivers.mavlink.ftp import Ftp
from groundstation.flight.placement import Placement, target_at
from groundstation.flight.profiles import PROFILES
from groundstation.flight.upload import SCRIPT, choose_way, coefficients_text, send_onboard
from groundstation.trajectory import FourierSeries, Sequence

lupa = pytest.importorskip("lupa", reason="lupa, a Lua interpreter, is not installed")
RNG = np.random.default_rng(3)
SERIES = FourierSeries(RNG.normal(0, 0.3, (4, 3)), RNG.normal(0, 0.3, (4, 3)), np.array([0.1, -0.2, 1.2, 0.3]), 0.7)
PLACED = Placement((4.0, -3.0, 0.5), 0.8)

BINDINGS = """
sent, texts, floats, mode, armed, asked, now = {}, {}, {}, 4, true, 1, 0
local V = {}
V.__index = V
for _, k in ipairs({"x", "y", "z"}) do V[k] = function(self, v) if v then self["_" .. k] = v end return self["_" .. k] end end
function Vector3f() return setmetatable({}, V) end
function millis() return {tofloat = function() return now end} end
vehicle = {get_mode = function() return mode end,
  set_target_posvelaccel_NED = function(_, p, v, a, use_yaw, yaw, use_rate, rate)
    sent[#sent + 1] = {now, p:x(), p:y(), p:z(), v:x(), v:y(), v:z(), a:x(), a:y(), a:z(), math.rad(yaw), math.rad(rate)}
    return true end}
arming = {is_armed = function() return armed end}
param = {get = function(_, name) return asked end}
gcs = {send_text = function(_, s, t) texts[#texts + 1] = t end,
       send_named_float = function(_, n, v) floats[#floats + 1] = v end}
io = {open = function() return {read = function() return plan_text end, close = function() end} end}
"""


def interpreter(text: str | None = None):
    lua = lupa.LuaRuntime()
    lua.globals().plan_text = coefficients_text(SERIES, PLACED) if text is None else text
    lua.execute(BINDINGS)
    lua.execute(SCRIPT.read_text())
    return lua


def run(lua, seconds: float) -> None:
    for _ in range(int(seconds * 100)):
        lua.globals().now += 10
        lua.globals().update()


def test_the_script_commands_the_very_setpoints_the_link_would_send():
    lua = interpreter()
    run(lua, 3.0)
    rows = [list(row.values()) for row in lua.globals().sent.values()]
    assert len(rows) > 250
    begin = rows[0][0] - 10
    profile = PROFILES["arducopter"]()
    for now, *values in rows[::25]:
        m = profile.setpoint(PLACED.to_vehicle(target_at(Sequence((SERIES,)), (now - begin) / 1000)), 0.0)
        expected = [m.x, m.y, m.z, m.vx, m.vy, m.vz, m.afx, m.afy, m.afz, m.yaw, m.yaw_rate]
        np.testing.assert_allclose(values, expected, atol=1e-6)


def test_it_ends_by_itself_and_says_so():
    lua = interpreter()
    run(lua, SERIES.duration_s + 1.0)
    assert list(lua.globals().texts.values()) == ["excitation: started", "excitation: complete"]
    assert list(lua.globals().floats.values())[-1] == -1


@pytest.mark.parametrize(
    ("change", "why"), [("mode = 9", "mode change"), ("armed = false", "mode change"), ("asked = 0", "station")]
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
    assert why in list(lua.globals().texts.values())[-1]


@pytest.mark.parametrize("text", ["", "nonsense", "3 0.7 9.0 0 0 0 0 1 2"])
def test_coefficients_that_are_not_whole_are_not_flown(text):
    lua = interpreter(text)
    run(lua, 1.0)
    assert len(lua.globals().sent) == 0
    assert "cannot be read" in list(lua.globals().texts.values())[-1]


def test_script_and_coefficients_arrive_whole():
    pair = Pair("arducopter").ready()
    pair.ask(send_onboard(PROFILES["arducopter"](), SERIES, PLACED))
    assert pair.ask(Ftp(1, 1).read("scripts/excitation.lua")) == SCRIPT.read_bytes()
    assert pair.ask(Ftp(1, 1).read("scripts/excitation.txt")).decode() == coefficients_text(SERIES, PLACED)


def test_the_way_is_chosen_with_a_reason():
    px4, copter = PROFILES["px4"](), PROFILES["arducopter"]()
    assert choose_way(px4, {}, onboard=True).kind == "setpoints"
    assert choose_way(copter, {"SCR_ENABLE": 0.0}, onboard=True).kind == "setpoints"
    assert choose_way(copter, {"SCR_ENABLE": 1.0}, onboard=True).kind == "onboard"
    assert choose_way(copter, {"SCR_ENABLE": 1.0}, onboard=False).kind == "setpoints"
