"""How long the command takes to be there: each start is a process of its own, the terminal UI in a real
pseudo-terminal.

Told are wall seconds and processor seconds (they differ on a busy machine), the medians of several starts; for the UI
until its first frame shows the panel that says what to press. Byte code is kept, as an installed program's is, even
where the environment says otherwise.

Run with ``python -m benchmarks.startup``.
"""

from __future__ import annotations

import fcntl
import os
import pty
import select
import signal
import statistics
import struct
import subprocess
import sys
import tempfile
import termios
import time
from pathlib import Path

RUNS = 7
COMMANDS = (("--help",), ("plan", "--help"), ("doctor", "--json"))
FRAME = b"Nothing is connected"
"""First words of what the first screen says."""
LIMIT_S = 60.0


def environment() -> dict[str, str]:
    """That of this process; byte code that it does not want kept goes to a folder of its own."""
    settings = dict(os.environ)
    if settings.pop("PYTHONDONTWRITEBYTECODE", ""):
        settings["PYTHONPYCACHEPREFIX"] = str(Path(tempfile.gettempdir()) / "groundstation-bytecode")
    return settings


def start_s(arguments: tuple[str, ...]) -> tuple[float, float]:
    """Wall and processor seconds of one run."""
    before, began = os.times(), time.perf_counter()
    command = [sys.executable, "-P", "-m", "groundstation.cli", *arguments]
    subprocess.run(command, capture_output=True, check=True, env=environment())
    return time.perf_counter() - began, children_s(before)


def first_frame_s() -> tuple[float, float]:
    """Wall and processor seconds until the terminal UI has drawn its first screen.

    Raises:
        TimeoutError: it did not appear.
    """
    before, began = os.times(), time.perf_counter()
    child, terminal = pty.fork()
    if child == 0:
        settings = environment() | {"TERM": "xterm-256color", "COLUMNS": "100", "LINES": "40"}
        os.execve(sys.executable, [sys.executable, "-P", "-m", "groundstation.cli"], settings)  # noqa: S606
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 100, 0, 0))
    seen = b""
    try:
        while FRAME not in seen:
            if time.perf_counter() - began > LIMIT_S:
                raise TimeoutError(f"no first frame within {LIMIT_S:g} s")
            if select.select([terminal], [], [], 0.1)[0]:
                seen += os.read(terminal, 65536)
        wall = time.perf_counter() - began
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(terminal)
    return wall, children_s(before)


def children_s(before: os.times_result) -> float:
    """Processor seconds of the children that ended since."""
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def medians(runs: int = RUNS) -> dict[str, tuple[float, float]]:
    """What was started, and its median wall and processor seconds; one run beforehand fills the caches."""
    out = {}
    for arguments in COMMANDS:
        start_s(arguments)
        wall, processor = zip(*(start_s(arguments) for _ in range(runs)), strict=True)
        out["groundstation " + " ".join(arguments)] = statistics.median(wall), statistics.median(processor)
    first_frame_s()
    wall, processor = zip(*(first_frame_s() for _ in range(runs)), strict=True)
    out["groundstation, first frame"] = statistics.median(wall), statistics.median(processor)
    return out


def main() -> None:
    """Print the medians."""
    for name, (wall, processor) in medians().items():
        print(f"{name:<28} {1e3 * wall:6.0f} ms, {1e3 * processor:5.0f} ms of processor (median of {RUNS})")


if __name__ == "__main__":
    main()
