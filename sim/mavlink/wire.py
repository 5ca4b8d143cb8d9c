"""The emulator's words on the wire: the shared codec, and the few messages PX4 sends that no released dialect has.

Those leave as :class:`RawMessage`, so that a station meets unknown ids here as it does on the real wire.
"""

from __future__ import annotations

from drivers.mavlink.dialect import Message, mavlink

__all__ = ["Message", "RawMessage", "mavlink", "whole"]


def whole(value: float) -> int:
    """A command's float parameter as the integer it stands for; -1 for what is none (a station may send NaN)."""
    return int(value) if abs(value) < 2.0**31 else -1


class RawMessage(mavlink.MAVLink_message):
    """A message outside the dialect.

    Args:
        number: its id.
        payload: its payload in wire order.
        seed: its CRC_EXTRA; those used here were confirmed on recorded frames.
    """

    def __init__(self, number: int, payload: bytes, seed: int):
        mavlink.MAVLink_message.__init__(self, number, f"UNKNOWN_{number}")
        self._raw_payload, self._seed = payload, seed

    def pack(self, mav: mavlink.MAVLink, force_mavlink1: bool = False) -> bytes:
        """Wire form."""
        return self._pack(mav, self._seed, self._raw_payload, force_mavlink1=force_mavlink1)
