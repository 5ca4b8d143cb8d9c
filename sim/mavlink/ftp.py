"""The autopilot's end of MAVLink FTP (mavlink.io/en/services/ftp.html): files in memory, sessions, bursts, CRC32."""

from __future__ import annotations

import struct
import zlib
from collections import deque
from dataclasses import dataclass, field

_HEADER = struct.Struct("<HBBBBBBI")
CHUNK = 239

TERMINATE, RESET, LIST, OPEN_READ, READ, CREATE, WRITE, REMOVE, MAKE_DIR, REMOVE_DIR = 1, 2, 3, 4, 5, 6, 7, 8, 9, 10
OPEN_WRITE, TRUNCATE, RENAME, CRC32, BURST = 11, 12, 13, 14, 15
ACK, NAK = 128, 129
FAIL, FAIL_ERRNO, INVALID_SIZE, INVALID_SESSION, NO_SESSIONS, EOF, UNKNOWN, EXISTS, PROTECTED, NOT_FOUND = range(1, 11)


@dataclass(frozen=True, slots=True)
class Packet:
    """The payload of FILE_TRANSFER_PROTOCOL."""

    sequence: int
    session: int
    opcode: int
    size: int
    requested: int
    burst_complete: int
    offset: int
    data: bytes

    @classmethod
    def parse(cls, payload: bytes) -> Packet:
        """From the 251 bytes on the wire."""
        sequence, session, opcode, size, requested, burst, _, offset = _HEADER.unpack_from(payload)
        return cls(sequence, session, opcode, size, requested, burst, offset, bytes(payload[12 : 12 + size]))

    def pack(self) -> bytes:
        """The 251 bytes on the wire."""
        head = _HEADER.pack(
            self.sequence % 65536,
            self.session,
            self.opcode,
            self.size,
            self.requested,
            self.burst_complete,
            0,
            self.offset,
        )
        return (head + self.data).ljust(251, b"\0")


@dataclass(slots=True)
class _Session:
    path: str
    writing: bool
    burst: deque[Packet] = field(default_factory=deque)


class FtpServer:
    """Files by absolute path and the sessions open on them.

    Args:
        files: content by path; shared with the log server, so that logs can be fetched this way too.
        directories: folders that exist though they are empty.
    """

    MAX_SESSIONS = 4

    def __init__(self, files: dict[str, bytearray], directories: tuple[str, ...]):
        self.files = files
        self.directories = set(directories)
        self._sessions: dict[int, _Session] = {}
        self._last: tuple[int, bytes] | None = None

    def handle(self, payload: bytes) -> list[bytes]:
        """Replies to one request; the answer to a repeated one is repeated, not done twice."""
        request = Packet.parse(payload)
        if self._last is not None and self._last[0] == request.sequence and request.opcode != BURST:
            return [self._last[1]]
        replies = self._burst(request) if request.opcode == BURST else [self._answer(request)]
        packed = [reply.pack() for reply in replies]
        if packed:
            self._last = (request.sequence, packed[-1])
        return packed

    def _answer(self, request: Packet) -> Packet:
        name = _path(request.data)
        handlers = {
            TERMINATE: self._terminate,
            RESET: self._reset,
            LIST: self._list,
            OPEN_READ: self._open_read,
            READ: self._read,
            CREATE: self._open_write,
            OPEN_WRITE: self._open_write,
            WRITE: self._write,
            REMOVE: self._remove,
            MAKE_DIR: self._make_dir,
            REMOVE_DIR: self._remove_dir,
            RENAME: self._rename,
            TRUNCATE: self._truncate,
            CRC32: self._crc,
        }
        handler = handlers.get(request.opcode)
        return _nak(request, UNKNOWN) if handler is None else handler(request, name)

    def _terminate(self, request: Packet, _: str) -> Packet:
        if self._sessions.pop(request.session, None) is None:
            return _nak(request, INVALID_SESSION)
        return _ack(request)

    def _reset(self, request: Packet, _: str) -> Packet:
        self._sessions.clear()
        return _ack(request)

    def _open(self, path: str, *, writing: bool) -> int | None:
        free = next((i for i in range(self.MAX_SESSIONS) if i not in self._sessions), None)
        if free is not None:
            self._sessions[free] = _Session(path, writing)
        return free

    def _open_read(self, request: Packet, name: str) -> Packet:
        if name not in self.files:
            return _nak(request, NOT_FOUND)
        session = self._open(name, writing=False)
        if session is None:
            return _nak(request, NO_SESSIONS)
        return _ack(request, struct.pack("<I", len(self.files[name])), session=session)

    def _open_write(self, request: Packet, name: str) -> Packet:
        if not self._is_directory(name.rpartition("/")[0] or "/"):
            return _nak(request, NOT_FOUND)
        session = self._open(name, writing=True)
        if session is None:
            return _nak(request, NO_SESSIONS)
        if request.opcode == CREATE:
            self.files[name] = bytearray()
        return _ack(request, struct.pack("<I", len(self.files.setdefault(name, bytearray()))), session=session)

    def _content(self, request: Packet, *, writing: bool) -> bytearray | None:
        session = self._sessions.get(request.session)
        return self.files.get(session.path) if session is not None and session.writing == writing else None

    def _read(self, request: Packet, _: str) -> Packet:
        content = self._content(request, writing=False)
        if content is None:
            return _nak(request, INVALID_SESSION)
        chunk = bytes(content[request.offset : request.offset + min(request.size or CHUNK, CHUNK)])
        return _ack(request, chunk, offset=request.offset) if chunk else _nak(request, EOF)

    def _write(self, request: Packet, _: str) -> Packet:
        content = self._content(request, writing=True)
        if content is None:
            return _nak(request, INVALID_SESSION)
        if len(content) < request.offset:
            content.extend(bytes(request.offset - len(content)))
        content[request.offset : request.offset + request.size] = request.data
        return _ack(request, struct.pack("<I", request.size), offset=request.offset)

    def _burst(self, request: Packet) -> list[Packet]:
        """Chunks from the offset on, some dozens at a time; the last of a burst says so."""
        content = self._content(request, writing=False)
        if content is None:
            return [_nak(request, INVALID_SESSION)]
        size, end = min(request.size or CHUNK, CHUNK), len(content)
        if request.offset >= end:
            return [_nak(request, EOF)]
        starts = range(request.offset, end, size)[:48]
        replies = [_ack(request, bytes(content[at : at + size]), offset=at, ahead=k + 1) for k, at in enumerate(starts)]
        last = replies[-1]
        replies[-1] = Packet(last.sequence, last.session, ACK, last.size, last.requested, 1, last.offset, last.data)
        return replies

    def _list(self, request: Packet, name: str) -> Packet:
        if not self._is_directory(name):
            return _nak(request, NOT_FOUND)
        entries, data = self._entries(name)[request.offset :], b""
        for entry in entries:
            if len(data) + len(entry) > CHUNK:
                break
            data += entry
        return _ack(request, data, offset=request.offset) if data else _nak(request, EOF)

    def _entries(self, directory: str) -> list[bytes]:
        prefix = directory.rstrip("/") + "/"
        inside = [
            d[len(prefix) :].split("/")[0] for d in self._all_directories() if d.startswith(prefix) and d != prefix
        ]
        folders = [f"D{d}\0".encode() for d in sorted({d for d in inside if d})]
        names = sorted(p for p in self.files if p.startswith(prefix) and "/" not in p[len(prefix) :])
        return folders + [f"F{p[len(prefix) :]}\t{len(self.files[p])}\0".encode() for p in names]

    def _all_directories(self) -> set[str]:
        parents = {path.rpartition("/")[0] for path in self.files}
        return self.directories | parents

    def _is_directory(self, path: str) -> bool:
        wanted = path.rstrip("/") or "/"
        return wanted == "/" or any(d == wanted or d.startswith(wanted + "/") for d in self._all_directories())

    def _remove(self, request: Packet, name: str) -> Packet:
        if self.files.pop(name, None) is None:
            return _nak(request, NOT_FOUND)
        return _ack(request)

    def _make_dir(self, request: Packet, name: str) -> Packet:
        if self._is_directory(name):
            return _nak(request, EXISTS)
        self.directories.add(name.rstrip("/"))
        return _ack(request)

    def _remove_dir(self, request: Packet, name: str) -> Packet:
        if name not in self.directories or self._entries(name):
            return _nak(request, FAIL)
        self.directories.discard(name)
        return _ack(request)

    def _rename(self, request: Packet, _: str) -> Packet:
        before, __, after = request.data.partition(b"\0")
        content = self.files.pop(_path(before), None)
        if content is None:
            return _nak(request, NOT_FOUND)
        self.files[_path(after)] = content
        return _ack(request)

    def _truncate(self, request: Packet, name: str) -> Packet:
        if name not in self.files:
            return _nak(request, NOT_FOUND)
        del self.files[name][request.offset :]
        return _ack(request)

    def _crc(self, request: Packet, name: str) -> Packet:
        if name not in self.files:
            return _nak(request, NOT_FOUND)
        return _ack(request, struct.pack("<I", crc32(bytes(self.files[name]))))


def crc32(data: bytes) -> int:
    """MAVLink FTP's CRC: the reflected polynomial of zlib's, started at 0 and not inverted."""
    return zlib.crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF


def _path(data: bytes) -> str:
    name = data.split(b"\0")[0].decode("utf-8", errors="replace")
    return "/" + name.lstrip("/")


def _ack(request: Packet, data: bytes = b"", *, session: int | None = None, offset: int = 0, ahead: int = 1) -> Packet:
    session = request.session if session is None else session
    return Packet(request.sequence + ahead, session, ACK, len(data), request.opcode, 0, offset, data)


def _nak(request: Packet, error: int) -> Packet:
    data = bytes([error])
    return Packet(request.sequence + 1, request.session, NAK, 1, request.opcode, 0, request.offset, data)
