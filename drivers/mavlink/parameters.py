"""Autopilot parameters: their two encodings, reading and writing as conversations. Every write is read back."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from drivers.mavlink.dialect import Message, mavlink
from drivers.mavlink.exchange import Ask, Steps

TOGETHER = 8
"""Requests on the way at once: few enough for a radio's buffer."""

_INTEGERS = {
    mavlink.MAV_PARAM_TYPE_UINT8: "<Bxxx",
    mavlink.MAV_PARAM_TYPE_INT8: "<bxxx",
    mavlink.MAV_PARAM_TYPE_UINT16: "<Hxx",
    mavlink.MAV_PARAM_TYPE_INT16: "<hxx",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
}


def decode_value(wire: float, kind: int, *, bytewise: bool) -> float:
    """The value behind the float on the wire: PX4 puts an integer's bits there, ArduPilot its value."""
    form = _INTEGERS.get(kind)
    if not bytewise or form is None:
        return float(wire)
    return float(struct.unpack(form, struct.pack("<f", wire))[0])


def encode_value(value: float, kind: int, *, bytewise: bool) -> float:
    """Inverse of :func:`decode_value`."""
    form = _INTEGERS.get(kind)
    if not bytewise or form is None:
        return float(value)
    return struct.unpack("<f", struct.pack(form, round(value)))[0]


class Parameters:
    """Conversations about one vehicle's parameters.

    Args:
        system, component: whose.
        bytewise: how integers travel.
    """

    def __init__(self, system: int, component: int, *, bytewise: bool):
        self._address = (system, component)
        self._bytewise = bytewise

    def read(self, name: str) -> Steps[tuple[float, int] | None]:
        """Value and type; None when the vehicle has no such parameter, or did not answer."""
        ask = mavlink.MAVLink_param_request_read_message(*self._address, name.encode(), -1)
        answer = yield Ask((ask,), _about(name), 0.7, 5)
        return self._open(answer)

    def read_all(self, names: Sequence[str]) -> Steps[dict[str, float]]:
        """Values by name, asked for together; one that is missing did not answer, as one the vehicle does not have."""
        found: dict[str, float] = {}
        refused: set[str] = set()

        def all_there(m: Message) -> bool:
            if m.get_type() in ("PARAM_VALUE", "PARAM_ERROR") and m.param_id in names:
                opened = self._open(m)
                if opened is None:
                    refused.add(m.param_id)
                else:
                    found[m.param_id] = opened[0]
            return len(found.keys() | refused) == len(set(names))

        for _ in range(4):
            missing = [name for name in names if name not in found and name not in refused]
            for at in range(0, len(missing), TOGETHER):
                ask = [
                    mavlink.MAVLink_param_request_read_message(*self._address, name.encode(), -1)
                    for name in missing[at : at + TOGETHER]
                ]
                done = set(missing[at : at + TOGETHER])
                yield Ask(tuple(ask), lambda m, done=done: all_there(m) or done <= found.keys() | refused, 0.7, 1)
        return found

    def write(self, name: str, value: float) -> Steps[bool]:
        """Set, and read back: a write with the wrong type is swallowed without a word, so success is what stands there
        after.
        """
        before = yield from self.read(name)
        if before is None:
            return False
        kind = before[1]
        wire = encode_value(value, kind, bytewise=self._bytewise)
        send = mavlink.MAVLink_param_set_message(*self._address, name.encode(), wire, kind)

        def holds(m: Message) -> bool:
            """Late answers to the question before still carry the old value: only the new one ends the wait."""
            found = self._open(m) if _about(name)(m) else None
            return found is not None and abs(found[0] - value) <= 1e-6 * max(1.0, abs(value))

        ask = mavlink.MAVLink_param_request_read_message(*self._address, name.encode(), -1)
        told = yield Ask((send,), holds, 0.7, 5)
        there = yield Ask((ask,), holds, 0.7, 5)
        return told is not None and there is not None

    def _open(self, answer: Message | None) -> tuple[float, int] | None:
        if answer is None or answer.get_type() != "PARAM_VALUE":
            return None
        return decode_value(answer.param_value, answer.param_type, bytewise=self._bytewise), answer.param_type


def _about(name: str):
    def fits(m: Message) -> bool:
        return m.get_type() in ("PARAM_VALUE", "PARAM_ERROR") and m.param_id == name

    return fits
