"""Files that are whole or not there: a reader never meets half of one, whatever stops the writer."""

from __future__ import annotations

import os
from pathlib import Path


def write_whole(path: str | Path, content: str | bytes) -> Path:
    """Write a file beside its place and move it there once it is on disk; returns the path.

    Args:
        path: the file; a link is followed, and what is no regular file (a terminal, a pipe) is written straight into.
        content: text, as UTF-8, or bytes.

    Raises:
        OSError: it cannot be written; what was there before is untouched.
    """
    path = Path(path)
    data = content.encode() if isinstance(content, str) else content
    place = path.resolve()
    if place.exists() and not place.is_file():
        place.write_bytes(data)
        return path
    beside = place.with_name(f".{place.name}.{os.getpid()}.new")
    try:
        with beside.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(place)
    finally:
        beside.unlink(missing_ok=True)
    return path
