"""MAVLink FTP as conversations: write a file with a checksum over what arrived, read one back, resumable. No I/O.

Payload (MAVLink FTP specification): sequence u16, session u8, opcode u8, size u8, request u8, burst complete u8, pad
u8, offset u32, 239 bytes of data. Sequence numbers tell a late answer from the one waited for.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass

from drivers.mavlink.dialect import Message, mavlink
from drivers.mavlink.exchange import Ask, Steps

DATA = 239
_HEAD = struct.Struct("<HBBBBBBI")
_TERMINATE, _RESET, _LIST, _OPEN_READ, _READ, _CREATE, _WRITE, _REMOVE = 1, 2, 3, 4, 5, 6, 7, 8
_OPEN_WRITE, _CRC, _MKDIR = 11, 14, 9
_ACK, _NAK = 128, 129
_END_OF_FILE = 6
_ERRORS = {1: "failed", 2: "failed with an error of its file system", 3: "wrong size", 4: "wrong session",
           5: "no session is free", 6: "end of file", 7: "unknown command", 8: "the file exists",
           9: "the file is protected", 10: "no such file"}  # fmt: skip


class FtpError(Exception):
    """The vehicle refused or never answered."""


@dataclass(frozen=True, slots=True)
class Reply:
    """An answer's payload."""

    ok: bool
    session: int
    request: int
    offset: int
    data: bytes

    @property
    def error(self) -> int:
        """Error code of a refusal; 0 for an acknowledgement."""
        return 0 if self.ok else (self.data[0] if self.data else 1)


def checksum(data: bytes, start: int = 0) -> int:
    """CRC-32 as MAVLink FTP wants it: the usual polynomial, started at 0 and not inverted at the end."""
    return zlib.crc32(data, start ^ 0xFFFFFFFF) ^ 0xFFFFFFFF


class Ftp:
    """Files of one vehicle.

    Args:
        system, component: whose.
    """

    def __init__(self, system: int, component: int):
        self._address = (system, component)
        self._sequence = 0

    def write(self, path: str, data: bytes, progress: Callable[[float], None] = lambda _f: None) -> Steps[None]:
        """Create (or replace) a file and have the vehicle confirm its checksum.

        Raises:
            FtpError: it was refused, or what lies there now is not what was sent.
        """
        yield from self._request(_RESET)
        opened = yield from self._request(_CREATE, data=path.encode())
        if not opened.ok:  # there already: some servers refuse to create over a file
            yield from self._request(_REMOVE, data=path.encode())
            opened = _good((yield from self._request(_CREATE, data=path.encode())), f"creating {path}")
        for at in range(0, len(data), DATA):
            part = data[at : at + DATA]
            reply = yield from self._request(_WRITE, session=opened.session, offset=at, data=part)
            _good(reply, f"writing {path} at byte {at}")
            progress((at + len(part)) / len(data))
        _good((yield from self._request(_TERMINATE, session=opened.session)), f"closing {path}")
        there = yield from self.crc(path)
        if there != checksum(data):
            raise FtpError(f"{path} was damaged on its way: checksum {there:08x}, sent {checksum(data):08x}")

    def crc(self, path: str) -> Steps[int]:
        """Checksum of a file on the vehicle; what it cannot compute is read back and computed here."""
        reply = yield from self._request(_CRC, data=path.encode(), timeout_s=5.0)
        if reply.ok and len(reply.data) >= 4:
            return struct.unpack_from("<I", reply.data)[0]
        return checksum((yield from self.read(path)))

    def read(
        self, path: str, start: bytes = b"", progress: Callable[[int, int], None] = lambda _n, _of: None
    ) -> Steps[bytes]:
        """A whole file. ``start`` is what an interrupted read had already; ``progress`` gets bytes had and size.

        Raises:
            FtpError: it was refused or stopped; ``error.args[1]`` holds what had come by then.
        """
        opened = _good((yield from self._request(_OPEN_READ, data=path.encode())), f"opening {path}")
        size = struct.unpack_from("<I", opened.data)[0] if len(opened.data) >= 4 else -1
        data = bytearray(start)
        try:
            while size < 0 or len(data) < size:
                reply = yield from self._request(_READ, session=opened.session, offset=len(data), size=DATA)
                if reply.error == _END_OF_FILE:
                    break
                data += _good(reply, f"reading {path} at byte {len(data)}").data
                progress(len(data), size)
        except FtpError as error:
            raise FtpError(str(error), bytes(data)) from None
        yield from self._request(_TERMINATE, session=opened.session)
        return bytes(data)

    def list(self, path: str) -> Steps[list[str]]:
        r"""Entries of a folder, as the server writes them ("Fname\tsize", "Dname").

        Raises:
            FtpError: it was refused.
        """
        entries: list[str] = []
        while True:
            reply = yield from self._request(_LIST, offset=len(entries), data=path.encode())
            if reply.error == _END_OF_FILE:
                return entries
            more = [e.decode(errors="replace") for e in _good(reply, f"listing {path}").data.split(b"\0") if e]
            if not more:
                return entries
            entries += more

    def make_folder(self, path: str) -> Steps[None]:
        """Make a folder; one that is there already is fine."""
        yield from self._request(_MKDIR, data=path.encode())

    def _request(
        self, opcode: int, *, session: int = 0, offset: int = 0, data: bytes = b"", size: int | None = None,
        timeout_s: float = 0.7,
    ) -> Steps[Reply]:  # fmt: skip
        self._sequence = (self._sequence + 2) % 65536
        count = len(data) if size is None else size
        payload = _HEAD.pack(self._sequence, session, opcode, count, 0, 0, 0, offset) + data
        message = mavlink.MAVLink_file_transfer_protocol_message(
            0, *self._address, list(payload.ljust(_HEAD.size + DATA, b"\0"))
        )
        answer = yield Ask((message,), _answers(self._sequence + 1), timeout_s, 6)
        if answer is None:
            raise FtpError("the vehicle does not answer file requests")
        return _open(answer)


def _answers(sequence: int) -> Callable[[Message], bool]:
    def fits(m: Message) -> bool:
        if m.get_type() != "FILE_TRANSFER_PROTOCOL":
            return False
        return _HEAD.unpack_from(bytes(m.payload))[0] == sequence % 65536

    return fits


def _open(m: Message) -> Reply:
    raw = bytes(m.payload)
    _, session, opcode, size, request, _, _, offset = _HEAD.unpack_from(raw)
    return Reply(opcode == _ACK, session, request, offset, raw[_HEAD.size : _HEAD.size + size])


def _good(reply: Reply, what: str) -> Reply:
    if not reply.ok:
        raise FtpError(f"{what}: {_ERRORS.get(reply.error, f'error {reply.error}')}")
    return reply
