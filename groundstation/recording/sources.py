"""The tables of any log by name, for a map that says what their columns are; of a table the columns that it names."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.recording import dataflashfile, kinds, ulogfile
from groundstation.recording.container import MAGIC as MCAP_MAGIC
from groundstation.recording.crazyflie import decode_usd, is_usd_log
from groundstation.recording.tablefile import read_columns
from groundstation.recording.tables import Table, table_of

Array = NDArray[np.float64]
if TYPE_CHECKING:
    from pyarrow import ChunkedArray, RecordBatch  # pyright: ignore[reportMissingImports]

_MOST_ELEMENTS = 64
_ROWS = 1 << 16
Source = Callable[[Collection[str]], Table]
"""Reads a table, of a long one the columns of these names alone; all where none is named."""


def sources_of(path: Path) -> dict[str, Source]:
    """Each table of a log; it is read when it is called for. A file of one table names it after itself, without a
    suffix.

    Raises:
        BadInput: the log is missing, or of no kind that has tables.
    """
    if path.is_dir():
        return _bag(path)
    try:
        with path.open("rb") as file:
            head = file.read(512)
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror}); give the path of a log.") from None
    if head.startswith(ulogfile.MAGIC):
        topics = ulogfile.decode_ulog(np.memmap(path, np.uint8, mode="r")).topics
        return {f"{n}.{i}" if i else n: lambda _, t=table: t for (n, i), table in sorted(topics.items())}
    if head.startswith(dataflashfile.MAGIC):
        tables = dataflashfile.decode_dataflash(np.memmap(path, np.uint8, mode="r")).tables
        return {name: lambda _, t=table: t for name, table in sorted(tables.items())}
    if head.startswith((MCAP_MAGIC, b"SQLite format 3\0")):
        return _bag(path)
    if head.startswith(b"PAR1"):
        return {path.stem: lambda names: _parquet(path, names)}
    if is_usd_log(head):
        log = decode_usd(np.memmap(path, np.uint8, mode="r"), str(path))
        return {
            event: lambda _, e=event: table_of(e, {"t_s": log.t_s[e], **log.columns[e]}, ("t_s", 1.0))
            for event in log.t_s
        }
    if head.startswith(b"H Product:Blackbox"):
        return {"blackbox": lambda _: _blackbox(path)}
    if "table in one file" in kinds.described(head, path.stat().st_size):
        return {path.stem: lambda names: _csv(path, names)}
    raise BadInput(f"{path}: {kinds.described(head, path.stat().st_size)}.")


def _bag(path: Path) -> dict[str, Source]:
    from groundstation.recording.rosbag import read_topic, topics_of

    return {topic: lambda _, t=topic: read_topic(path, t) for topic in sorted(topics_of(path))}


def _csv(path: Path, names: Collection[str]) -> Table:
    found = read_columns(path, names)
    return table_of(path.stem, found.columns, (next(iter(found.columns)), 1.0), found.units)


def _blackbox(path: Path) -> Table:
    from groundstation.recording.blackboxfile import decode_blackbox

    log = max(decode_blackbox(np.memmap(path, np.uint8, mode="r")), key=lambda log: len(log.rows))
    return table_of("blackbox", dict(zip(log.names, log.rows.T.astype(float), strict=True)), ("time", 1e6))


def _parquet(path: Path, names: Collection[str]) -> Table:
    """Some rows of some columns at a time: a file may hold more than the memory."""
    try:
        from pyarrow import ArrowInvalid, parquet  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise BadInput(f"{path}: a Parquet file needs the package pyarrow; install it (pip install pyarrow).") from None
    blocks: list[dict[str, Array]] = []
    try:
        with parquet.ParquetFile(path) as file:
            fields = [field for field in file.schema_arrow.names if not names or any(_is_of(n, field) for n in names)]
            for batch in file.iter_batches(_ROWS, columns=fields):
                blocks.append(_columns_of(batch, names))
                if not blocks[0].keys() >= set(names):  # whoever asks is told what there is
                    blocks = [_columns_of(next(file.iter_batches(_ROWS)), ())]
                    break
    except (ArrowInvalid, OSError) as error:
        raise BadInput(f"{path}: is a damaged Parquet file ({str(error)[:80]}); write it again.") from None
    found = [name for name in (blocks[0] if blocks else ()) if all(name in block for block in blocks)]
    if not found:
        raise BadInput(f"{path}: has no columns of numbers; write the times as seconds, too.")
    columns = {name: np.concatenate([block.pop(name) for block in blocks]) for name in found}
    return table_of(path.stem, columns, (found[0], 1.0))


def _is_of(name: str, field: str) -> bool:
    """Whether a column's name is of this field of a Parquet file: itself, one of its record's, or of its list's."""
    return name == field or name.startswith((f"{field}.", f"{field}["))


def _columns_of(batch: RecordBatch, names: Collection[str]) -> dict[str, Array]:
    """The columns of these names of some rows, all where none is named."""
    from pyarrow import Table as Rows  # pyright: ignore[reportMissingImports]
    from pyarrow import types

    table = Rows.from_batches([batch])
    while any(types.is_struct(field.type) for field in table.schema):
        table = table.flatten()  # a.b of a column a of records
    columns: dict[str, Array] = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        columns |= _numbers_of(name, column)
    return {name: column for name, column in columns.items() if not names or name in names}


def _numbers_of(name: str, column: ChunkedArray) -> dict[str, Array]:
    """A column of numbers, of times as seconds, or of lists of one length as name[0] and on; nothing of any other."""
    from pyarrow import types  # pyright: ignore[reportMissingImports]

    kind = column.type
    if types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind):
        return {name: np.asarray(column.to_numpy(zero_copy_only=False), dtype=float)}
    if types.is_timestamp(kind) or types.is_duration(kind) or types.is_time(kind):
        ticks = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[kind.unit]
        whole = column.cast("int32").cast("int64") if types.is_time32(kind) else column.cast("int64")
        return {name: np.asarray(whole.to_numpy(zero_copy_only=False), dtype=float) / ticks}
    if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        rows = column.to_pylist()
        counts = {len(row or ()) for row in rows}
        if len(counts) == 1 and 0 < (count := counts.pop()) <= _MOST_ELEMENTS and isinstance(rows[0][0], int | float):
            values = np.array(rows, dtype=float)
            return {f"{name}[{i}]": values[:, i] for i in range(count)}
    return {}
