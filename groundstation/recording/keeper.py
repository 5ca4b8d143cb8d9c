"""Watches over a recording while it is made: on the disk at an interval, and still where it should be.

A thread of its own, because a sync may take as long as the disk likes; nothing that flies or records waits for it. With
the file's own flush once a second of flight, a power cut costs at most two seconds of it (and what a disk lies about).
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path

EVERY_S = 0.5
"""Between two looks, so that a folder that is gone is told within a second."""
SYNC_EVERY = 2
"""Looks between two syncs: one second."""
LEAST_FREE = 16 << 20
"""Bytes of a disk that is as good as full: half a minute of the fullest recording."""


class Keeper:
    """Of one file.

    Args:
        path: of the file.
        sync: writes it through to the disk.
        on_trouble: called once, on this thread, with the sentence that says what is wrong and what to do.
        every_s: between two looks.
    """

    def __init__(
        self, path: Path, sync: Callable[[], None], on_trouble: Callable[[str], None], every_s: float = EVERY_S
    ):
        self._path, self._sync, self._on_trouble, self._every_s = path, sync, on_trouble, every_s
        self._made = path.stat()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="keeper", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop watching; a sync under way is not waited for."""
        self._end.set()

    def _run(self) -> None:
        looks = 0
        while not self._end.wait(self._every_s):
            looks += 1
            trouble = self._trouble(sync=looks % SYNC_EVERY == 0)
            if trouble and not self._end.is_set():
                self._on_trouble(trouble)
                return

    def _trouble(self, *, sync: bool) -> str:
        try:
            if sync:
                self._sync()
            return missing(self._path, self._made)
        except OSError as error:
            return f"{self._path}: cannot be written through to the disk ({error.strerror}); look at the disk."


def missing(path: Path, made: os.stat_result) -> str:
    """Why what is recorded would not be found or not be kept; empty when all is well."""
    try:
        now = path.stat()
    except OSError:
        return (
            f"{path.parent}: the flight's folder or its recording was removed or moved away; what is recorded is lost."
        )
    if (now.st_ino, now.st_dev) != (made.st_ino, made.st_dev):
        return f"{path}: was replaced by another file; what is recorded goes into the one before, which is lost."
    if not os.access(path.parent, os.W_OK):
        return f"{path.parent}: cannot be written any more (read-only?); what comes now may be lost. Mount it writable."
    room = os.statvfs(path.parent)
    if room.f_bavail * room.f_frsize < LEAST_FREE:
        return f"{path.parent}: the disk is full but for {room.f_bavail * room.f_frsize / 1e6:.0f} MB; make room on it."
    return ""
