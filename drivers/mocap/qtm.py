"""Qualisys' real-time protocol (QTM RT 1.23, little endian) as a client, and its discovery. No I/O.

Messages are a 32-bit length, a 32-bit kind and a payload. Bodies come as "6D with residual": millimetres, a rotation
matrix by columns, NaN while a body is not seen. A frame carries its exposure's time in microseconds on QTM's clock and
no time of sending, so that the delay of the processing is part of what the clock cannot tell.
"""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ElementTree
from math import isfinite

from drivers.mocap.readings import (
    LONGEST_MESSAGE,
    MOST_BODIES,
    Body,
    Cursor,
    Damaged,
    Frame,
    Reading,
    RoundTrip,
    quaternion_of_matrix,
    tracked,
)
from drivers.samples import Vector3

PORT = 22223
DISCOVERY_PORT = 22226
ERROR, COMMAND, XML, DATA, NO_MORE_DATA, EVENT, DISCOVER = 0, 1, 2, 3, 4, 6, 7
SIX_D_RESIDUAL = 11
VERSION = "1.23"
ASK_EVERY_S = 1.0
_HEADER = struct.Struct("<II")


def message(kind: int, payload: bytes) -> bytes:
    """One message; commands and XML end with a NUL."""
    return _HEADER.pack(8 + len(payload), kind) + payload


def command(text: str) -> bytes:
    """One command."""
    return message(COMMAND, text.encode() + b"\0")


def discovery(answer_port: int) -> bytes:
    """The datagram that every QTM on the network answers on that port of ours (big endian, unlike all else)."""
    return _HEADER.pack(10, DISCOVER) + struct.pack(">H", answer_port)


def discovered(data: bytes) -> str | None:
    """What an answer to :func:`discovery` says: "PC, QTM 2024.1, 12 cameras"; None if it is no such answer."""
    if len(data) < 11 or _HEADER.unpack_from(data)[1] != COMMAND:
        return None
    return data[8:-2].split(b"\0")[0].decode("utf-8", "replace")


class Qtm:
    """See :class:`drivers.mocap.readings.Reader`."""

    def __init__(self) -> None:
        self.server, self.up, self.trouble = "", "", ""
        self.names: tuple[str, ...] = ()
        self.malformed = 0
        self._buffer = bytearray()
        self._asked_s: float | None = None
        self._tripped_s: float | None = None
        self._stage = 0  # greeted, version agreed, settings asked, streaming

    def due(self, now_s: float) -> list[bytes]:
        """The next request of the greeting, once its answer came; then the bodies' names, now and then."""
        if self._stage == 1:
            self._stage = 2
            return [self._ask(f"Version {VERSION}", now_s)]
        if self._stage == 3:
            self._stage = 4
            return [self._ask("GetParameters 6D General", now_s), command("StreamFrames AllFrames 6DRes")]
        if self._stage < 4 or (self._asked_s is not None and now_s - self._asked_s < ASK_EVERY_S):
            return []
        if not self.names:
            return [self._ask("GetParameters 6D General", now_s)]
        self._tripped_s = now_s
        return [self._ask("Version", now_s)]  # for how long the way there and back takes

    def _ask(self, text: str, now_s: float) -> bytes:
        self._asked_s = now_s
        return command(text)

    def feed(self, data: bytes, received_s: float) -> list[Reading]:
        """A portion of the stream."""
        self._buffer += data
        out: list[Reading] = []
        while len(self._buffer) >= 8:
            size, kind = _HEADER.unpack_from(self._buffer)
            if not 8 <= size <= LONGEST_MESSAGE:
                self.malformed += 1
                self._buffer.clear()
                self.trouble = "what comes is no QTM real-time protocol"
                break
            if len(self._buffer) < size:
                break
            payload = bytes(self._buffer[8:size])
            del self._buffer[:size]
            try:
                out += self._message(kind, payload, received_s)
            except (Damaged, struct.error, ElementTree.ParseError):
                self.malformed += 1
        return out

    def _message(self, kind: int, payload: bytes, received_s: float) -> list[Reading]:
        if kind == COMMAND:
            return self._answer(payload.rstrip(b"\0").decode("utf-8", "replace"), received_s)
        if kind == ERROR:
            self.trouble = f"QTM says: {payload.rstrip(bytes(1)).decode('utf-8', 'replace')}"
        elif kind == XML:
            self._settings(payload.rstrip(b"\0"))
        elif kind == NO_MORE_DATA:
            self.trouble = "QTM sends no data: start a measurement or real-time streaming in QTM"
        elif kind == DATA:
            self.trouble = ""
            return [self._frame(Cursor(payload))]
        return []

    def _answer(self, text: str, received_s: float) -> list[Reading]:
        if self._stage == 0:  # its greeting: "QTM RT Interface connected"
            self._stage, self.server = 1, "QTM"
            return []
        if self._stage == 2:
            self._stage, self.server = 3, f"QTM, RT protocol {VERSION}"
            self._tripped_s = self._asked_s
        sent_s, self._tripped_s = self._tripped_s, None
        return [RoundTrip(received_s - sent_s)] if sent_s is not None and received_s >= sent_s else []

    def _settings(self, text: bytes) -> None:
        if b"<!ENTITY" in text or b"<!DOCTYPE" in text:
            raise Damaged("XML with entities")
        root = ElementTree.fromstring(text)  # noqa: S314 - entities are refused above, the size by the message's
        names = [str(e.text or "").strip() for e in root.iterfind("*/Body/Name")]
        if names:
            self.names = tuple(names[:MOST_BODIES])
        up = root.findtext("*/Vertical_Axis") or root.findtext("*/*/Vertical_Axis") or ""
        self.up = up.strip().lstrip("+-").lower()[:1] if up else self.up

    def _frame(self, cursor: Cursor) -> Frame:
        microseconds, number, parts = cursor.values("qII")
        seen: list[Body] = []
        lost: list[str] = []
        for _ in range(min(int(parts), 64)):
            size, kind = (int(v) for v in cursor.values("II"))
            part = Cursor(cursor.take(size - 8))
            if kind != SIX_D_RESIDUAL:
                continue
            count = part.integer("i")
            part.take(4)  # drop rate, out of synchronisation
            if not 0 <= count <= MOST_BODIES:
                raise Damaged(f"{count} bodies")
            for index in range(count):
                name = self.names[index] if index < len(self.names) else str(index + 1)
                body = _body(part, name, index + 1)
                lost.append(name) if body is None else seen.append(body)
        return Frame(int(number), int(microseconds) * 1e-6, None, tuple(seen), tuple(lost))


def _body(part: Cursor, name: str, number: int) -> Body | None:
    """One entry; None while it is not seen."""
    x, y, z = part.vector()
    m = [float(v) for v in part.values("9f")]
    residual = float(part.values("f")[0])
    quaternion = quaternion_of_matrix((m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]))
    position: Vector3 = (1e-3 * x, 1e-3 * y, 1e-3 * z)
    if quaternion is None or not tracked(position, quaternion):
        return None
    return Body(name, position, quaternion, number, 1e-3 * residual if isfinite(residual) and residual >= 0.0 else None)
