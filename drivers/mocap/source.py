"""Poses of one rigid body from a motion-capture system, from a process of its own.

    python -P -m drivers.mocap.source --system natnet --host 192.168.1.10 --body drone

Each pose leaves as four bytes of length (little-endian) and a ``drivers.samples.Batch`` on standard output, and so do
events that tell of the server, its clock and what is wrong. A server that hangs costs this process alone, and the link
sees poses grow old. Stamps are those of the exposure on the host's monotonic clock (:mod:`drivers.mocap.serverclock`).
"""

from __future__ import annotations

import argparse
import os
import struct
import sys
import time
from pathlib import Path

from drivers.mocap.health import Health, clock_text
from drivers.mocap.readings import Body
from drivers.mocap.serverclock import ServerClock
from drivers.mocap.session import SYSTEMS, Arrived, Delay, Session
from drivers.samples import Batch, Event, Pose, Quaternion, Vector3, decode_batch, encode_batch
from drivers.secure import read_identity

_LENGTH = struct.Struct("<I")
LONGEST_FRAME = 1 << 20
AGAIN_AFTER_S = 0.5
TOLD_EVERY_S = 2.0


def frame(sample: Pose | Event, host_s: float, sequence: int) -> bytes:
    """One sample as it leaves."""
    data = encode_batch(Batch(sequence, (host_s,), (sample,)))
    return _LENGTH.pack(len(data)) + data


class FrameReader:
    """Inverse of :func:`frame` for bytes that come in any portions.

    Attributes:
        damaged: frames that were none; after one that claims an impossible length, all that was buffered is dropped.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.damaged = 0

    def feed(self, data: bytes) -> list[tuple[Pose | Event, float]]:
        """What ``data`` completed, with the host time it arrived at."""
        self._buffer += data
        out: list[tuple[Pose | Event, float]] = []
        while len(self._buffer) >= 4:
            size = _LENGTH.unpack_from(self._buffer)[0]
            if size > LONGEST_FRAME:
                self.damaged += 1
                self._buffer.clear()
                break
            if len(self._buffer) < 4 + size:
                break
            body = bytes(self._buffer[4 : 4 + size])
            del self._buffer[: 4 + size]
            try:
                batch = decode_batch(body)
            except ValueError:
                self.damaged += 1
                continue
            pairs = zip(batch.samples, batch.host_s, strict=False)
            out += [(s, t) for s, t in pairs if isinstance(s, (Pose, Event))]
        return out


def z_up(position: Vector3, quaternion: Quaternion) -> tuple[Vector3, Quaternion]:
    """A pose of a y-up system in the z-up world: both world and body axes turned by a quarter about x, (x, y, z) to (x,
    -z, y).
    """
    (x, y, z), (w, a, b, c) = position, quaternion
    return (x, -z, y), (w, a, -c, b)


class Source:
    """Turns what arrives into what leaves, for one body.

    Args:
        options: system, host, body, up.
        clock: of the server; outlives connections.
    """

    def __init__(self, options: argparse.Namespace, clock: ServerClock):
        self._options, self._clock = options, clock
        self._sequence = 0
        self._health = Health()
        self._said = ""
        self._told_s = -1e9

    def run(self) -> None:
        """One connection, to its end.

        Raises:
            OSError: it ended, or there was none.
        """
        options = self._options
        measured = None if options.delay is None else Delay(options.delay, options.delay_error)
        shown = None if options.identity is None else read_identity(options.identity)
        session = Session(options.system, options.host, options.body, self._clock, measured, shown)
        parent = os.getppid()
        try:
            while os.getppid() == parent:
                for arrived in session.poll():
                    self._take(arrived)
                self._tell(session)
            raise BrokenPipeError("who started this is gone")
        finally:
            session.close()

    def say(self, kind: str, text: str) -> None:
        """An event, once until another is said."""
        if text != self._said:
            self._said = text
            self._put(Event(time.monotonic(), kind, text), time.monotonic())

    def _take(self, arrived: Arrived) -> None:
        body = arrived.frame.body(self._options.body)
        if body is None and arrived.frame.bodies and self._options.body not in arrived.frame.lost:
            return  # a system that reports each body by itself: another one's turn
        self._health.take(arrived, body)
        if body is not None:
            self._put(Pose(arrived.stamp_s, *self._upright(body)), arrived.received_s)

    def _upright(self, body: Body) -> tuple[Vector3, Quaternion]:
        if self._options.up == "y":
            return z_up(body.position_m, body.quaternion)
        return body.position_m, body.quaternion

    def _tell(self, session: Session) -> None:
        now_s = time.monotonic()
        if session.take_step():
            self.say(
                "mocap", f"the clock of {self._options.system} stepped (restarted, or set by NTP); it is measured anew"
            )
        if now_s - self._told_s < TOLD_EVERY_S:
            return
        self._told_s = now_s
        trouble = session.reader.trouble or self._missing(session)
        if trouble:
            self.say("mocap", trouble)
        elif self._clock.now is not None:
            told = clock_text(self._clock.now, session.error_s(), self._health.summary(now_s))
            self._put(Event(now_s, "clock", told), now_s)

    def _missing(self, session: Session) -> str:
        names, body = session.reader.names, self._options.body
        if names and body not in names and self._health.seen == 0:
            return f"{self._options.system} knows no body '{body}'; there are {', '.join(names[:20])}"
        return ""

    def _put(self, sample: Pose | Event, host_s: float) -> None:
        data = frame(sample, host_s, self._sequence)
        self._sequence += 1
        while data:
            data = data[os.write(1, data) :]


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Options of the process."""
    parser = argparse.ArgumentParser(prog="drivers.mocap.source", description=__doc__)
    parser.add_argument("--system", choices=tuple(SYSTEMS), required=True)
    parser.add_argument(
        "--host", default="127.0.0.1", help="address of the server, with :port where it is not the usual one"
    )
    parser.add_argument(
        "--body", default="1", help="name or number of the rigid body; topic for ros2; system id for mavlink"
    )
    parser.add_argument("--up", choices=("y", "z"), default="z", help="the axis that points up in the system's world")
    parser.add_argument("--delay", type=float, help="measured delay of the system's stamps after the exposure, s")
    parser.add_argument("--delay-error", type=float, default=0.0, help="and its error, s")
    parser.add_argument("--identity", type=Path, help="file of the certificate that a tls/ endpoint is shown")
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> int:
    """Entry point of the process: connect, and again after each failure, until standard output closes."""
    options = parse(arguments)
    source = Source(options, ServerClock())
    while True:
        try:
            source.run()
        except BrokenPipeError:
            return 0
        except OSError as error:
            try:
                source.say("mocap", f"{options.system} at {options.host}: {error}; trying again")
            except BrokenPipeError:
                return 0
        time.sleep(AGAIN_AFTER_S)


if __name__ == "__main__":
    sys.exit(main())
