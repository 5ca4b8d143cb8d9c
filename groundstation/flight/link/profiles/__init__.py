"""Vehicle profiles by name, and by what a heartbeat says."""

from __future__ import annotations

from groundstation.errors import BadInput
from groundstation.flight.link.profiles.arducopter import ArduCopter
from groundstation.flight.link.profiles.base import ParameterRule, Profile, StreamWish, Target, Version
from groundstation.flight.link.profiles.px4 import Px4

PROFILES: dict[str, type[Profile]] = {kind.name: kind for kind in (Px4, ArduCopter)}

__all__ = ["PROFILES", "ParameterRule", "Profile", "StreamWish", "Target", "Version", "profile_for"]


def profile_for(autopilot: int, system: int = 1, component: int = 1) -> Profile:
    """The profile of the autopilot that a heartbeat names.

    Raises:
        BadInput: none here knows it.
    """
    for kind in PROFILES.values():
        if kind.autopilot == autopilot:
            return kind(system, component)
    known = ", ".join(PROFILES)
    raise BadInput(f"system {system} runs autopilot {autopilot}, which no profile knows; there are {known}.")
