"""Motion capture in a process of its own: a client that hangs makes poses old, and nothing else."""

from __future__ import annotations

import os
import subprocess

from drivers.mocap.source import FrameReader
from drivers.samples import Event, Pose
from groundstation.flight.children import module_command
from groundstation.flight.link.mounting import Mounting
from groundstation.flight.station import MocapSource
from groundstation.vehicle import Vehicle


def _shown(host: str) -> tuple[str, ...]:
    if not host.startswith("tls/"):
        return ()
    from groundstation.flight.share.passes import station_file

    return ("--identity", str(station_file()))


class PoseSource:
    """The motion-capture client's process, read without waiting; started again by itself when it ends."""

    def __init__(self, mocap: MocapSource, vehicle: Vehicle):
        calibration = mocap.calibration
        measured = (
            ()
            if calibration is None
            else (f"--delay={calibration.delay_s!r}", f"--delay-error={2.0 * calibration.delay_std_s!r}")
        )
        self._command = module_command(
            "drivers.mocap.source", "--system", mocap.system, f"--host={mocap.host}", f"--body={mocap.body}",
            "--up", mocap.up, *measured, *_shown(mocap.host),
        )  # fmt: skip
        self._mounting = None if calibration is None else Mounting(calibration, vehicle)
        self._reader = FrameReader()
        self._process = self._start()

    def read(self) -> list[tuple[Pose | Event, float]]:
        """Poses of the declared tracked point and what the client tells, with the host time each arrived at."""
        assert self._process.stdout is not None  # noqa: S101 - piped below
        try:
            data = os.read(self._process.stdout.fileno(), 1 << 16)
        except BlockingIOError:
            return []
        if not data and self._process.poll() is not None:
            self._reader, self._process = FrameReader(), self._start()
        arrived = self._reader.feed(data)
        if self._mounting is None:
            return arrived
        return [(self._mounting.corrected(s) if isinstance(s, Pose) else s, t) for s, t in arrived]

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
