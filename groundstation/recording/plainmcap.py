"""MCAP files that ``rosbags`` refuses: recordings that were not ended, and other programs' exports of ROS 2 messages.

Read by :mod:`groundstation.recording.container`, which stops where a file was cut; the messages' types come from
their schemas.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from groundstation.recording.container import MAGIC, Contents, read_container

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

_LATEST_NS = 2**63 - 1


@dataclass(frozen=True, slots=True, eq=False)
class Connection:
    """A channel, named as the library names it."""

    topic: str
    msgtype: str
    msgcount: int
    channel: int


class PlainMcap:
    """What ``bagfile.opened`` gives of such a file: the part of the library's reader that is used.

    Attributes:
        connections: channels of ROS 2 messages.
        typestore: their types.
        notes: what is missing of the file, one sentence each.
    """

    def __init__(self, path: Path, contents: Contents, counts: Mapping[int, int], typestore: Typestore) -> None:
        self.typestore = typestore
        self._path = path
        self.connections = [
            Connection(channel.topic, channel.type, counts.get(number, 0), number)
            for number, channel in contents.channels.items()
            if channel.encoding == "cdr" and channel.topic
        ]
        name, channels = path.name, contents.channels
        others = sorted({channels[n].encoding for n in counts if channels[n].encoding not in ("cdr", "")})
        self.notes = []
        if not contents.complete:
            self.notes.append(f"{name}: the recording was not ended; it was read up to its last whole piece.")
        if contents.damaged:
            self.notes.append(f"{name}: {contents.damaged} pieces are damaged; their messages are left out.")
        if others:
            self.notes.append(f"{name}: messages in {', '.join(others)} are not read.")

    @property
    def topics(self) -> dict[str, Connection]:
        """By name."""
        return {connection.topic: connection for connection in self.connections}

    def messages(
        self, connections: Sequence[Connection] = (), start: int = 0, stop: int = _LATEST_NS
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Connection, time of arrival in nanoseconds, and bytes of each message, read from the file anew."""
        wanted = {connection.channel: connection for connection in connections or self.connections}
        with self._path.open("rb") as file:
            for message in read_container(file, Contents()):
                if message.channel in wanted and start <= message.log_ns < stop:
                    yield wanted[message.channel], message.log_ns, message.data

    def deserialize(self, data: bytes, kind: str) -> object:
        """A message decoded."""
        return self.typestore.deserialize_cdr(data, kind)


def plain_mcap(path: Path) -> PlainMcap | None:
    """The reader of a file, or of the one file of a folder; None where it is no MCAP file of ROS 2 messages."""
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    if len(files) != 1 or not files[0].is_file():
        return None
    with files[0].open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            return None
        contents = Contents()
        counts = Counter(message.channel for message in read_container(file, contents))
    types = {}
    for channel in contents.channels.values():
        if channel.language == "ros2msg":
            types.update(get_types_from_msg(channel.definition, channel.type))
        elif channel.language in ("ros2idl", "omgidl"):
            types.update(get_types_from_idl(channel.definition))
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    reader = PlainMcap(files[0], contents, counts, store)
    return reader if any(connection.msgcount for connection in reader.connections) else None
