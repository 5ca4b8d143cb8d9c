"""What message signing must remember from one run to the next: stamps sent and heard, per key. One small file.

MAVLink 2 message signing: a stamp is never used twice, and a stream's stamps only grow. A station that starts again and
has forgotten them would take frames that somebody recorded a minute ago for new ones.
"""

from __future__ import annotations

import hashlib
import json
import time
from pathlib import Path

from drivers.mavlink.signing import Signing, signing_stamp
from groundstation.errors import BadInput
from groundstation.writing import write_whole

AHEAD = 6_000_000
"""Stamps kept free above the last that was written down, 10 us each: a minute of a run that wrote no more."""


class SigningMemory:
    """Of one key.

    Args:
        path: the file, shared by the keys of a folder of flights; None remembers nothing.
        key: 32 bytes.
        unix_s: now.

    Raises:
        BadInput: the key has another size, or the file cannot be read.
    """

    def __init__(self, path: Path | None, key: bytes, unix_s: float):
        self._path = path
        self._name = hashlib.sha256(b"groundstation signing memory" + key).hexdigest()[:16]
        self._all: dict[str, dict[str, dict[str, int] | int]] = self._read()
        mine = self._all.get(self._name, {})
        heard = mine.get("heard", {})
        sent = mine.get("sent", 0)
        now = signing_stamp(unix_s)
        try:
            first = max(now, int(sent) + AHEAD if sent else now)  # type: ignore[arg-type]
            self.signing = Signing(key, first, now=now, heard=dict(heard))  # type: ignore[arg-type]
        except (TypeError, ValueError) as error:
            raise BadInput(f"the signing key or what is remembered of it is wrong ({error}).") from None

    def write(self) -> None:
        """Put down what was sent and heard so far; replaces the file whole."""
        if self._path is not None:
            self._all[self._name] = {"sent": self.signing.stamp, "heard": self.signing.heard()}
            write_whole(self._path, json.dumps(self._all))

    def _read(self) -> dict[str, dict[str, dict[str, int] | int]]:
        if self._path is None or not self._path.is_file():
            return {}
        try:
            document = json.loads(self._path.read_text(encoding="utf-8"))
            return {str(name): dict(values) for name, values in document.items()}
        except (OSError, ValueError, AttributeError, TypeError):
            raise BadInput(
                f"{self._path}: remembers the stamps of signed links and cannot be read; if it is damaged, remove it "
                "after a minute without flights."
            ) from None


def signing_memory(key_file: Path, memory: Path | None) -> SigningMemory:
    """The memory of the key in a file.

    Raises:
        BadInput: the file holds no key, or what is remembered cannot be read.
    """
    try:
        key = key_file.read_bytes()
    except OSError as error:
        raise BadInput(f"{key_file}: cannot be read ({error.strerror}); it holds exactly 32 bytes.") from None
    if len(key) != 32:
        raise BadInput(f"{key_file}: is no signing key ({len(key)} bytes); it holds exactly 32 bytes.")
    return SigningMemory(memory, key, time.time())
