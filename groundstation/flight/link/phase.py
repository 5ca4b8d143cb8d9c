"""Where a flight is by the link, and how an order is answered."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Phase(StrEnum):
    """Where the flight is."""

    IDLE = "idle"
    UPLOADED = "uploaded"
    ARMED = "armed"
    CLIMBING = "climbing"
    FOLLOWING = "following"
    HOLDING = "holding"
    LANDING = "landing"
    RELEASED = "released"
    LANDED = "landed"


IN_AIR = frozenset({Phase.CLIMBING, Phase.FOLLOWING, Phase.HOLDING, Phase.LANDING, Phase.RELEASED})
GUARDED = frozenset({Phase.CLIMBING, Phase.FOLLOWING, Phase.HOLDING, Phase.LANDING})


@dataclass(slots=True)
class Answered:
    """An order's answer, once there is one."""

    ok: bool | None = None
    reason: str = ""
