"""Recordings as MCAP files: whole ones written at once, and any read back, finished or cut off."""

from __future__ import annotations

import heapq
import json
import os
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from drivers.samples import Battery, Event, Imu, Motors, Pose, Raw, Setpoint, State
from groundstation.errors import BadInput
from groundstation.flightdata import Array, FlightData, Stream, motor_columns
from groundstation.outside import parse_json, read_bytes
from groundstation.recording import cdr
from groundstation.recording.container import Contents, ReadChannel, read_container
from groundstation.recording.recorded import (
    COLUMNS,
    LOG_COLUMNS,
    MOTOR_KINDS,
    Recording,
    Texts,
    motor_kind,
    recording_of,
)
from groundstation.recording.recorder import METADATA, SCHEMA, McapRecorder
from groundstation.recording.schemas import EXACT_TYPE, ROW_TYPE, STREAM_OF_TYPE, TOPICS
from groundstation.texts import shown

_OWN_KEYS = ("schema", "groundstation", "flight", "window_start_s", "window_end_s", "notes")
_EXTRA = "/extra/"


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


def _times(part: Stream | Texts) -> tuple[list[float], list[float], list[float]]:
    """Sort keys, device times and arrival times (NaN where not known)."""
    received = part.received_s if part.received_s is not None else np.full(len(part), np.nan)
    key = np.where(np.isfinite(received), received, part.t_s)
    return np.fmax.accumulate(np.nan_to_num(key)).tolist(), part.t_s.tolist(), received.tolist()


def _samples(recorder: McapRecorder, stream: Stream, name: str) -> Iterator[_Write]:
    kind = motor_kind(stream.columns)
    for key, device_s, host_s, v in zip(*_times(stream), stream.values.tolist(), strict=True):
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
    values = numbers.values.tolist() if numbers is not None else [()] * len(base)
    words = texts.rows if texts is not None else ((),) * len(base)
    channel = recorder.row_channel(
        f"{_EXTRA}{name}", numbers.columns if numbers is not None else (), texts.columns if texts is not None else ()
    )
    for key, device_s, host_s, v, w in zip(*_times(base), values, words, strict=True):
        yield key, lambda d=device_s, h=host_s, v=v, w=w: recorder.add_row(channel, d, h, v, w)


def _log(recorder: McapRecorder, log: Texts, name: str) -> Iterator[_Write]:
    for key, device_s, host_s, row in zip(*_times(log), log.rows, strict=True):
        if name == "events":
            yield key, lambda d=device_s, h=host_s, r=row: recorder.add(Event(d, r[0], r[1]), h)
        elif name == "raw":
            frame = Raw(device_s, "out" if row[0] == "out" else "in", bytes.fromhex(row[1]))
            yield key, lambda frame=frame, h=host_s: recorder.add(frame, h)
        else:
            yield key, lambda d=device_s, h=host_s, r=row: recorder.add_status(d, h, r[0], r[1] == "1", r[2])


class ForeignMcap(BadInput):
    """An MCAP file, but no recording of this program: perhaps a ROS 2 bag."""


def read_mcap(path: Path) -> Recording:
    """Read a recording up to its end or to where it was cut off; a note says where that was.

    Raises:
        BadInput: it is no recording of this program.
    """
    try:
        contents = read_container(read_bytes(path, "a recorded flight"))
    except ValueError as error:
        raise BadInput(f"{path}: is no MCAP recording ({error}); give the path of a recorded flight.") from None
    about = contents.metadata.get(METADATA)
    if about is None:
        raise ForeignMcap(f"{path}: is an MCAP file of another program.")
    if about.get("schema") != SCHEMA:
        raise BadInput(f"{path}: has schema {about.get('schema')}; this version reads {SCHEMA}. Update groundstation.")
    try:
        return _recording(contents, about, path)
    except (ValueError, LookupError, TypeError, ArithmeticError, MemoryError, struct.error) as error:
        raise BadInput(f"{path}: is damaged ({shown(error, limit=200)}); nothing can be read from it.") from None


def _recording(contents: Contents, about: dict[str, str], path: Path) -> Recording:
    exact = {c.topic.removesuffix("/exact"): _exact(c) for c in contents.channels.values() if c.type == EXACT_TYPE}
    streams: dict[str, Stream] = {}
    extras: dict[str, Stream] = {}
    texts: dict[str, Texts] = {}
    for channel in contents.channels.values():
        if not channel.payload:
            continue
        stream = STREAM_OF_TYPE.get(channel.type)
        if channel.type == ROW_TYPE:
            numbers, words = _read_rows(channel)
            name = channel.topic.removeprefix(_EXTRA)
            if numbers is not None:
                extras[name] = numbers
            if words is not None:
                texts[name] = words
        elif stream in LOG_COLUMNS:
            name = stream if channel.topic == TOPICS[stream].name else channel.topic.strip("/")
            texts[name] = _read_log(channel, stream)
        elif stream is not None:
            samples = _read_samples(channel, stream, exact.get(channel.topic, {}), path)
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
        notes=(*_strings(about.get("notes", "[]"), "notes"), *losses),
        left_out=losses,
    )


def _strings(text: str, what: str) -> tuple[str, ...]:
    """A JSON list of texts, as metadata hold it.

    Raises:
        ValueError: it is something else.
    """
    value = parse_json(text, what)
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise ValueError(f"{what} is no list of texts")
    return tuple(value)


def _losses(contents: Contents, path: Path) -> tuple[str, ...]:
    notes = []
    if not contents.complete:
        last = max((channel.log_ns[-1] for channel in contents.channels.values() if channel.log_ns), default=0)
        notes.append(f"{path.name}: the recording was cut off; read up to {last / 1e9:.3f} s of host time.")
    if contents.damaged:
        notes.append(f"{path.name}: {contents.damaged} pieces are damaged; their samples are left out.")
    return tuple(notes)


def _exact(channel: ReadChannel) -> dict[int, tuple[float, ...]]:
    """By sequence number of the standard message: device time, arrival time, values."""
    out = {}
    for sequence, payload in zip(channel.sequence, channel.payload, strict=True):
        decoder = cdr.Decoder(payload, 20)
        out[sequence] = (*cdr.own_times(payload, 4), *decoder.doubles())
    return out


def _stacked(channel: ReadChannel, record: np.dtype, path: Path) -> np.ndarray:
    if any(len(payload) != record.itemsize for payload in channel.payload):
        raise BadInput(f"{path}: topic {channel.topic} has messages of different layouts; the file is not ours.")
    return np.frombuffer(b"".join(channel.payload), dtype=record)


def _reorder(xyzw: Array) -> Array:
    return xyzw[:, [3, 0, 1, 2]]


def _read_samples(channel: ReadChannel, stream: str, exact: dict[int, tuple[float, ...]], path: Path) -> Stream:
    if stream == "motors":
        count = (len(channel.payload[0]) - 48) // 8
        records = _stacked(channel, cdr.motors_record(count), path)
        values, columns = records["values"], motor_columns(MOTOR_KINDS[int(records["kind"][0])], count)
        return _own_stream(records, values, columns)
    if stream == "setpoint":
        records = _stacked(channel, cdr.SETPOINT_RECORD, path)
        return _own_stream(records, records["values"], COLUMNS[stream])
    if stream == "state":
        records = _stacked(channel, cdr.STATE_RECORD, path)
        values = [records["position"], records["velocity"], _reorder(records["xyzw"]), records["rate"]]
        return _own_stream(records, np.hstack(values), COLUMNS[stream])
    if stream == "imu":
        records = _stacked(channel, cdr.IMU_RECORD, path)
        values = np.hstack([records["gyro"], records["accel"]])
    elif stream == "mocap":
        records = _stacked(channel, cdr.POSE_RECORD, path)
        values = np.hstack([records["position"], _reorder(records["xyzw"])])
    else:
        records = _stacked(channel, cdr.BATTERY_RECORD, path)
        values = np.column_stack([records["voltage"], -records["current"]]).astype(float)
    t_s = cdr.seconds_of_ns(cdr.record_stamp_ns(records))
    received = cdr.seconds_of_ns(np.asarray(channel.log_ns, dtype=np.int64))
    for index, sequence in enumerate(channel.sequence):
        kept = exact.get(sequence)
        if kept is not None:
            t_s[index], received[index] = kept[:2]
            if len(kept) > 2:
                values[index] = kept[2:]
    return Stream(t_s, values, COLUMNS[stream], _known(received))


def _own_stream(records: np.ndarray, values: Array, columns: tuple[str, ...]) -> Stream:
    return Stream(records["device_s"].copy(), np.ascontiguousarray(values), columns, _known(records["received_s"]))


def _known(received: Array) -> Array | None:
    return None if np.isnan(received).all() else np.array(received)


def _times_of(channel: ReadChannel) -> tuple[Array, Array | None]:
    times = np.array([cdr.own_times(payload) for payload in channel.payload])
    return times[:, 0].copy(), _known(times[:, 1])


def _read_rows(channel: ReadChannel) -> tuple[Stream | None, Texts | None]:
    numbers, words = (_strings(channel.metadata.get(key, "[]"), channel.topic) for key in ("numbers", "texts"))
    values, rows = [], []
    for payload in channel.payload:
        decoder = cdr.Decoder(payload)
        values.append(decoder.doubles())
        rows.append(tuple(decoder.text() for _ in range(decoder.count())))
    t_s, received = _times_of(channel)
    stream = Stream(t_s, np.array(values, dtype=float), numbers, received) if numbers else None
    return stream, Texts(t_s, tuple(rows), words, received) if words else None


def _read_log(channel: ReadChannel, name: str) -> Texts:
    rows = []
    for payload in channel.payload:
        decoder = cdr.Decoder(payload)
        if name == "events":
            rows.append((decoder.text(), decoder.text()))
        elif name == "raw":
            rows.append(("out" if decoder.byte() else "in", decoder.blob().hex()))
        else:
            rows.append((decoder.text(), str(decoder.byte()), decoder.text()))
    t_s, received = _times_of(channel)
    return Texts(t_s, tuple(rows), LOG_COLUMNS[name], received)
