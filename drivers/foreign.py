"""Logs of autopilots through the libraries that know them, in a process of its own with limits of memory and time.

    python -P -m drivers.foreign LIMITS REQUEST < /dev/null > tables.npz

Those libraries trust a log's own figures: 36 kB can keep one busy for ever, or make it ask for all memory. So they run
here, where the system ends them, and hand back plain tables: an NPZ of arrays, the first of which is a JSON text.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Table = dict[str, NDArray[Any]]
REFUSED = 2
"""Exit status of a log that the library could not read; the reason is on standard error."""


@dataclass(frozen=True, slots=True)
class Decoded:
    """What a library made of a log.

    Attributes:
        tables: columns of numbers by message and field, the first instance of each message.
        parameters: of the autopilot.
        info: texts about the system.
        complaints: what the library said while it read.
        dropouts_ms: gaps that the logger itself noted.
    """

    tables: dict[str, Table] = field(default_factory=dict)
    parameters: dict[str, float] = field(default_factory=dict)
    info: dict[str, str] = field(default_factory=dict)
    complaints: str = ""
    dropouts_ms: tuple[float, ...] = ()


def decode_ulog(path: Path, topics: Sequence[str]) -> Decoded:
    """A PX4 log. Raises whatever the library raises."""
    from pyulog import ULog

    complaints = io.StringIO()  # the library prints, and standard output is the caller's
    with contextlib.redirect_stdout(complaints):
        log = ULog(str(path), list(topics))
    tables = {topic.name: dict(topic.data) for topic in reversed(log.data_list) if len(topic.data["timestamp"]) > 1}
    return Decoded(
        tables,
        {str(name): float(value) for name, value in log.initial_parameters.items()},
        {str(key): str(value) for key, value in log.msg_info_dict.items()},
        complaints.getvalue(),
        tuple(float(dropout.duration) for dropout in log.dropouts),
    )


def decode_dataflash(path: Path, fields: Mapping[str, Sequence[str]]) -> Decoded:
    """An ArduPilot log. Raises whatever the library raises."""
    os.environ.setdefault("MAVLINK20", "1")
    from pymavlink.DFReader import DFReader_binary

    rows: dict[str, list[tuple[float, ...]]] = {name: [] for name in fields}
    parameters: dict[str, float] = {}
    complaints = io.StringIO()
    with contextlib.redirect_stderr(complaints), contextlib.redirect_stdout(complaints):
        reader = DFReader_binary(str(path), zero_time_base=True)
        while (message := reader.recv_match(type=list(fields))) is not None:
            name = message.get_type()
            if name == "PARM":
                parameters[str(message.Name)] = float(message.Value)
            else:
                rows[name].append((message.TimeUS, *(getattr(message, key, np.nan) for key in fields[name])))
    tables: dict[str, Table] = {}
    for name, found in rows.items():
        if len(found) > 1:
            matrix = np.array(found, dtype=float)
            tables[name] = {"TimeUS": matrix[:, 0]} | {key: matrix[:, i + 1] for i, key in enumerate(fields[name])}
    return Decoded(tables, parameters, {}, complaints.getvalue())


DECODERS = {"ulog": decode_ulog, "dataflash": decode_dataflash}


def pack(decoded: Decoded) -> bytes:
    """Tables as NPZ; columns that are no numbers are left out."""
    columns = [
        (table, name, values)
        for table, found in decoded.tables.items()
        for name, values in found.items()
        if isinstance(values, np.ndarray) and values.dtype.kind in "iufb" and values.ndim == 1
    ]
    about = {
        "columns": [(table, name) for table, name, _ in columns],
        "parameters": decoded.parameters,
        "info": decoded.info,
        "complaints": decoded.complaints[-100_000:],
        "dropouts_ms": decoded.dropouts_ms,
    }
    out = io.BytesIO()
    text = np.frombuffer(json.dumps(about).encode(), np.uint8)
    arrays: dict[str, Any] = {str(i): values for i, (_, _, values) in enumerate(columns)}
    np.savez(out, about=text, **arrays)
    return out.getvalue()


def unpack(data: bytes) -> Decoded:
    """Inverse of :func:`pack`.

    Raises:
        ValueError: the bytes are something else.
    """
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            about = json.loads(arrays["about"].tobytes())
            tables: dict[str, Table] = {}
            for index, (table, name) in enumerate(about["columns"]):
                tables.setdefault(table, {})[name] = arrays[str(index)]
    except (OSError, LookupError, TypeError) as error:
        raise ValueError(f"not the tables of a log: {error}") from None
    return Decoded(tables, about["parameters"], about["info"], about["complaints"], tuple(about["dropouts_ms"]))


def limit(memory: int, seconds: int) -> None:
    """Hold this process to so many more bytes and seconds of processor time, where the system can."""
    try:
        import resource
    except ImportError:  # no such limits on this system: the caller's clock alone ends it
        return
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    statm = Path("/proc/self/statm")
    if statm.is_file():
        used = int(statm.read_text(encoding="ascii").split()[0]) * os.sysconf("SC_PAGE_SIZE")
        resource.setrlimit(resource.RLIMIT_AS, (used + memory, used + memory))


def main(arguments: Sequence[str]) -> int:
    """Decode one log within limits; returns the exit status."""
    limits, request = (json.loads(text) for text in arguments)
    import pyulog  # noqa: F401 - both before the limits, which are for the log

    limit(limits["memory"], limits["seconds"])
    try:
        data = pack(DECODERS[request["kind"]](Path(request["path"]), request["wanted"]))
    except Exception as error:  # the libraries have no error of their own for most kinds of damage
        what = "MemoryError" if isinstance(error, MemoryError) else f"{type(error).__name__}: {error}"
        print(re.sub(r"\s+", " ", what)[:300], file=sys.stderr)
        return REFUSED
    sys.stdout.buffer.write(data)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
