"""Onboard logs over the LOG protocol, as conversations: list them, fetch one, resume where it stopped. No I/O.

A log is asked for in stretches; its pieces of 90 bytes come in any order and some not at all. What is missing of a
stretch is asked for again, so a lossy link costs time, never bytes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drivers.mavlink.dialect import Message, mavlink
from drivers.mavlink.exchange import Ask, Steps, listen

PIECE = 90
STRETCH = 512 * PIECE
_SILENCE_S = 0.6
_PATIENCE = 12
_ROUNDS = 40


class LogError(Exception):
    """The vehicle stopped answering."""


@dataclass(frozen=True, slots=True)
class LogEntry:
    """One onboard log; ids are in no order of time."""

    number: int
    size: int
    time_utc_s: int


class Logs:
    """Logs of one vehicle.

    Args:
        system, component: whose.
    """

    def __init__(self, system: int, component: int):
        self._address = (system, component)

    def list(self) -> Steps[list[LogEntry]]:
        """All logs; empty when the vehicle has none or does not answer."""
        ask = mavlink.MAVLink_log_request_list_message(*self._address, 0, 0xFFFF)
        found: dict[int, LogEntry] = {}
        m = yield Ask((ask,), _is("LOG_ENTRY"), 1.5, 4)
        while m is not None and m.num_logs:
            found[m.id] = LogEntry(m.id, m.size, m.time_utc)
            if len(found) >= m.num_logs:
                break
            m = yield listen(_is("LOG_ENTRY"), 1.5)
        return sorted(found.values(), key=lambda entry: entry.number)

    def fetch(
        self, entry: LogEntry, into: bytearray, progress: Callable[[int, int], None] = lambda _n, _of: None
    ) -> Steps[bytes]:
        """The log's bytes. ``into`` holds what an interrupted fetch had and grows as more comes, however this ends.

        Raises:
            LogError: nothing came any more.
        """
        data = into
        del data[entry.size :]
        barren = 0
        while len(data) < entry.size:
            begin = len(data)
            pieces = yield from self._stretch(entry, begin, min(STRETCH, entry.size - begin))
            while len(data) in pieces and len(data) < entry.size:
                data += pieces[len(data)]
            barren = 0 if len(data) > begin else barren + 1
            if barren > _PATIENCE:
                raise LogError(f"log {entry.number} stopped at byte {len(data)} of {entry.size}")
            progress(len(data), entry.size)
        yield Ask((mavlink.MAVLink_log_request_end_message(*self._address),), lambda _m: False, 0.01, 1)
        return bytes(data[: entry.size])

    def _stretch(self, entry: LogEntry, begin: int, count: int) -> Steps[dict[int, bytes]]:
        """Pieces of [begin, begin + count) by offset; asks again for what is missing."""
        pieces: dict[int, bytes] = {}
        wanted = set(range(begin, begin + count, PIECE))
        for _ in range(_ROUNDS):
            missing = wanted - pieces.keys()
            if not missing:
                break
            first = last = min(missing)
            while last in missing:
                last += PIECE
            last = min(last, begin + count)
            ask = mavlink.MAVLink_log_request_data_message(*self._address, entry.number, first, last - first)
            m = yield Ask((ask,), _piece_of(entry.number), _SILENCE_S, 1)
            while m is not None:
                if begin <= m.ofs < begin + count and m.count:
                    pieces[m.ofs] = bytes(m.data[: m.count])
                if m.ofs + PIECE >= last:
                    break
                m = yield listen(_piece_of(entry.number), _SILENCE_S)
        return pieces


def _is(name: str) -> Callable[[Message], bool]:
    return lambda m: m.get_type() == name


def _piece_of(number: int) -> Callable[[Message], bool]:
    return lambda m: m.get_type() == "LOG_DATA" and m.id == number
