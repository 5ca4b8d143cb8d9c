"""Poses of one rigid body from a motion-capture system, as lines of a process of its own.

    python -P -m drivers.mocap.source --system natnet --host 127.0.0.1 --body 1

Each pose leaves as four bytes of length (little-endian) and a ``drivers.samples.Batch`` on standard output. The systems'
libraries block, hold the interpreter lock or crash when a server is gone; here that costs this process alone, and the link
sees poses grow old. Stamps are mapped to the host's monotonic clock as the first arrival that a server stamp never beats:
the smallest difference so far, so that a late packet does not move the clock.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import socket
import struct
import sys
import time
from collections.abc import Callable
from math import isfinite
from typing import Any

from drivers.samples import Batch, Pose, Quaternion, Vector3, decode_batch, encode_batch

_LENGTH = struct.Struct("<I")
Emit = Callable[[float | None, Vector3, Quaternion], None]
SYSTEMS = ("natnet", "qtm", "vicon", "vrpn", "optitrack")


class StampMap:
    """Server time to host time: the smallest offset seen, let go slowly so that drifting clocks are followed.

    Args:
        forget_s_per_s: how fast the smallest offset may grow again; above any quartz's drift (1e-4).
    """

    def __init__(self, forget_s_per_s: float = 2e-4):
        self._forget = forget_s_per_s
        self._offset: float | None = None
        self._last_s = 0.0

    def host_s(self, server_s: float, received_s: float) -> float:
        """Host time of a server stamp that arrived at ``received_s``; never later than the arrival."""
        offset = received_s - server_s
        if self._offset is not None:
            allowed = self._offset + self._forget * max(0.0, received_s - self._last_s)
            offset = min(offset, allowed) if offset < allowed + 1.0 else offset  # a server that restarted begins anew
        self._offset, self._last_s = offset, received_s
        return server_s + offset


def frame(pose: Pose, host_s: float, sequence: int) -> bytes:
    """One pose as it leaves."""
    data = encode_batch(Batch(sequence, (host_s,), (pose,)))
    return _LENGTH.pack(len(data)) + data


class FrameReader:
    """Inverse of :func:`frame` for bytes that come in any portions."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[tuple[Pose, float]]:
        """Poses completed by ``data``, with the host time they arrived at."""
        self._buffer += data
        out: list[tuple[Pose, float]] = []
        while len(self._buffer) >= 4:
            size = _LENGTH.unpack_from(self._buffer)[0]
            if len(self._buffer) < 4 + size:
                break
            batch = decode_batch(bytes(self._buffer[4 : 4 + size]))
            del self._buffer[: 4 + size]
            out += [(s, t) for s, t in zip(batch.samples, batch.host_s, strict=True) if isinstance(s, Pose)]
        return out


def natnet(host: str, body: str, emit: Emit) -> None:
    """OptiTrack through NatNet 4: server stamps, one handler per frame."""
    from natnet import NatNetClient

    address, _, port = host.partition(":")
    own = _local_address(address)
    client = NatNetClient(address, own, command_port=int(port or 1510), use_multicast=False)
    number = int(body)

    def handle(frame_: Any) -> None:
        for rigid in frame_.rigid_bodies:
            if rigid.id_num == number and rigid.tracking_valid:
                x, y, z, w = rigid.rot
                emit(frame_.suffix.timestamp, rigid.pos, (w, x, y, z))

    client.on_data_frame_received_event.handlers.append(handle)
    client.connect(timeout=5)
    client.run_async()
    while client.connected:
        time.sleep(0.5)


def _local_address(server: str) -> str:
    """Our own address on the way to a server: what it may answer to, and nothing wider is bound."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect((server, 9))
        return probe.getsockname()[0]


def qtm(host: str, body: str, emit: Emit) -> None:
    """Qualisys through its real-time protocol: millimetres, rotation matrices by columns, stamps in microseconds."""
    asyncio.run(_qtm(host, body, emit))


async def _qtm(host: str, body: str, emit: Emit) -> None:
    import xml.etree.ElementTree as ElementTree

    import numpy as np
    import qtm_rt

    connection = await qtm_rt.connect(host)
    if connection is None:
        raise ConnectionError(f"no Qualisys server answers at {host}")
    settings = ElementTree.fromstring(await connection.get_parameters(parameters=["6d"]))  # noqa: S314 - from the lab's own server
    names = [str(e.text).strip() for e in settings.iterfind("*/Body/Name")]
    if body not in names:
        raise ConnectionError(f"Qualisys tracks no body '{body}'; there are {', '.join(names) or 'none'}")
    index = names.index(body)

    def handle(packet: Any) -> None:
        _, bodies = packet.get_6d()
        position, rotation = bodies[index]
        if isfinite(position.x):  # NaN while the body is not seen
            matrix = np.array(rotation.matrix).reshape(3, 3).T
            emit(
                packet.timestamp * 1e-6, (1e-3 * position.x, 1e-3 * position.y, 1e-3 * position.z), _quaternion(matrix)
            )

    await connection.stream_frames(components=["6d"], on_packet=handle)
    while connection.has_transport():
        await asyncio.sleep(0.5)


def other(system: str) -> Callable[[str, str, Emit], None]:
    """Vicon, VRPN and others through ``motioncapture``, which gives no stamps: arrival is all there is."""

    def run(host: str, body: str, emit: Emit) -> None:
        import motioncapture

        source = motioncapture.connect(system, {"hostname": host})
        while True:
            source.waitForNextFrame()
            rigid = source.rigidBodies.get(body)
            if rigid is not None:
                q = rigid.rotation
                x, y, z = (float(c) for c in rigid.position)
                emit(None, (x, y, z), (q.w, q.x, q.y, q.z))

    return run


def _quaternion(matrix: Any) -> Quaternion:
    """Rotation matrix to quaternion, by its trace or its largest diagonal entry (Shepperd)."""
    m = matrix
    four = [1 + m[0, 0] + m[1, 1] + m[2, 2], 1 + m[0, 0] - m[1, 1] - m[2, 2], 1 - m[0, 0] + m[1, 1] - m[2, 2],
            1 - m[0, 0] - m[1, 1] + m[2, 2]]  # fmt: skip
    k = max(range(4), key=lambda i: four[i])
    d = (m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1])
    s = (m[1, 0] + m[0, 1], m[0, 2] + m[2, 0], m[2, 1] + m[1, 2])
    rows = [(four[0], *d), (d[0], four[1], s[0], s[1]), (d[1], s[0], four[2], s[2]), (d[2], s[1], s[2], four[3])]
    scale = 0.5 / four[k] ** 0.5
    w, x, y, z = (float(v) * scale for v in rows[k])
    return (w, x, y, z)


def main(arguments: list[str] | None = None) -> int:
    """Entry point of the process: connect, and again after each failure, until standard output closes."""
    parser = argparse.ArgumentParser(prog="drivers.mocap.source", description=__doc__)
    parser.add_argument("--system", choices=SYSTEMS, required=True)
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--body", default="1", help="name of the rigid body; its number for NatNet")
    options = parser.parse_args(arguments)
    run = {"natnet": natnet, "qtm": qtm}.get(options.system) or other(options.system)
    stamps, sequence = StampMap(), 0

    def emit(server_s: float | None, position: Vector3, quaternion: Quaternion) -> None:
        nonlocal sequence
        now = time.monotonic()
        stamp = now if server_s is None else stamps.host_s(server_s, now)
        os.write(1, frame(Pose(stamp, position, quaternion), now, sequence))
        sequence += 1

    while True:
        try:
            run(options.host, options.body, emit)
        except BrokenPipeError:
            return 0
        except Exception as error:  # whatever the library throws, the next attempt may succeed
            print(f"{options.system} at {options.host}: {error}; trying again", file=sys.stderr, flush=True)
        time.sleep(1.0)


if __name__ == "__main__":
    sys.exit(main())
