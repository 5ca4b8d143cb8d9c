"""The MCAP container: records to a file in small chunks, and back from a file that may have been cut off anywhere.

The public library's writer offers no way to close a chunk by time, and its reader stops with an error where a file was
cut; both matter for a recorder that must survive a crash on a slow link. The records themselves are the library's.
Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from typing import BinaryIO, NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from numpy.typing import NDArray

MAGIC = b"\x89MCAP0\r\n"
CHUNK_BYTES = 64 * 1024
_EXPANDED_FREE = 64 * 1024 * 1024
_EXPANDED_RATIO = 24
"""A file may expand to 64 MiB and 24 times its size: recorded flights compress two- to fivefold, a drone at rest
tenfold.
"""
_LATEST_NS = 2**63
_MESSAGE = struct.Struct("<BQHIQQ")
_RECORD = struct.Struct("<BQ")


def _with_index(
    chunk: bytes, indexed: Mapping[int, list[tuple[int, int]]], offset: int
) -> tuple[list[bytes], dict[int, int]]:
    """A chunk that begins at an offset, followed by the index of each channel; and where those begin."""
    parts, offsets, where = [chunk], dict[int, int](), offset + len(chunk)
    for channel, entries in indexed.items():
        offsets[channel] = where
        parts.append(_bytes(records.MessageIndex(channel, entries)))
        where += len(parts[-1])
    return parts, offsets


class ContainerWriter:
    """Writes one MCAP file; every chunk is on its way to the disk when it is complete.

    Args:
        file: an unbuffered binary file.
        profile: MCAP profile; "ros2" for CDR messages with ``ros2msg`` schemas.
        library: what wrote the file.
    """

    def __init__(self, file: BinaryIO, profile: str, library: str, *, compress: bool = True) -> None:
        self._file = file
        self._offset = 0
        self._compress: Callable[[bytes], bytes] | None = (
            zstandard.ZstdCompressor(level=1).compress if compress else None
        )
        self._chunk = bytearray()
        self._chunk_span = (2**64 - 1, 0)
        self._index: dict[int, list[tuple[int, int]]] = {}
        self._schemas: dict[str, records.Schema] = {}
        self._channels: dict[int, records.Channel] = {}
        self._counts: dict[int, int] = {}
        self._span = (2**64 - 1, 0)
        self._chunks: list[records.ChunkIndex] = []
        self._attachments: list[records.AttachmentIndex] = []
        self._metadata: list[records.MetadataIndex] = []
        self._put(MAGIC + _bytes(records.Header(profile, library)))

    def _put(self, data: bytes) -> int:
        """Write all of ``data``; return where it begins."""
        view = memoryview(data)
        begin = self._offset
        while view:
            written = self._file.write(view)
            self._offset += written
            view = view[written:]
        return begin

    def channel(self, topic: str, type_name: str, definition: str, metadata: Mapping[str, str] | None = None) -> int:
        """Register a channel of CDR messages; returns its id."""
        if type_name not in self._schemas:
            schema = records.Schema(
                id=len(self._schemas) + 1, name=type_name, encoding="ros2msg", data=definition.encode()
            )
            self._schemas[type_name] = schema
            self._chunk += _bytes(schema)
        channel = records.Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding="cdr",
            metadata=dict(metadata or {}),
            schema_id=self._schemas[type_name].id,
        )
        self._channels[channel.id] = channel
        self._counts[channel.id] = 0
        self._index[channel.id] = []
        self._chunk += _bytes(channel)
        return channel.id

    def message(self, channel: int, log_ns: int, publish_ns: int, data: bytes, sequence: int | None = None) -> None:
        """Append a message; unless given, its sequence number counts from 0 in its channel."""
        count = self._counts[channel]
        self._counts[channel] = count + 1
        sequence = count if sequence is None else sequence
        self._index[channel].append((log_ns, len(self._chunk)))
        low, high = self._chunk_span
        self._chunk_span = (log_ns if log_ns < low else low, log_ns if log_ns > high else high)
        self._chunk += _MESSAGE.pack(5, 22 + len(data), channel, sequence, log_ns, publish_ns) + data
        if len(self._chunk) >= CHUNK_BYTES:
            self.flush()

    def count(self, channel: int) -> int:
        """Messages written to a channel: the sequence number that its next one will have."""
        return self._counts[channel]

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment at once."""
        self.flush()
        record = records.Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data)
        body = _bytes(record)
        begin = self._put(body)
        self._attachments.append(
            records.AttachmentIndex(
                offset=begin,
                length=len(body),
                log_time=0,
                create_time=0,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record at once. Of records with one name the last holds."""
        self.flush()
        body = _bytes(records.Metadata(name=name, metadata=dict(values)))
        self._metadata.append(records.MetadataIndex(offset=self._put(body), length=len(body), name=name))

    def flush(self) -> None:
        """Close the current chunk and hand it to the operating system."""
        if not self._chunk:
            return
        raw = bytes(self._chunk)
        indexed = {channel: entries for channel, entries in self._index.items() if entries}
        start, end = self._chunk_span if indexed else (0, 0)
        chunk = records.Chunk(
            compression="zstd" if self._compress else "",
            data=self._compress(raw) if self._compress else raw,
            message_start_time=start,
            message_end_time=end,
            uncompressed_crc=zlib.crc32(raw),
            uncompressed_size=len(raw),
        )
        parts, offsets = _with_index(_bytes(chunk), indexed, self._offset)
        begin = self._offset
        self._chunk.clear()
        self._chunk_span = (2**64 - 1, 0)
        for channel in indexed:
            self._index[channel] = []
        self._put(b"".join(parts))
        self._chunks.append(
            records.ChunkIndex(
                chunk_start_offset=begin,
                chunk_length=len(parts[0]),
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                uncompressed_size=len(raw),
                message_start_time=start,
                message_end_time=end,
                message_index_offsets=offsets,
                message_index_length=sum(map(len, parts[1:])),
            )
        )
        if indexed:
            self._span = (min(self._span[0], start), max(self._span[1], end))

    def finish(self) -> None:
        """Write the summary section and the footer. The file stays open."""
        self.flush()
        self._put(_bytes(records.DataEnd(0)))
        start = self._offset
        total = sum(self._counts.values())
        statistics = records.Statistics(
            message_count=total,
            schema_count=len(self._schemas),
            channel_count=len(self._channels),
            attachment_count=len(self._attachments),
            metadata_count=len(self._metadata),
            chunk_count=len(self._chunks),
            message_start_time=self._span[0] if total else 0,
            message_end_time=self._span[1],
            channel_message_counts={channel: count for channel, count in self._counts.items() if count},
        )
        groups = {
            Opcode.SCHEMA: list(self._schemas.values()),
            Opcode.CHANNEL: list(self._channels.values()),
            Opcode.STATISTICS: [statistics],
            Opcode.CHUNK_INDEX: self._chunks,
            Opcode.ATTACHMENT_INDEX: self._attachments,
            Opcode.METADATA_INDEX: self._metadata,
        }
        summary, offsets = b"", b""
        for opcode, members in groups.items():
            body = b"".join(_bytes(record) for record in members)
            if body:
                offset = records.SummaryOffset(
                    group_opcode=opcode, group_start=start + len(summary), group_length=len(body)
                )
                offsets += _bytes(offset)
                summary += body
        offset_start = start + len(summary)
        footer = _RECORD.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", start, offset_start)
        checksum = zlib.crc32(summary + offsets + footer)
        self._put(summary + offsets + footer + struct.pack("<I", checksum) + MAGIC)


def _bytes(record: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


@dataclass(slots=True)
class ReadChannel:
    """One channel of a file.

    ``encoding`` is that of the messages, ``language`` and ``definition`` are those of its schema.
    """

    topic: str
    type: str
    metadata: dict[str, str]
    encoding: str = ""
    language: str = ""
    definition: str = ""


@dataclass(slots=True)
class Contents:
    """What a file holds up to its end, or up to where it was cut, but for its messages.

    Attributes:
        complete: the file has its footer.
        channels: by their id.
        damaged: chunks whose checksum failed and records that cannot be; their messages are left out.
        expanded: bytes that its chunks have come to.
        last_ns: the latest log time of a message.
    """

    channels: dict[int, ReadChannel] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    complete: bool = False
    damaged: int = 0
    expanded: int = 0
    last_ns: int = 0


class Unmeasured(ValueError):
    """A file that is no MCAP file, or expands beyond all measure."""


class Message(NamedTuple):
    """A message as it lies in a file: its channel's id, its number there, its log time and its bytes."""

    channel: int
    sequence: int
    log_ns: int
    data: bytes


def read_container(file: BinaryIO, contents: Contents) -> Iterator[Message]:
    """Every whole message of an MCAP file in its order; what else the file holds goes into ``contents``.

    The file is read record by record, so that no more than a chunk of it is in memory. A record that the file ends in
    the middle of is left out, and ``complete`` is then false. A record that is not what it says it is costs itself
    alone, and ``damaged`` counts it. A channel is known by its id before its definition is (that may be in a damaged
    chunk; the summary repeats it): what channels are is known when all messages have been read.

    Raises:
        Unmeasured: the file does not begin like an MCAP file, or expands beyond all measure.
    """
    size = file.seek(0, 2)
    schemas: dict[int, records.Schema] = {}
    room = _EXPANDED_FREE + _EXPANDED_RATIO * size
    for head, length in _records(file, size):
        try:
            messages = _read_record(head[0], head + file.read(length), contents, room)
            if messages:
                yield from _read_messages(messages, schemas, contents)
        except _TORN:
            contents.damaged += 1
        if contents.expanded > room:
            raise Unmeasured(f"its {size} bytes expand to more than {room}")
        if contents.complete:
            break


def read_metadata(file: BinaryIO) -> dict[str, dict[str, str]]:
    """The metadata of a file by their names, its other records skipped.

    Raises:
        Unmeasured: the file does not begin like an MCAP file.
    """
    contents = Contents()
    for head, length in _records(file, file.seek(0, 2)):
        if head[0] == Opcode.METADATA:
            with suppress(*_TORN):
                _read_record(head[0], head + file.read(length), contents, 0)
    return contents.metadata


def indexed_times(file: BinaryIO) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Log times of a channel's messages in the file's order, chunk by chunk, by the indices behind these, nanoseconds.

    Raises:
        ValueError: the file does not begin like an MCAP file, or an index is torn.
    """
    for head, length in _records(file, file.seek(0, 2)):
        if head[0] == Opcode.MESSAGE_INDEX and length >= 6:
            body = file.read(length)
            entries = np.frombuffer(body[6:], np.dtype([("at_ns", "<i8"), ("offset", "<u8")]))
            yield int.from_bytes(body[:2], "little"), entries["at_ns"][np.argsort(entries["offset"], kind="stable")]


_TORN = (McapError, struct.error, ValueError, LookupError, OverflowError, MemoryError)


def _records(file: BinaryIO, size: int) -> Iterator[tuple[bytes, int]]:
    """The head and the length of each record that is whole; the file stands at its body."""
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        raise Unmeasured("it does not begin with the MCAP magic")
    position = len(MAGIC)
    while position + 9 <= size:
        file.seek(position)
        head = file.read(9)
        _, length = _RECORD.unpack(head)
        position += 9 + length
        if position > size:
            break
        yield head, length


def _read_record(opcode: int, record: bytes, contents: Contents, room: int) -> bytes:
    """Take a record in; those of schemas, channels and messages in it are given back."""
    body = record[9:]
    if opcode == Opcode.CHUNK:
        chunk = records.Chunk.read(_stream(body))
        _check_size(chunk, room)
        contents.expanded += chunk.uncompressed_size
        return _chunk_data(chunk) if contents.expanded <= room else b""
    if opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
        return record
    if opcode == Opcode.ATTACHMENT:
        if struct.unpack("<I", body[-4:])[0] not in (0, zlib.crc32(body[:-4])):
            raise ValueError("an attachment's checksum does not match")
        attachment = records.Attachment.read(_stream(body))
        contents.attachments[attachment.name] = attachment.data
    elif opcode == Opcode.METADATA:
        metadata = records.Metadata.read(_stream(body))
        contents.metadata[metadata.name] = metadata.metadata
    elif opcode == Opcode.FOOTER:
        contents.complete = True
    return b""


def _stream(body: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))


def _check_size(chunk: records.Chunk, room: int) -> None:
    """Raise ValueError for a chunk that declares what it cannot have, before anything is made of it."""
    declared = chunk.uncompressed_size
    if declared > room:
        raise ValueError("a chunk declares more than the file can hold")
    if chunk.compression == "zstd":
        try:
            framed = zstandard.get_frame_parameters(chunk.data).content_size
        except zstandard.ZstdError as error:
            raise ValueError(f"a chunk does not decompress ({error})") from None
        if framed not in (declared, zstandard.CONTENTSIZE_UNKNOWN):
            raise ValueError("a chunk and its frame declare different sizes")


def _chunk_data(chunk: records.Chunk) -> bytes:
    """Uncompressed records of a chunk: never more bytes than it declares.

    Raises:
        ValueError: it does not decompress to what it declares, or its checksum does not match.
    """
    declared = chunk.uncompressed_size
    try:
        if chunk.compression == "zstd":
            raw = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=declared)
        elif chunk.compression == "lz4":
            raw = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=declared)
        else:
            raw = chunk.data
    except (zstandard.ZstdError, RuntimeError) as error:
        raise ValueError(f"a chunk does not decompress ({error})") from None
    if len(raw) != declared:
        raise ValueError("a chunk has another size than it declares")
    if chunk.uncompressed_crc not in (0, zlib.crc32(raw)):
        raise ValueError("a chunk's checksum does not match")
    return raw


def _read_messages(raw: bytes, schemas: dict[int, records.Schema], contents: Contents) -> Iterator[Message]:
    """The messages of a chunk's records; its schemas and channels go into ``contents``."""
    position, size, channels = 0, len(raw), contents.channels
    head = _MESSAGE.unpack_from
    while position + 9 <= size:
        opcode = raw[position]
        if opcode == Opcode.MESSAGE:
            _, length, channel_id, sequence, log_ns, _ = head(raw, position)
            end = position + 9 + length
            if length < 22 or end > size or log_ns >= _LATEST_NS:
                raise ValueError("a message has a length or a time that it cannot have")
            if channel_id not in channels:
                channels[channel_id] = ReadChannel("", "", {})
            contents.last_ns = max(contents.last_ns, log_ns)
            yield Message(channel_id, sequence, log_ns, raw[position + 31 : end])
        else:
            end = position + 9 + _RECORD.unpack_from(raw, position)[1]
            if opcode == Opcode.SCHEMA:
                schema = records.Schema.read(_stream(raw[position + 9 : end]))
                schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                defined = records.Channel.read(_stream(raw[position + 9 : end]))
                known = channels.setdefault(defined.id, ReadChannel("", "", {}))
                known.topic, known.metadata, known.encoding = defined.topic, defined.metadata, defined.message_encoding
                if (schema := schemas.get(defined.schema_id)) is not None:
                    known.type, known.language = schema.name, schema.encoding
                    known.definition = schema.data.decode("utf-8", "replace")
        position = end
