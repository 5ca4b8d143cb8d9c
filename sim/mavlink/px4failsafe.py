"""What keeps PX4 from arming, and its failsafes that stay once they have acted: battery, geofence, silent station.

Thresholds and actions are the firmware's own parameters. The 2.4 s beyond COM_DL_LOSS_T are measured.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sim.mavlink.px4 import Px4

LINK_MARGIN_S = 2.4
GLOBAL_MODES = ("LOITER", "MISSION", "RTL")
"""They want a place on Earth to arm in, which poses do not give."""


def arming_obstacle(a: Px4) -> str | None:
    """Why it does not arm, None when it would."""
    if a.deny_arming is not None:
        return a.deny_arming
    if a.intention == "OFFBOARD" and not a.setpoints_fresh:
        return "no offboard signal"
    if a.modes[a.intention].needs_position and not a.estimate.position_valid:
        return "no valid local position estimate"
    if a.estimator.source == "vision" and a.intention in GLOBAL_MODES:
        return "no valid global position estimate"
    if a.battery.percent <= 100 * a.parameters["BAT_CRIT_THR"]:
        return "low battery"
    return None


def standing_failsafe(a: Px4) -> str | None:
    """The mode one of them demands from now on, None for none; on the ground there is none."""
    if a.landed:
        return None
    return _battery(a) or _fence(a) or link_action(a, silent_for_s(a) - a.parameters["COM_FAIL_ACT_T"])


def _battery(a: Px4) -> str | None:
    share, action = a.battery.percent / 100, int(a.parameters["COM_LOW_BAT_ACT"])
    if action == 0:
        return None
    critical = share <= a.parameters["BAT_CRIT_THR"]
    if share <= a.parameters["BAT_EMERGEN_THR"] or (action == 2 and critical):
        return "LAND"
    return "RTL" if action == 3 and critical else None


def _fence(a: Px4) -> str | None:
    horizontal, vertical = a.distance_from_home
    widest, highest = a.parameters["GF_MAX_HOR_DIST"], a.parameters["GF_MAX_VER_DIST"]
    if not (0.0 < widest < horizontal or 0.0 < highest < vertical):
        return None
    return {2: "LOITER", 3: "RTL", 5: "LAND"}.get(int(a.parameters["GF_ACTION"]))


def silent_for_s(a: Px4) -> float:
    """How long the station has been missing beyond what is tolerated; negative while it is not."""
    heard = max((link.heard_s for link in a.outbox.links.values()), default=-math.inf)
    if not math.isfinite(heard):
        return -math.inf
    return a.time_s - heard - a.parameters["COM_DL_LOSS_T"] - LINK_MARGIN_S


def link_action(a: Px4, overdue_s: float) -> str | None:
    """What NAV_DLL_ACT says once the time is up."""
    return {1: "LOITER", 2: "RTL", 3: "LAND"}.get(int(a.parameters["NAV_DLL_ACT"])) if overdue_s > 0.0 else None
