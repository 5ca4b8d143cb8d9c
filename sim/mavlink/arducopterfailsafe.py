"""What keeps ArduCopter from arming, and when its battery, geofence and silent-station failsafes act.

Thresholds and actions are the firmware's own parameters.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sim.mavlink.arducopter import ArduCopter


def arming_obstacle(a: ArduCopter) -> str | None:
    """Why it does not arm, None when it would."""
    if a.deny_arming is not None:
        return a.deny_arming
    if not a.estimate.position_valid:
        return "Need Position Estimate"
    if 0.0 < a.parameters["BATT_ARM_VOLT"] > a.truth.voltage_v:
        return "Battery 1 below minimum arming voltage"
    if a.mode.name in ("RTL", "LAND", "BRAKE"):
        return f"{a.mode.name} mode not armable"
    return None


def station_mode(a: ArduCopter) -> str | None:
    """The mode FS_GCS_ENABLE demands of a station that was heard and is no more; None while all is well."""
    action = int(a.parameters["FS_GCS_ENABLE"])
    heard_s = max((link.heard_s for link in a.outbox.links.values()), default=-math.inf)
    if not action or not math.isfinite(heard_s) or a.time_s - heard_s <= a.parameters["FS_GCS_TIMEOUT"]:
        return None
    return "LAND" if action == 5 or not a.estimate.position_valid else "RTL"


def battery_mode(a: ArduCopter) -> str | None:
    """The mode BATT_FS_LOW_ACT demands below BATT_LOW_VOLT."""
    action = a.parameters["BATT_FS_LOW_ACT"]
    if not action or not 0.0 < a.parameters["BATT_LOW_VOLT"] > a.truth.voltage_v:
        return None
    return "LAND" if action == 1 else "RTL"


def fence_breached(a: ArduCopter) -> bool:
    """Outside what FENCE_ALT_MAX and FENCE_RADIUS allow, and not on the way back already."""
    if not a.parameters["FENCE_ENABLE"] or a.mode.name in ("RTL", "LAND"):
        return False
    horizontal, vertical = a.distance_from_home
    kinds = int(a.parameters["FENCE_TYPE"])
    high = kinds & 1 and vertical > a.parameters["FENCE_ALT_MAX"]
    return bool(high or (kinds & 2 and horizontal > a.parameters["FENCE_RADIUS"]))


def fence_mode(a: ArduCopter) -> str | None:
    """The mode FENCE_ACTION demands of a breach; None only tells of it."""
    action = int(a.parameters["FENCE_ACTION"])
    return {1: "RTL", 2: "LAND", 4: "BRAKE"}.get(action, "RTL") if action else None
