"""The manifest of a flight: checksums of its files, signed when it was closed, so that a report can say they are as
flown.

SHA-256 of each file; the document is signed by HMAC-SHA256 (RFC 2104) with a key of this station. The key lies in the
user's configuration folder and not beside the flights, so that it does not travel with a copy of them. It proves that
whoever changed a file had not the key; against another process of the same user, which can read it, it proves nothing.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import secrets
import stat
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from groundstation.errors import BadInput
from groundstation.json_types import Document, JsonObject
from groundstation.outside import inside, read_bytes, read_json
from groundstation.paths import settings_dir
from groundstation.recording.merge import onboard_log_of
from groundstation.writing import write_whole

NAME = "manifest.json"
SCHEMA = "groundstation.manifest/1"
KEY_BYTES = 32
_WANTED = "the manifest of a flight"
_LEAVES = "Nothing proves that the data are as flown."


def signed(files: Mapping[str, str], inputs: Mapping[str, str], key: bytes) -> JsonObject:
    """A manifest.

    Args:
        files: SHA-256 by name, of the files in the flight's folder.
        inputs: the same of plan and vehicle as they were given; the recording holds both.
        key: of the station.
    """
    body = {"schema": SCHEMA, "key": key_name(key), "files": dict(files), "inputs": dict(inputs)}
    return {**body, "signature": _signature(body, key)}


def is_signed(document: object, key: bytes) -> bool:
    """Whether this key signed the document as it is."""
    if not isinstance(document, dict) or not isinstance(document.get("signature"), str):
        return False
    body = {name: value for name, value in document.items() if name != "signature"}
    return hmac.compare_digest(_signature(body, key).encode(), document["signature"].encode("utf-8", "replace"))


def key_name(key: bytes) -> str:
    """What tells one station's key from another's, and nothing else of it."""
    return hashlib.sha256(b"groundstation manifest key" + key).hexdigest()[:16]


def _signature(body: Document, key: bytes) -> str:
    return hmac.new(key, json.dumps(body, sort_keys=True).encode(), hashlib.sha256).hexdigest()


def key_file() -> Path:
    """Where the key of this station lies."""
    return settings_dir() / "manifest.key"


def station_key(*, make: bool = False) -> bytes | None:
    """The key of this station; None where there is none yet and none is to be made.

    Raises:
        BadInput: the file holds no key, or others may read it.
        OSError: it cannot be made.
    """
    path = key_file()
    if make and not path.exists():
        _make_key(path)
    if not path.exists():
        return None
    key = read_bytes(path, "the key of this station", KEY_BYTES)
    if len(key) != KEY_BYTES or stat.S_IMODE(path.stat().st_mode) & 0o077:
        raise BadInput(
            f"{path}: is no key of {KEY_BYTES} bytes, or others may read it; remove it to have a new one made."
        )
    return key


def _make_key(path: Path) -> None:
    """Whole or not there, and once: of two processes that make it, both use the first one's."""
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    beside = path.with_name(f".{path.name}.{os.getpid()}.new")
    descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(secrets.token_bytes(KEY_BYTES))
        with suppress(FileExistsError):
            path.hardlink_to(beside)
    finally:
        beside.unlink(missing_ok=True)


def write_manifest(folder: Path, names: Sequence[str], inputs: Mapping[str, Path]) -> str:
    """Take the checksums of a flight's files into its manifest; those that it has already stay as they were signed.

    Args:
        folder: of the flight.
        names: files in it; one that is not there is left out.
        inputs: plan and vehicle, wherever they lie.

    Returns:
        Why it could not be written, as a sentence; empty when it was. The flight does not depend on it.
    """
    try:
        key = station_key(make=True)
        assert key is not None  # noqa: S101  it was made
        path = folder / NAME
        before = read_json(path, _WANTED) if path.exists() else {}
        kept = before if is_signed(before, key) else {"files": {}}
        new = {name: checksum(folder / name) for name in names if (folder / name).is_file()}
        given = {name: checksum(file) for name, file in inputs.items()}
        document = signed({**new, **kept["files"]}, given, key)
        write_whole(path, json.dumps(document, indent=2) + "\n")
    except (OSError, BadInput) as error:
        return (
            f"{folder.name}: the manifest was not written ({error}); the flight is kept, but not proved to be as flown."
        )
    return ""


def checksum(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def provenance(recording: Path) -> str:
    """What the manifest beside a recording says of it, as sentences; empty where there is none.

    Never raises: a manifest is from outside, too.
    """
    path = recording.with_name(NAME)
    if not path.exists():
        return ""
    try:
        document, key = read_json(path, _WANTED), station_key()
        files = document["files"]
        differ = [text for name, known in files.items() if (text := _difference(path.parent, name, known))]
    except (BadInput, OSError, LookupError, TypeError, AttributeError) as error:
        reason = str(error) if isinstance(error, BadInput) else "it is not of that form"
        return f"{NAME} cannot be used: {reason.removesuffix('.')}. {_LEAVES}"
    if recording.name not in files:
        return f"{recording.name} is not in {NAME}. {_LEAVES}"
    if key is not None and document.get("key") == key_name(key) and not is_signed(document, key):
        return f"{NAME} was changed after this station signed it. {_LEAVES}"
    if differ:
        return f"The data are not as flown: {'; '.join(differ)}."
    names = ", ".join(files)
    if key is None or not is_signed(document, key):
        return f"{names}: as {NAME} says, which another station signed; it can be verified there alone."
    log = onboard_log_of(recording)
    later = f" {log.name} came later and has no checksum." if log is not None and log.name not in files else ""
    return (
        f"The data are as flown: {names} have the checksums that this station signed when the flight was closed.{later}"
    )


def _difference(folder: Path, name: str, known: str) -> str:
    path = inside(folder, name)
    if not path.is_file():
        return f"{name} is missing"
    return "" if checksum(path) == known else f"{name} changed after the flight was closed"
