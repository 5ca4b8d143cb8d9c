"""MAVLink 2 message signing: 48 bits of SHA-256 over key, frame, link and time stamp.

pymavlink stores a stream's time stamp *before* it verifies the signature, so one forged frame with a stamp far in the
future locks the true sender out. Here nothing is stored until the signature has been verified.
"""

from __future__ import annotations

import hashlib
import hmac

from drivers.mavlink.dialect import mavlink
from drivers.mavlink.framing import Frame

EPOCH_S = 1420070400.0
"""1 January 2015, the origin of signing time stamps, in Unix time."""

_ONE_MINUTE = 6_000_000  # in units of 10 us
UNSIGNED_ALLOWED = frozenset({mavlink.MAVLINK_MSG_ID_RADIO_STATUS})
"""Telemetry radios speak for themselves and cannot sign."""


def signing_stamp(unix_s: float) -> int:
    """Unix time in the stamp's unit, 10 us since :data:`EPOCH_S`."""
    return int((unix_s - EPOCH_S) * 1e5)


class Signing:
    """Signs what leaves and verifies what arrives.

    Args:
        key: the shared secret, 32 bytes.
        stamp: the first time stamp to sign with; see :func:`signing_stamp`. Never go back behind one used before.
        link_id: this channel.

    Attributes:
        rejected: frames refused, by reason.
    """

    def __init__(self, key: bytes, stamp: int, link_id: int = 0):
        if len(key) != 32:
            raise ValueError(f"a signing key has 32 bytes, not {len(key)}")
        self._key, self._stamp, self._link_id = key, stamp, link_id
        self._streams: dict[tuple[int, int, int], int] = {}
        self.rejected = {"unsigned": 0, "forged": 0, "replayed": 0}

    def sign(self, frame: bytes) -> bytes:
        """The frame (packed with the signed flag set, signature missing) with its signature."""
        body = frame + bytes([self._link_id]) + self._stamp.to_bytes(6, "little")
        self._stamp += 1
        return body + self._digest(body)

    def advance(self, stamp: int) -> None:
        """Let the stamp follow the clock; it never goes back."""
        self._stamp = max(self._stamp, stamp)

    def accepts(self, frame: Frame) -> bool:
        """Verify an incoming frame: signature first, then its stamp, and only then remember the stamp."""
        if not frame.signed:
            if frame.message_id in UNSIGNED_ALLOWED:
                return True
            self.rejected["unsigned"] += 1
            return False
        if not hmac.compare_digest(self._digest(frame.raw[:-6]), frame.raw[-6:]):
            self.rejected["forged"] += 1
            return False
        stamp = int.from_bytes(frame.raw[-12:-6], "little")
        stream = (frame.raw[-13], frame.system, frame.component)
        oldest = self._streams.get(stream, self._stamp - _ONE_MINUTE - 1)
        if stamp <= oldest:
            self.rejected["replayed"] += 1
            return False
        self._streams[stream] = stamp
        self.advance(stamp + 1)
        return True

    def _digest(self, body: bytes) -> bytes:
        return hashlib.sha256(self._key + body).digest()[:6]
