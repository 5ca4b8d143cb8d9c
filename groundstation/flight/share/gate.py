"""The gate of a station: shows its flight to other machines and takes their orders to the core, each as its pass
allows.

A process of its own, between the network and the loopback bus on which a flight runs. To the core it is a client like
any other: when it hangs, dies or is flooded, its clients' lease is free and the flight goes on. Towards the network it
listens with certificates alone (:mod:`drivers.secure`). Orders keep their sender's number and get the name in its
certificate, so the core refuses one that is played back, and its log says who aborted. What a watcher asks goes to the
core in a session that may only watch and abort: both doors would have to be wrong for it to arm.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import msgspec

from drivers import bus
from drivers.access import Access
from drivers.secure import CLIENTS_ALIVE, SHARED_STATUS, ClientKeys, Identity, PassRole, client_of, gate_rules, secured
from groundstation.errors import BadInput
from groundstation.flight import timeouts
from groundstation.flight.client.access import read_access
from groundstation.flight.client.client import running_cores
from groundstation.flight.journal import WATCH_FILE
from groundstation.flight.messages import CLIENT_ALIVE, CoreCommand, CoreStatus, Lease, LeaseAnswer
from groundstation.flight.sequence import FINAL
from groundstation.flight.share.files import read_part
from groundstation.flight.share.messages import FilePart, FileRequest, Shared

if TYPE_CHECKING:
    import zenoh

A = TypeVar("A", bound=msgspec.Struct)
NO_CORE = "no flight is prepared at the station."


class CoreLine:
    """The gate's two sessions to one core: one that may operate, one that may watch and abort.

    Args:
        folder: of the flight.
        operate: access from ``core.endpoint``.
        heard: takes each status as it was encoded, on zenoh's thread.

    Raises:
        ConnectionError: the core is gone.
        BadInput: the watchers' access file is not one.
    """

    def __init__(self, folder: Path, operate: Access, heard: Callable[[bytes], None]):
        self.folder = folder
        self.lost = threading.Event()
        self._lock = threading.Lock()
        self._tokens: dict[str, zenoh.LivelinessToken] = {}
        with ExitStack() as opened:
            self._operate = opened.enter_context(_opened(operate))
            self._watch = opened.enter_context(_opened(read_access(folder / WATCH_FILE)))
            self._handles = [
                bus.subscribe(self._watch, bus.CORE_STATUS, bytes, heard),
                bus.watch_alive(self._watch, bus.CORE_ALIVE, self._on_core),
            ]
            self._sessions = opened.pop_all()

    def abort(self, command: CoreCommand) -> bus.Answer:
        """Everyone's order."""
        return _asked(self._watch, bus.CORE_ABORT, command, bus.Answer)

    def order(self, key: str, request: msgspec.Struct, kind: type[A]) -> A:
        """An order of somebody who may operate."""
        return _asked(self._operate, key, request, kind)

    def client(self, name: str, *, alive: bool) -> None:
        """Hold the token of a client while it is there, so that its lease is free when it is not."""
        import zenoh

        with self._lock, suppress(zenoh.ZError):  # the core is gone, and its tokens with it
            if alive and name not in self._tokens:
                key = CLIENT_ALIVE.format(client=name)
                self._tokens[name] = self._operate.liveliness().declare_token(key)
            elif not alive and name in self._tokens:
                self._tokens.pop(name).undeclare()

    def close(self) -> None:
        """Leave the core; the flight goes on."""
        self._sessions.close()

    def _on_core(self, _key: str, alive: bool) -> None:
        if not alive:
            self.lost.set()


def _asked(session: zenoh.Session, key: str, request: msgspec.Struct, kind: type[A]) -> A:
    import zenoh

    try:
        return bus.ask(session, key, request, kind, timeouts.GATE_ANSWER_S)
    except (zenoh.ZError, ValueError) as error:
        raise ConnectionError(str(error)) from None


@contextmanager
def _opened(access: Access) -> Iterator[zenoh.Session]:
    session = bus.open_session(connect=[access.endpoint], connect_timeout_s=timeouts.GATE_LOOK_S, login=access.login)
    with session:
        yield session


class Gate:
    """Follows the newest flight of a folder and shares it.

    Args:
        logs: where flights are kept.
        station: its name.
        clock: monotonic seconds.
    """

    def __init__(self, logs: Path, station: str, clock: Callable[[], float] = time.monotonic):
        self._logs, self._station, self._clock = logs, station, clock
        self._line: CoreLine | None = None
        self._folder: Path | None = None
        self._status = b""
        self._present: set[str] = set()
        self._publisher: bus.Publisher | None = None
        self._shared_s = self._looked_s = -1e9

    def open(self, endpoint: str, identity: Identity, roles: Mapping[str, PassRole]) -> Callable[[], None]:
        """Listen for the passes given; returns what ends it.

        Raises:
            ConnectionError: the endpoint cannot be listened on.
        """
        session = bus.open_session(listen=[endpoint], secure=secured(identity, rules=gate_rules(roles)))
        handles: list[object] = []
        for name, role in roles.items():
            if role != "poses":
                handles += self._serve(session, ClientKeys(name), role)
        handles.append(bus.watch_alive(session, CLIENTS_ALIVE, self._on_client))
        self._publisher = bus.Publisher(session, SHARED_STATUS)

        def close() -> None:
            self._publisher = None
            handles.clear()
            for name in list(self._present):
                self._on_client(ClientKeys(name).alive, False)
            session.close()

        return close

    def turn(self) -> None:
        """Find a core, leave one that ended, say once a second that the station is there.

        Call it about ten times a second.
        """
        now_s = self._clock()
        line = self._line
        if line is not None and line.lost.is_set():
            self._line = None
            line.close()
        if self._line is None and now_s - self._looked_s >= timeouts.GATE_LOOK_S:
            self._looked_s = now_s
            self._find()
        if now_s - self._shared_s >= timeouts.GATE_SAYS_S:
            self._share(fresh=False)

    def close(self) -> None:
        """Leave the core."""
        if self._line is not None:
            self._line.close()
            self._line = None

    # Towards the network ----------------------------------------------------------------------------------------------

    def _serve(self, session: zenoh.Session, keys: ClientKeys, role: PassRole) -> list[object]:
        """Each key of each client on a thread of its own: whoever is slow or floods is so alone."""
        name = keys.name
        handles = [
            bus.serve(session, keys.abort, CoreCommand, lambda order: self._abort(name, order)),
            bus.serve(session, keys.file, FileRequest, self._file),
        ]
        if role == "operate":
            handles += [
                bus.serve(session, keys.command, CoreCommand, lambda order: self._command(name, order)),
                bus.serve(session, keys.lease, Lease, lambda request: self._lease(name, request)),
            ]
        return handles

    def _abort(self, name: str, order: CoreCommand) -> bus.Answer:
        abort = CoreCommand("abort", name, order.sequence)
        return self._asked(lambda line: line.abort(abort), lambda reason: bus.Answer(False, reason))

    def _command(self, name: str, order: CoreCommand) -> bus.Answer:
        own = CoreCommand(order.name, name, order.sequence)
        return self._asked(
            lambda line: line.order(bus.CORE_COMMAND, own, bus.Answer), lambda reason: bus.Answer(False, reason)
        )

    def _lease(self, name: str, request: Lease) -> LeaseAnswer:
        def ask(line: CoreLine) -> LeaseAnswer:
            line.client(name, alive=True)
            return line.order(bus.CORE_LEASE, msgspec.structs.replace(request, client=name), LeaseAnswer)

        return self._asked(ask, lambda reason: LeaseAnswer(False, "", reason))

    def _asked(self, ask: Callable[[CoreLine], A], refused: Callable[[str], A]) -> A:
        line = self._line
        if line is None:
            return refused(NO_CORE)
        try:
            return ask(line)
        except ConnectionError as error:
            return refused(f"the core does not answer the gate: {error}")

    def _file(self, request: FileRequest) -> FilePart:
        folder = self._folder
        if folder is None or request.flight != folder.name:
            return FilePart(False, "that flight is not shared now")
        return read_part(folder, request.name, request.offset)

    def _on_client(self, key: str, alive: bool) -> None:
        name = client_of(key)
        (self._present.add if alive else self._present.discard)(name)
        if (line := self._line) is not None:
            line.client(name, alive=alive)

    # Towards the core -------------------------------------------------------------------------------------------------

    def _find(self) -> None:
        for folder, operate in running_cores(self._logs)[:1]:
            if folder != self._folder:
                self._folder, self._status = folder, b""
            with suppress(ConnectionError, BadInput):
                self._line = CoreLine(folder, operate, self._heard)
                for name in list(self._present):
                    self._line.client(name, alive=True)

    def _heard(self, status: bytes) -> None:
        self._status = status
        self._share(fresh=True)
        with suppress(ValueError):
            if bus.decode(status, CoreStatus).phase in FINAL and (line := self._line) is not None:
                line.lost.set()

    def _share(self, *, fresh: bool) -> None:
        self._shared_s = self._clock()
        if (publisher := self._publisher) is not None:
            publisher.put(Shared(self._station, self._line is not None, self._status, fresh))
