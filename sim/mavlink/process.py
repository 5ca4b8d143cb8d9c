"""The emulated autopilot as a process: sockets, serial lines and the wall clock around the core."""

from __future__ import annotations

import contextlib
import signal
import socket
import time
from collections.abc import Callable
from types import FrameType

from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.signing import Signing, signing_stamp
from drivers.mavlink.transports import Line, Peer, SerialTransport, open_transport
from groundstation.errors import BadInput
from sim.mavlink.autopilot import Autopilot
from sim.mavlink.faults import FaultSchedule

DATAGRAM = 1200
MAX_BEHIND_S = 0.25
DEFAULT_LINKS = {
    "px4": ("udpout://127.0.0.1:14540", "udpout://127.0.0.1:14550"),
    "arducopter": ("tcpin://127.0.0.1:5760", "udpout://127.0.0.1:14540", "udpout://127.0.0.1:14550"),
}
STATION_PORT = 14550
"""PX4 streams to this port what a ground station wants, to others what a companion computer wants."""


class TcpServer:
    """One client at a time, as ArduPilot's simulator serves it; a new one takes the place of the old."""

    datagrams = False

    def __init__(self, host: str, port: int):
        self.trouble = ""
        self._server = socket.create_server((host, port))
        self._server.setblocking(False)
        self._client: socket.socket | None = None
        self._pending = bytearray()

    @property
    def port(self) -> int:
        """The port it listens on."""
        return self._server.getsockname()[1]

    def read(self) -> list[tuple[Peer, bytes]]:
        """What has arrived; does not wait."""
        with contextlib.suppress(BlockingIOError):
            client, _ = self._server.accept()
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._drop()
            self._client = client
        if self._client is None:
            return []
        try:
            data = self._client.recv(65536)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self._drop()
            return []
        return [("tcp", data)]

    def write(self, data: bytes) -> None:
        """Send what fits; a client that does not read loses the newest."""
        if self._client is None or len(self._pending) > 1 << 20:
            return
        self._pending += data
        try:
            del self._pending[: self._client.send(self._pending)]
        except BlockingIOError:
            pass
        except OSError:
            self._drop()

    def close(self) -> None:
        """Close everything."""
        self._drop()
        self._server.close()

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client = None
        self._pending.clear()


def open_link(url: str) -> Line:
    """A transport by URL; ``tcpin://HOST:PORT`` serves, the others are those of the station.

    Raises:
        BadInput: the URL names no link, or it cannot be opened.
    """
    kind, _, place = url.partition(":")
    place = place.removeprefix("//")
    try:
        if kind == "tcpin":
            host, _, port = place.rpartition(":")
            return TcpServer(host, int(port))
        return open_transport(f"{kind}://{place}")
    except (ValueError, OSError) as error:
        raise BadInput(f"--link {url}: {error}.") from None


def attach(autopilot: Autopilot, urls: tuple[str, ...], *, key: bytes | None = None) -> dict[str, Line]:
    """Open the links and tell the autopilot of them.

    A serial line carries a tenth of its baud rate in bytes. With a key every frame is signed, and unsigned ones are
    refused.
    """
    transports: dict[str, Line] = {}
    for url in urls:
        transport = open_link(url)
        transports[url] = transport
        signing = None if key is None else Signing(key, signing_stamp(time.time()), link_id=len(transports))
        codec = MavlinkCodec(autopilot.SYSTEM, 1, signing, gated=False)
        kind = "station" if url.endswith(f":{STATION_PORT}") else "companion"
        if isinstance(transport, SerialTransport):
            baud = float(url.rpartition(":")[2]) if url.rpartition(":")[2].isdigit() else 57600.0
            autopilot.add_link(url, "station", bytes_per_s=baud / 10, codec=codec)
        else:
            autopilot.add_link(url, kind, codec=codec)
    return transports


class Service:
    """Runs an autopilot against the wall clock.

    Args:
        autopilot: with its links known.
        transports: by link name.
        speed: simulated seconds per second.
        faults: what goes wrong and when, in seconds of the simulation.
        monotonic: the clock.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        transports: dict[str, Line],
        *,
        speed: float = 1.0,
        faults: FaultSchedule | None = None,
        monotonic: Callable[[], float] = time.monotonic,
    ):
        self._autopilot, self._transports = autopilot, transports
        self._speed, self._monotonic = speed, monotonic
        self._faults = faults or FaultSchedule([])
        self._base_s, self._behind_s = monotonic(), 0.0
        self._stop = False

    def stop(self, _number: int = 0, _frame: FrameType | None = None) -> None:
        """Leave the loop; a signal handler."""
        self._stop = True

    def run(self) -> None:
        """Until stopped."""
        tick = self._autopilot.tick_s / self._speed
        signal.signal(signal.SIGTERM, self.stop)
        signal.signal(signal.SIGINT, self.stop)
        try:
            while not self._stop:
                begun = self._monotonic()
                self.turn(begun)
                time.sleep(max(0.0005, tick - (self._monotonic() - begun)))
        finally:
            for transport in self._transports.values():
                transport.close()

    def turn(self, now_s: float) -> None:
        """Take what has come, step, send what is to go.

        When the machine cannot keep up the simulated time falls behind instead of being made up in a rush.
        """
        incoming = [(name, data) for name, link in self._transports.items() for _, data in link.read()]
        host_s = (now_s - self._base_s) * self._speed - self._behind_s
        self._faults.apply(self._autopilot, host_s)
        out: dict[str, bytearray] = {}
        for name, frame in self._autopilot.step(host_s, incoming):
            pending = out.setdefault(name, bytearray())
            if len(pending) + len(frame) > DATAGRAM:
                self._transports[name].write(bytes(pending))
                pending.clear()
            pending += frame
        for name, data in out.items():
            self._transports[name].write(bytes(data))
        late = (self._monotonic() - now_s) * self._speed
        if late > MAX_BEHIND_S:
            self._behind_s += late - MAX_BEHIND_S
