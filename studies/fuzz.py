"""Mutated inputs over every reader of files from outside: none may crash, hang over 20 s, or take more than 1 GB
(``benchmarks.fuzz``).

Seeds lie in tests/corpus, one folder a reader. Input k of a reader is a function of (seed, reader, k) alone. Inputs run
in child processes, one for up to two thousand inputs, that the system holds to 1 GB and that end themselves where one
input takes 20 s.
"""

from __future__ import annotations

import contextlib
import faulthandler
import json
import mmap
import os
import random
import shutil
import struct
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

from groundstation.errors import GroundStationError
from studies.fuzz_readers import READERS
from studies.mutators import mutate_folder, mutate_named

CORPUS = Path(__file__).resolve().parent.parent / "tests" / "corpus"
RESULTS = Path(__file__).resolve().parent.parent / "docs" / "results" / "fuzz.json"
SEED = 1
LONGEST_S = 20
MEMORY = 1 << 30
AT_A_TIME = 2000

Seeds = list[tuple[str, bytes | dict[str, bytes]]]


def seeds_of(reader: str) -> Seeds:
    """The sound inputs of a reader by name: bytes, or a folder as files by name."""
    found: Seeds = []
    for path in sorted((CORPUS / reader).iterdir()):
        if path.is_dir():
            files = {p.relative_to(path).as_posix(): p.read_bytes() for p in sorted(path.rglob("*")) if p.is_file()}
            found.append((path.name, files))
        else:
            found.append((path.name, path.read_bytes()))
    return found


def make_input(reader: str, seeds: Seeds, index: int, place: Path, seed: int = SEED) -> Path:
    """Input number ``index`` of a reader, written into an empty folder; every hundredth seed comes as it is."""
    rng = random.Random(f"{seed}/{reader}/{index}")
    name, content = seeds[index % len(seeds)]
    path = place / name
    if isinstance(content, bytes):
        path.write_bytes(content if index < len(seeds) else mutate_named(name, content, rng))
        return path
    for inner, data in (content if index < len(seeds) else mutate_folder(content, rng)).items():
        (path / inner).parent.mkdir(parents=True, exist_ok=True)
        (path / inner).write_bytes(data)
    return path


def run_one(reader: str, path: Path) -> str:
    """Read one input: "read", "refused", or the signature of a crash."""
    try:
        READERS[reader].read(path)
    except GroundStationError as error:
        return "refused" if "\n" not in str(error) else f"a refusal of several lines: {str(error)[:80]!r}"
    except (Exception, RecursionError) as error:
        where = traceback.extract_tb(error.__traceback__)
        ours = [
            f for f in where if "/groundstation/" in f.filename or "/sim/" in f.filename or "/drivers/" in f.filename
        ]
        at = (ours or where)[-1]
        return f"{type(error).__name__} at {Path(at.filename).name}:{at.lineno} ({str(error)[:80]!r})"
    return "read"


def child(reader: str, first: int, last: int, shared: mmap.mmap, out: int, seed: int) -> None:
    """Run inputs ``first`` to ``last``; says which is under way in ``shared`` and what came of each on ``out``."""
    import resource

    warnings.simplefilter("default")  # a test makes errors of them; an overflow in a hostile plan's numbers is no crash
    used = int(Path("/proc/self/statm").read_text().split()[0]) * mmap.PAGESIZE
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    seeds = seeds_of(reader)
    place = Path(tempfile.mkdtemp(prefix="fuzz-"))
    done: Counter[str] = Counter()
    examples: dict[str, int] = {}
    try:
        for index in range(first, last):
            shared[:8] = struct.pack("<q", index)
            faulthandler.dump_traceback_later(LONGEST_S, exit=True)
            path = make_input(reader, seeds, index, place, seed)
            outcome = run_one(reader, path)
            done[outcome] += 1
            examples.setdefault(outcome, index)
            shared[8:16] = struct.pack("<q", index + 1)
            for entry in place.iterdir():
                shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
    finally:
        faulthandler.cancel_dump_traceback_later()
        shutil.rmtree(place, ignore_errors=True)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    os.write(out, json.dumps({"done": done, "examples": examples, "peak_mb": peak}).encode())


def run_block(reader: str, first: int, last: int, seed: int) -> tuple[dict[str, Any], int]:
    """A child over a block of inputs: what came of them, and the number of the next input."""
    shared = mmap.mmap(-1, 16)
    shared[:] = struct.pack("<qq", first, first)
    read_end, write_end = os.pipe()
    sys.stdout.flush()
    pid = os.fork()
    if pid == 0:
        os.close(read_end)
        status = 1
        with contextlib.suppress(BaseException):
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, 1)
            os.dup2(null, 2)
            child(reader, first, last, shared, write_end, seed)
            status = 0
        os._exit(status)
    os.close(write_end)
    with os.fdopen(read_end, "rb") as pipe:
        said = pipe.read()
    _, status = os.waitpid(pid, 0)
    if status == 0 and said:
        return json.loads(said), last
    at, _ = struct.unpack("<qq", shared[:])
    how = "hang" if os.waitstatus_to_exitcode(status) == 1 else f"ended with {os.waitstatus_to_exitcode(status)}"
    # What the child had counted is lost with it: the inputs before are run again, without this one.
    before, _ = run_block(reader, first, at, seed) if at > first else ({"done": {}, "examples": {}, "peak_mb": 0}, at)
    signature = f"{how} (over {LONGEST_S} s or 1 GB)"
    before["done"][signature] = before["done"].get(signature, 0) + 1
    before["examples"].setdefault(signature, at)
    return before, at + 1


def warm(reader: str) -> None:
    """Read the sound inputs once, so that the children find all modules imported; not of those whose libraries start
    threads.
    """
    if reader not in _THREADED:
        for index in range(len(seeds := seeds_of(reader))):
            place = Path(tempfile.mkdtemp(prefix="fuzz-"))
            try:
                run_one(reader, make_input(reader, seeds, index, place))
            finally:
                shutil.rmtree(place, ignore_errors=True)


_THREADED = frozenset({"database"})
"""A forked child must not inherit a library that runs threads."""


class Tally:
    """Counts by reader."""

    def __init__(self) -> None:
        self.done: dict[str, Counter[str]] = {reader: Counter() for reader in READERS}
        self.examples: dict[str, dict[str, int]] = {reader: {} for reader in READERS}
        self.peak_mb = dict.fromkeys(READERS, 0)

    def add(self, reader: str, found: dict[str, Any]) -> None:
        """What a block came to."""
        self.done[reader].update(found["done"])
        for signature, index in found["examples"].items():
            self.examples[reader].setdefault(signature, index)
        self.peak_mb[reader] = max(self.peak_mb[reader], found["peak_mb"])

    def crashes(self) -> dict[str, str]:
        """Signature by its first input."""
        fine = ("read", "refused")
        return {f"{r}:{i}": s for r, each in self.examples.items() for s, i in each.items() if s not in fine}

    def total(self) -> int:
        """Inputs."""
        return sum(sum(counts.values()) for counts in self.done.values())

    def rows(self) -> list[dict[str, Any]]:
        """By reader."""
        return [
            {
                "reader": reader,
                "inputs": sum(counts.values()),
                "read": counts["read"],
                "refused": counts["refused"],
                "crashed": sum(counts.values()) - counts["read"] - counts["refused"],
                "peak_mb": self.peak_mb[reader],
            }
            for reader, counts in self.done.items()
        ]


def fuzz(
    count: int, minutes: float | None = None, seed: int = SEED, only: tuple[str, ...] = (), start: int = 0
) -> Tally:
    """So many inputs over all readers by their shares, or what fits into the minutes, in turns."""
    tally = Tally()
    shares = {name: reader.share for name, reader in READERS.items() if not only or name in only}
    total = sum(shares.values())
    quota = {name: max(start + round(count * share / total), start + 1) for name, share in shares.items()}
    nexts = dict.fromkeys(shares, start)
    for name in shares:
        warm(name)
    end_s = None if minutes is None else time.monotonic() + 60.0 * minutes
    turns = max(1, count // (AT_A_TIME * len(shares)))
    while any(nexts[name] < quota[name] for name in shares):
        for name in shares:
            if end_s is not None and time.monotonic() > end_s:
                return tally
            last = min(quota[name], nexts[name] + max(1, min(AT_A_TIME, -(-(quota[name] - start) // turns))))
            while nexts[name] < last:
                found, nexts[name] = run_block(name, nexts[name], last, seed)
                tally.add(name, found)
    return tally


def replay(text: str, seed: int) -> None:
    """One input in this process, with its traceback."""
    reader, _, index = text.partition(":")
    place = Path(tempfile.mkdtemp(prefix="fuzz-"))
    path = make_input(reader, seeds_of(reader), int(index), place, seed)
    print(f"{reader} input {index} of seed {seed}: {path}")
    READERS[reader].read(path)
