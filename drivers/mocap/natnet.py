"""OptiTrack's NatNet, versions 3.0 to 4.2, as a client. No I/O.

Wire format: little endian, a 16-bit message number and a 16-bit length, then the message (NatNet SDK 4.1,
``PythonClient`` and ``PacketClient``). Frames carry three stamps of the server's high-resolution clock: middle of the
exposure, data received, transmitted. That clock is asked for by echo requests (SDK 3.0 on), so that it is known both
ways.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from math import isfinite

from drivers.mocap.readings import Body, Cursor, Damaged, Exchange, Frame, Reading, tracked, unit
from drivers.samples import Quaternion

COMMAND_PORT = 1510
CONNECT, SERVER_INFO, REQUEST_MODEL, MODEL, FRAME = 0, 1, 4, 5, 7
KEEP_ALIVE, ECHO_REQUEST, ECHO_RESPONSE = 10, 12, 13
GREETING_EVERY_S, KEEP_ALIVE_EVERY_S, ECHO_EVERY_S, MODEL_EVERY_S = 1.0, 1.0, 0.2, 5.0
_HEADER = struct.Struct("<HH")
_ROUND_NUMBER = 1_000_000
"""Echo requests carry our own time in whole microseconds, which the server sends back untouched."""


@dataclass(frozen=True, slots=True)
class Multicast:
    """Where the server sends its frames to."""

    group: str
    port: int


def message(number: int, payload: bytes = b"") -> bytes:
    """One message."""
    return _HEADER.pack(number, len(payload)) + payload


class NatNet:
    """See :class:`drivers.mocap.readings.Reader`.

    Attributes:
        multicast: the group to join, where the server streams to one.
    """

    def __init__(self) -> None:
        self.server, self.up, self.trouble = "", "", ""
        self.names: tuple[str, ...] = ()
        self.malformed = 0
        self.multicast: Multicast | None = None
        self._version: tuple[int, int] | None = None
        self._ticks_per_s = 0
        self._called: dict[int, str] = {}
        self._greeted_s = self._alive_s = self._echoed_s = self._asked_s = -1e9

    def due(self, now_s: float) -> list[bytes]:
        """Greet until the server tells its version; then ask for names, keep the stream alive, and ask for its
        clock.
        """
        out: list[bytes] = []
        if self._version is None:
            if now_s - self._greeted_s >= GREETING_EVERY_S:
                self._greeted_s = now_s
                out.append(message(CONNECT, b"Ping\0"))
            return out
        if now_s - self._asked_s >= MODEL_EVERY_S:
            self._asked_s = now_s
            out.append(message(REQUEST_MODEL))
        if now_s - self._alive_s >= KEEP_ALIVE_EVERY_S:
            self._alive_s = now_s
            out.append(message(KEEP_ALIVE))
        if self._ticks_per_s and now_s - self._echoed_s >= ECHO_EVERY_S:
            self._echoed_s = now_s
            out.append(message(ECHO_REQUEST, struct.pack("<Q", int(now_s * _ROUND_NUMBER))))
        return out

    def feed(self, data: bytes, received_s: float) -> list[Reading]:
        """One datagram."""
        try:
            return self._message(data, received_s)
        except (Damaged, struct.error):
            self.malformed += 1
            return []

    def _message(self, data: bytes, received_s: float) -> list[Reading]:
        if len(data) < 4:
            raise Damaged("no header")
        number, size = _HEADER.unpack_from(data)
        cursor = Cursor(data[4 : 4 + size] if size else data[4:])  # Motive leaves the length of large frames at zero
        if number == SERVER_INFO:
            self._server_info(cursor)
        elif number == MODEL and self._version is not None:
            self._called |= _rigid_body_names(cursor, self._version)
            self.names = tuple(self._called.values())
        elif number == ECHO_RESPONSE and self._ticks_per_s:
            ours, theirs = cursor.values("QQ")
            sent_s = ours / _ROUND_NUMBER
            if 0.0 <= received_s - sent_s < 2.0:
                return [Exchange(sent_s, theirs / self._ticks_per_s, received_s)]
        elif number == FRAME and self._version is not None:
            return [self._frame(cursor)]
        return []

    def _server_info(self, cursor: Cursor) -> None:
        name = cursor.take(256).split(b"\0")[0].decode("utf-8", "replace")
        application, protocol = cursor.values("4B"), cursor.values("4B")
        version = (int(protocol[0]), int(protocol[1]))
        if version < (3, 0):
            self.trouble = (
                f"{name} speaks NatNet {version[0]}.{version[1]}, which has no exposure stamps; update it to 3 or later"
            )
            return
        if version != self._version:
            self._called = {}
        self._version, self.trouble = version, ""
        self.server = f"{name} {'.'.join(str(v) for v in application[:3])}, NatNet {version[0]}.{version[1]}"
        if cursor.left >= 8:
            self._ticks_per_s = cursor.integer("Q")
        if cursor.left >= 7:
            port, many = cursor.values("HB")
            group = ".".join(str(b) for b in cursor.take(4))
            self.multicast = Multicast(group, int(port)) if many and _is_group(group) else None

    def _frame(self, cursor: Cursor) -> Frame:
        assert self._version is not None  # noqa: S101 - asked by the caller
        number = cursor.integer()
        seen, lost = _bodies(cursor, self._version, self._called)
        exposure, _, transmit = _stamps(cursor)
        ticks = self._ticks_per_s
        exposure_s = exposure / ticks if ticks and exposure else None
        sent_s = transmit / ticks if ticks and transmit else None
        if exposure_s is not None and sent_s is not None and not 0.0 <= sent_s - exposure_s < 10.0:
            exposure_s = None  # played back from a file: the exposure was another day
        return Frame(number, exposure_s, sent_s, tuple(seen), tuple(lost))


def _is_group(address: str) -> bool:
    return 224 <= int(address.split(".")[0]) < 240


def _bodies(cursor: Cursor, version: tuple[int, int], called: dict[int, str]) -> tuple[list[Body], list[str]]:
    """Walk marker sets and unlabeled markers, and read the rigid bodies; leaves the cursor after the last section."""
    sized = version >= (4, 1)
    if sized:
        _skip(cursor)
        _skip(cursor)
    else:
        for _ in range(cursor.count(5)):
            cursor.terminated()
            cursor.take(12 * cursor.count(12))
        cursor.take(12 * cursor.count(12))
    count = cursor.count(38)
    if sized:
        cursor.integer()
    seen: list[Body] = []
    lost: list[str] = []
    for _ in range(count):
        number = cursor.integer("i")
        position = cursor.vector()
        x, y, z, w = (float(v) for v in cursor.values("4f"))
        error, flags = cursor.values("fH")
        quaternion: Quaternion = (w, x, y, z)
        name = called.get(number, str(number))
        if int(flags) & 1 and tracked(position, quaternion):
            residual = float(error) if isfinite(float(error)) else None
            seen.append(Body(name, position, unit(quaternion), number, residual))
        else:
            lost.append(name)
    _walk_rest(cursor, version)
    return seen, lost


def _skip(cursor: Cursor) -> None:
    """A section that tells its size (NatNet 4.1 on)."""
    cursor.integer()
    cursor.take(cursor.integer())


def _walk_rest(cursor: Cursor, version: tuple[int, int]) -> None:
    """Skeletons, assets, labeled markers, force plates, devices."""
    if version >= (4, 1):
        for _ in range(5):
            _skip(cursor)
        return
    for _ in range(cursor.count(8)):
        cursor.integer()
        cursor.take(38 * cursor.count(38))
    cursor.take(26 * cursor.count(26))
    for _ in range(2):
        for _ in range(cursor.count(8)):
            cursor.integer()
            for _ in range(cursor.count(4)):
                cursor.take(4 * cursor.count(4))


def _stamps(cursor: Cursor) -> tuple[int, int, int]:
    """Time code, software stamp, and the three of the high-resolution clock: exposure, received, transmitted."""
    cursor.values("IId")
    exposure, received, transmit = (int(v) for v in cursor.values("QQQ"))
    return exposure, received, transmit


def _rigid_body_names(cursor: Cursor, version: tuple[int, int]) -> dict[int, str]:
    """Names by number, as far as the description can be read: what comes after an unknown part is left."""
    called: dict[int, str] = {}
    for _ in range(cursor.count(4)):
        kind = cursor.integer()
        if version >= (4, 1):
            part = Cursor(cursor.take(cursor.integer()))
            if kind == 1:
                name = part.terminated()
                called[part.integer("i")] = name
            continue
        if kind == 0:
            cursor.terminated()
            for _ in range(cursor.count(1)):
                cursor.terminated()
        elif kind == 1:
            name = cursor.terminated()
            called[cursor.integer("i")] = name
            _walk_description(cursor, version)
        else:
            break
    return called


def _walk_description(cursor: Cursor, version: tuple[int, int]) -> None:
    """Parent, offset and markers of a rigid body before NatNet 4.1."""
    cursor.take(16)
    markers = cursor.count(16)
    cursor.take(16 * markers)
    if version >= (4, 0):
        for _ in range(markers):
            cursor.terminated()
