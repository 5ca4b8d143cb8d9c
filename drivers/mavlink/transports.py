"""Ways to a vehicle: serial, UDP in and out, and TCP. Non-blocking; the link's loop waits for them.

A link is named by a URL: ``serial:///dev/ttyACM0:921600``, ``udpin://127.0.0.1:14540``, ``udpout://127.0.0.1:14550``,
``tcp://127.0.0.1:5760``. Whatever goes wrong underneath shows as silence and a sentence in ``trouble``; the transport
opens itself again.
"""

from __future__ import annotations

import contextlib
import re
import select
import socket
import time
from dataclasses import dataclass
from typing import Any, Protocol

Peer = str
"""Where bytes came from: an address, or a constant on links that have one other end."""

_REOPEN_S = 0.5
_MOST_DATAGRAMS = 500  # of one read, some milliseconds: a flood must not keep us from everything else
_RECEIVE_BUFFER = 4 << 20  # a log download comes in bursts of 256 KB, more than a default buffer holds


class Line(Protocol):
    """One way to one or more peers, which waits for nothing.

    Attributes:
        datagrams: frames never continue in the next read.
        trouble: why nothing flows, empty while it does.
    """

    datagrams: bool
    trouble: str

    def read(self) -> list[tuple[Peer, bytes]]:
        """What has arrived; does not wait."""
        ...

    def write(self, data: bytes) -> None:
        """Send to the vehicle; what cannot be sent now is lost, as on any radio."""
        ...

    def close(self) -> None:
        """Give the port back."""
        ...


class Transport(Line, Protocol):
    """A line whose owner can sleep on it, and say who is answered."""

    def answer(self, peer: Peer) -> None:
        """From now on write to this peer and to no other; where there is one other end, it is meant anyway."""
        ...

    def wait(self, timeout_s: float) -> None:
        """Sleep until something arrives or time is up."""
        ...


class UdpTransport:
    """UDP: ``listen`` waits for a vehicle to speak and answers it there; otherwise we speak first.

    Only the first peer heard is answered, until it has been silent for ``forget_s`` or :meth:`answer` says who is: from
    then on nobody else is, however long that one is silent. A second sender on the port (another simulator, a stray
    tool) must not receive this vehicle's setpoints.
    """

    datagrams = True

    def __init__(self, host: str, port: int, *, listen: bool, forget_s: float = 5.0):
        self.trouble = ""
        self._target = None if listen else (socket.gethostbyname(host), port)
        self._fixed = not listen
        self._heard_s = -1e9
        self._forget_s = forget_s
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        self._socket.bind((host, port) if listen else ("", 0))

    @property
    def port(self) -> int:
        """The port we are bound to."""
        return self._socket.getsockname()[1]

    def read(self) -> list[tuple[Peer, bytes]]:
        """All datagrams waiting."""
        got: list[tuple[Peer, bytes]] = []
        size = 0
        while len(got) < _MOST_DATAGRAMS and size < _RECEIVE_BUFFER:
            try:
                data, address = self._socket.recvfrom(65536)
            except BlockingIOError:
                break
            except OSError as error:  # the other end's port is closed: ICMP comes back as an error of this socket
                self.trouble = f"nobody listens there ({error.strerror})"
                break
            now = time.monotonic()
            if not self._fixed and (self._target is None or now - self._heard_s > self._forget_s):
                self._target = address
            if address == self._target:
                self._heard_s = now
                self.trouble = ""
            size += len(data)
            got.append((f"{address[0]}:{address[1]}", data))
        return got

    def answer(self, peer: Peer) -> None:
        """Write to nobody else."""
        if not self._fixed or peer != f"{self._target[0]}:{self._target[1]}":  # type: ignore[index] - fixed has one
            host, _, port = peer.rpartition(":")
            self._target, self._fixed = (host, int(port)), True

    def write(self, data: bytes) -> None:
        """One datagram to the vehicle, if there is one yet."""
        if self._target is None:
            return
        try:
            self._socket.sendto(data, self._target)
        except OSError as error:
            self.trouble = f"cannot send to {self._target[0]}:{self._target[1]} ({error.strerror})"

    def wait(self, timeout_s: float) -> None:
        """Until a datagram is there."""
        select.select([self._socket], [], [], max(0.0, timeout_s))

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class StreamTransport:
    """What serial lines and TCP connections share: one peer, bytes in order, reopened when they break."""

    datagrams = False

    def __init__(self, name: str):
        self.trouble = ""
        self._name = name
        self._retry_s = -1e9
        self._handle: Any = None
        self._pending = bytearray()
        self._reopen()
        if self._handle is None:
            raise ConnectionError(self.trouble)

    def read(self) -> list[tuple[Peer, bytes]]:
        """What is there."""
        if self._handle is None and time.monotonic() - self._retry_s > _REOPEN_S:
            self._reopen()
        if self._handle is None:
            return []
        try:
            self._flush()
            data = self._receive()
        except OSError as error:
            self._lost(error)
            return []
        return [(self._name, data)] if data else []

    def write(self, data: bytes) -> None:
        """Queue and push; more than 64 KiB behind, the newest is dropped (a frozen line must not delay what comes
        later).
        """
        if self._handle is None or len(self._pending) > 1 << 16:
            return
        self._pending += data
        try:
            self._flush()
        except OSError as error:
            self._lost(error)

    def answer(self, peer: Peer) -> None:
        """There is one other end."""

    def wait(self, timeout_s: float) -> None:
        """Until bytes are there."""
        if self._handle is None:
            time.sleep(min(max(0.0, timeout_s), 0.01))
            return
        with contextlib.suppress(OSError, ValueError):
            select.select([self._handle], [self._handle] if self._pending else [], [], max(0.0, timeout_s))

    def close(self) -> None:
        """Close the port."""
        if self._handle is not None:
            self._handle.close()
            self._handle = None

    def _reopen(self) -> None:
        self._retry_s = time.monotonic()
        try:
            self._handle = self._open()
            self.trouble = ""
        except OSError as error:
            self.trouble = f"{self._name} cannot be opened ({error})"

    def _lost(self, error: OSError) -> None:
        self.trouble = f"{self._name} broke ({error}); trying to open it again"
        self._pending.clear()
        self._retry_s = time.monotonic()
        with contextlib.suppress(OSError):
            self.close()
        self._handle = None

    def _open(self) -> Any:
        raise NotImplementedError

    def _receive(self) -> bytes:
        raise NotImplementedError

    def _flush(self) -> None:
        raise NotImplementedError


class SerialTransport(StreamTransport):
    """A serial line, opened for us alone."""

    def __init__(self, device: str, baud: int = 57600):
        self._device, self._baud = device, baud
        super().__init__(f"{device} at {baud} baud")

    def _open(self) -> Any:
        import serial

        return serial.Serial(self._device, self._baud, timeout=0, write_timeout=0, exclusive=True)

    def _receive(self) -> bytes:
        return self._handle.read(65536)

    def _flush(self) -> None:
        if self._pending:
            del self._pending[: self._handle.write(bytes(self._pending)) or 0]


class TcpTransport(StreamTransport):
    """A TCP connection that we open."""

    def __init__(self, host: str, port: int):
        self._address = (host, port)
        super().__init__(f"tcp://{host}:{port}")

    def _open(self) -> socket.socket:
        connection = socket.create_connection(self._address, timeout=1.0)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setblocking(False)
        return connection

    def _receive(self) -> bytes:
        try:
            data = self._handle.recv(65536)
        except BlockingIOError:
            return b""
        if not data:
            raise ConnectionResetError("the other end closed it")
        return data

    def _flush(self) -> None:
        try:
            if self._pending:
                del self._pending[: self._handle.send(self._pending)]
        except BlockingIOError:
            pass


LINKS = "write serial:///dev/ttyACM0:921600, udpin://127.0.0.1:14540, udpout://127.0.0.1:14550 or tcp://127.0.0.1:5760"
_URL = re.compile(r"^(?P<kind>udpin|udpout|tcp|serial)://(?P<place>.+?)(?::(?P<number>\d+))?$")


def open_transport(url: str) -> Transport:
    """A transport from its URL.

    Raises:
        ValueError: the URL names none.
        ConnectionError: it cannot be opened now.
    """
    kind, place, number = parse_url(url)
    try:
        if kind == "serial":
            return SerialTransport(place, number)
        if kind == "tcp":
            return TcpTransport(place, number)
        return UdpTransport(place, number, listen=kind == "udpin")
    except OSError as error:
        why = str(error)
        raise ConnectionError(
            why if why.startswith(f"{url} cannot be opened") else f"{url} cannot be opened: {why}"
        ) from None


def parse_url(url: str) -> tuple[str, str, int]:
    """Kind of a link, host or device, port or rate.

    Raises:
        ValueError: the URL names none.
    """
    match = _URL.match(url)
    if match is None or (match["kind"] != "serial" and match["number"] is None):
        raise ValueError(f"'{url}' names no link; {LINKS}")
    return match["kind"], match["place"], int(match["number"] or 57600)


@dataclass(frozen=True, slots=True)
class SerialPort:
    """A port that was found: where it is, what it calls itself, and whether it looks like an autopilot or a radio."""

    device: str
    name: str
    likely: bool


_AUTOPILOTS = {
    0x26AC: "3D Robotics / PX4",
    0x3162: "Holybro",
    0x2DAE: "CubePilot",
    0x1209: "ArduPilot",
    0x0483: "STM32",
}
_RADIOS = {0x0403: "FTDI (telemetry radio)", 0x10C4: "CP210x (telemetry radio)", 0x1A86: "CH340 (telemetry radio)"}


def serial_ports() -> list[SerialPort]:
    """Serial ports by vendor and product id, likely ones first."""
    from serial.tools import list_ports

    found = []
    for port in list_ports.comports():
        known = _AUTOPILOTS.get(port.vid or 0) or _RADIOS.get(port.vid or 0)
        name = " ".join(filter(None, (port.manufacturer, port.product))) or port.description or port.device
        ids = f" ({port.vid:04x}:{port.pid:04x})" if port.vid is not None and port.pid is not None else ""
        found.append(SerialPort(port.device, f"{name}{ids}" + (f", {known}" if known else ""), known is not None))
    return sorted(found, key=lambda port: (not port.likely, port.device))
