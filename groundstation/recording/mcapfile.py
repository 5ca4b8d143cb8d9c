"""Recordings as MCAP files: whole ones written at once, and any read back, finished or cut off."""

from __future__ import annotations

import heapq
import json
import os
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from drivers.samples import Battery, Event, Imu, Motors, Pose, Raw, Setpoint, State
from groundstation.errors import BadInput
from groundstation.flightdata import Array, FlightData, Stream
from groundstation.outside import require_file
from groundstation.recording.container import Contents, ReadChannel, Unmeasured, read_metadata
from groundstation.recording.mcapchannels import Block, Gathered, gathered, row_columns, strings, with_exact
from groundstation.recording.part import WHOLE, Part
from groundstation.recording.recorded import LOG_COLUMNS, Recording, Texts, motor_kind, recording_of
from groundstation.recording.recorder import METADATA, SCHEMA, McapRecorder
from groundstation.recording.schemas import EXACT_TYPE, ROW_TYPE, STREAM_OF_TYPE, TOPICS
from groundstation.texts import shown

_OWN_KEYS = ("schema", "groundstation", "flight", "window_start_s", "window_end_s", "notes")
_EXTRA = "/extra/"
_BLOCK = 4096
"""Samples that are written from Python's own numbers at a time; these take four times as much as an array."""


def write_mcap(flight: FlightData, path: str | Path) -> Path:
    """Write a flight as a finished recording; returns the path.

    Raises:
        BadInput: the file exists already or cannot be written.
    """
    return write_recording_as_mcap(recording_of(flight), Path(path))


def write_recording_as_mcap(recording: Recording, path: Path) -> Path:
    """Write a recording in order of arrival (device time where that is not known): the whole of it, or nothing.

    Raises:
        BadInput: the file exists already or cannot be written.
    """
    if path.exists():
        raise BadInput(f"{path}: exists already; a recording is never written over. Name another file.")
    beside = path.with_name(f".{path.name}.{os.getpid()}.new")
    try:
        _write(recording, beside)
        beside.rename(path)
    except OSError as error:
        raise BadInput(f"{path}: cannot be written ({error.strerror}); name a file on a disk with room.") from None
    finally:
        beside.unlink(missing_ok=True)
    return path


def _write(recording: Recording, path: Path) -> None:
    about = {**recording.metadata, "flight": recording.name}
    if recording.window_s is not None:
        about |= {"window_start_s": repr(recording.window_s[0]), "window_end_s": repr(recording.window_s[1])}
    if recording.notes:
        about["notes"] = json.dumps(recording.notes)
    with McapRecorder(path, about, recording.files) as recorder:
        # Keys are made non-decreasing: order within a stream is the recording's own, whatever its stamps say.
        sources = [_samples(recorder, recording.streams[name], name) for name in recording.streams]
        sources += [_rows(recorder, recording, name) for name in {**recording.extras, **_side_texts(recording)}]
        sources += [_log(recorder, recording.texts[name], name) for name in LOG_COLUMNS if name in recording.texts]
        for _, write in heapq.merge(*sources, key=lambda item: item[0]):
            write()
    if recorder.failure is not None:
        raise BadInput(recorder.failure)


_Write = tuple[float, Callable[[], None]]


def _side_texts(recording: Recording) -> dict[str, Texts]:
    return {name: texts for name, texts in recording.texts.items() if name not in LOG_COLUMNS}


def _blocks(part: Stream | Texts) -> Iterator[tuple[slice, list[float], list[float], list[float]]]:
    """Block by block: its rows, sort keys, device times and arrival times (NaN where not known)."""
    received = part.received_s if part.received_s is not None else np.full(len(part), np.nan)
    key = np.fmax.accumulate(np.nan_to_num(np.where(np.isfinite(received), received, part.t_s)))
    for first in range(0, len(part), _BLOCK):
        rows = slice(first, first + _BLOCK)
        yield rows, key[rows].tolist(), part.t_s[rows].tolist(), received[rows].tolist()


def _samples(recorder: McapRecorder, stream: Stream, name: str) -> Iterator[_Write]:
    kind = motor_kind(stream.columns)
    for rows, keys, device, host in _blocks(stream):
        for key, device_s, host_s, v in zip(keys, device, host, stream.values[rows].tolist(), strict=True):
            if name == "imu":
                sample = Imu(device_s, tuple(v[:3]), tuple(v[3:]))
            elif name == "mocap":
                sample = Pose(device_s, tuple(v[:3]), tuple(v[3:]))
            elif name == "motors":
                sample = Motors(device_s, tuple(v), kind)
            elif name == "battery":
                sample = Battery(device_s, v[0], v[1])
            elif name == "setpoint":
                sample = Setpoint(device_s, tuple(v[:3]), v[3])
            else:
                sample = State(device_s, tuple(v[:3]), tuple(v[3:6]), tuple(v[6:10]), tuple(v[10:]))
            yield key, lambda sample=sample, host_s=host_s: recorder.add(sample, host_s)


def _rows(recorder: McapRecorder, recording: Recording, name: str) -> Iterator[_Write]:
    numbers, texts = recording.extras.get(name), _side_texts(recording).get(name)
    base = numbers if numbers is not None else texts
    if base is None:
        return
    channel = recorder.row_channel(
        f"{_EXTRA}{name}", numbers.columns if numbers is not None else (), texts.columns if texts is not None else ()
    )
    for rows, keys, device, host in _blocks(base):
        values = numbers.values[rows].tolist() if numbers is not None else [()] * len(keys)
        words = texts.rows[rows] if texts is not None else ((),) * len(keys)
        for key, device_s, host_s, v, w in zip(keys, device, host, values, words, strict=True):
            yield key, lambda d=device_s, h=host_s, v=v, w=w: recorder.add_row(channel, d, h, v, w)


def _log(recorder: McapRecorder, log: Texts, name: str) -> Iterator[_Write]:
    for rows, keys, device, host in _blocks(log):
        for key, device_s, host_s, row in zip(keys, device, host, log.rows[rows], strict=True):
            if name == "events":
                yield key, lambda d=device_s, h=host_s, r=row: recorder.add(Event(d, r[0], r[1]), h)
            elif name == "raw":
                frame = Raw(device_s, "out" if row[0] == "out" else "in", bytes.fromhex(row[1]))
                yield key, lambda frame=frame, h=host_s: recorder.add(frame, h)
            else:
                yield key, lambda d=device_s, h=host_s, r=row: recorder.add_status(d, h, r[0], r[1] == "1", r[2])


class ForeignMcap(BadInput):
    """An MCAP file, but no recording of this program: perhaps a ROS 2 bag."""


def read_mcap(path: Path, part: Part = WHOLE) -> Recording:
    """Read a recording up to its end or to where it was cut off; a note says where that was.

    Args:
        path: of the file.
        part: what is wanted of its streams, on the motors' clock.

    Raises:
        BadInput: it is no recording of this program.
    """
    require_file(path, "a recorded flight")
    try:
        with path.open("rb") as file:
            about = read_metadata(file).get(METADATA)
            if about is None:
                raise ForeignMcap(f"{path}: is an MCAP file of another program.")
            if about.get("schema") != SCHEMA:
                raise BadInput(
                    f"{path}: has schema {about.get('schema')}; this version reads {SCHEMA}. Update groundstation."
                )
            contents, found = _gathered(file, part, path)
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror}); give the path of a recorded flight.") from None
    except ValueError as error:
        raise BadInput(f"{path}: is no MCAP recording ({error}); give the path of a recorded flight.") from None
    try:
        return _recording(contents, found, about, path)
    except _FAULTS as error:
        raise BadInput(_damaged(path, error)) from None


_FAULTS = (ValueError, LookupError, TypeError, ArithmeticError, MemoryError, struct.error)


def _damaged(path: Path, error: BaseException) -> str:
    return f"{path}: is damaged ({shown(error, limit=200)}); nothing can be read from it."


def _gathered(file: BinaryIO, part: Part, path: Path) -> tuple[Contents, dict[int, Gathered]]:
    try:
        return gathered(file, part)
    except Unmeasured:
        raise
    except _FAULTS as error:
        raise BadInput(_damaged(path, error)) from None


def _recording(contents: Contents, found: dict[int, Gathered], about: dict[str, str], path: Path) -> Recording:
    exact = {
        channel.topic.removesuffix("/exact"): found[number]
        for number, channel in contents.channels.items()
        if channel.type == EXACT_TYPE and number in found
    }
    streams: dict[str, Stream] = {}
    extras: dict[str, Stream] = {}
    texts: dict[str, Texts] = {}
    for number, channel in contents.channels.items():
        if number not in found:
            continue
        stream = STREAM_OF_TYPE.get(channel.type)
        if channel.type == ROW_TYPE:
            name = channel.topic.removeprefix(_EXTRA)
            _add_rows(name, channel, found[number].joined(), extras, texts)
        elif stream in LOG_COLUMNS:
            name = stream if channel.topic == TOPICS[stream].name else channel.topic.strip("/")
            log = found[number].joined()
            texts[name] = Texts(log.t_s, tuple(log.words), LOG_COLUMNS[stream], _known(log.received_s))
        elif stream is not None:
            samples = _samples_of(found[number], exact.get(channel.topic))
            if channel.topic == TOPICS[stream].name:
                streams[stream] = samples
            else:
                extras[channel.topic.strip("/")] = samples
    losses = _losses(contents, path)
    window = (about.get("window_start_s"), about.get("window_end_s"))
    return Recording(
        name=about.get("flight", path.parent.name if path.stem == "flight" else path.stem),
        streams=streams,
        extras=extras,
        texts=texts,
        files=contents.attachments,
        metadata={key: value for key, value in about.items() if key not in _OWN_KEYS},
        window_s=None if None in window else (float(window[0] or 0), float(window[1] or 0)),
        notes=(*strings(about.get("notes", "[]"), "notes"), *losses),
        left_out=losses,
    )


def _add_rows(name: str, channel: ReadChannel, rows: Block, extras: dict[str, Stream], texts: dict[str, Texts]) -> None:
    numbers, words = row_columns(channel)
    received = _known(rows.received_s)
    if numbers:
        extras[name] = Stream(rows.t_s, rows.values, numbers, received)
    if words:
        texts[name] = Texts(rows.t_s, tuple(rows.words), words, received)


def _samples_of(kept: Gathered, companions: Gathered | None) -> Stream:
    samples = kept.joined()
    if companions is not None:
        samples = with_exact(samples, kept.sequence, companions.joined(), companions.sequence)
    return Stream(samples.t_s, samples.values, samples.columns, _known(samples.received_s))


def _losses(contents: Contents, path: Path) -> tuple[str, ...]:
    notes = []
    if not contents.complete:
        last_s = contents.last_ns / 1e9
        notes.append(f"{path.name}: the recording was cut off; read up to {last_s:.3f} s of host time.")
    if contents.damaged:
        notes.append(f"{path.name}: {contents.damaged} pieces are damaged; their samples are left out.")
    return tuple(notes)


def _known(received: Array | None) -> Array | None:
    return None if received is None or np.isnan(received).all() else received
