"""Which message goes out on a link and when, with the two firmwares' different ideas of an interval.

PX4 checks every stream in each pass of its 4 ms loop: one is due once its age exceeds the interval less a part of the
loop's delay; the next is counted from the due time unless half an interval was missed. So 5 ms become 8 ms, 10 ms hold
on average, and nothing is faster than its topic (recorded: 247, 186 and 123 Hz at most). ArduPilot keeps whole
milliseconds and catches up (recorded: a request for 3333 us came at 333 Hz).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

Rule = Literal["px4", "ardupilot"]
PX4_SLACK_US = 900


@dataclass(slots=True)
class Stream:
    """One message's schedule on one link."""

    interval_us: int
    last_us: int = -(10**9)
    generation: int = -1


@dataclass(slots=True)
class Streams:
    """The schedule of one link.

    Args:
        rule: whose idea of an interval.
        topic_hz: how often a message's content is renewed, by id; nothing is sent twice.
    """

    rule: Rule
    topic_hz: dict[int, float] = field(default_factory=dict)
    table: dict[int, Stream] = field(default_factory=dict)

    def set(self, message_id: int, interval_us: int) -> None:
        """Ask for an interval; 0 or less stops the stream."""
        if interval_us <= 0:
            self.table.pop(message_id, None)
            return
        if self.rule == "ardupilot":
            interval_us = interval_us // 1000 * 1000
        known = self.table.get(message_id)
        if known is None:
            self.table[message_id] = Stream(interval_us)
        else:
            known.interval_us = interval_us

    def interval_us(self, message_id: int) -> int | None:
        """The interval in use, None when the message is not streamed."""
        stream = self.table.get(message_id)
        return None if stream is None else stream.interval_us

    def due(self, now_us: int) -> list[int]:
        """Message ids to send now; they are taken as sent."""
        return [number for number, stream in self.table.items() if self._is_due(number, stream, now_us)]

    def _is_due(self, number: int, stream: Stream, now_us: int) -> bool:
        age = now_us - stream.last_us
        slack = PX4_SLACK_US if self.rule == "px4" else 0
        if age < stream.interval_us - slack or (slack and age == stream.interval_us - slack):
            return False
        rate = self.topic_hz.get(number, math.inf)
        if math.isfinite(rate):
            generation = math.floor(now_us * 1e-6 * rate + 1e-6)
            if generation <= stream.generation:
                return False
            stream.generation = generation
        limit = 1.5 * stream.interval_us if self.rule == "px4" else 2.0 * stream.interval_us
        stream.last_us = stream.last_us + stream.interval_us if age < limit else now_us
        return True
