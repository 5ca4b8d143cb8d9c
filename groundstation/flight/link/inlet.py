"""What is taken in from a line: from whom, how much in one step, and what of it is believed. No I/O, no clock.

Three promises:

* The peer is bound to the flight. Setpoints go where the vehicle was found; another address is taken in its place only
  in flight, only while the old one is silent, and only for the same system and component whose clock goes on. On the
  ground the operator starts the link again.
* Work is bounded. A step decodes so many frames and bytes of the vehicle's and less of strangers'; what is left waits,
  with the time it came, and the oldest of too much is dropped and counted. Strangers are not decoded once the vehicle
  is known.
* Only the autopilot is believed. Frames of other components of its system are recorded, those of other systems counted.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from drivers.mavlink.codec import MavlinkCodec, Received
from drivers.mavlink.dialect import mavlink
from drivers.mavlink.signing import Signing
from drivers.mavlink.transports import Peer

PIECE = 4096
"""Bytes decoded in one go: a bound on what one call of the framer can cost."""
MOST_FRAMES = 100
"""Frames of one step, some milliseconds of work; a busy link brings 30 in the 20 ms between two setpoints."""
MOST_NOISE = 2 * PIECE
"""Bytes of one step that belong to no frame, a few milliseconds of work."""
MOST_WAITING = 4 << 20
"""Bytes that wait to be decoded; more than a burst of a log's download."""
STRANGERS_BYTES = 2 * PIECE
"""Of strangers, a step, while the vehicle is looked for."""
STRANGERS = 8
"""Strangers whose state is kept at a time, and whose addresses are told."""
CLOCK_S = 0.5
"""How far the clock of who claims to be the vehicle may lie from where the vehicle's would be."""


class Complaints:
    """What was not believed, failed, or did not belong here: counted by name, and told at the 1st, 10th, 100th, ...
    time.
    """

    def __init__(self, most: int = 100):
        self.counts: dict[str, int] = {}
        self._most = most

    def count(self, what: str, times: int = 1) -> bool:
        """Once more; whether it is to be told now."""
        if what not in self.counts and len(self.counts) >= self._most:
            what = "others"
        before = self.counts.get(what, 0)
        self.counts[what] = before + times
        return len(str(before + times)) > len(str(before)) or not before


@dataclass(slots=True)
class Load:
    """What strangers sent since it was last told."""

    datagrams: int = 0
    bytes: int = 0
    peers: set[Peer] = field(default_factory=set)

    def add(self, peer: Peer, size: int) -> None:
        """One datagram."""
        self.datagrams += 1
        self.bytes += size
        if len(self.peers) < STRANGERS:
            self.peers.add(peer)

    def __str__(self) -> str:
        shown = ", ".join(sorted(self.peers)[:3]) + (", ..." if len(self.peers) > 3 else "")
        return f"{self.datagrams} datagrams, {self.bytes / 1e3:.0f} kB from {shown}"


@dataclass(frozen=True, slots=True)
class Arrival:
    """A frame, when it came, and from where."""

    received_s: float
    peer: Peer
    received: Received


class Inlet:
    """Of one link.

    Args:
        signing: key for the whole flight; None leaves MAVLink unsigned.

    Attributes:
        peer: the vehicle's address; None before it is known.
        dropped: bytes of the vehicle's that were too many to wait.
        load: what strangers sent since :meth:`take_load`.
    """

    def __init__(self, signing: Signing | None = None):
        self._signing = signing
        self.peer: Peer | None = None
        self.codecs: dict[Peer, MavlinkCodec] = {}
        self.dropped = 0
        self.load = Load()
        self.heard_s = float("-inf")
        self._waiting: deque[tuple[float, Peer, bytes]] = deque()
        self._bytes = 0
        self._frames: deque[Arrival] = deque()

    @property
    def waiting(self) -> bool:
        """Something is left for the next step."""
        return bool(self._waiting or self._frames)

    def bind(self, peer: Peer, now_s: float) -> None:
        """From now on the vehicle is there; what others are still waiting with is noise."""
        self.peer, self.heard_s = peer, now_s
        self.codecs = {p: c for p, c in self.codecs.items() if p == peer}
        self._waiting = deque(item for item in self._waiting if item[1] == peer)
        self._bytes = sum(len(data) for _, _, data in self._waiting)

    def put(self, now_s: float, incoming: Iterable[tuple[Peer, bytes]], *, others: bool) -> None:
        """Take what arrived; ``others``: strangers are listened to as well, within their bounds."""
        room = STRANGERS_BYTES
        for peer, data in incoming:
            if peer == self.peer:
                self.heard_s = now_s
            elif self.peer is not None:
                self.load.add(peer, len(data))
                if not others or len(data) > room:
                    continue
                room -= len(data)
            self._queue(now_s, peer, data)

    def take(self, *, datagrams: bool) -> Iterator[Arrival]:
        """Frames of one step, the vehicle's and those of who may be it."""
        noise = 0
        for _ in range(MOST_FRAMES):
            while not self._frames and self._waiting:
                if noise > MOST_NOISE:
                    return
                received_s, peer, data = self._waiting.popleft()
                self._bytes -= len(data)
                codec = self._codec(peer)
                skipped = codec.framer.skipped
                found = codec.decode(data, datagram=datagrams)
                self._frames.extend(Arrival(received_s, peer, received) for received in found)
                noise += codec.framer.skipped - skipped
            if not self._frames:
                return
            yield self._frames.popleft()

    def take_load(self) -> Load:
        """What strangers sent since the last call."""
        load, self.load = self.load, Load()
        return load

    def _codec(self, peer: Peer) -> MavlinkCodec:
        """Of an address; of too many strangers the first is forgotten, so that no crowd keeps the vehicle out."""
        if peer not in self.codecs and len(self.codecs) > STRANGERS:
            del self.codecs[next(known for known in self.codecs if known != self.peer)]
        return self.codecs.setdefault(peer, MavlinkCodec(signing=self._signing))

    def _queue(self, now_s: float, peer: Peer, data: bytes) -> None:
        self._codec(peer)
        for at in range(0, len(data), PIECE):
            piece = data[at : at + PIECE]
            self._waiting.append((now_s, peer, piece))
            self._bytes += len(piece)
        while self._bytes > MOST_WAITING:
            _, _, oldest = self._waiting.popleft()
            self._bytes -= len(oldest)
            self.dropped += len(oldest)


def says_who_it_is(received: Received) -> bool:
    """A heartbeat of an autopilot."""
    m = received.message
    return received.name == "HEARTBEAT" and m is not None and m.autopilot != mavlink.MAV_AUTOPILOT_INVALID


def stamp_s(received: Received) -> float | None:
    """The vehicle's time since boot, where a message tells it."""
    boot_ms = getattr(received.message, "time_boot_ms", None)
    return None if not boot_ms else boot_ms * 1e-3
