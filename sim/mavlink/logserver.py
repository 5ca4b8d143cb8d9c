"""The LOG_* protocol: list the flights' logs, send one in pieces of 90 bytes."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from sim.mavlink.wire import Message, mavlink

PIECE = 90
FRAME = 109
"""Bytes of a LOG_DATA on the wire."""


@dataclass(frozen=True, slots=True)
class LogFile:
    """A finished log: its number on the card, when it was begun (Unix seconds) and where it lies among the files."""

    number: int
    begun_unix_s: int
    path: str


class LogServer:
    """Answers for the logs of one vehicle.

    Args:
        files: content by path, shared with the FTP server.
        pieces_per_tick: how many LOG_DATA leave per control cycle: the autopilot's download rate.
    """

    def __init__(self, files: dict[str, bytearray], *, pieces_per_tick: int):
        self._files = files
        self._pieces = pieces_per_tick
        self.logs: list[LogFile] = []
        self._queue: deque[Message] = deque()
        self._sending: tuple[int, bytearray, int, int] | None = None

    def request_list(self, start: int, end: int) -> None:
        """LOG_REQUEST_LIST: one LOG_ENTRY per log, or one that says there is none."""
        last = max((log.number for log in self.logs), default=0)
        for log in self.logs:
            if start <= log.number <= end:
                size = len(self._files.get(log.path, b""))
                entry = mavlink.MAVLink_log_entry_message(log.number, len(self.logs), last, log.begun_unix_s, size)
                self._queue.append(entry)
        if not self.logs:
            self._queue.append(mavlink.MAVLink_log_entry_message(0, 0, 0, 0, 0))

    def request_data(self, number: int, offset: int, count: int) -> None:
        """LOG_REQUEST_DATA: send from the offset on; an unknown log gives an empty piece."""
        path = next((log.path for log in self.logs if log.number == number), None)
        content = self._files.get(path) if path is not None else None
        if content is None or offset >= len(content):
            self._queue.append(mavlink.MAVLink_log_data_message(number, offset, 0, [0] * PIECE))
            self._sending = None
            return
        self._sending = (number, content, offset, min(len(content), offset + count))

    def stop(self) -> None:
        """LOG_REQUEST_END."""
        self._sending = None

    def erase(self) -> None:
        """LOG_ERASE."""
        for log in self.logs:
            self._files.pop(log.path, None)
        self.logs.clear()
        self.stop()

    def due(self, room: float = math.inf) -> list[Message]:
        """What leaves in this control cycle, where a wire has room for so many bytes of a log."""
        out = list(self._queue)
        self._queue.clear()
        for _ in range(math.ceil(min(self._pieces, max(0.0, room) / FRAME))):
            if self._sending is None:
                break
            number, content, offset, end = self._sending
            piece = content[offset : min(offset + PIECE, end)]
            out.append(mavlink.MAVLink_log_data_message(number, offset, len(piece), list(piece.ljust(PIECE, b"\0"))))
            offset += len(piece)
            self._sending = (number, content, offset, end) if offset < end else None
        return out
