"""The messages of a ROS 2 bag as tables of numbers: MCAP and sqlite, whole or in part, by the ``rosbags`` library."""

from __future__ import annotations

from array import array
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.errors import BadInput
from groundstation.recording.autopilot import one_line
from groundstation.recording.cdrlayout import MOST_ELEMENTS, UNREAD, Columns
from groundstation.recording.part import WHOLE, Part
from groundstation.recording.plainmcap import plain_mcap
from groundstation.recording.tables import Table, table_of_rows

_DEFINED = {
    "actuator_msgs/msg/Actuators": "std_msgs/Header header\nfloat64[] position\nfloat64[] velocity\nfloat64[] "
    "normalized\n",
    "mav_msgs/msg/Actuators": "std_msgs/Header header\nfloat64[] angles\nfloat64[] angular_velocities\nfloat64[] "
    "normalized\n",
}
"""Messages of motors, for bags that define none: those of sqlite before ROS 2 Iron."""


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """The library's reader on a bag.

    Raises:
        BadInput: the library cannot read it.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in _DEFINED.items():
        store.register(get_types_from_msg(text, name))
    with ExitStack() as stack:
        try:
            try:
                reader = stack.enter_context(AnyReader([path], default_typestore=store))
            except Exception:  # the library has no one error for a file that it does not take
                reader = plain_mcap(path)
                if reader is None:
                    raise
            yield reader
        except (BadInput, MemoryError):
            raise
        except Exception as error:  # nor has it one for a file that is damaged
            raise BadInput(
                f"{path}: is no ROS 2 bag that can be read ({one_line(error)}); repair it with "
                f"`{_remedy(path)}`, or record it again."
            ) from None


def _remedy(path: Path) -> str:
    """What mends a bag whose recording was not ended."""
    single = path.suffix == ".mcap" or (
        path.is_dir() and any(path.glob("*.mcap")) and (path / "metadata.yaml").exists()
    )
    return "mcap recover" if single else "ros2 bag reindex"


def topics_in(reader: Any) -> dict[str, tuple[str, int]]:
    found: dict[str, tuple[str, int]] = {}
    for connection in reader.connections:
        kind, count = found.get(connection.topic, (connection.msgtype, 0))
        found[connection.topic] = (kind, count + connection.msgcount)
    return found


RECEIVED = "_received"


def tables_in(reader: Any, path: Path, topics: Collection[str], part: Part = WHOLE) -> dict[str, Table]:
    """The numbers of these topics in one pass over the bag.

    Args:
        reader: on the bag.
        path: of the bag, for messages.
        topics: that are wanted.
        part: what is wanted of them, by the times at which they were received.
    """
    store = reader.typestore
    start, stop, step = part.ticks(1e9).tolist()
    columns: dict[str, Columns] = {}
    received: dict[str, array[int]] = {topic: array("q") for topic in topics}
    mine = [connection for connection in reader.connections if connection.topic in received]
    for connection in mine:
        _require_definition(store, connection, path)
        columns.setdefault(connection.topic, _columns(reader, connection.msgtype))
    span = {} if part == WHOLE else {"start": max(start, 0), "stop": max(stop, 0)}
    for connection, at_ns, data in reader.messages(connections=mine, **span) if mine else ():
        before = received[connection.topic]
        if not step or not before or abs(at_ns - before[-1]) >= step:
            before.append(at_ns)
            columns[connection.topic].add(data)
    return {topic: _table(topic, received.pop(topic), columns.pop(topic)) for topic in list(columns)}


def _columns(reader: Any, kind: str) -> Columns:
    def flattened(data: bytes) -> dict[str, float]:
        row: dict[str, float] = {}
        _flatten(reader.deserialize(data, kind), "", row)
        return row

    return Columns(lambda name: reader.typestore.get_msgdef(name).fields, kind, flattened)


def _require_definition(store: Any, connection: Any, path: Path) -> None:
    """Raise where the bag has a topic of a type that it does not define."""
    if connection.msgtype not in store.fielddefs:
        raise BadInput(
            f"{path}: does not say what {connection.msgtype} is (topic {connection.topic}): bags of ROS 2 Humble and "
            "before hold no definitions. Convert it where that package is installed: `ros2 bag convert`, to MCAP."
        )


def _table(topic: str, received: array[int], columns: Columns) -> Table:
    values = columns.values(spare=2)  # in their place, since a copy of all is most that a bag takes
    places = {name: i for i, name in enumerate(columns.names or ())}
    places[RECEIVED] = at = len(places)
    values[:, at] = np.frombuffer(received, np.int64) * 1e-9
    if "timestamp" in places:  # px4_msgs
        return table_of_rows(topic, values, places, ("timestamp", 1e6))
    clock = RECEIVED
    if {"header.stamp.sec", "header.stamp.nanosec"} <= places.keys():
        places["_stamp"] = at + 1
        values[:, at + 1] = values[:, places["header.stamp.sec"]] + 1e-9 * values[:, places["header.stamp.nanosec"]]
        clock = "_stamp" if values[:, at + 1].any() else RECEIVED
    return table_of_rows(topic, values, places, (clock, 1.0))


def _flatten(message: Any, prefix: str, out: dict[str, float]) -> None:
    """Numbers of a message under their paths, as :mod:`~groundstation.recording.cdrlayout` names them."""
    for name in message.__dataclass_fields__:
        if name.startswith("__") or UNREAD in name:
            continue
        value = getattr(message, name)
        if isinstance(value, (bool, int, float, np.number)):
            out[prefix + name] = float(value)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.size <= MOST_ELEMENTS:
            out |= {f"{prefix}{name}[{i}]": float(v) for i, v in enumerate(value.reshape(-1))}
        elif hasattr(value, "__dataclass_fields__"):
            _flatten(value, f"{prefix}{name}.", out)
        elif isinstance(value, (list, tuple)) and len(value) <= MOST_ELEMENTS:
            for i, item in enumerate(value):
                if hasattr(item, "__dataclass_fields__"):
                    _flatten(item, f"{prefix}{name}[{i}].", out)


def as_received(reader: Any, path: Path, motors: str, part: Part) -> Part:
    """A part of the motors' clock by the times at which messages were received."""
    if not np.isfinite([part.start_s, part.end_s]).any():
        return part
    for connection, at_ns, data in reader.messages(connections=[c for c in reader.connections if c.topic == motors]):
        columns = _columns(reader, connection.msgtype)
        columns.add(data)
        ahead_s = at_ns * 1e-9 - float(_table(motors, array("q", [at_ns]), columns).seconds()[0])
        return Part(part.start_s + ahead_s, part.end_s + ahead_s, part.step_s)
    return part


def last_message(reader: Any, topic: str) -> Any:
    """The last message of a topic, decoded; None where it has none."""
    last = None
    for connection, _, data in reader.messages(connections=[c for c in reader.connections if c.topic == topic]):
        last = connection.msgtype, data
    return None if last is None else reader.deserialize(last[1], last[0])
