"""A foreign library that expands what it reads, in a process of its own with limits of memory, disk and time.

    python -P -m groundstation.recording.confined

reads a pickled call from its parent on standard input and answers on standard output. ``rosbags`` decompresses whatever
a bag says, however far that expands; only the system can bound it. Small bags without compression are read in place,
since the process costs a second.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Concatenate, ParamSpec, TypeVar

from groundstation.errors import BadInput

SMALL = 20_000_000
"""Bytes of a bag that is read in place where nothing in it is compressed."""
FREE, RATIO = 1 << 30, 24
"""Bytes that a bag may take, in memory or on the disk, beside so many times its own size; recordings compress tenfold
at most.
"""
LEAST_S, PER_MB_S = 60.0, 2.0
"""The library reads some megabytes a second where the machine is busy."""
_MARKS = (b"zstd", b"lz4", b"\x28\xb5\x2f\xfd", b"\x04\x22\x4d\x18")
"""Names of compressions, and what their files begin with (RFC 8878; LZ4 frame format)."""
_INSIDE = "GROUNDSTATION_CONFINED"

P = ParamSpec("P")
R = TypeVar("R")


def confined(function: Callable[Concatenate[Path, P], R]) -> Callable[Concatenate[Path, P], R]:
    """A function of ``groundstation.recording.rosbag`` that runs in a process of its own where its bag asks for
    that.
    """

    @wraps(function)
    def run(path: Path, *args: P.args, **kwargs: P.kwargs) -> R:
        size, packed = _size(path)
        if _INSIDE in os.environ:
            return function(path, *args, **kwargs)
        if not (packed or size > SMALL):
            try:
                return function(path, *args, **kwargs)
            except MemoryError:  # a damaged size that the library asks memory for before it looks at the file
                raise BadInput(f"{path}: is damaged (a record longer than the memory); record it again.") from None
        return _elsewhere(function.__name__, path, size, (path, *args), kwargs)

    return run


def _size(path: Path) -> tuple[int, bool]:
    """Bytes of a bag, and whether one that is small holds anything compressed."""
    try:
        files = [path] if path.is_file() else [file for file in path.iterdir() if file.is_file()]
        size = sum(file.stat().st_size for file in files)
        packed = size <= SMALL and any(
            mark in data for file in files for data in [file.read_bytes()] for mark in _MARKS
        )
    except OSError:
        return 0, False  # the reader says what is wrong with it
    return size, packed


def _elsewhere(name: str, path: Path, size: int, args: tuple[object, ...], kwargs: dict[str, object]):
    """The same in a child; whatever comes of it there is a value or a sentence here."""
    limit_s, room = LEAST_S + PER_MB_S * size / 1e6, FREE + RATIO * size
    command = [sys.executable, "-P", "-m", "groundstation.recording.confined"]
    with tempfile.TemporaryDirectory(prefix="groundstation-") as scratch:
        environment = {
            **os.environ,
            _INSIDE: "1",
            "TMPDIR": scratch,
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
        }
        call = pickle.dumps((name, args, kwargs, room))
        try:
            done = subprocess.run(
                command, input=call, capture_output=True, timeout=limit_s, env=environment, check=False
            )
        except subprocess.TimeoutExpired:
            raise BadInput(f"{path}: could not be read within {limit_s:.0f} s; record it again, or cut it.") from None
    if done.returncode != 0:
        raise BadInput(
            f"{path}: its {size} bytes take more than the {room >> 20} MiB that they may, or end the library that "
            "reads them; record it again without compression."
        )
    good, answer = pickle.loads(done.stdout)  # noqa: S301  our own child's, over a pipe
    if not good:
        raise BadInput(answer)
    return answer


def _limit(room: int) -> None:
    """Bound this process's memory and the files that it writes."""
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[0])
        used = pages * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + room, used + room))
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
    except (ImportError, OSError, ValueError):
        return  # a system without such limits; the time is bounded still


def main() -> int:
    """The child: one call, one answer; status 1 when memory or disk did not suffice."""
    out = os.dup(1)
    os.dup2(2, 1)  # what a library prints is no answer
    name, args, kwargs, room = pickle.loads(sys.stdin.buffer.read())  # noqa: S301  from our own parent
    from groundstation.recording import rosbag

    _limit(room)
    try:
        answer: tuple[bool, object] = (True, getattr(rosbag, name)(*args, **kwargs))
    except BadInput as error:
        answer = (False, str(error))
    except MemoryError:
        return 1
    with os.fdopen(out, "wb") as file:
        pickle.dump(answer, file, protocol=pickle.HIGHEST_PROTOCOL)
    return 0


if __name__ == "__main__":
    sys.exit(main())
