"""The message definitions: every dialect pymavlink knows, MAVLink 2, and the few in use that its release lacks.

Imported directly, not through ``mavutil``, so that neither MAVLINK_DIALECT nor MAVLINK20 in the environment of whoever
imports pymavlink first can change what a frame means here.
"""

from __future__ import annotations

import struct
from typing import Any, ClassVar

from pymavlink.dialects.v20 import all as mavlink
from pymavlink.generator.mavcrc import x25crc

Message = Any
"""A pymavlink message; its classes are generated and carry no useful static types."""


def crc_extra(name: str, fields: list[tuple[str, str, int]]) -> int:
    """The seed of a message's checksum, from its name and its fields in wire order (type, name, array length or 0).

    MAVLink serialisation guide: X.25 of "NAME " and "type name " per field, an array's length as one byte.
    """
    crc = x25crc()
    crc.accumulate_str(f"{name} ")
    for kind, field, length in fields:
        crc.accumulate_str(f"{kind} {field} ")
        if length:
            crc.accumulate(bytes([length]))
    return (crc.crc & 0xFF) ^ (crc.crc >> 8)


class EscStatus(mavlink.MAVLink_message):
    """ESC_STATUS (291) of the common dialect: four ESCs from ``index`` on; speeds in rpm, negative when reversed."""

    id = 291
    msgname = "ESC_STATUS"
    fieldnames: ClassVar[list[str]] = ["index", "time_usec", "rpm", "voltage", "current"]
    ordered_fieldnames: ClassVar[list[str]] = ["time_usec", "rpm", "voltage", "current", "index"]
    fieldtypes: ClassVar[list[str]] = ["uint8_t", "uint64_t", "int32_t", "float", "float"]
    fielddisplays_by_name: ClassVar[dict[str, str]] = {}
    fieldenums_by_name: ClassVar[dict[str, str]] = {}
    fieldunits_by_name: ClassVar[dict[str, str]] = {}
    native_format = bytearray(b"<QiffB")
    orders: ClassVar[list[int]] = [4, 0, 1, 2, 3]
    lengths: ClassVar[list[int]] = [1, 4, 4, 4, 1]
    array_lengths: ClassVar[list[int]] = [0, 4, 4, 4, 0]
    crc_extra = crc_extra(
        "ESC_STATUS",
        [("uint64_t", "time_usec", 0), ("int32_t", "rpm", 4), ("float", "voltage", 4), ("float", "current", 4),
         ("uint8_t", "index", 0)],
    )  # fmt: skip
    unpacker = struct.Struct("<Q4i4f4fB")

    def __init__(self, index: int, time_usec: int, rpm: list[int], voltage: list[float], current: list[float]):
        mavlink.MAVLink_message.__init__(self, EscStatus.id, EscStatus.msgname)
        self._fieldnames = EscStatus.fieldnames
        self._instance_field, self._instance_offset = None, -1
        self.index, self.time_usec, self.rpm, self.voltage, self.current = index, time_usec, rpm, voltage, current

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        """Wire form."""
        payload = self.unpacker.pack(self.time_usec, *self.rpm, *self.voltage, *self.current, self.index)
        return self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1)


if EscStatus.id not in mavlink.mavlink_map:
    mavlink.mavlink_map[EscStatus.id] = EscStatus

MESSAGES: dict[int, Any] = mavlink.mavlink_map
"""Message classes by id."""


def message_id(name: str) -> int:
    """The id of a message by its name."""
    return next(number for number, kind in MESSAGES.items() if kind.msgname == name)
