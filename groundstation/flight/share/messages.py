"""What a station's gate says and hears beside the core's own messages."""

from __future__ import annotations

import msgspec

from groundstation.flight.journal import NAME as JOURNAL

FILES = (
    "plan.toml",
    JOURNAL,
    "identification.json",
    "diagnosis.json",
    "refused.json",
    "evolution.json",
    "identification.toml",
    "next_flight.toml",
    "report.html",
)
"""What of a flight's folder a view on another machine may read: all that its screens show.

The recording stays at the station.
"""
PART_BYTES = 128 * 1024
"""Of one answer: small enough that an order never waits long behind it."""
FILE_BYTES = 64 * 1024 * 1024


class Shared(msgspec.Struct, frozen=True):
    """The flight of a station, published on every status of the core, and once a second.

    Attributes:
        station: its name.
        running: a core is up; else ``status`` is the last one of a flight that ended.
        status: ``messages.CoreStatus``, encoded; empty before the first flight.
        fresh: the core said it just now.
    """

    station: str
    running: bool
    status: bytes = b""
    fresh: bool = False


class FileRequest(msgspec.Struct, frozen=True):
    """A part of a file of the flight that is shared."""

    flight: str
    name: str
    offset: int = 0


class FilePart(msgspec.Struct, frozen=True):
    """The part, and how long the file is."""

    ok: bool
    reason: str = ""
    size: int = 0
    data: bytes = b""
