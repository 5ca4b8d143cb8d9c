"""Who speaks: the vehicle, somebody beside it, or somebody else. Decided once, where a frame enters. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from drivers.mavlink.timesync import ClockFit
from drivers.mavlink.transports import Peer
from groundstation.flight.link.inlet import CLOCK_S, Arrival, stamp_s
from groundstation.flight.link.profiles import Profile

Who = Literal["vehicle", "moved", "beside", "other"]
"""``moved``: the vehicle, from a new address; ``beside``: another component of its system; ``other``: to be left out.
"""


@dataclass(frozen=True, slots=True)
class Speaker:
    """Who it is, and what is to be said of it; empty when nothing is."""

    who: Who
    said: str = ""


_OTHER = Speaker("other")


def speaker(
    arrival: Arrival, profile: Profile, peer: Peer | None, clock: ClockFit | None, *, silent: bool, in_flight: bool
) -> Speaker:
    """Who sent a frame.

    Args:
        arrival: the frame, whence and when. Its signature, where one is used, was verified before.
        profile: of the vehicle: its system and its autopilot's component.
        peer: where the vehicle was found.
        clock: maps our time to the vehicle's; None before it was asked.
        silent: nothing came from there for a while.
        in_flight: the vehicle is led, or on its way down.
    """
    frame = arrival.received.frame
    if frame.system != profile.system:
        return _OTHER
    if arrival.peer == peer:
        if frame.component == profile.component:
            return Speaker("vehicle")
        return Speaker("beside", f"component {frame.component} of the vehicle speaks; recorded, not believed")
    stamp = stamp_s(arrival.received)
    if not silent or frame.component != profile.component or clock is None or stamp is None:
        return _OTHER
    if abs(stamp - clock.device(arrival.received_s)) > CLOCK_S:
        return Speaker("other", f"{arrival.peer} says it is the vehicle, but its clock is another's; not listened to")
    if not in_flight:
        return Speaker("other", f"the vehicle is heard from {arrival.peer}, not from {peer}; start the link again")
    return Speaker("moved", f"the vehicle moved from {peer} to {arrival.peer}; its clock goes on")
