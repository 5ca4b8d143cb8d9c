"""A view of a station on another machine: what :class:`groundstation.flight.client.client.CoreClient` is beside the
core.
"""

from __future__ import annotations

import queue
import socket
import ssl
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import msgspec

from drivers import bus
from drivers.secure import GATE_PORT, SHARED_STATUS, ClientKeys, Identity, secured
from groundstation.errors import BadInput
from groundstation.flight import timeouts
from groundstation.flight.messages import CommandName, CoreCommand, CoreStatus, Lease, LeaseAnswer
from groundstation.flight.share.messages import FilePart, FileRequest, Shared
from groundstation.flight.share.passes import Pass

if TYPE_CHECKING:
    import zenoh

A = TypeVar("A", bound=msgspec.Struct)
UNHEARD = "the station does not answer this pass; was it withdrawn there, or the connection lost?"
WATCHES = "this pass may watch and abort; ask at the station for one with `--role operate`."


class RemoteClient:
    """A connection to a station's gate. Use :func:`connect`.

    Attributes:
        name: that of the pass: as whom the core knows this view.
        operates: the pass is one for operators.
    """

    def __init__(self, session: zenoh.Session, name: str, *, operates: bool):
        self._session, self._keys = session, ClientKeys(name)
        self.name, self.operates = name, operates
        self._sequence = 0
        self._inbox: queue.SimpleQueue[Shared] = queue.SimpleQueue()
        self._subscription = bus.subscribe(session, SHARED_STATUS, bus.decoder_of(Shared), self._inbox.put)

    def shared(self, timeout_s: float) -> Shared | None:
        """The newest word of the gate; waits for one, and returns None when none came in time."""
        newest = None
        try:
            newest = self._inbox.get(timeout=timeout_s)
            while True:
                newest = self._inbox.get_nowait()
        except queue.Empty:
            return newest

    def require_heard(self) -> None:
        """Wait for the gate's first word, which stays to be read.

        Raises:
            ConnectionError: none came: it admits the session and says nothing to this pass.
        """
        first = self.shared(timeouts.GATE_HEARD_S)
        if first is None:
            raise ConnectionError(UNHEARD)
        self._inbox.put(first)

    def command(self, name: CommandName, timeout_s: float = 5.0) -> bus.Answer:
        """Give an order; ``abort`` is open to everyone."""
        if name != "abort" and not self.operates:
            return bus.Answer(False, WATCHES)
        request = CoreCommand(name, self.name, self._next())
        key = self._keys.abort if name == "abort" else self._keys.command
        return self._ask(key, request, bus.Answer, timeout_s)

    def take_lease(self, *, force: bool = False) -> LeaseAnswer:
        """Become the operator, if nobody else is."""
        return self._lease(Lease(self.name, take=True, force=force, sequence=self._next()))

    def file(self, request: FileRequest) -> FilePart:
        """A part of a file of the flight."""
        return self._ask(self._keys.file, request, FilePart)

    def _lease(self, request: Lease) -> LeaseAnswer:
        if not self.operates:
            return LeaseAnswer(False, "", WATCHES)
        return self._ask(self._keys.lease, request, LeaseAnswer)

    def _ask(self, key: str, request: msgspec.Struct, kind: type[A], timeout_s: float = 5.0) -> A:
        try:
            return bus.ask(self._session, key, request, kind, timeout_s)
        except ConnectionError:
            raise ConnectionError(UNHEARD) from None

    def _next(self) -> int:
        """As :meth:`groundstation.flight.client.client.CoreClient._next`."""
        self._sequence = max(self._sequence + 1, time.time_ns())
        return self._sequence


def status_of(shared: Shared) -> CoreStatus | None:
    """The flight's status; None before the first flight, and of one that cannot be read."""
    try:
        return bus.decode(shared.status, CoreStatus) if shared.status else None
    except ValueError:
        return None


def place_of(host: str) -> tuple[str, int]:
    """Host and port of a gate.

    Raises:
        BadInput: the port is none.
    """
    name, colon, port = host.rpartition(":")
    if not colon:
        return host, GATE_PORT
    if not port.isdigit() or not 0 < int(port) < 65536:
        raise BadInput(f"{host}: '{port}' is no port; give HOST or HOST:PORT.")
    return name, int(port)


@contextmanager
def connect(host: str, shown: Pass, *, timeout_s: float = timeouts.GATE_FOUND_S) -> Iterator[RemoteClient]:
    """Connect to a station's gate; zenoh takes a connection that was lost up again by itself.

    Args:
        host: of the station, with ``:port`` where it is not the usual one.
        shown: the pass to show.
        timeout_s: how long it may take to be reached.

    Raises:
        ConnectionError: one sentence on what stands in the way.
    """
    name, port = place_of(host)
    keys = ClientKeys(shown.name)
    try:
        socket.create_connection((name, port), timeout=timeouts.GATE_HEARD_S).close()  # nobody there is known at once
        session = bus.open_session(
            connect=[f"tls/{name}:{port}"], connect_timeout_s=timeout_s, secure=secured(shown.identity)
        )
    except OSError:
        raise ConnectionError(why_not(name, port, shown.identity)) from None
    with session, bus.alive(session, keys.alive):
        yield RemoteClient(session, shown.name, operates=shown.role == "operate")


def why_not(host: str, port: int, identity: Identity) -> str:
    """What keeps a session from opening, found by a handshake of our own: one sentence."""
    there = f"{host}:{port}"
    try:
        with socket.create_connection((host, port), timeout=timeouts.GATE_HEARD_S) as line:
            return _handshake(line, host, there, identity)
    except socket.gaierror:
        return f"{there}: no computer of that name is known here; give the station's address."
    except OSError as error:
        return (
            f"{there}: nobody answers ({error}); is `groundstation station --share` running there, and its port open?"
        )


def _handshake(line: socket.socket, host: str, there: str, identity: Identity) -> str:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    with tempfile.TemporaryDirectory(prefix="groundstation-") as folder:  # for its owner alone
        file = Path(folder) / "own.pem"
        file.write_bytes(identity.certificate + identity.key)
        context.load_cert_chain(file)
    context.load_verify_locations(cadata=identity.authority.decode())
    try:
        with context.wrap_socket(line, server_hostname=host) as secure:
            secure.settimeout(1.0)
            secure.recv(1)  # who does not take our certificate says so now
    except ssl.SSLCertVerificationError as error:
        return (
            f"{there}: what answers cannot prove to be the station ({error.verify_message}); "
            "if its address changed, start `groundstation station --share` there again."
        )
    except TimeoutError:
        return f"{there}: answers, but opens no session; try again."
    except (ssl.SSLError, ConnectionError) as error:
        return f"{there}: does not take this certificate ({error}); have another pass made there."
    return f"{there}: ends the connection; try again."
