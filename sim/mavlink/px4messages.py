"""Messages of PX4 alone, and what it says it can do."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable

from sim.mavlink import messages
from sim.mavlink.parameters import Parameter
from sim.mavlink.wire import Message, RawMessage, mavlink

CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | mavlink.MAV_PROTOCOL_CAPABILITY_FTP | mavlink.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)  # fmt: skip


def link_node_status(a: messages.Autopilot) -> Message:
    """LINK_NODE_STATUS."""
    return RawMessage(8, struct.pack("<QIIIIIHHHBBB", a.boot_us, 24000, 0, 24000, 0, 0, 0, 0, 0, 0, 0, 0), 117)


def event_sequence(a: messages.Autopilot) -> Message:
    """CURRENT_EVENT_SEQUENCE."""
    return RawMessage(411, struct.pack("<HB", a.counter & 0xFF, 0), 106)


def current_mode(a: messages.Autopilot) -> Message:
    """CURRENT_MODE: what is flown, and what was asked for."""
    return RawMessage(436, struct.pack("<IIB", a.mode.custom, a.intended_custom, 0), 193)


def time_estimate(_: messages.Autopilot) -> Message:
    """TIME_ESTIMATE_TO_TARGET: nothing is estimated."""
    return RawMessage(380, struct.pack("<5i", 0, -1, -1, -1, -1), 232)


def parameters_hash(parameters: Iterable[Parameter]) -> float:
    """The checksum of names and values, as the bits of a float."""
    digest = 0
    for p in parameters:
        packed = struct.pack("<f", p.value) if p.is_float else struct.pack("<i", int(p.value))
        digest = zlib.crc32(p.name.encode() + packed, digest)
    return float(struct.unpack("<f", struct.pack("<I", digest))[0])
