"""What every motion-capture reader takes in and gives out, whatever the system. No I/O.

A reader is a protocol without sockets: bytes in (:meth:`Reader.feed`), bytes out (:meth:`Reader.due`), frames and clock
evidence as events. Lengths are metres, quaternions scalar first, body to world, times seconds on the clock they name.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, sqrt
from typing import Protocol

from drivers.samples import Quaternion, Vector3

LONGEST_MESSAGE = 4 << 20
"""Bytes of one message. A thousand bodies with all their markers need a tenth of it; what claims more is no message."""
MOST_BODIES = 1000


@dataclass(frozen=True, slots=True)
class Body:
    """One tracked rigid body of a frame.

    Attributes:
        name: as the system calls it; its number in digits where it gives none.
        number: its number, where it has one.
        residual_m: mean distance of its markers from where the fitted body has them, where it is told.
    """

    name: str
    position_m: Vector3
    quaternion: Quaternion
    number: int | None = None
    residual_m: float | None = None


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame of the cameras.

    Attributes:
        number: the system's own count of frames, where it has one.
        exposure_s: middle of the exposure on the server's clock; None where the protocol does not tell.
        sent_s: when the server sent it, on the same clock; None where the protocol does not tell.
        bodies: those that were seen.
        lost: names of those that were not.
    """

    number: int | None
    exposure_s: float | None
    sent_s: float | None
    bodies: tuple[Body, ...]
    lost: tuple[str, ...] = ()

    def body(self, wanted: str) -> Body | None:
        """The body of that name, else of that number."""
        return next((b for b in self.bodies if b.name == wanted), None) or next(
            (b for b in self.bodies if b.number is not None and str(b.number) == wanted), None
        )


@dataclass(frozen=True, slots=True)
class Exchange:
    """A question and its answer: the server's clock showed ``server_s`` between two times of ours."""

    sent_s: float
    server_s: float
    received_s: float


@dataclass(frozen=True, slots=True)
class RoundTrip:
    """A question and its answer that carries no time: how long both ways took."""

    seconds: float


Reading = Frame | Exchange | RoundTrip


class Reader(Protocol):
    """One system's protocol, as seen by a client.

    Attributes:
        server: name and version of what answers; empty before it did.
        names: bodies that the server knows, seen or not.
        up: the axis that the server says points up, "y" or "z"; empty where it does not tell.
        malformed: messages that could not be read, and were skipped.
        trouble: why nothing comes, one sentence; empty while all is well.
    """

    server: str
    names: tuple[str, ...]
    up: str
    malformed: int
    trouble: str

    def due(self, now_s: float) -> list[bytes]:
        """What has to be sent now: greetings, requests, signs of life. Called at least ten times a second."""
        ...

    def feed(self, data: bytes, received_s: float) -> list[Reading]:
        """Take in bytes (a datagram, or a portion of a stream). Any bytes at all; never raises."""
        ...


class Damaged(ValueError):
    """A message that ends too early, or claims more than there is."""


class Cursor:
    """Reads one message from its front; never beyond its end.

    Args:
        data: the message.
        order: "<" or ">".
    """

    def __init__(self, data: bytes, order: str = "<"):
        self._data, self._order, self.at = data, order, 0

    @property
    def left(self) -> int:
        """Bytes not read yet."""
        return len(self._data) - self.at

    def take(self, size: int) -> bytes:
        """The next bytes."""
        if not 0 <= size <= self.left:
            raise Damaged(f"{size} bytes wanted, {self.left} left")
        self.at += size
        return self._data[self.at - size : self.at]

    def values(self, form: str) -> tuple[int | float, ...]:
        """The next values, as ``struct`` writes their form."""
        layout = struct.Struct(self._order + form)
        return layout.unpack(self.take(layout.size))

    def integer(self, form: str = "I") -> int:
        """The next integer."""
        return int(self.values(form)[0])

    def count(self, least: int, form: str = "I") -> int:
        """A count of entries of at least that many bytes each, as many as can be there."""
        count = self.integer(form)
        if not 0 <= count * max(1, least) <= self.left:
            raise Damaged(f"{count} entries of {least} bytes claimed, {self.left} bytes left")
        return count

    def terminated(self) -> str:
        """Text up to its NUL."""
        end = self._data.find(b"\0", self.at)
        if end < 0:
            raise Damaged("text without an end")
        text = self.take(end - self.at).decode("utf-8", "replace")
        self.at += 1
        return text

    def vector(self, form: str = "3f") -> Vector3:
        """The next three numbers."""
        x, y, z = self.values(form)
        return (float(x), float(y), float(z))


def tracked(position: Vector3, quaternion: Quaternion) -> bool:
    """Whether these are a pose: finite, within ten kilometres, and a quaternion of about unit length."""
    numbers = (*position, *quaternion)
    if not all(isfinite(v) for v in numbers) or max(abs(v) for v in position) > 1e4:
        return False
    return abs(sum(v * v for v in quaternion) - 1.0) < 0.02


def unit(quaternion: Quaternion) -> Quaternion:
    """At unit length."""
    w, x, y, z = quaternion
    size = sqrt(w * w + x * x + y * y + z * z) or 1.0
    return (w / size, x / size, y / size, z / size)


def quaternion_of_matrix(m: Sequence[float]) -> Quaternion | None:
    """Quaternion of a rotation matrix by rows, by its trace or its largest diagonal entry (Shepperd 1978).

    None where it is no rotation: a mirrored matrix (determinant -1) has no quaternion.
    """
    if not all(isfinite(v) and abs(v) < 2.0 for v in m):
        return None
    determinant = (
        m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) + m[2] * (m[3] * m[7] - m[4] * m[6])
    )
    if abs(determinant - 1.0) > 0.02:
        return None
    four = (1 + m[0] + m[4] + m[8], 1 + m[0] - m[4] - m[8], 1 - m[0] + m[4] - m[8], 1 - m[0] - m[4] + m[8])
    k = max(range(4), key=lambda i: four[i])
    d = (m[7] - m[5], m[2] - m[6], m[3] - m[1])
    s = (m[3] + m[1], m[2] + m[6], m[7] + m[5])
    rows = [(four[0], *d), (d[0], four[1], s[0], s[1]), (d[1], s[0], four[2], s[2]), (d[2], s[1], s[2], four[3])]
    w, x, y, z = rows[k]
    return unit((w, x, y, z))
