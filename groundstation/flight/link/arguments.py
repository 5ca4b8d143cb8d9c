"""The link process's command line, and what follows from it."""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from groundstation.flight.link.parameter_journal import ParameterJournal
from groundstation.flight.link.signing_memory import SigningMemory, signing_memory


@dataclass(frozen=True, slots=True)
class Kept:
    """What a link writes down.

    Attributes:
        journal: remembers changed parameters through a crash.
        raw_log: where frames of both directions go, as a telemetry log; None keeps none.
        memory: of the stamps of a signed link; None for an unsigned one.
    """

    journal: ParameterJournal
    raw_log: Path | None = None
    memory: SigningMemory | None = None


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The options of one link process."""
    parser = argparse.ArgumentParser(
        prog="groundstation.flight.link.process", description="the link process of one vehicle"
    )
    parser.add_argument("--link", required=True, help="serial:///dev/ttyACM0:921600, udpin://127.0.0.1:14540, ...")
    parser.add_argument("--vehicle", type=Path, required=True)
    parser.add_argument("--station", default="default")
    parser.add_argument("--drone", required=True, help="name on the bus")
    parser.add_argument("--connect", required=True, help="zenoh endpoint of the core")
    parser.add_argument(
        "--system", type=int, help="the vehicle's system id; default the station file's, else the first heard"
    )
    parser.add_argument("--force", action="append", default=[], metavar="NAME", help="fly although this check fails")
    parser.add_argument(
        "--set-parameters", action="store_true", help="set what the flight needs, restore it afterwards"
    )
    parser.add_argument("--bytes-per-s", type=float, help="what the link carries, e.g. a radio behind USB")
    parser.add_argument("--raw-log", type=Path, help="telemetry log of every frame")
    parser.add_argument("--journal", type=Path, help="where changed parameters are remembered through a crash")
    parser.add_argument("--take-over", choices=("", "land", "hold"), default="", help="of a vehicle in flight")
    parser.add_argument("--key-file", type=Path, help="32-byte signing key; signs and verifies every frame")
    return parser.parse_args(arguments)


def bandwidth_of(url: str) -> float | None:
    """Bytes a second of a serial line (10 bits a byte); None elsewhere."""
    if not url.startswith("serial://"):
        return None
    number = url.rsplit(":", 1)[-1]
    return (int(number) if number.isdigit() else 57600) / 10.0


def free_bytes(raw_log: Path | None) -> Callable[[], int | None]:
    """How much room there is where the raw log goes; None without one."""
    return lambda: None if raw_log is None else shutil.disk_usage(raw_log.parent).free


def signing_of(path: Path | None, journal: Path | None) -> SigningMemory | None:
    """The key and what is remembered of it, beside the journal; None for an unsigned link."""
    if path is None:
        return None
    memory = None if journal is None else journal.with_name("signing.json")
    return signing_memory(path, memory)
