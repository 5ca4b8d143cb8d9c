"""Motion capture in a process of its own: a client library that hangs makes poses old, and nothing else."""

from __future__ import annotations

import os
import subprocess

from drivers.mocap.source import FrameReader
from drivers.samples import Pose
from groundstation.flight.children import module_command
from groundstation.flight.station import MocapSource


class PoseSource:
    """The motion-capture client's process, read without waiting; started again by itself when it ends."""

    def __init__(self, mocap: MocapSource):
        self._command = module_command(
            "drivers.mocap.source", "--system", mocap.system, "--host", mocap.host, "--body", mocap.body
        )
        self._reader = FrameReader()
        self._process = self._start()

    def read(self) -> list[tuple[Pose, float]]:
        """Poses that arrived, with the host time they did."""
        assert self._process.stdout is not None  # noqa: S101 - piped below
        try:
            data = os.read(self._process.stdout.fileno(), 1 << 16)
        except BlockingIOError:
            return []
        if not data and self._process.poll() is not None:
            self._reader, self._process = FrameReader(), self._start()
        return self._reader.feed(data)

    def close(self) -> None:
        """End it; it has nothing to save."""
        self._process.kill()
        self._process.wait()

    def _start(self) -> subprocess.Popen[bytes]:
        process = subprocess.Popen(
            self._command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, start_new_session=True
        )
        assert process.stdout is not None  # noqa: S101
        os.set_blocking(process.stdout.fileno(), False)
        return process
