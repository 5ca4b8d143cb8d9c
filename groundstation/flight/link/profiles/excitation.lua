-- Flies the uploaded excitation on board: the finite Fourier series of the plan, sampled at the autopilot's own rate.
-- Wants: SCR_ENABLE 1, this file in scripts/, and beside it excitation.txt with the coefficients (see upload.py).
-- The station writes where the plan's origin lies (SCR_USER2..4: north, east, down, m; SCR_USER5: its heading, rad), then
-- SCR_USER1 = 1 while the vehicle hovers in GUIDED at the start, and watches GSPATH: seconds flown; -1 idle; -2 flown to the
-- end; -3 ended before. Any other mode ends it for good. SCR_USER1 survives a restart, so a 1 found at the start is no order:
-- only a change from 0 to 1 that this script has seen is one.

local PERIOD_MS, REPORT_MS, IDLE_MS = 10, 100, 1000
local GUIDED = 4
local plan, started_ms, armed_order, reported_ms
local outcome = -1

local function read_plan()
  local file = io.open("APM/scripts/excitation.txt", "r") or io.open("scripts/excitation.txt", "r")
  if not file then return nil end
  local numbers = {}
  for word in string.gmatch(file:read("*a"), "%S+") do numbers[#numbers + 1] = tonumber(word) end
  file:close()
  -- harmonics, base frequency (rad/s), duration (s), then per channel (north, east, down, yaw) of the plan's own frame the
  -- offset and harmonics pairs a, b
  local n = numbers[1]
  if not n or #numbers ~= 3 + 4 * (1 + 2 * n) then return nil end
  for i = 2, 5 do numbers["place" .. i] = param:get("SCR_USER" .. i) end
  return numbers
end

-- q = sum a/(w l) sin(w l t) - b/(w l) cos(w l t) + c with its first two derivatives
local function channel(index, t)
  local n, w = plan[1], plan[2]
  local at = 3 + (index - 1) * (1 + 2 * n) + 1
  local q, v, acc = plan[at], 0, 0
  for l = 1, n do
    local a, b, wl = plan[at + 2 * l - 1], plan[at + 2 * l], w * l
    local s, c = math.sin(wl * t), math.cos(wl * t)
    q = q + a / wl * s - b / wl * c
    v = v + a * c + b * s
    acc = acc + wl * (b * c - a * s)
  end
  return q, v, acc
end

local function wrapped(radians)  -- the binding takes no more than a turn
  return (math.deg(radians) + 180) % 360 - 180
end

local function command(t)
  local pn, vn, an = channel(1, t)
  local pe, ve, ae = channel(2, t)
  local pd, vd, ad = channel(3, t)
  local yaw, rate = channel(4, t)
  local c, s = math.cos(plan.place5), math.sin(plan.place5)
  local position, velocity, acceleration = Vector3f(), Vector3f(), Vector3f()
  position:x(plan.place2 + c * pn - s * pe) position:y(plan.place3 + s * pn + c * pe) position:z(plan.place4 + pd)
  velocity:x(c * vn - s * ve) velocity:y(s * vn + c * ve) velocity:z(vd)
  acceleration:x(c * an - s * ae) acceleration:y(s * an + c * ae) acceleration:z(ad)
  vehicle:set_target_posvelaccel_NED(
    position, velocity, acceleration, true, wrapped(yaw + plan.place5), true, math.deg(rate), false)
end

local function report(now_ms, value, every_ms)
  if reported_ms and now_ms - reported_ms < every_ms then return end
  reported_ms = now_ms
  gcs:send_named_float("GSPATH", value)
end

local function stop(value, why)
  outcome, started_ms, reported_ms = value, nil, nil
  gcs:send_text(6, "excitation: " .. why)
end

local function may_fly()
  return vehicle:get_mode() == GUIDED and arming:is_armed() and vehicle:get_likely_flying()
end

function update()
  local now_ms, asked = millis():tofloat(), param:get("SCR_USER1") == 1
  if not asked then armed_order = true end
  if started_ms then
    local t = (now_ms - started_ms) * 0.001
    if not may_fly() then stop(-3, "ended by mode change")
    elseif not asked then stop(-3, "ended by the station")
    elseif t > plan[3] then stop(-2, "complete")
    else
      command(t)
      report(now_ms, t, REPORT_MS)
    end
  elseif asked and armed_order then
    armed_order = false
    plan = read_plan()
    if not plan then stop(-3, "excitation.txt cannot be read")
    elseif not may_fly() then stop(-3, "needs an armed vehicle in the air in GUIDED")
    else
      started_ms, outcome, reported_ms = now_ms, -1, nil
      gcs:send_text(6, "excitation: started")
    end
  elseif not asked then
    outcome = -1
  end
  if not started_ms then report(now_ms, outcome, outcome == -1 and IDLE_MS or REPORT_MS) end
  return update, PERIOD_MS
end

return update()
