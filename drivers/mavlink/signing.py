"""MAVLink 2 message signing: 48 bits of SHA-256 over key, frame, link and time stamp.

pymavlink stores a stream's time stamp *before* it verifies the signature, so one forged frame with a stamp far in the
future locks the true sender out. Here nothing is stored until the signature has been verified.

Our stamp follows the vehicle's, as the specification wants, so that a vehicle whose clock is ahead takes ours. How old
the first frame of a new stream may be is judged by our own clock alone: one vehicle a year ahead locks no other out.
Stamps in the last year of their 48 bits are refused: nothing could follow them.
"""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Mapping

from drivers.mavlink.dialect import mavlink
from drivers.mavlink.framing import Frame

EPOCH_S = 1420070400.0
"""1 January 2015, the origin of signing time stamps, in Unix time."""

_LAST = (1 << 48) - 1
_ONE_YEAR = 3_155_760_000_000
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
        now: our own clock's stamp, where the first to sign with is another.
        heard: newest stamps of streams heard before, as :meth:`heard` gave them.

    Attributes:
        rejected: frames refused, by reason.
        stamp: the next to sign with.
    """

    def __init__(
        self,
        key: bytes,
        stamp: int,
        link_id: int = 0,
        *,
        now: int | None = None,
        heard: Mapping[str, int] | None = None,
    ):
        if len(key) != 32:
            raise ValueError(f"a signing key has 32 bytes, not {len(key)}")
        if not 0 <= stamp <= _LAST - _ONE_YEAR:
            raise ValueError(f"{stamp} is no time stamp to begin with; is the clock of this computer right?")
        self._key, self.stamp, self._link_id = key, stamp, link_id
        self._now = stamp if now is None else now
        self._streams: dict[tuple[int, int, int], int] = {
            (link, system, component): newest
            for name, newest in (heard or {}).items()
            for link, system, component in [tuple(map(int, name.split("/")))]
        }
        self.rejected = {"unsigned": 0, "forged": 0, "replayed": 0, "ahead": 0}

    def sign(self, frame: bytes) -> bytes:
        """The frame (packed with the signed flag set, signature missing) with its signature."""
        body = frame + bytes([self._link_id]) + self.stamp.to_bytes(6, "little")
        self.stamp = min(self.stamp + 1, _LAST)
        return body + self._digest(body)

    def advance(self, stamp: int) -> None:
        """Let the stamp follow the clock; it never goes back."""
        self.stamp = min(max(self.stamp, stamp), _LAST)

    def heard(self) -> dict[str, int]:
        """The newest stamp of each stream, "link/system/component" -> stamp."""
        return {"/".join(map(str, stream)): newest for stream, newest in self._streams.items()}

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
        if stamp > _LAST - _ONE_YEAR:
            self.rejected["ahead"] += 1
            return False
        oldest = self._streams.get(stream, self._now - _ONE_MINUTE - 1)
        if stamp <= oldest:
            self.rejected["replayed"] += 1
            return False
        self._streams[stream] = stamp
        self.advance(stamp + 1)
        return True

    def _digest(self, body: bytes) -> bytes:
        return hashlib.sha256(self._key + body).digest()[:6]
