"""An OptiTrack server fed by the simulated cameras: NatNet 4.1, unicast, one rigid body (the SDK's PacketClient
sample).

A frame leaves when the scenario's latency has passed since its exposure. Its stamps are of the cameras' clock: exposure
and transmission in ticks, and the exposure in seconds as older clients read it. Echo requests are answered with that
clock's time.
"""

from __future__ import annotations

import heapq
import socket
import struct
import time
from collections.abc import Callable

from sim.scenario import Clock
from sim.simulation import Samples

CONNECT, SERVER_INFO, FRAME, KEEP_ALIVE, ECHO, ECHOED = 0, 1, 7, 10, 12, 13
TICKS_PER_S = 10_000_000
STARTED_S = 100.0
"""The cameras' clock at the beginning: stamps are unsigned, and a scenario's offset may be negative."""
BETWEEN_STEPS_S = 0.02
"""The clock goes on by itself between two steps of the physics, but not while they stall."""


class NatNetServer:
    """Cameras that see one body.

    Args:
        place: ``HOST:PORT`` that commands come to; frames go to whoever greeted, from there.
        clock: of the cameras, as the scenario has it.
        monotonic: the host's clock.

    Attributes:
        covered: nothing is seen, no frame leaves.
        sent: frames that left.
    """

    def __init__(self, place: str, clock: Clock, *, monotonic: Callable[[], float] = time.monotonic):
        host, _, port = place.rpartition(":")
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((host, int(port)))
        self._socket.setblocking(False)
        self._clock, self._monotonic = clock, monotonic
        self._peers: set[tuple[str, int]] = set()
        self._due: list[tuple[float, int, float, tuple[float, ...]]] = []
        self._number = 0
        self._time_s, self._stepped_s = 0.0, monotonic()
        self.covered = False
        self.sent = 0

    @property
    def port(self) -> int:
        """Where commands come to."""
        return self._socket.getsockname()[1]

    def turn(self, time_s: float, poses: list[Samples]) -> None:
        """The physics have reached ``time_s``: take over the poses (the list is emptied), answer, send what is due."""
        self._time_s, self._stepped_s = time_s, self._monotonic()
        for stamps, arrivals, rows in poses:
            for stamp, arrival, row in zip(stamps.tolist(), arrivals.tolist(), rows.tolist(), strict=True):
                self._number += 1
                heapq.heappush(self._due, (arrival, self._number, stamp, tuple(row)))
        poses.clear()
        self._answer()
        while self._due and self._due[0][0] <= time_s:
            _, number, stamp, row = heapq.heappop(self._due)
            if not self.covered:
                self._send(self._frame(number, stamp, row))

    def close(self) -> None:
        """Give the port back."""
        self._socket.close()

    def _now_s(self) -> float:
        """Of the cameras' clock."""
        true_s = self._time_s + min(BETWEEN_STEPS_S, self._monotonic() - self._stepped_s)
        return STARTED_S + self._clock.offset_s + true_s * (1.0 + 1e-6 * self._clock.drift_ppm)

    def _answer(self) -> None:
        while True:
            try:
                data, peer = self._socket.recvfrom(2048)
            except (BlockingIOError, ConnectionRefusedError):
                return
            if len(data) < 4:
                continue
            (number,) = struct.unpack_from("<H", data)
            if number == CONNECT:
                self._peers.add(peer)
                name = b"Motive".ljust(256, b"\0") + bytes((3, 1, 0, 0)) + bytes((4, 1, 0, 0))
                self._reply(SERVER_INFO, name + struct.pack("<QHB4B", TICKS_PER_S, self.port, 0, 0, 0, 0, 0), peer)
            elif number == ECHO and len(data) >= 12:
                self._reply(ECHOED, data[4:12] + struct.pack("<Q", round(self._now_s() * TICKS_PER_S)), peer)

    def _reply(self, number: int, payload: bytes, peer: tuple[str, int]) -> None:
        try:
            self._socket.sendto(struct.pack("<HH", number, len(payload)) + payload, peer)
        except OSError:  # a client that is gone
            self._peers.discard(peer)

    def _send(self, payload: bytes) -> None:
        self.sent += 1
        for peer in list(self._peers):
            self._reply(FRAME, payload, peer)

    def _frame(self, number: int, stamp_s: float, row: tuple[float, ...]) -> bytes:
        x, y, z, qw, qx, qy, qz = row
        exposure_s = STARTED_S + stamp_s
        rigid = struct.pack("<i3f4ffH", 1, x, y, z, qx, qy, qz, qw, 0.0004, 1)
        empty = struct.pack("<II", 0, 0)
        sections = empty + empty + struct.pack("<II", 1, len(rigid)) + rigid + 5 * empty
        exposure, transmitted = (round(s * TICKS_PER_S) for s in (exposure_s, self._now_s()))
        stamps = struct.pack("<IIdQQQH", 0, 0, exposure_s, exposure, exposure, max(exposure, transmitted), 0)
        return struct.pack("<I", number) + sections + stamps + struct.pack("<I", 0)
