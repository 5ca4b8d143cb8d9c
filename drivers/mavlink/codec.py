"""MAVLink frames to messages and back, for one peer. Holds no socket, clock or thread."""

from __future__ import annotations

from dataclasses import dataclass, field

from drivers.mavlink.dialect import MESSAGES, Message, mavlink
from drivers.mavlink.framing import Frame, Framer
from drivers.mavlink.gate import refusal
from drivers.mavlink.signing import Signing

STATION_SYSTEM = 245
STATION_COMPONENT = mavlink.MAV_COMP_ID_MISSIONPLANNER


@dataclass(frozen=True, slots=True)
class Received:
    """A frame and what it says; ``message`` is None for ids nobody here knows, which pass and break nothing.

    ``refused``: it says something impossible (:mod:`drivers.mavlink.gate`); kept as bytes, and never believed.
    """

    frame: Frame
    message: Message | None
    refused: bool = False

    @property
    def name(self) -> str:
        """The message's name, "UNKNOWN_<id>" without one."""
        return f"UNKNOWN_{self.frame.message_id}" if self.message is None else self.message.get_type()


@dataclass(slots=True)
class Refusal:
    """Messages of one name that were not believed: why the first was not, and how many."""

    why: str
    count: int = 0


@dataclass(slots=True)
class Counters:
    """What one sender's sequence numbers say about the way here."""

    received: int = 0
    lost: int = 0
    late: int = 0
    _expected: int | None = field(default=None, repr=False)

    def count(self, sequence: int) -> None:
        """Account for a frame; one that comes after its successor was lost only for a while."""
        self.received += 1
        if self._expected is None:
            self._expected = (sequence + 1) % 256
            return
        gap = (sequence - self._expected) % 256
        if gap < 128:
            self.lost += gap
            self._expected = (sequence + 1) % 256
        else:
            self.late += 1
            self.lost = max(0, self.lost - 1)


class MavlinkCodec:
    """Bytes of one peer to messages, and messages to bytes.

    Args:
        system, component: who we are.
        signing: sign and verify every frame; None leaves MAVLink unsigned.
        gated: refuse what says something impossible. A vehicle's own end must not: a field that is NaN tells it
            "unknown".

    Attributes:
        counters: per (system, component) heard.
        framer: counts bytes that belonged to no frame.
        refused: messages with a right checksum that say something impossible, by name.
    """

    def __init__(
        self, system: int = STATION_SYSTEM, component: int = STATION_COMPONENT, signing: Signing | None = None, *,
        gated: bool = True,
    ):  # fmt: skip
        self.signing, self._gated = signing, gated
        self.framer = Framer()
        self.counters: dict[tuple[int, int], Counters] = {}
        self.refused: dict[str, Refusal] = {}
        self._packer = mavlink.MAVLink(None, system, component)
        self._packer.signing.sign_outgoing = False
        self._decoder = mavlink.MAVLink(None)

    def decode(self, data: bytes, *, datagram: bool = False) -> list[Received]:
        """Messages completed by ``data``; forged, replayed and corrupted frames are counted and left out."""
        return [r for f in self.framer.feed(data, datagram=datagram) if (r := self._open(f)) is not None]

    def encode(self, message: Message) -> bytes:
        """One frame, numbered, and signed when a key is set."""
        if self.signing is None:
            raw = message.pack(self._packer)
        else:
            raw = self.signing.sign(_without_signature(message, self._packer))
        self._packer.seq = (self._packer.seq + 1) % 256
        return raw

    def refusal_of(self, frame: Frame) -> str:
        """Why a frame that was refused was, as "ATTITUDE: roll is inf" (of the first of its name)."""
        name = MESSAGES[frame.message_id].msgname
        return f"{name}: {self.refused[name].why}"

    def _open(self, frame: Frame) -> Received | None:
        if self.signing is not None and not self.signing.accepts(frame):
            return None
        self.counters.setdefault((frame.system, frame.component), Counters()).count(frame.sequence)
        if not frame.known:
            return Received(frame, None)
        try:
            message = self._decoder.decode(bytearray(frame.raw))
            why = refusal(message) if self._gated else ""
        except Exception as error:  # generated code and foreign bytes: whatever it is, it must not reach who flies
            message, why = None, f"cannot be decoded ({type(error).__name__})"
        if not why:
            return Received(frame, message)
        name = MESSAGES[frame.message_id].msgname
        self.refused.setdefault(name, Refusal(why)).count += 1
        return Received(frame, None, refused=True)


def _without_signature(message: Message, packer: mavlink.MAVLink) -> bytes:
    """The frame with the signed flag in its header and the checksum that covers it, before the signature block."""
    packer.signing.sign_outgoing = True
    packer.signing.secret_key = b""
    try:
        return message.pack(packer)[:-13]
    finally:
        packer.signing.sign_outgoing = False
        packer.signing.secret_key = None
