"""A client of the core: starts one, sees its status, gives orders. Killing a client never ends a flight."""

from __future__ import annotations

import os
import queue
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from drivers import bus
from drivers.access import Access, Login, Secrets, hand_over, new_secrets
from groundstation.errors import BadInput
from groundstation.flight import timeouts
from groundstation.flight.children import Child, last_line, module_command, start_child
from groundstation.flight.client.access import read_access, write_access
from groundstation.flight.journal import ENDPOINT_FILE, WATCH_FILE, read_journal
from groundstation.flight.journal import NAME as JOURNAL
from groundstation.flight.messages import CLIENT_ALIVE, CommandName, CoreCommand, CoreStatus, Lease, LeaseAnswer
from groundstation.texts import file_name

if TYPE_CHECKING:
    import zenoh


class CoreClient:
    """A connection to a core. Use :func:`connect`.

    Attributes:
        seen: the newest status it was asked for; None before the first.
    """

    def __init__(self, session: zenoh.Session, name: str):
        self._session = session
        self.name = name
        self.seen: CoreStatus | None = None
        self._sequence = 0
        self._inbox: queue.SimpleQueue[CoreStatus] = queue.SimpleQueue()
        self._subscription = bus.subscribe(
            session,
            bus.CORE_STATUS,
            bus.decoder_of(CoreStatus),
            self._inbox.put,
        )

    def status(self, timeout_s: float) -> CoreStatus | None:
        """The newest status; waits for one, and returns None when none came in time."""
        newest = None
        try:
            newest = self.seen = self._inbox.get(timeout=timeout_s)
            while True:
                newest = self.seen = self._inbox.get_nowait()
        except queue.Empty:
            return newest

    def command(self, name: CommandName, timeout_s: float = 5.0) -> bus.Answer:
        """Give an order; ``abort`` is open to everyone."""
        request = CoreCommand(name, self.name, self._next())
        key = bus.CORE_ABORT if name == "abort" else bus.CORE_COMMAND
        return bus.ask(self._session, key, request, bus.Answer, timeout_s)

    def take_lease(self, *, force: bool = False) -> LeaseAnswer:
        """Become the operator, if nobody else is."""
        request = Lease(self.name, take=True, force=force, sequence=self._next())
        return bus.ask(self._session, bus.CORE_LEASE, request, LeaseAnswer)

    def _next(self) -> int:
        """The number of the next order: of the clock, so that it grows when a client of this name is started again."""
        self._sequence = max(self._sequence + 1, time.time_ns())
        return self._sequence


@contextmanager
def connect(access: Access, *, name: str = "", timeout_s: float = timeouts.CORE_CONNECT_S) -> Iterator[CoreClient]:
    """Connect to a core's endpoint.

    Args:
        access: its endpoint, e.g. ``tcp/127.0.0.1:7450``, and as whom to connect.
        name: how this client calls itself; unique by default.
        timeout_s: how long the core may take to come up.

    Raises:
        ConnectionError: nobody listens there.
    """
    name = name or f"client-{os.getpid()}-{uuid.uuid4().hex[:6]}"
    with (
        bus.open_session(connect=[access.endpoint], connect_timeout_s=timeout_s, login=access.login) as session,
        bus.alive(session, CLIENT_ALIVE.format(client=name)),
    ):
        yield CoreClient(session, name)


@dataclass(frozen=True, slots=True)
class FlightOrder:
    """What a core flies.

    Attributes:
        folder: where the flight is kept; made when the core starts.
        plan: plan file.
        vehicle: vehicle file.
        drone: module and arguments of the process that stands for the vehicle.
        analyse: identify, diagnose and report after landing.
        take_over: ``land`` or ``hold`` a vehicle found in flight, instead of flying the plan; the folder is an
            interrupted flight's then.
    """

    folder: Path
    plan: Path
    vehicle: Path
    drone: tuple[str, ...]
    analyse: bool = True
    take_over: str = ""


def start_core(
    order: FlightOrder, *, start: bool = False, listen: tuple[str, ...] = (), secrets: Secrets | None = None
) -> tuple[Child, Access]:
    """Start the core of one flight in a session of its own.

    Args:
        order: what it flies.
        start: fly as soon as the checks pass, without an operator's ``start``.
        listen: endpoints beyond the loopback one, for clients on other machines.
        secrets: of the roles; new ones by default.

    Returns:
        The process, and an operator's access to it, which is also in ``core.endpoint`` in the folder, for this user
        alone; in ``watch.endpoint`` is that of those who may watch and abort.
    """
    folder = order.folder
    folder.mkdir(parents=True, exist_ok=True)
    endpoint = bus.loopback(bus.free_port())
    secrets = secrets or new_secrets()
    access = Access(endpoint, Login("operate", secrets["operate"]))
    write_access(folder / ENDPOINT_FILE, access)
    write_access(folder / WATCH_FILE, Access(endpoint, Login("watch", secrets["watch"])))
    arguments = ["--folder", folder, "--plan", order.plan, "--vehicle", order.vehicle, "--listen", endpoint]
    for extra in listen:
        arguments += ["--listen", extra]
    if start:
        arguments.append("--start")
    if order.take_over:
        arguments += ["--take-over", order.take_over]
    if not order.analyse:
        arguments.append("--no-analysis")
    command = module_command("groundstation.flight.core.process", *map(str, arguments), "--", *order.drone)
    return start_child(command, folder / "core.log", environment=hand_over(flight=secrets)), access


def running_cores(
    logs: Path, timeout_s: float = 1.0, report: Callable[[str], None] = lambda sentence: None
) -> list[tuple[Path, Access]]:
    """Flights in ``logs`` whose core answers now: (folder, access), newest first; ``report`` gets a sentence on each
    file that is not ours.
    """
    found = []
    for file in sorted(logs.glob(f"*/{ENDPOINT_FILE}"), reverse=True):
        try:
            access = read_access(file)
            with bus.open_session(connect=[access.endpoint], connect_timeout_s=timeout_s, login=access.login):
                found.append((file.parent, access))
        except BadInput as error:
            report(str(error))
        except ConnectionError:
            continue
    return found


def interrupted_flight(logs: Path, vehicle: str) -> Path | None:
    """The newest flight of a vehicle that has no outcome and no core that answers; None without one."""
    alive = {folder for folder, _ in running_cores(logs)}
    for folder in sorted(logs.glob(f"*-{vehicle}*"), reverse=True):
        log = folder / JOURNAL
        entries = read_journal(log) if log.is_file() and not log.is_symlink() else []
        if entries and folder not in alive:
            return None if entries[-1]["kind"] == "outcome" else folder
    return None


def outcome(folder: Path) -> tuple[int, str]:
    """Exit status and sentence with which a core ended its flight.

    Raises:
        BadInput: the core was killed before it could write one.
    """
    log = folder / JOURNAL
    entries = read_journal(log) if log.is_file() else []
    if not entries or entries[-1]["kind"] != "outcome" or not isinstance(entries[-1].get("exit_status"), int):
        said = last_line(folder / "core.log")
        why = f": {said}" if said else "; it was killed, and the recording opens as far as it goes"
        raise BadInput(f"{folder}: the core ended without an outcome{why}.")
    return int(entries[-1]["exit_status"]), str(entries[-1].get("reason", ""))


def new_flight_folder(logs: Path, vehicle: str, now: time.struct_time | None = None) -> Path:
    """A folder name that sorts by time: ``logs/2025-01-31T12-00-00-qball2``; a suffix keeps it unique."""
    stem = f"{time.strftime('%Y-%m-%dT%H-%M-%S', now or time.localtime())}-{file_name(vehicle, 'vehicle')}"
    folder, number = logs / stem, 2
    while folder.exists():
        folder, number = logs / f"{stem}-{number}", number + 1
    return folder
