"""Those who publish poses without being asked: zenoh batches, ROS 2 messages through a bridge, MAVLink ODOMETRY."""

from __future__ import annotations

import struct

from drivers import bus
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.dialect import mavlink
from drivers.mocap.shared import UNSEEN
from drivers.samples import Batch, Pose, encode_batch
from sim.mocap.scene import Seen
from sim.mocap.wire import Shot


class ZenohPublisher:
    """Our own batches on ``mocap/NAME``, or PoseStamped messages on the name as a topic."""

    def __init__(self, port: int, *, ros2: bool = False):
        self._session = bus.open_session(listen=[bus.loopback(port)])
        self._ros2 = ros2

    def send(self, shot: Shot) -> None:
        """One frame."""
        for each in shot.seen:
            position, quaternion = each.pose or UNSEEN
            if self._ros2:
                self._session.put(each.name, pose_stamped(shot.exposure_s, each))
            else:
                batch = Batch(shot.number, (shot.sent_s,), (Pose(shot.exposure_s, position, quaternion),))
                self._session.put(f"mocap/{each.name}", encode_batch(batch))

    def close(self) -> None:
        """End it."""
        self._session.close()


def pose_stamped(stamp_s: float, seen: Seen) -> bytes:
    """CDR of geometry_msgs/PoseStamped: header (stamp, "map"), position, orientation x y z w."""
    (x, y, z), (w, a, b, c) = seen.pose or UNSEEN
    seconds = int(stamp_s)
    head = struct.pack("<iII4s", seconds, round((stamp_s - seconds) * 1e9), 4, b"map\0")
    return b"\0\1\0\0" + head + bytes(-len(head) % 8) + struct.pack("<7d", x, y, z, a, b, c, w)


class MavlinkWire:
    """A companion that has the poses: ODOMETRY of the first body, TIMESYNC answered."""

    def __init__(self) -> None:
        self._codec = MavlinkCodec(system=1, component=197)
        self.wanted = False

    def greeting(self) -> list[bytes]:
        """See :class:`sim.mocap.wire.Wire`."""
        return []

    def receive(self, data: bytes, clock_s: float) -> list[bytes]:
        """See :class:`sim.mocap.wire.Wire`."""
        out: list[bytes] = []
        for received in self._codec.decode(data):
            self.wanted = True
            if received.name == "TIMESYNC" and received.message is not None and received.message.tc1 == 0:
                answer = mavlink.MAVLink_timesync_message(int(clock_s * 1e9), received.message.ts1)
                out.append(self._codec.encode(answer))
        return out

    def frame(self, shot: Shot) -> list[bytes]:
        """See :class:`sim.mocap.wire.Wire`."""
        seen = shot.seen[0]
        if seen.pose is None:
            return []
        (x, y, z), (w, a, b, c) = seen.pose
        nan = float("nan")
        message = mavlink.MAVLink_odometry_message(
            round(shot.exposure_s * 1e6), mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_BODY_FRD, x, -y, -z,
            [w, a, -b, -c], nan, nan, nan, nan, nan, nan, [nan] * 21, [nan] * 21, 0, mavlink.MAV_ESTIMATOR_TYPE_VISION,
        )  # fmt: skip
        return [self._codec.encode(message)]
