"""The gate for what others wrote: files, names and texts from outside become bounded values here, or one sentence.

Three kinds of input pass: a *file* (regular, of bounded size), a *document* in it (TOML or JSON of bounded depth,
numbers within 64 bits), and a *text* that names a file or is shown to somebody. Whatever the bytes, these functions
return a value that the rest of the program can hold, or raise :class:`BadInput`; they never wait and never raise
anything else.
"""

from __future__ import annotations

import json
import os
import stat
import tomllib
from pathlib import Path
from typing import Any

from groundstation.errors import BadInput
from groundstation.json_types import JsonObject
from groundstation.texts import holdable, shown

DOCUMENT_BYTES = 64 * 1024 * 1024
"""A settings file has a few kilobytes, an identification with its evolution a few megabytes."""
DEPTH = 40
"""Tables within tables. Our documents have 6; parsers and writers recurse, and Python allows them about 300."""
_INTEGER = 2**63
_SECRET_BYTES = 64 * 1024


def inside(folder: Path, name: str) -> Path:
    """The path of a file in a folder, from a name that came from outside.

    Args:
        folder: where it must lie.
        name: with ``/`` between folders; each part of letters, digits, blanks and ``.+,=@()[]~-``.

    Raises:
        BadInput: the name is of another form, leads out of the folder, or passes through a link.
    """
    if not holdable(name):
        raise BadInput(f"{folder}: '{shown(name, limit=60)}' cannot name a file in it; rename it.")
    root = folder.resolve()
    path = root / name
    for place in (path, *path.parents):
        if place == root:
            break
        if _is_link(place):
            raise BadInput(f"{place}: is a link; put the file itself there.")
    return folder / name


def _is_link(place: Path) -> bool:
    """Whether it is a link; :class:`BadInput` where the system takes no name of this length."""
    try:
        return place.is_symlink()
    except OSError as error:
        raise BadInput(f"'{shown(str(place), limit=60)}' cannot name a file ({error.strerror}); rename it.") from None


def read_bytes(path: Path, wanted: str, limit: int | None = None) -> bytes:
    """The bytes of a regular file.

    Args:
        path: of the file; a link that a person gives is followed.
        wanted: what the sentence asks for, e.g. "a plan".
        limit: the most bytes it may have.

    Raises:
        BadInput: it is missing, no regular file (a pipe would wait forever), too large, or cannot be read.
    """
    require_file(path, wanted, limit)
    try:
        return path.read_bytes()
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror}); give the path of {wanted}.") from None
    except MemoryError:
        raise BadInput(f"{path}: does not fit into this machine's memory; give a shorter one.") from None


def require_file(path: Path, wanted: str, limit: int | None = None) -> None:
    """Raise what :func:`read_bytes` raises of a file that it would not open."""
    try:
        status = path.stat()
    except (OSError, ValueError) as error:
        if isinstance(error, FileNotFoundError):
            raise BadInput(f"{shown(path)}: there is no such file; give the path of {wanted}.") from None
        why = getattr(error, "strerror", None) or "no file has such a name"
        raise BadInput(f"{shown(path)}: cannot be read ({why}); give the path of {wanted}.") from None
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe, a socket or a device"
        raise BadInput(f"{path}: is {kind}; give the path of {wanted}, a regular file.")
    if limit is not None and status.st_size > limit:
        raise BadInput(f"{path}: has {status.st_size} bytes, more than the {limit} of {wanted}; give another file.")


def require_own(path: Path, wanted: str, remedy: str) -> None:
    """Raise unless a file with a secret is one that this user alone can have written and can read.

    Raises:
        BadInput: it is a link, no regular file, or somebody else's; ``remedy`` ends the sentence.
    """
    if path.is_symlink():
        raise BadInput(f"{path}: is a link. {remedy}")
    require_file(path, wanted, _SECRET_BYTES)
    status = path.stat()
    if hasattr(os, "getuid") and (status.st_uid != os.getuid() or stat.S_IMODE(status.st_mode) & 0o077):
        raise BadInput(f"{path}: belongs to somebody else, or others may read it. {remedy}")


def read_toml(path: Path, wanted: str) -> JsonObject:
    """The document in a TOML file.

    Raises:
        BadInput: as :func:`read_bytes` and :func:`parse_toml`.
    """
    return parse_toml(read_bytes(path, wanted, DOCUMENT_BYTES), str(path))


def parse_toml(data: bytes, source: str) -> JsonObject:
    """A TOML document.

    Raises:
        BadInput: no UTF-8, no TOML, or beyond the bounds of a document.
    """
    return _parsed(data, source, "TOML", tomllib.loads)


def read_json(path: Path, wanted: str) -> Any:
    """The value in a JSON file.

    Raises:
        BadInput: as :func:`read_bytes` and :func:`parse_json`.
    """
    return parse_json(read_bytes(path, wanted, DOCUMENT_BYTES), str(path))


def parse_json(data: bytes | str, source: str) -> Any:
    """A JSON value.

    Raises:
        BadInput: no UTF-8, no JSON, or beyond the bounds of a document.
    """
    return _parsed(data, source, "JSON", json.loads)


def _parsed(data: bytes | str, source: str, kind: str, parse: Any) -> Any:
    try:
        document = parse(data if isinstance(data, str) else data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise BadInput(f"{source}: is not valid {kind} (byte {error.start} is no UTF-8); correct that line.") from None
    except RecursionError:
        raise BadInput(f"{source}: nests deeper than {DEPTH} levels; flatten it.") from None
    except ValueError as error:
        raise BadInput(f"{source}: is not valid {kind} ({shown(error, limit=200)}); correct that line.") from None
    fault = _beyond(document)
    if fault:
        raise BadInput(f"{source}: {fault}.")
    return document


def _beyond(document: Any) -> str:
    """What of a document is beyond its bounds; empty when nothing is."""
    level: list[Any] = [document]
    for _ in range(DEPTH):
        following: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                following.extend(value.values())
            elif isinstance(value, list):
                following.extend(value)
            elif isinstance(value, int) and not -_INTEGER <= value < _INTEGER:
                return "holds a whole number beyond 64 bits; write it as a decimal, or correct it"
        if not following:
            return ""
        level = following
    return f"nests deeper than {DEPTH} levels; flatten it"
