"""What leaves the emulated autopilot: links with their schedules, status texts, parameters, pieces of logs."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from drivers.mavlink.codec import MavlinkCodec
from sim.mavlink.streams import Streams
from sim.mavlink.wire import Message, mavlink

if TYPE_CHECKING:
    from sim.mavlink.autopilot import Autopilot

BUFFER = 4096.0
TEXT_AGE_S = 5.0
TEXT_LENGTH = 50


@dataclass(slots=True)
class Link:
    """One connection to a station.

    Attributes:
        kind: what is streamed unasked.
        bytes_per_s: what the wire carries; streams, parameters and logs wait for room, answers do not.
        heard_s: when a ground station's heartbeat last came, on the autopilot's clock.
        budget: room on the wire, bytes.
        texts_sent: number of the last status text that went out here.
        parameters: indices still to be sent.
        out: frames ready to leave.
    """

    name: str
    kind: str
    codec: MavlinkCodec
    streams: Streams
    bytes_per_s: float = math.inf
    heard_s: float = -math.inf
    budget: float = BUFFER
    texts_sent: int = 0
    parameters: deque[int] = field(default_factory=deque)
    out: list[bytes] = field(default_factory=list)

    def send(self, *outgoing: Message) -> None:
        """Queue messages."""
        self.out.extend(self.codec.encode(message) for message in outgoing)


class Outbox:
    """All links of one autopilot and what is common to them."""

    def __init__(self) -> None:
        self.links: dict[str, Link] = {}
        self._texts: deque[tuple[float, int, Message]] = deque(maxlen=64)
        self._text_count = 0

    def broadcast(self, *outgoing: Message) -> None:
        """Queue messages on every link."""
        for link in self.links.values():
            link.send(*outgoing)

    def text(self, now_s: float, severity: int, text: str, number: int) -> None:
        """STATUSTEXT in pieces of fifty, under one number."""
        for index, start in enumerate(range(0, len(text), TEXT_LENGTH)):
            piece = text[start : start + TEXT_LENGTH].encode()
            self._text_count += 1
            message = mavlink.MAVLink_statustext_message(severity, piece, number, index)
            self._texts.append((now_s, self._text_count, message))

    def emit(self, a: Autopilot) -> None:
        """Everything that is due in this cycle."""
        for link in self.links.values():
            if math.isfinite(link.bytes_per_s):
                link.budget = min(BUFFER, link.budget + link.bytes_per_s * a.EMIT_US * 1e-6)
        pieces = a.logs.due(
            min((link.budget for link in self.links.values() if math.isfinite(link.bytes_per_s)), default=math.inf)
        )
        for link in self.links.values():
            before = len(link.out)
            self._emit_texts(a, link)
            for _ in range(min(len(link.parameters), a.PARAMETERS_PER_TICK if link.budget > 0.0 else 0)):
                link.send(parameter_value(a, link.parameters.popleft()))
            link.send(*pieces)
            for message_id in link.streams.due(a.boot_us):
                if link.budget > 0.0:
                    link.send(*a.build(message_id))
            if math.isfinite(link.bytes_per_s):
                link.budget -= sum(len(frame) for frame in link.out[before:])

    def _emit_texts(self, a: Autopilot, link: Link) -> None:
        if link.texts_sent == self._text_count or not a.text_eligible(link):
            return
        link.send(*(m for t, n, m in self._texts if n > link.texts_sent and a.time_s - t < TEXT_AGE_S))
        link.texts_sent = self._text_count

    def restart(self, new_streams: Callable[[str], Streams]) -> None:
        """Forget what was asked for and said."""
        self._texts.clear()
        for link in self.links.values():
            link.streams, link.heard_s, link.texts_sent = new_streams(link.kind), -math.inf, self._text_count
            link.parameters.clear()

    def drain(self) -> list[tuple[str, bytes]]:
        """(link, frame) in order of departure, once."""
        out = [(link.name, frame) for link in self.links.values() for frame in link.out]
        for link in self.links.values():
            link.out.clear()
        return out


def parameter_value(a: Autopilot, index: int, *, shown: int | None = None) -> Message:
    """PARAM_VALUE of a parameter by index; ``shown`` is the index it claims."""
    parameter = a.parameters.all[index]
    return mavlink.MAVLink_param_value_message(
        parameter.name.encode(),
        a.parameters.to_wire(parameter),
        parameter.kind,
        len(a.parameters),
        index if shown is None else shown,
    )
