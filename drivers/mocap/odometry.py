"""Poses that a vehicle or its companion has already, as MAVLink: ODOMETRY, ATT_POS_MOCAP, VISION or
VICON_POSITION_ESTIMATE.

No I/O. The stamps are the sender's clock, which TIMESYNC asks for both ways.
"""

from __future__ import annotations

from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.dialect import Message, mavlink
from drivers.mavlink.geometry import flip, flip_quaternion, quaternion_of
from drivers.mocap.readings import MOST_BODIES, Body, Exchange, Frame, Reading, tracked, unit
from drivers.samples import Quaternion, Vector3

TIMESYNC_EVERY_S = 0.2
HEARTBEAT_EVERY_S = 1.0
_FLU = (mavlink.MAV_FRAME_LOCAL_FLU, mavlink.MAV_FRAME_LOCAL_ENU)
_ANGLES = ("VISION_POSITION_ESTIMATE", "VICON_POSITION_ESTIMATE", "GLOBAL_VISION_POSITION_ESTIMATE")


class Odometry:
    """See :class:`drivers.mocap.readings.Reader`. A body's name is the system id of who sends it."""

    def __init__(self) -> None:
        self.server, self.up, self.trouble = "", "z", ""
        self.names: tuple[str, ...] = ()
        self.malformed = 0
        self._codec = MavlinkCodec(gated=False)  # velocities may be NaN in a pose; what is used of it is checked here
        self._synced_s = self._alive_s = -1e9

    def due(self, now_s: float) -> list[bytes]:
        """A heartbeat, so that routers know where to send, and TIMESYNC requests."""
        out: list[bytes] = []
        if now_s - self._alive_s >= HEARTBEAT_EVERY_S:
            self._alive_s = now_s
            out.append(self._codec.encode(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3)))
        if now_s - self._synced_s >= TIMESYNC_EVERY_S:
            self._synced_s = now_s
            out.append(self._codec.encode(mavlink.MAVLink_timesync_message(0, int(now_s * 1e9))))
        return out

    def feed(self, data: bytes, received_s: float) -> list[Reading]:
        """One datagram, or a portion of a stream."""
        out: list[Reading] = []
        for received in self._codec.decode(data):
            if received.message is None:
                self.malformed += received.refused
                continue
            if received.name == "TIMESYNC" and received.message.tc1:
                sent_s = received.message.ts1 * 1e-9
                if 0.0 <= received_s - sent_s < 2.0:
                    out.append(Exchange(sent_s, received.message.tc1 * 1e-9, received_s))
                continue
            found = _pose(received.name, received.message)
            if found is not None:
                out.append(self._frame(str(received.frame.system), *found))
        return out

    def _frame(self, name: str, stamp_s: float, position: Vector3, quaternion: Quaternion) -> Frame:
        if name not in self.names and len(self.names) < MOST_BODIES:
            self.names = (*self.names, name)
        self.server = "MAVLink"
        if not tracked(position, quaternion):
            return Frame(None, stamp_s, None, (), (name,))
        return Frame(None, stamp_s, None, (Body(name, position, unit(quaternion), int(name)),))


def _pose(name: str, m: Message) -> tuple[float, Vector3, Quaternion] | None:
    """Stamp, position and attitude, z up and FLU; None of a message that is no pose."""
    if name == "ODOMETRY":
        w, x, y, z = m.q
        if m.frame_id in _FLU:
            return m.time_usec * 1e-6, (m.x, m.y, m.z), (w, x, y, z)
        return m.time_usec * 1e-6, flip((m.x, m.y, m.z)), flip_quaternion((w, x, y, z))
    if name == "ATT_POS_MOCAP":
        w, x, y, z = m.q
        return m.time_usec * 1e-6, flip((m.x, m.y, m.z)), flip_quaternion((w, x, y, z))
    if name in _ANGLES:
        return m.usec * 1e-6, flip((m.x, m.y, m.z)), flip_quaternion(quaternion_of(m.roll, m.pitch, m.yaw))
    return None
