"""A motion-capture server on loopback, in a thread of its own: cameras' rate, processing, clock, and what goes wrong.

The server's clock is the host's with an offset and a drift of its own, and can be stepped. A frame is exposed at whole
periods, processed for a while that varies, and sent; behind it the network may hold it up.
"""

from __future__ import annotations

import random
import selectors
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace

from sim.mocap.published import MavlinkWire, ZenohPublisher
from sim.mocap.scene import Figure, Scene, Seen
from sim.mocap.wire import NatNetWire, QtmWire, Shot, ViconWire, VrpnWire, Wire

UDP = ("natnet", "mavlink")
ZENOH = ("zenoh", "ros2")


@dataclass(slots=True)
class Setup:
    """How a server behaves; may be changed while it runs.

    Attributes:
        system: natnet, qtm, vicon, vrpn, zenoh, ros2 or mavlink.
        rate_hz: of the cameras.
        offset_s, drift: server clock = (1 + drift) host clock + offset.
        processing_s, processing_std_s: from exposure to sending.
        hold_up_s: mean of an exponential delay of the network on top.
        address, port: to listen on; port 0 takes a free one.
        version, multicast: of NatNet.
        y_up: its world has y up (Vicon says so).
        cut: nothing arrives and nothing leaves.
        seed: of the delays.
    """

    system: str
    rate_hz: float = 100.0
    offset_s: float = 5000.0
    drift: float = 0.0
    processing_s: float = 0.004
    processing_std_s: float = 0.0003
    hold_up_s: float = 0.0
    address: str = "127.0.0.1"
    port: int = 0
    version: tuple[int, int] = (4, 1)
    multicast: tuple[str, int] | None = None
    y_up: bool = False
    cut: bool = False
    seed: int = 1
    names: tuple[str, ...] = field(default=("drone", "wand"))


@dataclass(slots=True)
class _Client:
    wire: Wire
    send: Callable[[bytes], object]


class Server:
    """Runs until :meth:`stop`; usable as a context.

    Args:
        setup: how it behaves.
        scene: what its cameras see, by host time since ``began_s``.
        began_s: host time of the scene's zero; now by default.
    """

    def __init__(self, setup: Setup, scene: Scene | None = None, began_s: float | None = None):
        self.setup = setup
        self.scene: Scene = Figure(setup.names) if scene is None else scene
        self.began_s = time.monotonic() if began_s is None else began_s
        self._random = random.Random(setup.seed)
        self._clients: dict[object, _Client] = {}
        self._selector = selectors.DefaultSelector()
        self._stop = threading.Event()
        self._later: list[tuple[float, bytes, _Client]] = []
        self._publisher: ZenohPublisher | None = None
        self._group: socket.socket | None = None
        self._listen()
        self._thread = threading.Thread(target=self._run, name=f"mocap {setup.system}", daemon=True)
        self._thread.start()

    @property
    def host(self) -> str:
        """What a client is given as the server's address."""
        return f"{self.setup.address}:{self.setup.port}"

    def clock_s(self, host_s: float) -> float:
        """The server's clock at a host time."""
        return (1.0 + self.setup.drift) * host_s + self.setup.offset_s

    def stop(self) -> None:
        """End it; its port is free afterwards."""
        self._stop.set()
        self._thread.join()
        for key in list(self._selector.get_map().values()):
            key.fileobj.close()  # type: ignore[union-attr]
        self._selector.close()
        if self._publisher is not None:
            self._publisher.close()
        if self._group is not None:
            self._group.close()

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _listen(self) -> None:
        setup = self.setup
        if setup.system in ZENOH:
            if setup.port == 0:
                with socket.socket() as probe:
                    probe.bind((setup.address, 0))
                    setup.port = probe.getsockname()[1]
            self._publisher = ZenohPublisher(setup.port, ros2=setup.system == "ros2")
            return
        kind = socket.SOCK_DGRAM if setup.system in UDP else socket.SOCK_STREAM
        own = socket.socket(socket.AF_INET, kind)
        own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        own.bind((setup.address, setup.port))
        setup.port = own.getsockname()[1]
        own.setblocking(False)
        if kind == socket.SOCK_STREAM:
            own.listen()
        self._selector.register(own, selectors.EVENT_READ, self._datagram if setup.system in UDP else self._accept)
        if setup.multicast is not None:
            self._group = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._group.bind((setup.address, 0))
            self._group.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(setup.address))

    def _wire(self) -> Wire:
        setup = self.setup
        names = [seen.name for seen in self.scene.at(0.0)]
        makers: dict[str, Callable[[], Wire]] = {
            "natnet": lambda: NatNetWire(names, setup.version, setup.multicast),
            "qtm": lambda: QtmWire(names),
            "vicon": lambda: ViconWire(names, setup.rate_hz, y_up=setup.y_up),
            "vrpn": lambda: VrpnWire(names),
            "mavlink": MavlinkWire,
        }
        return makers[setup.system]()

    # Sockets ----------------------------------------------------------------------------------------------------------

    def _accept(self, own: socket.socket) -> None:
        connection, _ = own.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setblocking(False)
        client = _Client(self._wire(), connection.send)
        self._clients[connection] = client
        self._selector.register(connection, selectors.EVENT_READ, self._stream)
        for data in client.wire.greeting():
            connection.send(data)

    def _stream(self, connection: socket.socket) -> None:
        try:
            data = connection.recv(1 << 16)
        except OSError:
            data = b""
        client = self._clients[connection]
        if not data:
            self._forget(connection)
        elif not self.setup.cut:
            self._answer(client, client.wire.receive(data, self.clock_s(time.monotonic())))

    def _forget(self, connection: object) -> None:
        if self._clients.pop(connection, None) is not None and isinstance(connection, socket.socket):
            self._selector.unregister(connection)
            connection.close()

    def _datagram(self, own: socket.socket) -> None:
        data, address = own.recvfrom(1 << 16)
        if self.setup.cut:
            return
        if address not in self._clients:
            self._clients[address] = _Client(self._wire(), lambda out: own.sendto(out, address))
        client = self._clients[address]
        self._answer(client, client.wire.receive(data, self.clock_s(time.monotonic())))

    def _answer(self, client: _Client, answers: list[bytes]) -> None:
        for data in answers:
            with suppress(OSError):
                client.send(data)

    # Frames -----------------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        number = int(self.clock_s(time.monotonic()) * self.setup.rate_hz) + 1
        shot, due_s = self._expose(number)
        while not self._stop.is_set():
            now_s = time.monotonic()
            if now_s < due_s:
                self._wait(due_s - now_s)
                continue
            if not self.setup.cut:
                self._send(shot)
            number = max(number + 1, int(self.clock_s(now_s) * self.setup.rate_hz) - 5)
            if self._exposed_s(number) > now_s + 2.0:
                number = int(self.clock_s(now_s) * self.setup.rate_hz) + 1  # the clock was set back
            shot, due_s = self._expose(number)

    def _wait(self, seconds: float) -> None:
        if not self._selector.get_map():
            time.sleep(min(seconds, 0.05))
            return
        for key, _ in self._selector.select(min(seconds, 0.05)):
            key.data(key.fileobj)

    def _exposed_s(self, number: int) -> float:
        """Host time of a frame's exposure: whole periods of the server's clock."""
        return (number / self.setup.rate_hz - self.setup.offset_s) / (1.0 + self.setup.drift)

    def _expose(self, number: int) -> tuple[Shot, float]:
        """A frame, and the host time at which it arrives at the network's other end."""
        setup, exposed_s = self.setup, self._exposed_s(number)
        processed_s = max(1e-4, self._random.gauss(setup.processing_s, setup.processing_std_s))
        held_s = self._random.expovariate(1.0 / setup.hold_up_s) if setup.hold_up_s > 0.0 else 0.0
        sent_s = exposed_s + processed_s
        seen: list[Seen] = self.scene.at(exposed_s - self.began_s)
        return Shot(number, self.clock_s(exposed_s), self.clock_s(sent_s), seen), sent_s + held_s

    def _send(self, shot: Shot) -> None:
        if self.setup.hold_up_s == 0.0:  # as a server does: stamped as it leaves
            shot = replace(shot, sent_s=max(shot.sent_s, self.clock_s(time.monotonic())))
        if self._publisher is not None:
            self._publisher.send(shot)
        elif self._group is not None and self.setup.multicast is not None:
            for data in self._wire().frame(shot):
                self._group.sendto(data, self.setup.multicast)
        for key, client in list(self._clients.items()):
            if self._group is not None:
                continue
            try:
                for data in client.wire.frame(shot):
                    client.send(data)
            except BlockingIOError:
                continue  # a client that does not read loses frames
            except OSError:
                self._forget(key)
