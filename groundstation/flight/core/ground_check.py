"""What the core itself sees of any vehicle: are the streams there and how do they do, is the battery charged."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec.structs import replace

from groundstation.flight import timeouts
from groundstation.flight.messages import CheckStatus, StreamStatus
from groundstation.flight.sequence import ChecksAnswered
from groundstation.vehicle import Vehicle

NEEDED_STREAMS = ("imu", "motors")
REMEDIES = {
    "imu": "raise its rate at the autopilot, or look at the link's load",
    "motors": "switch the motors' stream on at the autopilot",
    "pose": "look whether the cameras see the markers and the body is tracked",
    "state": "look at the autopilot's estimator",
    "battery": "look at the battery's monitor",
    "setpoint": "the station itself stalls; end what loads this computer",
}


def with_troubles(streams: Mapping[str, StreamStatus], *, in_flight: bool) -> dict[str, StreamStatus]:
    """The same streams, each with what is wrong with it in words and what to do."""
    told = dict(streams)
    for name in NEEDED_STREAMS:
        told.setdefault(name, StreamStatus())
    return {name: replace(stream, trouble=_trouble(name, stream, in_flight)) for name, stream in told.items()}


def _trouble(name: str, stream: StreamStatus, in_flight: bool) -> str:
    remedy = REMEDIES.get(name, "look at what sends it")
    if stream.count == 0:
        return f"nothing came yet; {remedy}"
    if stream.age_s > timeouts.STREAM_SILENT_S and (in_flight or name in NEEDED_STREAMS):
        return f"silent for {stream.age_s:.1f} s; {remedy}"
    if stream.rate_hz > 5.0 and stream.longest_gap_s > timeouts.STREAM_GAP_S:
        return f"had a gap of {stream.longest_gap_s:.1f} s; {remedy}"
    return ""


def checklist(streams: Mapping[str, StreamStatus], battery_v: float, vehicle: Vehicle) -> tuple[CheckStatus, ...]:
    """The items of :func:`check_ground`, each with what was seen."""
    items = []
    for name in NEEDED_STREAMS:
        stream = streams.get(name)
        seen = f"arrives at {stream.rate_hz:.0f} Hz" if stream else f"nothing came; {REMEDIES[name]}"
        items.append(CheckStatus(name, stream is not None, seen))
    empty_v = vehicle.battery.empty_v
    if battery_v > 0.0 and empty_v is not None:
        charged = battery_v >= empty_v
        items.append(
            CheckStatus(
                "voltage", charged, f"{battery_v:.2f} V, empty at {empty_v:g} V{'' if charged else '; charge it'}"
            )
        )
    return tuple(items)


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
    if seen_s < timeouts.STREAMS_LOOK_S:
        return None
    missing = [name for name in NEEDED_STREAMS if name not in streams]
    if missing:
        reason = f"no samples of {' and '.join(missing)} arrive; switch the stream on"
        return None if seen_s < timeouts.STREAMS_PATIENCE_S else ChecksAnswered(False, reason)
    empty_v = vehicle.battery.empty_v
    if empty_v is not None and 0.0 < battery_v < empty_v:
        return ChecksAnswered(False, f"the battery is at {battery_v:.2f} V, below {empty_v:g} V; charge it")
    return ChecksAnswered(True)
