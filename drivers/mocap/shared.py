"""Poses that somebody else already publishes on zenoh: our own batches, or ROS 2 topics through a bridge. No I/O.

``zenoh``: a :class:`drivers.samples.Batch` of poses on ``mocap/NAME``; each stamp is the exposure on the publisher's
clock, the host time beside it when it was published. ``ros2``: the CDR of PoseStamped, Odometry or TransformStamped, as
zenoh-bridge-ros2dds and rmw_zenoh carry it; the header's stamp is taken for the exposure. The connection puts the
key before the payload: a 16-bit length, the key, the payload.
"""

from __future__ import annotations

import struct

from drivers.mocap.readings import LONGEST_MESSAGE, MOST_BODIES, Body, Cursor, Damaged, Frame, Reading, tracked, unit
from drivers.samples import Pose, Quaternion, Vector3, decode_batch

PREFIX = "mocap/"
UNSEEN: tuple[Vector3, Quaternion] = ((float("nan"), float("nan"), float("nan")), (1.0, 0.0, 0.0, 0.0))
"""Published for a body that the cameras know and do not see."""
_LENGTH = struct.Struct("<H")
_POSE_BYTES = 56
_BEHIND_POSE = (0, 8 * (36 + 6 + 36))
"""Bytes behind the pose: of PoseStamped and TransformStamped, and of Odometry (covariance, twist and its covariance).
"""


def keyed(key: str, payload: bytes) -> bytes:
    """A payload with the key it came on."""
    name = key.encode()[:0xFFFF]
    return _LENGTH.pack(len(name)) + name + payload


def _split(data: bytes) -> tuple[str, bytes]:
    if len(data) > LONGEST_MESSAGE:
        raise Damaged("too long")
    cursor = Cursor(data)
    key = cursor.take(cursor.integer("H")).decode("utf-8", "replace")
    return key, cursor.take(cursor.left)


class _Published:
    """What both have in common."""

    def __init__(self) -> None:
        self.server, self.up, self.trouble = "", "", ""
        self.names: tuple[str, ...] = ()
        self.malformed = 0

    def due(self, now_s: float) -> list[bytes]:
        """Nothing is asked."""
        return []

    def _know(self, name: str) -> None:
        if name not in self.names and len(self.names) < MOST_BODIES:
            self.names = (*self.names, name)


class Zenoh(_Published):
    """See :class:`drivers.mocap.readings.Reader`."""

    def feed(self, data: bytes, received_s: float) -> list[Reading]:
        """One publication."""
        try:
            key, payload = _split(data)
            batch = decode_batch(payload)
        except ValueError:
            self.malformed += 1
            return []
        name = key.removeprefix(PREFIX)
        self.server = "zenoh"
        out: list[Reading] = []
        for sample, host_s in zip(batch.samples, batch.host_s, strict=False):
            if isinstance(sample, Pose) and tracked(sample.position_m, sample.quaternion):
                self._know(name)
                body = Body(name, sample.position_m, unit(sample.quaternion))
                out.append(Frame(batch.sequence, sample.device_s, max(host_s, sample.device_s), (body,)))
            elif isinstance(sample, Pose):
                self._know(name)
                out.append(Frame(batch.sequence, sample.device_s, None, (), (name,)))
        return out


class Ros2(_Published):
    """See :class:`drivers.mocap.readings.Reader`."""

    def feed(self, data: bytes, received_s: float) -> list[Reading]:
        """One message."""
        try:
            key, payload = _split(data)
            stamp_s, body = _pose(payload, key)
        except (Damaged, struct.error):
            self.malformed += 1
            return []
        self.server = "ROS 2 over zenoh"
        self._know(key)
        return [Frame(None, stamp_s, None, (), (key,)) if body is None else Frame(None, stamp_s, None, (body,))]


def _pose(payload: bytes, name: str) -> tuple[float, Body | None]:
    """Stamp and pose: header, perhaps the child frame's name, seven doubles, and what Odometry has behind them."""
    if len(payload) < 4 or payload[0] != 0 or payload[1] not in (0, 1):
        raise Damaged("no plain CDR")
    cursor = Cursor(payload[4:], "<" if payload[1] else ">")
    seconds, nanoseconds = cursor.values("iI")
    cursor.take(cursor.integer())
    rest = _to_pose(cursor)
    x, y, z, qx, qy, qz, qw = (float(v) for v in rest.values("7d"))
    pose = ((x, y, z), (qw, qx, qy, qz))
    stamp_s = int(seconds) + 1e-9 * int(nanoseconds)
    return stamp_s, Body(name, pose[0], unit(pose[1])) if tracked(*pose) else None


def _to_pose(cursor: Cursor) -> Cursor:
    """The cursor at the pose, told by how many bytes are behind it; alignment counts from after the encapsulation."""
    start = cursor.at
    for skip_child in (False, True):
        cursor.at = start
        if skip_child:
            cursor.take(-cursor.at % 4)
            cursor.take(cursor.integer())
        cursor.take(-cursor.at % 8)
        behind = cursor.left - _POSE_BYTES
        if any(0 <= behind - size < 8 for size in _BEHIND_POSE):
            return cursor
    raise Damaged("neither PoseStamped nor TransformStamped nor Odometry")
