"""One connection to a motion-capture server: its socket, its protocol, its clock.

What a driver and the doctor share.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from drivers.mocap.connection import Connection, Tcp, Udp, Zenoh
from drivers.mocap.natnet import COMMAND_PORT, NatNet
from drivers.mocap.qtm import PORT as QTM_PORT
from drivers.mocap.qtm import Qtm
from drivers.mocap.readings import Exchange, Frame, Reader, RoundTrip
from drivers.mocap.serverclock import ServerClock
from drivers.mocap.shared import PREFIX, Ros2
from drivers.mocap.shared import Zenoh as ZenohReader
from drivers.mocap.vicon import PORT as VICON_PORT
from drivers.mocap.vicon import Vicon
from drivers.mocap.vrpn import PORT as VRPN_PORT
from drivers.mocap.vrpn import Vrpn
from drivers.secure import Identity

SILENT_S = 3.0
UNTOLD_DELAY_S, UNTOLD_DELAY_ERROR_S = 0.005, 0.005
"""From exposure to what a stamp tells, where the protocol does not say: makers name 3 to 10 ms for real-time bodies."""


@dataclass(frozen=True, slots=True)
class Delay:
    """How much later than the exposure a system's stamps are, beyond what its protocol tells, and within what."""

    seconds: float
    error_s: float


@dataclass(frozen=True, slots=True)
class System:
    """What a driver of one system consists of.

    Attributes:
        maker: for people.
        kind: of connection.
        port: where its server listens by default.
        reader: its protocol.
        delay: of its stamps, as long as nobody measured it.
    """

    maker: str
    kind: Literal["tcp", "udp", "zenoh"]
    port: int
    reader: Callable[[], Reader]
    delay: Delay = Delay(0.0, 0.0)


def _odometry() -> Reader:
    """Loaded where it is read: MAVLink's messages take a third of a second."""
    from drivers.mocap.odometry import Odometry

    return Odometry()


_UNTOLD = Delay(UNTOLD_DELAY_S, UNTOLD_DELAY_ERROR_S)
SYSTEMS: dict[str, System] = {
    "natnet": System("OptiTrack (NatNet)", "udp", COMMAND_PORT, NatNet),
    "qtm": System("Qualisys (QTM)", "tcp", QTM_PORT, Qtm, _UNTOLD),
    "vicon": System("Vicon (DataStream)", "tcp", VICON_PORT, Vicon),
    "vrpn": System("VRPN", "tcp", VRPN_PORT, Vrpn, _UNTOLD),
    "zenoh": System("zenoh", "zenoh", 7447, ZenohReader),
    "ros2": System("ROS 2 (through a zenoh bridge)", "zenoh", 7447, Ros2, _UNTOLD),
    "mavlink": System("MAVLink poses", "udp", 14550, _odometry),
}


@dataclass(frozen=True, slots=True)
class Arrived:
    """A frame as it arrived.

    Attributes:
        frame: what the server sent.
        received_s: on the host's monotonic clock.
        stamp_s: of the exposure, on the host's monotonic clock.
    """

    frame: Frame
    received_s: float
    stamp_s: float


class Session:
    """A connection that lasts until the server is gone or silent.

    Args:
        system: a key of :data:`SYSTEMS`.
        host: of the server, with ``:port`` where it is not the usual one; of zenoh, an endpoint.
        body: wanted (zenoh subscribes to it alone); empty for all.
        clock: of the server, known from an earlier connection.
        delay: of its stamps as measured; None takes the system's.
        identity: what to show to a zenoh endpoint that asks for certificates.

    Attributes:
        silent_s: without a byte for so long, it ends: a restarted server knows nothing of its clients.

    Raises:
        OSError: it cannot be reached.
    """

    def __init__(
        self,
        system: str,
        host: str,
        body: str = "",
        clock: ServerClock | None = None,
        delay: Delay | None = None,
        identity: Identity | None = None,
    ):
        self.system = SYSTEMS[system]
        self.delay = self.system.delay if delay is None else delay
        self.reader = self.system.reader()
        self.clock = ServerClock() if clock is None else clock
        self.stepped = False
        self.silent_s = SILENT_S
        self._joined = False
        self._heard_s = self._due_s = time.monotonic()
        self._connection = _connect(system, host, body, identity)
        if isinstance(self._connection, Tcp):
            self.clock.round_trip(self._connection.round_trip_s)

    def poll(self, timeout_s: float = 0.05) -> list[Arrived]:
        """Send what is due, and take in what arrived.

        Raises:
            ConnectionError, OSError: the server is gone, or silent for too long.
        """
        now_s = time.monotonic()
        for data in self.reader.due(now_s):
            self._connection.write(data)
        out: list[Arrived] = []
        for data, received_s in self._connection.read(timeout_s):
            self._heard_s = received_s
            for reading in self.reader.feed(data, received_s):
                if isinstance(reading, Exchange):
                    self.stepped |= self.clock.exchange(reading.sent_s, reading.server_s, reading.received_s)
                elif isinstance(reading, RoundTrip):
                    self.clock.round_trip(reading.seconds)
                else:
                    out.append(self._dated(reading, received_s))
        self._join()
        if time.monotonic() - self._heard_s > self.silent_s:
            raise ConnectionError(self.reader.trouble or f"nothing came for {self.silent_s:g} s")
        return out

    def take_step(self) -> bool:
        """Whether the server's clock stepped since the last call."""
        stepped, self.stepped = self.stepped, False
        return stepped

    def strangers(self) -> tuple[str, ...]:
        """Addresses of other servers that were heard and left out."""
        return tuple(sorted(self._connection.strangers)) if isinstance(self._connection, Udp) else ()

    def close(self) -> None:
        """End it."""
        self._connection.close()

    def _dated(self, frame: Frame, received_s: float) -> Arrived:
        known_s = frame.sent_s if frame.sent_s is not None else frame.exposure_s
        wanted_s = frame.exposure_s if frame.exposure_s is not None else frame.sent_s
        if known_s is None or wanted_s is None:
            return Arrived(frame, received_s, received_s - self.delay.seconds)
        self.stepped |= self.clock.arrival(known_s, received_s)
        return Arrived(frame, received_s, self.clock.host_s(wanted_s, received_s) - self.delay.seconds)

    def error_s(self) -> float:
        """Within what stamps are known: the clock's error and the delay's."""
        now = self.clock.now
        return float("inf") if now is None else now.error_s + self.delay.error_s

    def _join(self) -> None:
        wanted = getattr(self.reader, "multicast", None)
        if wanted is not None and not self._joined and isinstance(self._connection, Udp):
            self._connection.join(wanted.group, wanted.port)
            self._joined = True


def _connect(name: str, host: str, body: str, identity: Identity | None) -> Connection:
    system = SYSTEMS[name]
    if system.kind == "zenoh":
        endpoint = host if "/" in host else f"tcp/{host if ':' in host else f'{host}:{system.port}'}"
        key = (body or "**") if name == "ros2" else f"{PREFIX}{body or '*'}"
        return Zenoh(endpoint, key, identity)
    address, _, port = host.partition(":")
    if port and not port.isdigit():
        raise ConnectionError(f"{host}: the port is no number")
    return (Udp if system.kind == "udp" else Tcp)(address, int(port or system.port))
