"""VRPN's tracker (protocol 07) as a client over TCP. No I/O.

Wire format: a cookie of 24 characters both ways, then big-endian messages with a header of 24 bytes (length without
padding, seconds, microseconds, sender, type, sequence number) and a payload padded to 8 bytes (VRPN,
``vrpn_Connection.C`` and ``vrpn_Tracker.C``, published under the Boost licence). Senders and types are numbered by each
side for itself, and described by messages of type -1 and -2. A pose carries the server's clock at the time of its
report; a ping is answered with that clock too, so that it is known both ways. No exposure is told.
"""

from __future__ import annotations

import struct

from drivers.mocap.readings import LONGEST_MESSAGE, Body, Cursor, Damaged, Exchange, Frame, Reading, tracked, unit

PORT = 3883
COOKIE = b"vrpn: ver. 07.35  0".ljust(24, b"\0")
SENDER_DESCRIPTION, TYPE_DESCRIPTION = -1, -2
POSE_TYPE, PING_TYPE, PONG_TYPE = "vrpn_Tracker Pos_Quat", "vrpn_Base ping_message", "vrpn_Base pong_message"
NO_TRACKERS = ("VRPN Control", "vrpn_Control")
PING_EVERY_S = 0.2
LOST_AFTER_S = 0.25
"""A body that is not seen is not reported at all; it counts as lost after this long without a report."""
_HEADER = struct.Struct(">IIIiiI")


def message(kind: int, sender: int, payload: bytes, stamp_s: float = 0.0) -> bytes:
    """One message with its padding."""
    seconds, rest = divmod(round(stamp_s * 1e6), 1_000_000)
    header = _HEADER.pack(24 + len(payload), seconds & 0xFFFFFFFF, rest, sender, kind, 0)
    return header + payload + bytes(-len(payload) % 8)


def description(kind: int, number: int, name: str) -> bytes:
    """What a sender or a type of ours is called."""
    text = name.encode() + b"\0"
    return message(kind, number, struct.pack(">I", len(text)) + text)


class Vrpn:
    """See :class:`drivers.mocap.readings.Reader`."""

    def __init__(self) -> None:
        self.server, self.up, self.trouble = "", "", ""
        self.names: tuple[str, ...] = ()
        self.malformed = 0
        self._buffer = bytearray()
        self._greeted = self._cookie = False
        self._senders: dict[int, str] = {}
        self._types: dict[int, str] = {}
        self._described: set[str] = set()
        self._pinged_s = -1e9
        self._ping_s: float | None = None
        self._seen_s: dict[str, float] = {}

    def due(self, now_s: float) -> list[bytes]:
        """Cookie, the types and senders that pings need, and a ping now and then."""
        out: list[bytes] = []
        if not self._greeted:
            self._greeted = True
            return [COOKIE]
        if not self._cookie:
            return out
        if not self._described:
            out.append(description(TYPE_DESCRIPTION, 0, PING_TYPE))
        for name in self.names:
            if name not in self._described and len(self._described) < 100:
                out.append(description(SENDER_DESCRIPTION, len(self._described), name))
                self._described.add(name)
        if self._described and now_s - self._pinged_s >= PING_EVERY_S:
            self._pinged_s = self._ping_s = now_s
            out.append(message(0, 0, b""))  # a ping to the first sender
        return out

    def feed(self, data: bytes, received_s: float) -> list[Reading]:
        """A portion of the stream."""
        self._buffer += data
        out: list[Reading] = []
        if not self._cookie and not self._take_cookie():
            return out
        while len(self._buffer) >= 24:
            size = struct.unpack_from(">I", self._buffer)[0]
            padded = size + (-size % 8)
            if not 24 <= size <= LONGEST_MESSAGE:
                self.malformed += 1
                self._buffer.clear()
                self.trouble = "what comes is no VRPN"
                break
            if len(self._buffer) < padded:
                break
            body = bytes(self._buffer[:size])
            del self._buffer[:padded]
            try:
                out += self._message(body, received_s)
            except (Damaged, struct.error):
                self.malformed += 1
        return out

    def _take_cookie(self) -> bool:
        if len(self._buffer) < 24:
            return False
        cookie = bytes(self._buffer[:24])
        if not cookie.startswith(b"vrpn: ver. 07."):
            self.malformed += 1
            self._buffer.clear()
            self.trouble = "what answers is no VRPN server of protocol 07"
            return False
        del self._buffer[:24]
        self._cookie, self.trouble = True, ""
        self.server = cookie[:16].decode("ascii", "replace").replace("vrpn: ver.", "VRPN")
        return True

    def _message(self, body: bytes, received_s: float) -> list[Reading]:
        _, seconds, microseconds, sender, kind, _ = _HEADER.unpack_from(body)
        payload = Cursor(body[24:], ">")
        stamp_s = seconds + 1e-6 * microseconds
        if kind == TYPE_DESCRIPTION and len(self._types) < 2000:
            self._types[sender] = _name(payload)
        elif kind == SENDER_DESCRIPTION and len(self._senders) < 1000:
            self._senders[sender] = _name(payload)
            self.names = tuple(n for n in self._senders.values() if n not in NO_TRACKERS)
        elif self._types.get(kind) == PONG_TYPE and self._ping_s is not None:
            sent_s, self._ping_s = self._ping_s, None
            if 0.0 <= received_s - sent_s < 2.0:
                return [Exchange(sent_s, stamp_s, received_s)]
        elif self._types.get(kind) == POSE_TYPE:
            return self._pose(payload, self._senders.get(sender, str(sender)), stamp_s, received_s)
        return []

    def _pose(self, payload: Cursor, name: str, stamp_s: float, received_s: float) -> list[Reading]:
        sensor, _ = payload.values("ii")
        position = payload.vector("3d")
        x, y, z, w = (float(v) for v in payload.values("4d"))
        if sensor != 0 or not tracked(position, (w, x, y, z)):
            return []
        self._seen_s[name] = received_s
        lost = tuple(n for n in self.names if received_s - self._seen_s.get(n, -1e9) > LOST_AFTER_S)
        return [Frame(None, None, stamp_s, (Body(name, position, unit((w, x, y, z))),), lost)]


def _name(payload: Cursor) -> str:
    return payload.take(min(payload.integer(), payload.left)).split(b"\0")[0].decode("utf-8", "replace")
