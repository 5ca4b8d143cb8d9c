"""The mission protocol, upload and read-back; missions are kept, not flown."""

from __future__ import annotations

from dataclasses import dataclass, field

from sim.mavlink.streams import Rule
from sim.mavlink.wire import Message, mavlink

_RELATIVE_INT: dict[int, int] = {
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    mavlink.MAV_FRAME_GLOBAL_INT: mavlink.MAV_FRAME_GLOBAL,
}


@dataclass(slots=True)
class MissionServer:
    """The items on board and the upload in progress.

    Args:
        dialect: ArduPilot asks with MISSION_REQUEST, makes item 0 its home and reads frames back without "_INT"; PX4
            asks with MISSION_REQUEST_INT and gives back what it got.
        home: latitude and longitude in 1e-7 deg, altitude in m: what ArduPilot puts into item 0.
    """

    dialect: Rule
    home: tuple[int, int, float]
    items: list[Message] = field(default_factory=list)
    _incoming: list[Message] = field(default_factory=list)
    _expected: int = 0

    def handle(self, message: Message, sender: tuple[int, int]) -> tuple[list[Message], bool]:
        """Replies to a message of the protocol, and whether it completed an upload."""
        kind = message.get_type()
        if kind in ("MISSION_COUNT", "MISSION_REQUEST_LIST", "MISSION_CLEAR_ALL") and message.mission_type != 0:
            return [self._ack(sender, mavlink.MAV_MISSION_UNSUPPORTED, message.mission_type)], False
        if kind == "MISSION_COUNT":
            self._incoming, self._expected = [], message.count
            if message.count == 0:
                self.items = []
                return [self._ack(sender, mavlink.MAV_MISSION_ACCEPTED)], True
            return [self._ask(sender, 0)], False
        if kind == "MISSION_ITEM_INT":
            return self._take(message, sender)
        if kind == "MISSION_REQUEST_LIST":
            return [mavlink.MAVLink_mission_count_message(*sender, len(self.items), 0)], False
        if kind in ("MISSION_REQUEST_INT", "MISSION_REQUEST"):
            if message.seq >= len(self.items):
                return [self._ack(sender, mavlink.MAV_MISSION_INVALID_SEQUENCE)], False
            return [self._item(message.seq, sender)], False
        if kind == "MISSION_CLEAR_ALL":
            self.items = []
            return [self._ack(sender, mavlink.MAV_MISSION_ACCEPTED)], True
        return [], False

    def _take(self, message: Message, sender: tuple[int, int]) -> tuple[list[Message], bool]:
        if message.seq != len(self._incoming) or not self._expected:
            return [self._ask(sender, len(self._incoming))] if self._expected else [], False
        self._incoming.append(message)
        if len(self._incoming) < self._expected:
            return [self._ask(sender, len(self._incoming))], False
        self.items, self._expected = self._incoming, 0
        return [self._ack(sender, mavlink.MAV_MISSION_ACCEPTED)], True

    def _ask(self, sender: tuple[int, int], sequence: int) -> Message:
        if self.dialect == "ardupilot":
            return mavlink.MAVLink_mission_request_message(*sender, sequence, 0)
        return mavlink.MAVLink_mission_request_int_message(*sender, sequence, 0)

    def _ack(self, sender: tuple[int, int], result: int, mission_type: int = 0) -> Message:
        return mavlink.MAVLink_mission_ack_message(*sender, result, mission_type)

    def _item(self, sequence: int, sender: tuple[int, int]) -> Message:
        m = self.items[sequence]
        frame, x, y, z = m.frame, m.x, m.y, m.z
        p1, p2, p3, p4 = m.param1, m.param2, m.param3, m.param4
        if self.dialect == "ardupilot":
            frame = _RELATIVE_INT.get(int(m.frame), int(m.frame))
            if sequence == 0:
                frame, (x, y, z) = mavlink.MAV_FRAME_GLOBAL, self.home
            if m.command == mavlink.MAV_CMD_NAV_LAND:
                p4 = 1.0  # recorded: the yaw of a landing reads back as 1
        return mavlink.MAVLink_mission_item_int_message(
            *sender, sequence, frame, m.command, 0, m.autocontinue, p1, p2, p3, p4, x, y, z, 0
        )
