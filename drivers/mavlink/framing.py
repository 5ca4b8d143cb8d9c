"""Cut a byte stream or datagrams into MAVLink frames. Holds no socket and no clock.

A frame of a known message is accepted on its checksum; on a wrong one the search goes on at the *next byte*, so that a
stray start marker never swallows the valid frame behind it. The checksum of an unknown message cannot be verified (its
seed is not known): such a frame is passed on only if no valid frame of a known message hides inside it and the next
frame starts where it ends.

Work is bounded: of one call's bytes, so many places where a frame could start are tried, and then the rest is noise.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivers.mavlink.dialect import MESSAGES, x25crc

V1, V2 = 0xFE, 0xFD
_SIGNED = 0x01
_OVERHEAD = {V1: 8, V2: 12}
_HEADER = {V1: 6, V2: 10}
_SIGNATURE = 13
MOST_TRIED = 300
"""Places of one call that look like a frame and are none.

Noise has two such in 256 bytes; a whole piece of 4 KiB, 32.
"""


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame as it stood on the wire.

    Attributes:
        raw: all bytes, signature included.
        message_id: which message.
        system, component: who sent it.
        sequence: the sender's frame counter, 0..255.
        signed: carries a signature (not yet verified).
        known: the message is in the dialect, and its checksum is right.
    """

    raw: bytes
    message_id: int
    system: int
    component: int
    sequence: int
    signed: bool
    known: bool


class Framer:
    """Bytes in, frames out.

    Attributes:
        skipped: bytes that belonged to no frame.
        corrupt: candidates of known messages with a wrong checksum.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._tried = 0
        self.skipped = 0
        self.corrupt = 0

    def feed(self, data: bytes, *, datagram: bool = False) -> list[Frame]:
        """Frames completed by ``data``.

        Args:
            data: what arrived.
            datagram: frames do not continue in the next call; a remainder is searched and dropped.
        """
        self._buffer += data
        self._tried = 0
        frames: list[Frame] = []
        start = 0
        while start < len(self._buffer):
            if self._tried > MOST_TRIED:
                self.skipped += len(self._buffer) - start
                start = len(self._buffer)
                break
            if self._buffer[start] not in _HEADER:
                start += 1
                self.skipped += 1
                continue
            size = _frame_size(self._buffer, start)
            if size is None or start + size > len(self._buffer):
                if size != 0 and not datagram:
                    break  # may still be completed
                frame = None
            else:
                frame = self._accept(start, size) if size else None
            if frame is None:
                self._tried += 1
                start += 1
                self.skipped += 1
                continue
            frames.append(frame)
            start += len(frame.raw)
        del self._buffer[:start]
        return frames

    def _accept(self, start: int, size: int) -> Frame | None:
        raw = bytes(self._buffer[start : start + size])
        frame = _parse(raw)
        if frame.message_id in MESSAGES:
            if frame.known:
                return frame
            self.corrupt += 1
            return None
        after = start + size
        ends_cleanly = after == len(self._buffer) or self._buffer[after] in _HEADER
        return frame if ends_cleanly and not self._hides_valid_frame(start + 1, after) else None

    def _hides_valid_frame(self, begin: int, end: int) -> bool:
        """A checksummed frame of a known message starts in [begin, end)."""
        buffer = self._buffer
        for start in range(begin, end):
            if buffer[start] in _HEADER:
                self._tried += 1
                size = _frame_size(buffer, start)
                if size and start + size <= len(buffer) and _parse(bytes(buffer[start : start + size])).known:
                    return True
        return False


def _frame_size(buffer: bytearray, start: int) -> int | None:
    """Bytes of the frame that claims to start here; None: too few bytes to tell; 0: this cannot be a frame."""
    marker = buffer[start]
    if len(buffer) < start + _HEADER[marker]:
        return None
    flags = buffer[start + 2] if marker == V2 else 0
    if flags & ~_SIGNED:  # the standard: a receiver must drop frames with incompatibility flags it does not know
        return 0
    return buffer[start + 1] + _OVERHEAD[marker] + (_SIGNATURE if flags & _SIGNED else 0)


def _parse(raw: bytes) -> Frame:
    if raw[0] == V2:
        number = raw[7] | raw[8] << 8 | raw[9] << 16
        signed = bool(raw[2] & _SIGNED)
        return Frame(raw, number, raw[5], raw[6], raw[4], signed, _checksum_right(raw, number, signed))
    return Frame(raw, raw[5], raw[3], raw[4], raw[2], False, _checksum_right(raw, raw[5], False))


def _checksum_right(raw: bytes, number: int, signed: bool) -> bool:
    kind = MESSAGES.get(number)
    if kind is None:
        return False
    end = len(raw) - 2 - (_SIGNATURE if signed else 0)
    crc = x25crc(raw[1:end] + bytes([kind.crc_extra])).crc
    return crc == raw[end] | raw[end + 1] << 8
