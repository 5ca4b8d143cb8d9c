"""What the servers say, by system: OptiTrack NatNet, Qualisys QTM RT, Vicon DataStream, VRPN. No I/O.

Each follows its maker's published client: NatNet SDK 4.1 samples, qualisys_python_sdk 3.1, Vicon DataStream SDK 1.11
(``ViconCGStream``), VRPN 7.38 (``vrpn_Connection.C``). Times are the server's own clock.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from math import nan
from typing import Protocol

from sim.mocap.scene import Quaternion, Seen


@dataclass(frozen=True, slots=True)
class Shot:
    """One frame of the cameras: its number, when it was exposed and sent, and what was seen."""

    number: int
    exposure_s: float
    sent_s: float
    seen: Sequence[Seen]


class Wire(Protocol):
    """One client's connection, as the server has it."""

    def greeting(self) -> list[bytes]:
        """What leaves as soon as a client connects."""
        ...

    def receive(self, data: bytes, clock_s: float) -> list[bytes]:
        """Answers to what a client sent."""
        ...

    def frame(self, shot: Shot) -> list[bytes]:
        """A frame, once the client asked for frames."""
        ...


def matrix_of(quaternion: Quaternion) -> list[float]:
    """Rotation matrix by rows."""
    w, x, y, z = quaternion
    return [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]


class NatNetWire:
    """Motive. One for all clients, as its frames are the same.

    Args:
        names: of the bodies, numbered from 1.
        version: of the protocol: (3, 0), (3, 1), (4, 0) or (4, 1).
        multicast: group and port, where it streams to one.
    """

    TICKS = 10_000_000

    def __init__(
        self, names: Sequence[str], version: tuple[int, int] = (4, 1), multicast: tuple[str, int] | None = None
    ):
        self._names, self._version, self._multicast = tuple(names), version, multicast
        self.wanted = False

    def greeting(self) -> list[bytes]:
        """See :class:`Wire`."""
        return []

    def receive(self, data: bytes, clock_s: float) -> list[bytes]:
        """See :class:`Wire`."""
        if len(data) < 4:
            return []
        number, _ = struct.unpack_from("<HH", data)
        if number in (0, 14):
            self.wanted = True
            return [self._say(1, self._server())]
        if number == 4:
            return [self._say(5, self._model())]
        if number == 12 and len(data) >= 12:
            return [self._say(13, data[4:12] + struct.pack("<Q", round(clock_s * self.TICKS)))]
        return []

    def _say(self, number: int, payload: bytes) -> bytes:
        return struct.pack("<HH", number, len(payload)) + payload

    def _server(self) -> bytes:
        group, port = self._multicast or ("0.0.0.0", 1511)  # noqa: S104 - no group; nothing is bound to it
        quad = bytes(int(part) for part in group.split("."))
        head = b"Motive".ljust(256, b"\0") + bytes([3, 1, 0, 0]) + bytes([*self._version, 0, 0])
        return head + struct.pack("<QHB", self.TICKS, port, self._multicast is not None) + quad

    def _sized(self, payload: bytes) -> bytes:
        return (struct.pack("<I", len(payload)) if self._version >= (4, 1) else b"") + payload

    def _model(self) -> bytes:
        out = struct.pack("<I", 2 * len(self._names))
        for number, name in enumerate(self._names, start=1):
            text = name.encode() + b"\0"
            markers = b"".join(f"Marker{i}".encode() + b"\0" for i in (1, 2, 3))
            out += struct.pack("<I", 0) + self._sized(text + struct.pack("<I", 3) + markers)
            body = text + struct.pack("<ii3f", number, -1, 0, 0, 0) + struct.pack("<I", 3)
            body += struct.pack("<9f3I", *(0.1, 0, 0), *(0, 0.1, 0), *(-0.1, 0, 0.02), 0, 0, 0)
            if self._version >= (4, 0):
                body += markers
            out += struct.pack("<I", 1) + self._sized(body)
        return out

    def _section(self, count: int, payload: bytes = b"") -> bytes:
        return struct.pack("<I", count) + self._sized(payload)

    def frame(self, shot: Shot) -> list[bytes]:
        """See :class:`Wire`."""
        bodies = b""
        for each in shot.seen:
            (x, y, z), (w, a, b, c) = each.pose or ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
            bodies += struct.pack("<i3f4ffH", each.number, x, y, z, a, b, c, w, each.residual_m, each.pose is not None)
        marker = b"all\0" + struct.pack("<I3f", 1, 0.1, 0.2, 0.3)
        labeled = struct.pack("<I3ffHf", 65537, 0.1, 0.2, 0.3, 0.012, 2, 0.0003)
        out = struct.pack("<I", shot.number) + self._section(1, marker) + self._section(1, struct.pack("<3f", 1, 2, 3))
        out += self._section(len(shot.seen), bodies) + self._section(0)
        if self._version >= (4, 1):
            out += self._section(0)
        out += self._section(1, labeled) + self._section(0) + self._section(0)
        exposure, sent = round(shot.exposure_s * self.TICKS), round(shot.sent_s * self.TICKS)
        out += struct.pack("<IIdQQQ", 0, 0, shot.exposure_s, exposure, (exposure + sent) // 2, sent)
        if self._version >= (4, 1):
            out += struct.pack("<II", int(shot.exposure_s), 0)
        return [self._say(7, out + struct.pack("<HI", 0, 0))]


class QtmWire:
    """QTM's real-time server, one client's connection."""

    def __init__(self, names: Sequence[str]):
        self._names = tuple(names)
        self._buffer = b""
        self.wanted = False

    def greeting(self) -> list[bytes]:
        """See :class:`Wire`."""
        return [self._say(1, b"QTM RT Interface connected\0")]

    def _say(self, kind: int, payload: bytes) -> bytes:
        return struct.pack("<II", 8 + len(payload), kind) + payload

    def receive(self, data: bytes, clock_s: float) -> list[bytes]:
        """See :class:`Wire`."""
        self._buffer += data
        out: list[bytes] = []
        while len(self._buffer) >= 8:
            size, kind = struct.unpack_from("<II", self._buffer)
            if len(self._buffer) < size or size < 8:
                break
            text = self._buffer[8:size].rstrip(b"\0").decode(errors="replace").lower()
            self._buffer = self._buffer[size:]
            out += self._answer(text) if kind == 1 else []
        return out

    def _answer(self, text: str) -> list[bytes]:
        if text.startswith("version"):
            return [self._say(1, f"Version set to {text.split()[-1]}\0".encode())]
        if text.startswith("getparameters"):
            bodies = "".join(f"<Body><Name>{n}</Name><Color R='0' G='0' B='0'/></Body>" for n in self._names)
            general = "<General><Frequency>200</Frequency><Vertical_Axis>+Z</Vertical_Axis></General>"
            tracked = f"<The_6D><Bodies>{len(self._names)}</Bodies>{bodies}</The_6D>"
            xml = f"<QTM_Parameters_Ver_1.23>{general}{tracked}</QTM_Parameters_Ver_1.23>"
            return [self._say(2, xml.encode() + b"\0")]
        if text.startswith("streamframes"):
            self.wanted = "stop" not in text
            return []
        return [self._say(0, b"Parse error\0")]

    def frame(self, shot: Shot) -> list[bytes]:
        """See :class:`Wire`: one component, 6D with residual."""
        if not self.wanted:
            return []
        body = struct.pack("<ihh", len(shot.seen), 0, 0)
        for each in shot.seen:
            if each.pose is None:
                body += struct.pack("<13f", *[nan] * 13)
                continue
            m, p = matrix_of(each.pose[1]), each.pose[0]
            columns = [m[3 * row + column] for column in range(3) for row in range(3)]
            body += struct.pack("<13f", *(1e3 * v for v in p), *columns, 1e3 * each.residual_m)
        part = struct.pack("<II", 8 + len(body), 11) + body
        return [self._say(3, struct.pack("<qII", round(shot.exposure_s * 1e6), shot.number, 1) + part)]


class ViconWire:
    """Vicon Tracker, one client's connection.

    Args:
        names: of the subjects, numbered from 1; the root segment is called as its subject.
        rate_hz: of the cameras.
        start_s: exposure of frame 0 on the cameras' clock.
    """

    KINDS = (1, 2, 5, 8, 9, 26, 37, 42, 100004)

    def __init__(self, names: Sequence[str], rate_hz: float, *, y_up: bool = False):
        self._names, self._rate_hz, self._y_up = tuple(names), rate_hz, y_up
        self._buffer = b""
        self._described = self.wanted = False
        self._asked: set[int] = set()

    def greeting(self) -> list[bytes]:
        """See :class:`Wire`."""
        return [self._packet(self._thing(100001, self._set(self.KINDS)))]

    def _set(self, kinds: Sequence[int]) -> bytes:
        return struct.pack(f"<I{len(kinds)}I", len(kinds), *kinds)

    def _thing(self, kind: int, body: bytes) -> bytes:
        return struct.pack("<II", kind, len(body)) + body

    def _packet(self, *things: bytes) -> bytes:
        body = b"".join(things)
        return struct.pack("<II", 0x1A2B0001, len(body)) + body

    def receive(self, data: bytes, clock_s: float) -> list[bytes]:
        """See :class:`Wire`."""
        self._buffer += data
        out: list[bytes] = []
        while len(self._buffer) >= 8:
            _, size = struct.unpack_from("<II", self._buffer)
            if len(self._buffer) < 8 + size:
                break
            body, self._buffer = self._buffer[8 : 8 + size], self._buffer[8 + size :]
            out += self._objects(body)
        return out

    def _objects(self, body: bytes) -> list[bytes]:
        out, at = list[bytes](), 0
        while at + 8 <= len(body):
            kind, size = struct.unpack_from("<II", body, at)
            part, at = body[at + 8 : at + 8 + size], at + 8 + size
            if kind == 100001:
                self._asked = set(struct.unpack_from(f"<{len(part) // 4 - 1}I", part, 4))
                self._described = False
            elif kind == 100002:
                self.wanted = bool(part[0])
            elif kind == 42:
                out.append(self._packet(self._thing(42, part)))
        return out

    def _static(self) -> list[bytes]:
        """Period, up axis, subjects; told once."""
        period = struct.pack("<q", round(135e6 / self._rate_hz))
        out = [self._thing(1, period), self._thing(37, bytes([self._y_up]))]
        for number, name in enumerate(self._names, start=1):
            text = struct.pack("<I", len(name)) + name.encode()
            segment = struct.pack("<II6f", 0, 1, *[0.0] * 6) + text
            body = struct.pack("<I", number) + text + struct.pack("<I", 1) + segment + struct.pack("<II", 0, 0)
            out.append(self._thing(2, body))
        return out

    def frame(self, shot: Shot) -> list[bytes]:
        """See :class:`Wire`."""
        if not self.wanted or not self._asked:
            return []
        table = struct.pack("<I2I", 1, 9, len(shot.seen))
        things = [self._thing(100004, table + struct.pack("<I", 0))]
        if not self._described:
            things += self._static()
            self._described = True
        things.append(self._thing(5, struct.pack("<I", shot.number)))
        latency = shot.sent_s - shot.exposure_s
        samples = [(b"Camera System", 0.4 * latency), (b"Data Processing", 0.6 * latency)]
        text = b"".join(struct.pack("<I", len(n)) + n + struct.pack("<d", v) for n, v in samples)
        things.append(self._thing(26, struct.pack("<I", len(samples)) + text))
        for each in shot.seen:
            if each.pose is not None:
                p, m = each.pose[0], matrix_of(each.pose[1])
                segment = struct.pack("<I12d", 1, *(1e3 * v for v in p), *m)
                things.append(self._thing(9, struct.pack("<II", each.number, 1) + segment))
        return [self._packet(*things)]


class VrpnWire:
    """A VRPN server with one tracker per body, one client's connection."""

    TYPES = ("vrpn_Base text_message", "vrpn_Base ping_message", "vrpn_Base pong_message", "vrpn_Tracker Pos_Quat")

    def __init__(self, names: Sequence[str]):
        self._names = tuple(names)
        self._buffer = b""
        self._types: dict[int, str] = {}
        self.wanted = False
        self._cookie = False

    def greeting(self) -> list[bytes]:
        """See :class:`Wire`."""
        return [b"vrpn: ver. 07.35  0".ljust(24, b"\0")]

    def _say(self, kind: int, sender: int, payload: bytes, clock_s: float) -> bytes:
        seconds = int(clock_s)
        head = struct.pack(">IIIiiI", 24 + len(payload), seconds, round((clock_s - seconds) * 1e6), sender, kind, 0)
        return head + payload + bytes(-len(payload) % 8)

    def receive(self, data: bytes, clock_s: float) -> list[bytes]:
        """See :class:`Wire`."""
        self._buffer += data
        out: list[bytes] = []
        if not self._cookie and len(self._buffer) >= 24:
            self._cookie, self._buffer, self.wanted = True, self._buffer[24:], True
            for kind, names in ((-1, ("VRPN Control", *self._names)), (-2, self.TYPES)):
                for number, name in enumerate(names):
                    text = name.encode() + b"\0"
                    out.append(self._say(kind, number, struct.pack(">I", len(text)) + text, clock_s))
        while self._cookie and len(self._buffer) >= 24:
            size, _, _, number, kind, _ = struct.unpack_from(">IIIiiI", self._buffer)
            if len(self._buffer) < size + (-size % 8):
                break
            payload, self._buffer = self._buffer[24:size], self._buffer[size + (-size % 8) :]
            if kind == -2:
                self._types[number] = payload[4:].split(b"\0")[0].decode()
            elif self._types.get(kind) == self.TYPES[1]:
                out.append(self._say(2, 1, b"", clock_s))
        return out

    def frame(self, shot: Shot) -> list[bytes]:
        """See :class:`Wire`; a hidden body is not reported at all."""
        out: list[bytes] = []
        for each in shot.seen if self.wanted else ():
            if each.pose is not None:
                p, (w, x, y, z) = each.pose
                out.append(self._say(3, each.number, struct.pack(">ii7d", 0, 0, *p, x, y, z, w), shot.sent_s))
        return out
