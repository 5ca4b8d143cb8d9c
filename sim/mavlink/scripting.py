"""Lua scripts on board of the emulated ArduCopter: the real script, run by a Lua interpreter against the firmware's
bindings.

Only what a trajectory needs is bound: clock, mode, arming, parameters, texts, named floats, guided targets, files in
the scripts folder. The interpreter is the development package lupa; without it scripting is refused, as on a small
board.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from drivers.mavlink.geometry import flip
from sim.mavlink.control import Setpoint
from sim.mavlink.parameters import Parameter
from sim.mavlink.wire import mavlink

if TYPE_CHECKING:
    from sim.mavlink.arducopter import ArduCopter

FOLDER = "/APM/scripts/"
SWITCHES = (
    Parameter("SCR_ENABLE", mavlink.MAV_PARAM_TYPE_INT8, 0.0),
    *(Parameter(f"SCR_USER{n}", mavlink.MAV_PARAM_TYPE_REAL32, 0.0) for n in range(1, 7)),
)
"""Not in the recorded table, whose build had no scripting."""

_BINDINGS = """
return function(python)
  -- Looked up once: a wrapper made at each call would be garbage, collected in the middle of another call.
  local host = {}
  for _, k in ipairs({"millis", "mode", "flying", "armed", "parameter", "text", "named", "target", "file"}) do
    host[k] = python[k]
  end
  local V = {}
  V.__index = V
  for _, k in ipairs({"x", "y", "z"}) do
    V[k] = function(self, v) if v then self["_" .. k] = v end return self["_" .. k] or 0 end
  end
  function Vector3f() return setmetatable({}, V) end
  function millis() return {tofloat = function() return host.millis() end} end
  vehicle = {
    get_mode = function() return host.mode() end,
    get_likely_flying = function() return host.flying() end,
    set_target_posvelaccel_NED = function(_, p, v, a, _, yaw, _, rate)
      return host.target(p:x(), p:y(), p:z(), v:x(), v:y(), v:z(), a:x(), a:y(), a:z(), math.rad(yaw), math.rad(rate))
    end}
  arming = {is_armed = function() return host.armed() end}
  param = {get = function(_, name) return host.parameter(name) end}
  gcs = {send_text = function(_, severity, text) host.text(severity, text) end,
         send_named_float = function(_, name, value) host.named(name, value) end}
  io = {open = function(name)
    local text = host.file(name)
    return text and {read = function() return text end, close = function() end} or nil
  end}
end
"""


class ScriptHost:
    """All scripts in the scripts folder, each called when its own return value says.

    Args:
        autopilot: whose vehicle they may command.

    Raises:
        ImportError: no Lua interpreter is installed.
    """

    def __init__(self, autopilot: ArduCopter):
        from lupa import lua53  # the version ArduPilot carries

        new_runtime: Any = lua53.LuaRuntime
        self._autopilot = autopilot
        self._calls: list[tuple[float, Any]] = []
        for name in sorted(n for n in autopilot.files if n.startswith(FOLDER) and n.endswith(".lua")):
            lua: Any = new_runtime(register_eval=False, unpack_returned_tuples=True)
            lua.execute(_BINDINGS)(self._bindings())
            self._run(lambda lua=lua, name=name: lua.execute(bytes(autopilot.files[name]).decode(errors="replace")))

    def step(self) -> None:
        """Call what is due."""
        now_s = self._autopilot.time_s
        due = [call for at, call in self._calls if at <= now_s + 1e-9]
        self._calls = [(at, call) for at, call in self._calls if at > now_s + 1e-9]
        for call in due:
            self._run(call)

    def _run(self, call: Any) -> None:
        """A script returns the function to call next and in how many milliseconds; one that fails is not called
        again.
        """
        from lupa import lua53  # the version ArduPilot carries

        try:
            again = call()
        except lua53.LuaError as error:
            self._autopilot.text(mavlink.MAV_SEVERITY_CRITICAL, f"Lua: {error}"[:200])
            return
        if isinstance(again, tuple):
            function, period_ms = again
            self._calls.append((self._autopilot.time_s + period_ms * 1e-3, function))

    def _bindings(self) -> dict[str, Any]:
        a = self._autopilot
        return {
            "millis": lambda: a.boot_ms,
            "mode": lambda: a.mode.custom,
            "flying": lambda: a.armed and not a.landed,
            "armed": lambda: a.armed,
            "parameter": self._parameter,
            "text": a.text,
            "named": lambda name, value: a.outbox.broadcast(
                mavlink.MAVLink_named_value_float_message(a.boot_ms, name.encode(), float(value))
            ),
            "target": self._target,
            "file": self._file,
        }

    def _parameter(self, name: str) -> float | None:
        index = self._autopilot.parameters.index(name)
        return None if index is None else self._autopilot.parameters.all[index].value

    def _file(self, name: str) -> str | None:
        """Scripts name files from the card's root."""
        content = self._autopilot.files.get("/" + name.removeprefix("/"))
        return None if content is None else bytes(content).decode()

    def _target(self, *v: float) -> bool:
        if self._autopilot.mode.name != "GUIDED" or not all(map(math.isfinite, v)):
            return False
        p, velocity, acceleration = flip((v[0], v[1], v[2])), flip((v[3], v[4], v[5])), flip((v[6], v[7], v[8]))
        self._autopilot.follow(Setpoint(p, velocity, acceleration, -v[9], -v[10]))
        return True
