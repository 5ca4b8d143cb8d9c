"""The messages of a recording's channels as columns: decoded block by block as they are read, so that no message is
kept as it lay in the file.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np

from groundstation.flightdata import Array, motor_columns
from groundstation.outside import parse_json
from groundstation.recording import cdr
from groundstation.recording.container import Contents, Message, ReadChannel, read_container
from groundstation.recording.part import WHOLE, Part
from groundstation.recording.recorded import COLUMNS, LOG_COLUMNS, MOTOR_KINDS
from groundstation.recording.schemas import EXACT_TYPE, ROW_TYPE, STREAM_OF_TYPE, TOPICS

_BLOCK = 2048
_Words = list[tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class Block:
    """Some messages of a channel.

    Attributes:
        t_s: device times, shape (k,).
        received_s: arrivals, shape (k,); None of standard messages, whose log time it is.
        values: shape (k, c).
        words: texts of each, or none.
        columns: names of the values, where the messages tell them.
    """

    t_s: Array
    received_s: Array | None
    values: Array
    words: _Words = field(default_factory=list)
    columns: tuple[str, ...] = ()


@dataclass(slots=True)
class Gathered:
    """What is kept of a channel's messages: numbers and log times of all, and their contents in blocks."""

    sequence: array[int] = field(default_factory=lambda: array("I"))
    log_ns: array[int] = field(default_factory=lambda: array("q"))
    blocks: list[Block] = field(default_factory=list)
    _waiting: list[bytes] = field(default_factory=list)
    _last_ns: int = -(2**62)

    def add(self, message: Message, channel: ReadChannel, step_ns: int) -> None:
        """A message, unless it is closer than a step to the last one that was kept; texts are kept all.

        A companion that is left out costs its message what that one had to round: a nanosecond.
        """
        if step_ns and channel.type not in _KEPT and abs(message.log_ns - self._last_ns) < step_ns:
            return
        self._last_ns = message.log_ns
        self.sequence.append(message.sequence)
        self.log_ns.append(message.log_ns)
        self._waiting.append(message.data)
        if len(self._waiting) >= _BLOCK and channel.type:
            self.settle(channel)

    def settle(self, channel: ReadChannel) -> None:
        """Decode what waits."""
        waiting, self._waiting = self._waiting, []
        if waiting:
            self.blocks.append(_decoded(channel, waiting))

    def joined(self) -> Block:
        """All blocks as one; they are given up.

        Raises:
            ValueError: they are of different layouts.
        """
        blocks, self.blocks = self.blocks, []
        if any(block.columns != blocks[0].columns for block in blocks):
            raise ValueError("a topic has messages of different layouts")
        received = [block.received_s for block in blocks if block.received_s is not None]
        t_s = np.concatenate([block.t_s for block in blocks])
        values = np.concatenate([block.values for block in blocks])
        words = [row for block in blocks for row in block.words]
        arrival = np.concatenate(received) if received else cdr.seconds_of_ns(np.frombuffer(self.log_ns, np.int64))
        return Block(t_s, arrival, values, words, blocks[0].columns)


_KEPT = {TOPICS[name].type for name in LOG_COLUMNS}
"""Types of messages that are kept however close they lie."""


def gathered(file: BinaryIO, part: Part = WHOLE) -> tuple[Contents, dict[int, Gathered]]:
    """What a recording holds, and its channels' messages by their ids.

    Args:
        file: the recording.
        part: the messages that are wanted, by the motors' clock. Of events and status all are; of a link's raw frames
            none, unless everything is.

    Raises:
        ValueError: it is no MCAP file, or a message is not what its type says.
    """
    start, stop, step = _as_logged(file, part).ticks(1e9).tolist()
    contents, found = Contents(), dict[int, Gathered]()
    for message in read_container(file, contents):
        channel = contents.channels[message.channel]
        if part != WHOLE and channel.type == TOPICS["raw"].type:
            continue
        if start <= message.log_ns <= stop or channel.type in _TOLD:
            kept = found.get(message.channel)
            if kept is None:
                kept = found[message.channel] = Gathered()
            kept.add(message, channel, step)
    for number, kept in found.items():
        kept.settle(contents.channels[number])
    return contents, {number: kept for number, kept in found.items() if kept.blocks}


_TOLD = {TOPICS[name].type for name in ("events", "status")}
"""Types of messages that tell of the flight as a whole."""


def _as_logged(file: BinaryIO, part: Part) -> Part:
    """A part of the motors' clock by the times at which messages were logged."""
    if not np.isfinite([part.start_s, part.end_s]).any():
        return part
    contents = Contents()
    for message in read_container(file, contents):
        channel = contents.channels[message.channel]
        if (channel.topic, channel.type) == (TOPICS["motors"].name, TOPICS["motors"].type):
            return part.later(message.log_ns * 1e-9 - cdr.own_times(message.data)[0])
    return part


def _decoded(channel: ReadChannel, payloads: list[bytes]) -> Block:
    stream = STREAM_OF_TYPE.get(channel.type, "")
    if channel.type == EXACT_TYPE:
        return _exact(channel, payloads)
    if channel.type == ROW_TYPE:
        return _rows(payloads)
    if stream in LOG_COLUMNS:
        return _log(payloads, stream)
    if stream == "motors":
        return _motors(channel, payloads)
    if stream in _OWN:
        record, values_of = _OWN[stream]
        records = _stacked(channel, payloads, record)
        values = np.ascontiguousarray(values_of(records))
        return Block(records["device_s"].copy(), records["received_s"].copy(), values, columns=COLUMNS[stream])
    if stream in _STANDARD:
        record, values_of = _STANDARD[stream]
        records = _stacked(channel, payloads, record)
        values = values_of(records)
        return Block(cdr.seconds_of_ns(cdr.record_stamp_ns(records)), None, values, columns=COLUMNS[stream])
    return Block(np.empty(0), np.empty(0), np.empty((0, 0)))


def _stacked(channel: ReadChannel, payloads: list[bytes], record: np.dtype) -> np.ndarray:
    if any(len(payload) != record.itemsize for payload in payloads):
        raise ValueError(f"topic {channel.topic} has messages of different layouts")
    return np.frombuffer(b"".join(payloads), dtype=record)


def _motors(channel: ReadChannel, payloads: list[bytes]) -> Block:
    count = (len(payloads[0]) - 48) // 8
    records = _stacked(channel, payloads, cdr.motors_record(count))
    columns = motor_columns(MOTOR_KINDS[int(records["kind"][0])], count)
    return Block(records["device_s"].copy(), records["received_s"].copy(), records["values"].copy(), columns=columns)


def _reorder(xyzw: Array) -> Array:
    return xyzw[:, [3, 0, 1, 2]]


_ValuesOf = Callable[[np.ndarray], Array]
_OWN: Mapping[str, tuple[np.dtype, _ValuesOf]] = {
    "setpoint": (cdr.SETPOINT_RECORD, lambda r: r["values"].copy()),
    "state": (
        cdr.STATE_RECORD,
        lambda r: np.hstack([r["position"], r["velocity"], _reorder(r["xyzw"]), r["rate"]]),
    ),
}
_STANDARD: Mapping[str, tuple[np.dtype, _ValuesOf]] = {
    "imu": (cdr.IMU_RECORD, lambda r: np.hstack([r["gyro"], r["accel"]])),
    "mocap": (cdr.POSE_RECORD, lambda r: np.hstack([r["position"], _reorder(r["xyzw"])])),
    "battery": (cdr.BATTERY_RECORD, lambda r: np.column_stack([r["voltage"], -r["current"]]).astype(float)),
}
"""By stream: the record that its messages are, and the values in it."""


def _exact(channel: ReadChannel, payloads: list[bytes]) -> Block:
    count = max((len(payloads[0]) - 28) // 8, 0)
    more = [("_pad", "V4"), ("values", "<f8", (count,))] if count else []
    records = _stacked(channel, payloads, np.dtype([("_e", "V4"), ("times", "<f8", 2), ("count", "<u4"), *more]))
    values = records["values"].copy() if count else np.empty((len(records), 0))
    return Block(records["times"][:, 0].copy(), records["times"][:, 1].copy(), values)


def with_exact(samples: Block, numbers: Sequence[int], exact: Block, companions: Sequence[int]) -> Block:
    """Samples with what their messages had to round, from the companions of the same numbers.

    Raises:
        ValueError: the companions have values of another width.
    """
    assert samples.received_s is not None and exact.received_s is not None  # noqa: S101 - joined blocks
    theirs = np.asarray(companions)
    order = np.argsort(theirs, kind="stable")
    place = np.searchsorted(theirs[order], numbers, side="right") - 1
    rows = order[np.maximum(place, 0)]
    hit = (place >= 0) & (theirs[rows] == np.asarray(numbers))
    t_s, received, values = samples.t_s, samples.received_s, samples.values
    t_s[hit], received[hit] = exact.t_s[rows[hit]], exact.received_s[rows[hit]]
    if exact.values.shape[1]:
        values[hit] = exact.values[rows[hit]]
    return samples


def _own_times(payloads: list[bytes]) -> tuple[Array, Array]:
    times = np.array([cdr.own_times(payload) for payload in payloads])
    return times[:, 0].copy(), times[:, 1].copy()


def _rows(payloads: list[bytes]) -> Block:
    values: list[tuple[float, ...]] = []
    words: _Words = []
    for payload in payloads:
        decoder = cdr.Decoder(payload)
        values.append(decoder.doubles())
        words.append(tuple(decoder.text() for _ in range(decoder.count())))
    return Block(*_own_times(payloads), np.array(values, dtype=float).reshape(len(payloads), -1), words)


def row_columns(channel: ReadChannel) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of a channel of rows: of its numbers, and of its texts.

    Raises:
        ValueError: its metadata are something else.
    """
    numbers, texts = (strings(channel.metadata.get(key, "[]"), channel.topic) for key in ("numbers", "texts"))
    return numbers, texts


def strings(text: str, what: str) -> tuple[str, ...]:
    """A JSON list of texts, as metadata hold it.

    Raises:
        ValueError: it is something else.
    """
    value = parse_json(text, what)
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise ValueError(f"{what} is no list of texts")
    return tuple(value)


def _log(payloads: list[bytes], name: str) -> Block:
    words: _Words = []
    for payload in payloads:
        decoder = cdr.Decoder(payload)
        if name == "events":
            words.append((decoder.text(), decoder.text()))
        elif name == "raw":
            words.append(("out" if decoder.byte() else "in", decoder.blob().hex()))
        else:
            words.append((decoder.text(), str(decoder.byte()), decoder.text()))
    return Block(*_own_times(payloads), np.empty((len(payloads), 0)), words)
