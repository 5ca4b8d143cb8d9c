"""The refusals and faults a user can meet. Each message says what is wrong, where, and what to do."""

from __future__ import annotations

from groundstation.texts import shown

LONGEST = 4000
"""Characters of a message. It may quote what others wrote, so it is a text that can be shown."""


class GroundStationError(Exception):
    """Base of every expected failure. ``exit_status`` is the process's exit status (docs/formats.md)."""

    exit_status = 2

    def __init__(self, text: str = ""):
        super().__init__(shown(text, limit=LONGEST))


class BadInput(GroundStationError):
    """The input or the arguments are wrong; nothing was written."""

    exit_status = 2


class Refused(GroundStationError):
    """The work was done and the answer is a refusal, with its reason and remedy.

    Args:
        reason: what the data cannot tell, in one sentence.
        remedy: what motion, stream or setting would change that.
        not_identifiable: the parameters that get no number.
    """

    exit_status = 3

    def __init__(self, reason: str, remedy: str = "", not_identifiable: tuple[str, ...] = ()):
        super().__init__(f"{reason} {remedy}".strip())
        self.reason = shown(reason, limit=LONGEST)
        self.remedy = shown(remedy, limit=LONGEST)
        self.not_identifiable = not_identifiable


class NotIdentifiable(Refused):
    """This motion does not reveal the named parameters."""


class LinkLost(GroundStationError):
    """A flight ended without the vehicle having been seen on the ground: it may still be flying."""

    exit_status = 5


class FlightAborted(GroundStationError):
    """A flight was aborted and ended safely."""

    exit_status = 4
