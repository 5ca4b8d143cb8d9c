"""Which autopilots are heard on a link, and what to say where the one to fly is not the first, or not the only one."""

from __future__ import annotations

_MOST = 8  # a stranger may claim every number there is
_NAMES = {3: "ArduPilot", 12: "PX4"}


class Roster:
    """Systems by id.

    Args:
        wanted: the system to fly; None takes the first heard.
    """

    def __init__(self, wanted: int | None):
        self.wanted = wanted
        self.systems: dict[int, str] = {}

    def hears(self, system: int, autopilot: int) -> str:
        """A heartbeat of an autopilot: what to tell of it; empty for one heard before, and for the only one that is
        expected.
        """
        if system in self.systems or len(self.systems) >= _MOST:
            return ""
        self.systems[system] = _NAMES.get(autopilot, f"autopilot {autopilot}")
        if len(self.systems) == 1 and self.wanted in (None, system):
            return ""
        if self.wanted is None:
            return (
                f"systems heard on the link: {self}; the first that can be flown is taken; choose with --system N, or "
                "with the station file's key system"
            )
        return f"systems heard on the link: {self}; system {self.wanted} is wanted"

    def trouble(self) -> str:
        """Why nobody is flown yet."""
        if not self.systems:
            return "no autopilot heard yet"
        if self.wanted is not None and self.wanted not in self.systems:
            return f"system {self.wanted} is not heard; on the link are {self}"
        return ""

    def __str__(self) -> str:
        return ", ".join(f"{number} ({name})" for number, name in sorted(self.systems.items()))
