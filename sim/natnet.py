"""An OptiTrack server fed by the simulated cameras of a flight: NatNet 4.1, unicast, one rigid body.

A frame leaves when the scenario's latency has passed since its exposure. Its stamps are of the cameras' clock, and so
are the answers to echo requests. What is said is written by :class:`sim.mocap.wire.NatNetWire`.
"""

from __future__ import annotations

import heapq
import socket
import time
from collections.abc import Callable

from sim.mocap.scene import Seen
from sim.mocap.wire import NatNetWire, Shot
from sim.scenario import Clock
from sim.simulation import Samples

BODY = "drone"
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
        self._wire = NatNetWire((BODY,))
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
                self._send(self._shot(number, stamp, row))

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
            for answer in self._wire.receive(data, self._now_s()):
                self._peers.add(peer)
                self._reply(answer, peer)

    def _reply(self, message: bytes, peer: tuple[str, int]) -> None:
        try:
            self._socket.sendto(message, peer)
        except OSError:  # a client that is gone
            self._peers.discard(peer)

    def _send(self, shot: Shot) -> None:
        self.sent += 1
        for message in self._wire.frame(shot):
            for peer in list(self._peers):
                self._reply(message, peer)

    def _shot(self, number: int, stamp_s: float, row: tuple[float, ...]) -> Shot:
        x, y, z, qw, qx, qy, qz = row
        exposure_s = STARTED_S + stamp_s
        seen = (Seen(BODY, 1, ((x, y, z), (qw, qx, qy, qz))),)
        return Shot(number, exposure_s, max(exposure_s, self._now_s()), seen)
