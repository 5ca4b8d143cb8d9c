"""Sockets to a motion-capture server: TCP, UDP with a multicast group, zenoh.

Every arrival is stamped as it is read.
"""

from __future__ import annotations

import queue
import select
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Protocol

from drivers.mocap.shared import keyed

if TYPE_CHECKING:
    import zenoh

    from drivers.secure import Identity

CONNECT_S = 3.0
BUFFER_BYTES = 1 << 20
_READ_AT_ONCE = 64


class Connection(Protocol):
    """Bytes to and from one server."""

    def read(self, timeout_s: float) -> list[tuple[bytes, float]]:
        """What arrived, with the host's monotonic time of it; waits for the first.

        Raises:
            ConnectionError: the server is gone.
        """
        ...

    def write(self, data: bytes) -> None:
        """Send."""
        ...

    def close(self) -> None:
        """End it."""
        ...


class Tcp:
    """One stream.

    Attributes:
        round_trip_s: of the connection's handshake: a bound on what the fastest packet takes.
    """

    def __init__(self, host: str, port: int):
        began_s = time.monotonic()
        self._socket = socket.create_connection((host, port), timeout=CONNECT_S)
        self.round_trip_s = time.monotonic() - began_s
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)

    def read(self, timeout_s: float) -> list[tuple[bytes, float]]:
        """See :class:`Connection`."""
        if not select.select([self._socket], [], [], timeout_s)[0]:
            return []
        data = self._socket.recv(1 << 16)
        if not data:
            raise ConnectionError("the server ended the connection")
        return [(data, time.monotonic())]

    def write(self, data: bytes) -> None:
        """See :class:`Connection`."""
        self._socket.sendall(data)

    def close(self) -> None:
        """See :class:`Connection`."""
        self._socket.close()


class Udp:
    """Datagrams from one server's address alone; another server's on the same group or port are counted and dropped.

    Args:
        host, port: of the server.

    Attributes:
        strangers: addresses of others that were heard.
    """

    def __init__(self, host: str, port: int):
        self._server = (socket.gethostbyname(host), port)
        self._own = own_address(self._server[0])
        self._commands = _udp(self._own, 0)
        self._sockets = [self._commands]
        self.strangers: set[str] = set()

    def join(self, group: str, port: int) -> None:
        """Also read what is sent to a multicast group, on the interface that the server is on."""
        data = _udp(group, port)
        wanted = socket.inet_aton(group) + socket.inet_aton(self._own)
        data.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, wanted)
        self._sockets.append(data)

    def read(self, timeout_s: float) -> list[tuple[bytes, float]]:
        """See :class:`Connection`."""
        out: list[tuple[bytes, float]] = []
        for ready in select.select(self._sockets, [], [], timeout_s)[0]:
            for _ in range(_READ_AT_ONCE):
                try:
                    data, address = ready.recvfrom(1 << 16)
                except BlockingIOError:
                    break
                except ConnectionRefusedError:  # nobody listens there now; it may begin to
                    continue
                if address[0] == self._server[0]:
                    out.append((data, time.monotonic()))
                elif len(self.strangers) < 10:
                    self.strangers.add(address[0])
        return out

    def write(self, data: bytes) -> None:
        """See :class:`Connection`."""
        with suppress(ConnectionRefusedError):
            self._commands.sendto(data, self._server)

    def close(self) -> None:
        """See :class:`Connection`."""
        for each in self._sockets:
            each.close()


class Zenoh:
    """Subscriptions of one endpoint.

    Args:
        endpoint: as "tcp/192.168.1.5:7447", or "tls/..." of a computer that asks for certificates.
        key: key expression of the poses.
        identity: what to show there.
    """

    def __init__(self, endpoint: str, key: str, identity: Identity | None = None):
        from drivers import bus
        from drivers.secure import secured

        self._arrived: queue.Queue[tuple[bytes, float]] = queue.Queue(maxsize=10_000)
        secure = None if identity is None else secured(identity)
        self._session = bus.open_session(connect=[endpoint], connect_timeout_s=CONNECT_S, secure=secure)
        self._handle = self._session.declare_subscriber(key, self._take)

    def _take(self, sample: zenoh.Sample) -> None:
        now_s = time.monotonic()
        with suppress(queue.Full):  # a reader that is stuck is told by the age of what it gives
            self._arrived.put_nowait((keyed(str(sample.key_expr), bytes(sample.payload)), now_s))

    def read(self, timeout_s: float) -> list[tuple[bytes, float]]:
        """See :class:`Connection`."""
        try:
            out = [self._arrived.get(timeout=timeout_s)]
        except queue.Empty:
            return []
        while len(out) < _READ_AT_ONCE and not self._arrived.empty():
            out.append(self._arrived.get_nowait())
        return out

    def write(self, data: bytes) -> None:
        """Nothing is asked of a publisher."""

    def close(self) -> None:
        """See :class:`Connection`."""
        self._session.close()


def own_address(server: str) -> str:
    """Our own address on the way to a server: what it may answer to, and nothing wider is bound."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect((server, 9))
        return probe.getsockname()[0]


def _udp(address: str, port: int) -> socket.socket:
    result = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    result.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    result.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
    result.bind((address, port))
    result.setblocking(False)
    return result


def broadcast(port: int, make: Callable[[int], bytes], listen_s: float) -> list[tuple[bytes, str]]:
    """Ask everybody on the network, and give what was answered with the addresses it came from.

    Args:
        make: the datagram, from the port of ours that answers go to.
    """
    out: list[tuple[bytes, str]] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
        asker.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        asker.bind(("", 0))
        data = make(asker.getsockname()[1])
        for address in ("255.255.255.255", "127.0.0.1"):
            with suppress(OSError):  # no network, or none that broadcasts
                asker.sendto(data, (address, port))
        until_s = time.monotonic() + listen_s
        while (left_s := until_s - time.monotonic()) > 0.0 and len(out) < 100:
            if not select.select([asker], [], [], left_s)[0]:
                break
            with suppress(OSError):
                answer, where = asker.recvfrom(1 << 16)
                out.append((answer, where[0]))
    return out
