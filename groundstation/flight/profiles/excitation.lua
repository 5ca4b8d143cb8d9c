-- Flies the uploaded excitation on board: the finite Fourier series of the plan, sampled at the autopilot's own rate.
-- Wants: SCR_ENABLE 1, this file in scripts/, and scripts/excitation.txt with the coefficients (see upload.py).
-- The station starts it by setting SCR_USER1 to 1 while the vehicle hovers in GUIDED at the start, and watches GSPATH
-- (seconds flown; -1 when it is over). Any other mode ends it for good: a second start needs SCR_USER1 0, then 1.

local PERIOD_MS = 10
local GUIDED = 4
local plan, started_ms, over

local function read_plan()
  local file = io.open("scripts/excitation.txt", "r")
  if not file then return nil end
  local numbers = {}
  for word in string.gmatch(file:read("*a"), "%S+") do numbers[#numbers + 1] = tonumber(word) end
  file:close()
  -- harmonics, base frequency (rad/s), duration (s), origin north, east, down (m), heading (rad), then per channel
  -- (north, east, down, yaw) the offset and harmonics pairs a, b
  local n = numbers[1]
  if not n or #numbers ~= 7 + 4 * (1 + 2 * n) then return nil end
  return numbers
end

-- q = sum a/(w l) sin(w l t) - b/(w l) cos(w l t) + c with its first two derivatives
local function channel(index, t)
  local n, w = plan[1], plan[2]
  local at = 7 + (index - 1) * (1 + 2 * n) + 1
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

local function command(t)
  local pn, vn, an = channel(1, t)
  local pe, ve, ae = channel(2, t)
  local pd, vd, ad = channel(3, t)
  local yaw, rate = channel(4, t)
  local position, velocity, acceleration = Vector3f(), Vector3f(), Vector3f()
  position:x(pn) position:y(pe) position:z(pd)
  velocity:x(vn) velocity:y(ve) velocity:z(vd)
  acceleration:x(an) acceleration:y(ae) acceleration:z(ad)
  vehicle:set_target_posvelaccel_NED(position, velocity, acceleration, true, math.deg(yaw), true, math.deg(rate), false)
end

local function stop(why)
  over, started_ms = true, nil
  gcs:send_named_float("GSPATH", -1)
  gcs:send_text(6, "excitation: " .. why)
end

function update()
  local asked = param:get("SCR_USER1") == 1
  if not asked then over = false end
  if started_ms then
    local t = (millis():tofloat() - started_ms) * 0.001
    if vehicle:get_mode() ~= GUIDED or not arming:is_armed() then stop("ended by mode change")
    elseif not asked then stop("ended by the station")
    elseif t > plan[3] then stop("complete")
    else
      command(t)
      gcs:send_named_float("GSPATH", t)
    end
  elseif asked and not over then
    plan = read_plan()
    if not plan then stop("scripts/excitation.txt cannot be read")
    elseif vehicle:get_mode() ~= GUIDED or not arming:is_armed() then stop("needs an armed vehicle in GUIDED")
    else
      started_ms = millis():tofloat()
      gcs:send_text(6, "excitation: started")
    end
  end
  return update, PERIOD_MS
end

return update()
