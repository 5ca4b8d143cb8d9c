"""Foreign logs read by :mod:`drivers.foreign` in a process of its own: a log that takes too much ends in one sentence."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from drivers.foreign import REFUSED, Decoded, unpack
from groundstation.errors import BadInput
from groundstation.outside import require_file, shown

MEMORY_BYTES, MEMORY_PER_BYTE = 512 * 1024 * 1024, 20
"""A log's tables as Python objects take up to about thirteen times its size."""
SECONDS, SECONDS_PER_MB = 12, 3
"""Of processor time: thirty times what the slower library takes for a sound log, and under 20 s for a small one."""
WALL_RATIO = 10
"""Of wall time to processor time, for a machine that others keep busy."""


def read_tables(kind: str, path: Path, wanted: Sequence[str] | Mapping[str, Sequence[str]]) -> Decoded:
    """The messages that are wanted of a log.

    Args:
        kind: a key of ``drivers.foreign.DECODERS``.
        path: of the log.
        wanted: names of topics, or fields by message.

    Raises:
        BadInput: the library cannot read it, or not within the limits.
    """
    require_file(path, "a log")
    megabytes = path.stat().st_size / 1e6
    seconds = SECONDS + int(SECONDS_PER_MB * megabytes)
    memory = MEMORY_BYTES + int(MEMORY_PER_BYTE * megabytes * 1e6)
    request = {"kind": kind, "path": str(path.resolve()), "wanted": wanted}
    command = [sys.executable, "-P", "-m", "drivers.foreign", json.dumps({"memory": memory, "seconds": seconds})]
    too_much = f"{path}: cannot be read within {seconds} s and {memory >> 20} MB; its figures are damaged or made up. "
    too_much += "Download the log again."
    try:
        done = subprocess.run(
            [*command, json.dumps(request)],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=WALL_RATIO * seconds,
            check=False,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        )
    except subprocess.TimeoutExpired:
        raise BadInput(too_much) from None
    said = shown(done.stderr.decode("utf-8", "replace").strip().rpartition("\n")[2], limit=200)
    if done.returncode == REFUSED and said != "MemoryError":
        raise BadInput(f"{path}: is damaged ({said}); download the log again.")
    if done.returncode in (REFUSED, -signal.SIGXCPU, -signal.SIGKILL, -signal.SIGSEGV, -signal.SIGABRT):
        raise BadInput(too_much)
    if done.returncode:
        raise BadInput(f"{path}: the reader of such logs ended ({said}); install groundstation again.")
    try:
        return unpack(done.stdout)
    except ValueError as error:
        raise BadInput(f"{path}: is damaged ({error}); download the log again.") from None
