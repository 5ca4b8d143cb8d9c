"""The bus: how drone, core and user interface meet on zenoh. Keys, message types, and thin typed helpers; no behaviour.

Topology. The core listens on a loopback endpoint; the simulated drone and every user interface connect to it
(:func:`open_session`). Sessions are peers; multicast and gossip are off, so nobody is met who was not named.

Drone, keys under ``gs/<drone>/`` (:class:`DroneKeys`)::

    samples   publication  drone -> core   drivers.samples.Batch: samples in order of arrival, sequence-numbered from 0
    status    publication  drone -> core   DroneStatus, on every change and at least every 0.1 s of the drone's time
    credit    publication  core -> drone   Credit: how far the drone may run (lock-step), and that the core lives
    upload    queryable    on the drone    Upload -> Answer
    command   queryable    on the drone    Command -> Answer
    describe  queryable    on the drone    Describe -> Description: what flies here
    alive     liveliness   of the drone

Core, keys under ``gs/core/``: ``status`` (publication), ``command``, ``abort`` and ``lease`` (queryables), ``alive``
(liveliness). Who may send on which key: :mod:`drivers.access`.
The payloads of those belong to the core; :func:`publish`, :func:`subscribe`, :func:`serve` and :func:`ask` carry any
``msgspec.Struct``.

Lock-step. All times called ``host_s`` are the host's monotonic clock, which is *simulated* while the drone runs faster
than real time: it starts at 0 when the drone process starts, and advances only with the drone. The drone simulates
while ``host_s < Credit.host_s``, in batches of at most ``Description.batch_s``, and sends a sample when its simulated
*arrival* time is reached. The core grants more as it has digested what came: keep credit 0.5 to 2 s ahead of the last
batch. With ``--real-time`` the drone paces itself by the wall clock and takes from credit only that the core is alive.

Orders take effect at the simulated instant at which the drone stands, between two batches. The core lets it stand at
fixed instants on the ground (``groundstation.flight.core.pacing``), so one seed and plan give one flight on any
machine.

Losing the station. A drone that was sent at least one Credit and then hears none for :data:`CREDIT_TIMEOUT_S` of wall
time (:data:`LOCK_STEP_TIMEOUT_S` in lock-step), or sees ``gs/core/alive`` vanish, no longer waits: it flies itself
down, lands and disarms, publishing all the while. A lock-stepped drone then stands still until a core grants credit
beyond its ``host_s`` again, and ends its process after ten seconds alone; a real-time drone after two minutes. Send
Credit at least every 0.5 s, also when it grants nothing new.

Everything is MessagePack with field names, so that fields can be added; a payload that does not decode never reaches a
handler: requests are answered ``ok = False`` with the reason, publications are counted in ``Subscription.rejected``.
"""

from __future__ import annotations

import json
import socket
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import msgspec

from drivers.access import Login, Secrets
from drivers.admission import admission, keep_inside

if TYPE_CHECKING:
    import zenoh

CREDIT_TIMEOUT_S = 3.0
"""Wall time without Credit after which a drone in real time takes the station for dead."""
LOCK_STEP_TIMEOUT_S = 30.0
"""And one in lock-step, for which no time passes meanwhile: a core short of processor time is none that died."""

CORE_ALIVE = "gs/core/alive"
CORE_STATUS = "gs/core/status"
CORE_COMMAND = "gs/core/command"
CORE_ABORT = "gs/core/abort"
CORE_LEASE = "gs/core/lease"

DronePhase = Literal["idle", "uploaded", "armed", "takeoff", "exciting", "landing", "landed", "crashed"]
"""Of the drone itself: ``takeoff`` until the excitation starts, ``landing`` from its end (or an abort) to touch-down;
``armed`` is armed on the ground, ``landed`` is disarmed after a flight (a new upload is accepted), ``crashed`` is a
vehicle that hit the ground or tumbled (disarmed; a new upload sets it upright again)."""

CommandName = Literal["arm", "start", "finish", "extend", "abort", "land", "kill", "disarm", "shutdown"]
"""``start`` flies the uploaded plan from take-off to landing; ``abort`` and ``land`` stop where it is and descend;
``finish`` ends the excitation at its next rest point, ``extend`` lets it go on for a period more than it would, up to
what was uploaded; ``kill`` stops the rotors wherever it is; ``disarm`` is refused in the air; ``shutdown`` ends the
drone process, refused in the air.
"""

M = TypeVar("M", bound=msgspec.Struct)


class Credit(msgspec.Struct, frozen=True):
    """Core to drone: simulate up to this host time (seconds), and know that the core lives."""

    host_s: float


class DroneStatus(msgspec.Struct, frozen=True):
    """What the drone is doing.

    Attributes:
        phase: see :data:`DronePhase`.
        armed: rotors may turn.
        device_s: the flight controller's clock, the one that stamps motors and setpoints.
        host_s: simulated (or real) host time of this status.
        text: one sentence for people; empty when there is nothing to say.
        flight_s: seconds since take-off began; 0 on the ground.
        flight_end_s: planned seconds from take-off to touch-down; 0 without a plan.
        window_s: start and end of the excitation in ``device_s``; known from the start of the flight.
        position_m, setpoint_m: where it is and where it should be, world frame (a live view; samples are the record).
        euler_rad: roll, pitch, yaw.
        plan_crc32: CRC-32 of the upload it holds.
    """

    phase: DronePhase
    armed: bool
    device_s: float
    host_s: float
    text: str = ""
    flight_s: float = 0.0
    flight_end_s: float = 0.0
    window_s: tuple[float, float] | None = None
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    setpoint_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    euler_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    plan_crc32: int | None = None


class Upload(msgspec.Struct, frozen=True):
    """A plan file's bytes with their checksum; build with :func:`make_upload`."""

    format: Literal["toml", "json"]
    plan: bytes
    crc32: int


class Command(msgspec.Struct, frozen=True):
    """An order to the drone."""

    name: CommandName


class Describe(msgspec.Struct, frozen=True):
    """Ask a drone what it is."""


class Description(msgspec.Struct, frozen=True):
    """What flies here, and for reports on simulated flights alone the true vehicle.

    Attributes:
        drone: its name on the bus.
        vehicle: name of the declared vehicle.
        motor_kind: what ``Motors`` samples hold.
        real_time: paced by the wall clock instead of by credit.
        batch_s: longest stretch of host time in one batch.
        scenario: name of the scenario.
        truth_toml: the true vehicle's file (``groundstation.vehicle`` format): mass, inertia and what else is drawn
            there.
        notes: what the recording shall say of itself, one sentence each.
        ok, reason: as in :class:`Answer`.
    """

    drone: str = ""
    vehicle: str = ""
    motor_kind: Literal["rotor_speed", "command", "wrench"] = "rotor_speed"
    real_time: bool = False
    batch_s: float = 0.05
    scenario: str = ""
    truth_toml: str = ""
    notes: tuple[str, ...] = ()
    ok: bool = True
    reason: str = ""


class Answer(msgspec.Struct, frozen=True):
    """Yes, or no with one sentence why."""

    ok: bool
    reason: str = ""


@dataclass(frozen=True, slots=True)
class DroneKeys:
    """Key expressions of one drone; ``DroneKeys("*")`` for subscribers to all."""

    drone: str

    def __post_init__(self) -> None:
        if not self.drone or any(mark in self.drone for mark in "/#?$ ") or (self.drone != "*" and "*" in self.drone):
            raise ValueError(f"'{self.drone}' cannot name a drone on the bus: no '/', '#', '?', '$', '*' or blanks")

    def _key(self, leaf: str) -> str:
        return f"gs/{self.drone}/{leaf}"

    @property
    def samples(self) -> str:
        return self._key("samples")

    @property
    def status(self) -> str:
        return self._key("status")

    @property
    def credit(self) -> str:
        return self._key("credit")

    @property
    def upload(self) -> str:
        return self._key("upload")

    @property
    def command(self) -> str:
        return self._key("command")

    @property
    def describe(self) -> str:
        return self._key("describe")

    @property
    def alive(self) -> str:
        return self._key("alive")


def make_upload(plan: bytes, form: Literal["toml", "json"] = "toml") -> Upload:
    """An upload with its checksum."""
    return Upload(form, plan, zlib.crc32(plan))


def checksum_holds(upload: Upload) -> bool:
    """Whether the bytes are the ones that were sent."""
    return zlib.crc32(upload.plan) == upload.crc32


def encode(message: msgspec.Struct) -> bytes:
    """Wire form of any message."""
    return msgspec.msgpack.encode(message)


def decode(data: bytes, kind: type[M]) -> M:
    """Inverse of :func:`encode`.

    Raises:
        ValueError: the bytes are no such message.
    """
    try:
        return msgspec.msgpack.decode(data, type=kind)
    except (msgspec.DecodeError, RecursionError) as error:
        raise ValueError(f"not a {kind.__name__}: {error}") from None


def free_port() -> int:
    """A TCP port that is free on the loopback interface now (another process may take it before it is used)."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def loopback(port: int) -> str:
    """Zenoh endpoint of a port on this machine alone."""
    return f"tcp/127.0.0.1:{port}"


def open_session(
    *,
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    connect_timeout_s: float = 5.0,
    login: Login | None = None,
    admit: tuple[Secrets, str] | None = None,
    secure: Mapping[str, Any] | None = None,
) -> zenoh.Session:
    """Open a peer session that meets only the endpoints named.

    Args:
        listen: endpoints to accept peers on; none by default (zenoh's own default is all interfaces).
        connect: endpoints to connect to; re-connected by zenoh when lost.
        connect_timeout_s: how long the first connection may take.
        login: as whom to open the session.
        admit: secrets of the roles and the vehicle's name: only sessions that log in are accepted, each for its role.
        secure: settings of a session between machines (:func:`drivers.secure.secured`). Without them nothing listens
            beyond this machine.

    Raises:
        ConnectionError: an endpoint cannot be opened or reached, or would listen beyond this machine without
            certificates.
    """
    import zenoh

    secure = secure or {}
    keep_inside(listen, secure)

    settings = {
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "connect/timeout_ms": int(1000 * connect_timeout_s),
        "connect/exit_on_failure": True,
        "transport/link/tx/lease": 2000,
        "transport/link/tx/queue/size/data": 16,  # the most there can be: about a megabyte before anything is dropped
    }
    if login is not None:
        settings["transport/auth/usrpwd"] = {"user": login.role, "password": login.secret}
    config = zenoh.Config()
    try:
        with admission(admit) as admitting:
            for key, value in {**settings, **admitting, **secure}.items():
                config.insert_json5(key, json.dumps(value))
            return zenoh.open(config)
    except zenoh.ZError as error:
        places = ", ".join([*listen, *connect]) or "no endpoint"
        raise ConnectionError(
            f"the bus at {places} cannot be opened ({error}); is the port right and the core up?"
        ) from None


class Publisher:
    """A typed publisher. ``lossless`` blocks while a subscriber is behind: for lock-step alone, never on a thread that
    flies.

    Without it messages are dropped under congestion; sequence numbers in them count the gaps. Such messages share
    zenoh's transmission buffers: express ones take a buffer each, and on a machine short of processor time those run
    out.
    """

    def __init__(self, session: zenoh.Session, key: str, *, lossless: bool = False):
        import zenoh

        control = zenoh.CongestionControl.BLOCK if lossless else zenoh.CongestionControl.DROP
        self._publisher = session.declare_publisher(
            key, congestion_control=control, reliability=zenoh.Reliability.RELIABLE, express=lossless
        )

    def put(self, message: msgspec.Struct | bytes) -> None:
        """Publish a message, or bytes already encoded."""
        self._publisher.put(message if isinstance(message, bytes) else encode(message))

    def close(self) -> None:
        """Undeclare."""
        self._publisher.undeclare()


class Subscription:
    """A running subscription: ``rejected`` counts payloads that did not decode."""

    def __init__(self) -> None:
        self.rejected = 0
        self._handle: Any = None

    def close(self) -> None:
        """Undeclare."""
        self._handle.undeclare()


def subscribe(
    session: zenoh.Session, key: str, decoder: Callable[[bytes], Any], handler: Callable[[Any], None]
) -> Subscription:
    """Call ``handler`` on zenoh's thread with every decoded message; hand over to a queue there, do no work.

    Args:
        session: an open session.
        key: key expression, may contain ``*``.
        decoder: bytes to message, raising ValueError: ``drivers.samples.decode_batch`` or
            ``decoder_of(DroneStatus)``.
        handler: receives the message.
    """
    subscription = Subscription()

    def receive(sample: zenoh.Sample) -> None:
        try:
            message = decoder(sample.payload.to_bytes())
        except ValueError:
            subscription.rejected += 1
            return
        handler(message)

    subscription._handle = session.declare_subscriber(key, receive)
    return subscription


def serve(
    session: zenoh.Session,
    key: str,
    kind: type[M],
    handler: Callable[[M], msgspec.Struct],
    answered: Callable[[], None] | None = None,
) -> Any:
    """Answer requests on a key: ``handler`` runs on zenoh's thread and returns the answer; ``answered`` is called there
    once it has been sent, or could not be.

    A payload that is no ``kind`` is answered ``Answer(ok=False, reason)``. Keep the return value; undeclare it to stop.
    """

    def receive(query: zenoh.Query) -> None:
        try:
            request = decode(query.payload.to_bytes() if query.payload is not None else b"", kind)
        except ValueError as error:
            answer: msgspec.Struct = Answer(False, f"the request was not understood: {error}")
        else:
            answer = handler(request)
        try:
            query.reply(key, encode(answer))
            query.drop()
        finally:  # whether or not the one who asked is still there
            if answered is not None:
                answered()

    return session.declare_queryable(key, receive)


def ask(session: zenoh.Session, key: str, request: msgspec.Struct, kind: type[M] = Answer, timeout_s: float = 5.0) -> M:
    """Send a request and wait for the answer (blocks the calling thread).

    Args:
        session: an open session.
        key: the queryable's key, e.g. ``DroneKeys(name).upload``.
        request: :class:`Upload`, :class:`Command`, :class:`Describe`, ...
        kind: type of the answer; it must have ``ok`` and ``reason``, which carry a refusal.
        timeout_s: after this, nobody answered.

    Raises:
        ConnectionError: nobody answered in time.
        ValueError: the answer is no ``kind``.
    """
    for reply in session.get(key, payload=encode(request), timeout=timeout_s):
        if reply.ok is not None:
            return decode(reply.ok.payload.to_bytes(), kind)
    raise ConnectionError(f"nobody answered on {key} (waited up to {timeout_s:g} s); is the other process up?")


@contextmanager
def alive(session: zenoh.Session, key: str) -> Iterator[None]:
    """Hold a liveliness token while the block runs; it vanishes by itself when the process dies (2 s when it
    freezes).
    """
    token = session.liveliness().declare_token(key)
    try:
        yield
    finally:
        token.undeclare()


def watch_alive(session: zenoh.Session, key: str, handler: Callable[[str, bool], None]) -> Any:
    """Call ``handler(key, is_alive)`` for tokens present now and whenever one comes or goes. Keep the return value."""
    import zenoh

    def receive(sample: zenoh.Sample) -> None:
        handler(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

    return session.liveliness().declare_subscriber(key, receive, history=True)


def decoder_of(kind: type[M]) -> Callable[[bytes], M]:
    """Return the decoder of one message type, as :func:`subscribe` takes it."""
    return lambda data: decode(data, kind)
