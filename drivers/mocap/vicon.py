"""Vicon's DataStream (Tracker, Nexus, Shogun, Evoke) as a client. No I/O.

Wire format: little-endian packets of a 32-bit tag, a 32-bit length and objects, each again a tag, a length and a body
(Vicon DataStream SDK, ``ViconCGStream``, published under the MIT licence). The server begins with the kinds of object
it has; the client answers with those it wants, and asks for all frames. Frames are numbered on the cameras' clock,
whose period is told in ticks of 135 MHz; the latency of each, from exposure to sending, comes with it. That dates the
exposure on the cameras' own clock. A ping, which is echoed, gives the way there and back.
"""

from __future__ import annotations

import struct
from math import isfinite

from drivers.mocap.readings import (
    LONGEST_MESSAGE,
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

PORT = 801
TICKS_PER_S = 135e6
PACKET = 0x1A2B0001
OBJECT_KINDS, REQUEST_FRAME, CONTENTS = 100001, 100002, 100004
STREAM_INFO, SUBJECT_INFO, FRAME_INFO, GLOBAL_SEGMENTS, LATENCY_INFO = 1, 2, 5, 9, 26
APPLICATION_INFO, OBJECT_QUALITY, PING = 37, 40, 42
WANTED = (STREAM_INFO, SUBJECT_INFO, FRAME_INFO, GLOBAL_SEGMENTS, LATENCY_INFO, APPLICATION_INFO, PING, CONTENTS)
PING_EVERY_S = 0.5
_HEADER = struct.Struct("<II")


def packet(*objects: bytes) -> bytes:
    """A packet of objects."""
    body = b"".join(objects)
    return _HEADER.pack(PACKET, len(body)) + body


def thing(kind: int, body: bytes) -> bytes:
    """One object."""
    return _HEADER.pack(kind, len(body)) + body


class Vicon:
    """See :class:`drivers.mocap.readings.Reader`."""

    def __init__(self) -> None:
        self.server, self.up, self.trouble = "", "", ""
        self.names: tuple[str, ...] = ()
        self.malformed = 0
        self._buffer = bytearray()
        self._offered: set[int] | None = None
        self._asked = False
        self._subjects: dict[int, tuple[str, int]] = {}  # number -> name, root segment
        self._period_s: float | None = None
        self._latency_s: float | None = None
        self._frame: int | None = None
        self._poses: dict[int, Body] = {}
        self._pinged_s = -1e9
        self._pings: dict[int, float] = {}

    def due(self, now_s: float) -> list[bytes]:
        """The wanted kinds once those offered are known; a ping now and then."""
        if self._offered is None:
            return []
        out: list[bytes] = []
        if not self._asked:
            self._asked = True
            kinds = sorted((set(WANTED) & self._offered) | {CONTENTS})
            out.append(packet(thing(OBJECT_KINDS, struct.pack(f"<I{len(kinds)}I", len(kinds), *kinds))))
            out.append(packet(thing(REQUEST_FRAME, b"\1")))
        if PING in self._offered and now_s - self._pinged_s >= PING_EVERY_S:
            self._pinged_s = now_s
            number = int(now_s * 1e6)
            self._pings = {n: t for n, t in self._pings.items() if now_s - t < 5.0} | {number: now_s}
            out.append(packet(thing(PING, struct.pack("<Q", number))))
        return out

    def feed(self, data: bytes, received_s: float) -> list[Reading]:
        """A portion of the stream."""
        self._buffer += data
        out: list[Reading] = []
        while len(self._buffer) >= 8:
            tag, size = _HEADER.unpack_from(self._buffer)
            if tag != PACKET or size > LONGEST_MESSAGE:
                self.malformed += 1
                self._buffer.clear()
                self.trouble = "what comes is no Vicon DataStream"
                break
            if len(self._buffer) < 8 + size:
                break
            body = bytes(self._buffer[8 : 8 + size])
            del self._buffer[: 8 + size]
            try:
                out += self._packet(Cursor(body), received_s)
            except (Damaged, struct.error):
                self.malformed += 1
        return out

    def _packet(self, cursor: Cursor, received_s: float) -> list[Reading]:
        out: list[Reading] = []
        frame, posed, unchanged = None, dict[int, Body](), set[int]()
        while cursor.left >= 8:
            kind, size = (int(v) for v in cursor.values("II"))
            part = Cursor(cursor.take(size))
            if kind == OBJECT_KINDS:
                self._offered, self.server = set(_integers(part)), "Vicon DataStream"
            elif kind == CONTENTS:
                part.take(8 * part.count(8))
                unchanged = set(_integers(part))
            elif kind == STREAM_INFO:
                period = part.integer("q") / TICKS_PER_S
                self._period_s = period if 1e-4 < period < 10.0 else None
            elif kind == APPLICATION_INFO:
                self.up = "y" if part.integer("B") == 1 else "z"
            elif kind == SUBJECT_INFO:
                self._subject(part)
            elif kind == FRAME_INFO:
                frame = part.integer()
            elif kind == LATENCY_INFO:
                self._latency_s = _latency_s(part)
            elif kind == GLOBAL_SEGMENTS:
                self._segments(part, posed)
            elif kind == PING:
                sent_s = self._pings.pop(part.integer("Q"), None)
                if sent_s is not None and received_s >= sent_s:
                    out.append(RoundTrip(received_s - sent_s))
        if frame is not None:
            self._poses = self._poses if GLOBAL_SEGMENTS in unchanged and not posed else posed
            out.append(self._dated(frame))
        return out

    def _subject(self, part: Cursor) -> None:
        number, name = part.integer(), _text(part)
        roots = [(part.integer(), part.integer(), part.take(24), _text(part)) for _ in range(part.count(36))]
        root = next((segment for parent, segment, _, _ in roots if parent == 0), None)
        if root is None and roots:
            root = roots[0][1]
        if root is not None and len(self._subjects) < 1000:
            self._subjects[number] = (name, root)
        self.names = tuple(name for name, _ in self._subjects.values())

    def _segments(self, part: Cursor, posed: dict[int, Body]) -> None:
        number = part.integer()
        name, root = self._subjects.get(number, (str(number), -1))
        for _ in range(part.count(100)):
            segment = part.integer()
            x, y, z = part.vector("3d")
            quaternion = quaternion_of_matrix([float(v) for v in part.values("9d")])
            position: Vector3 = (1e-3 * x, 1e-3 * y, 1e-3 * z)
            if segment == root and quaternion is not None and tracked(position, quaternion):
                posed[number] = Body(name, position, quaternion, number)

    def _dated(self, number: int) -> Frame:
        exposure_s = number * self._period_s if self._period_s is not None else None
        sent_s = exposure_s + self._latency_s if exposure_s is not None and self._latency_s is not None else None
        lost = tuple(name for n, (name, _) in self._subjects.items() if n not in self._poses)
        return Frame(number, exposure_s, sent_s, tuple(self._poses.values()), lost)


def _text(part: Cursor) -> str:
    return part.take(part.integer()).decode("utf-8", "replace")


def _integers(part: Cursor) -> list[int]:
    return [int(v) for v in part.values(f"{part.count(4)}I")]


def _latency_s(part: Cursor) -> float | None:
    """Sum of the named latencies; None where it cannot be one."""
    total = 0.0
    for _ in range(part.count(12)):
        _text(part)
        total += float(part.values("d")[0])
    return total if isfinite(total) and 0.0 <= total < 10.0 else None
