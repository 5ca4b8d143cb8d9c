"""Files of the shared flight, part by part: what the gate gives, and how a view puts them together."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from groundstation.errors import BadInput
from groundstation.flight.share.messages import FILE_BYTES, FILES, PART_BYTES, FilePart, FileRequest
from groundstation.outside import require_file
from groundstation.texts import file_name
from groundstation.writing import write_whole


def read_part(folder: Path, name: str, offset: int) -> FilePart:
    """A part of one of :data:`FILES` in a folder; of any other name, nothing."""
    path = folder / name if name in FILES else None
    try:
        if path is None or path.is_symlink() or offset < 0:
            return FilePart(False, "no such file is shared")
        require_file(path, "a shared file", FILE_BYTES)
        with path.open("rb") as file:
            file.seek(offset)
            return FilePart(True, "", path.stat().st_size, file.read(PART_BYTES))
    except (BadInput, OSError):
        return FilePart(False, "it is not there (yet)")


def fetch(ask: Callable[[FileRequest], FilePart], flight: str, into: Path) -> list[str]:
    """Fetch what there is of a flight into a folder of its own; returns the names of what came.

    Raises:
        ConnectionError: the gate does not answer.
        OSError: it cannot be written.
    """
    folder = into / file_name(flight, "flight")
    folder.mkdir(parents=True, exist_ok=True)
    return [name for name in FILES if _fetched(ask, FileRequest(flight, name), folder / name)]


def _fetched(ask: Callable[[FileRequest], FilePart], first: FileRequest, path: Path) -> bool:
    """One file, whole or not at all; one that grows while it is read is taken as far as it was at the beginning."""
    part = ask(first)
    if not part.ok or not 0 <= part.size <= FILE_BYTES:
        return False
    size, data = part.size, bytearray(part.data)
    while len(data) < size:
        part = ask(FileRequest(first.flight, first.name, len(data)))
        if not part.ok or not part.data:
            return False
        data += part.data
    write_whole(path, bytes(data[:size]))
    return True
