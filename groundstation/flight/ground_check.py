"""Preflight of what the core itself sees, on any vehicle: are the streams there, is the battery charged."""

from __future__ import annotations

from collections.abc import Mapping

from groundstation.flight.messages import StreamStatus
from groundstation.flight.sequence import ChecksAnswered
from groundstation.vehicle import Vehicle

LOOK_S = 1.0
PATIENCE_S = 5.0
NEEDED_STREAMS = ("imu", "motors")


def check_ground(
    streams: Mapping[str, StreamStatus], battery_v: float, vehicle: Vehicle, seen_s: float
) -> ChecksAnswered | None:
    """Yes or no with the reason and the remedy; None while there is too little to say.

    Args:
        streams: how each stream arrives.
        battery_v: at the terminals; 0 when it was not told.
        vehicle: as declared.
        seen_s: host time since the first sample.
    """
    if seen_s < LOOK_S:
        return None
    missing = [name for name in NEEDED_STREAMS if name not in streams]
    if missing:
        reason = f"no samples of {' and '.join(missing)} arrive; switch the stream on"
        return None if seen_s < PATIENCE_S else ChecksAnswered(False, reason)
    empty_v = vehicle.battery.empty_v
    if empty_v is not None and 0.0 < battery_v < empty_v:
        return ChecksAnswered(False, f"the battery is at {battery_v:.2f} V, below {empty_v:g} V; charge it")
    return ChecksAnswered(True)
