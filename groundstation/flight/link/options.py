"""What one link is asked to do beside flying, and what one of its steps gives."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from drivers.samples import Sample

TakeOver = Literal["", "land", "hold"]


@dataclass(frozen=True, slots=True)
class Options:
    """What one link is to do beside flying.

    Attributes:
        system: vehicle's system id; None takes the first autopilot heard.
        force: preflight checks whose failure the operator answers for.
        set_parameters: set the settable ones for the flight, and restore them afterwards.
        bytes_per_s: what the line carries; None where that is no limit.
        keep_raw: raw frames become samples too.
        quiet: ask for no messages and read no parameters: for fetching files alone.
        take_over: what is done with a vehicle that is found in flight: ``land``, or ``hold`` (a minute, then land).
            Empty leaves it to its own failsafe: it gets no heartbeat of ours, which would hold that off.
    """

    system: int | None = None
    force: tuple[str, ...] = ()
    set_parameters: bool = False
    bytes_per_s: float | None = None
    keep_raw: bool = True
    quiet: bool = False
    take_over: TakeOver = ""


PLAIN = Options()


@dataclass(slots=True)
class Output:
    """What one step gives: bytes to send, samples with the host time they came, parameters changed (name, before,
    now).
    """

    send: list[bytes] = field(default_factory=list)
    samples: list[tuple[Sample, float]] = field(default_factory=list)
    changed: list[tuple[str, float, float]] = field(default_factory=list)
