"""Runs what listens on the network until it is told to stop: a station's gate, or a camera computer's poses."""

from __future__ import annotations

import datetime
import re
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers import bus
from drivers.admission import allow_descriptors
from drivers.mocap.session import Session
from drivers.mocap.shared import PREFIX, UNSEEN
from drivers.samples import Batch, Pose, encode_batch
from drivers.secure import poses_rules, secured
from groundstation.errors import BadInput
from groundstation.flight import timeouts
from groundstation.flight.share import passes
from groundstation.flight.share.gate import Gate
from groundstation.flight.share.passes import Pass

Say = Callable[[str], None]
_TAKEN = "another program has the port, or the address is none of this computer's; give another with --listen."


@dataclass(frozen=True, slots=True)
class Cameras:
    """A motion-capture system as the camera computer reads it: a key of ``drivers.mocap.session.SYSTEMS``, and its
    server.
    """

    system: str
    host: str


def share(logs: Path, endpoint: str, addresses: Sequence[str], stop: threading.Event, say: Say) -> None:
    """Share a station's flights; the list of passes is taken up whenever it changes.

    Args:
        logs: where flights are kept.
        endpoint: to listen on, as "tls/0.0.0.0:7451".
        addresses: by which others call this computer, beside those it knows.
        stop: ends it.
        say: takes lines for people.

    Raises:
        BadInput: the endpoint cannot be listened on, or the passes are damaged.
    """
    allow_descriptors()
    own = passes.renew_station(addresses, datetime.datetime.now(datetime.UTC))
    gate = Gate(logs, own.station)
    try:
        while not stop.is_set():
            _listen(gate, endpoint, own, stop, say)
    finally:
        gate.close()


def _listen(gate: Gate, endpoint: str, own: Pass, stop: threading.Event, say: Say) -> None:
    """Until the list of passes changes."""
    changed, roles = _changed(), passes.roles()
    try:
        close = gate.open(endpoint, own.identity, roles)
    except ConnectionError:
        raise BadInput(f"{endpoint} cannot be listened on: {_TAKEN}") from None
    people = ", ".join(f"{name} ({role})" for name, role in roles.items() if role != "poses")
    say(f"sharing at {endpoint} with {people or 'nobody: `groundstation station --invite NAME` makes a pass'}")
    try:
        while not stop.wait(timeouts.GATE_TURN_S) and _changed() == changed:
            gate.turn()
    finally:
        close()


def _changed() -> int:
    path = passes.list_file()
    return path.stat().st_mtime_ns if path.exists() else 0


def publish_poses(cameras: Cameras, endpoint: str, own: Pass, stop: threading.Event, say: Say) -> None:
    """Read a motion-capture system and give its poses to the station, over a connection with certificates.

    Stamps are those of the exposure on this computer's clock; the station maps that clock to its own by arrivals.

    Raises:
        BadInput: the endpoint cannot be listened on.
    """
    try:
        session = bus.open_session(listen=[endpoint], secure=secured(own.identity, rules=poses_rules()))
    except ConnectionError:
        raise BadInput(f"{endpoint} cannot be listened on: {_TAKEN}") from None
    with session:
        poses = Poses(lambda name, batch: session.put(f"{PREFIX}{_key(name)}", encode_batch(batch)))
        said = ""
        while not stop.is_set():
            try:
                poses.read(cameras, stop, say)
            except OSError as error:
                if (sentence := f"{cameras.system} at {cameras.host}: {error}; trying again") != said:
                    said = sentence
                    say(sentence)
            stop.wait(timeouts.POSES_AGAIN_S)


class Poses:
    """Gives on what a session reads.

    Args:
        put: publishes a body's batch.
    """

    def __init__(self, put: Callable[[str, Batch], None]):
        self._put, self._sequence, self._announced = put, 0, False

    def read(self, cameras: Cameras, stop: threading.Event, say: Say) -> None:
        """One connection, to its end.

        Raises:
            OSError: it ended, or there was none.
        """
        session = Session(cameras.system, cameras.host)
        try:
            while not stop.is_set():
                for arrived in session.poll():
                    for body in arrived.frame.bodies:
                        self._give(body.name, Pose(arrived.stamp_s, body.position_m, body.quaternion))
                    for name in arrived.frame.lost:
                        self._give(name, Pose(arrived.stamp_s, *UNSEEN))
                if not self._announced and session.reader.names:
                    self._announced = True
                    say(f"{cameras.system} at {cameras.host}: {', '.join(session.reader.names[:20])}")
        finally:
            session.close()

    def _give(self, name: str, pose: Pose) -> None:
        self._put(name, Batch(self._sequence, (time.monotonic(),), (pose,)))
        self._sequence += 1


def _key(name: str) -> str:
    """A body's name as one part of a key: what a key may not hold becomes an underscore."""
    return re.sub(r"[/*#?$\s]", "_", name) or "_"
