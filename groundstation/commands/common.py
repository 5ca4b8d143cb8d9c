"""What all commands share: their result, their options, progress on standard error."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from groundstation.errors import BadInput

if TYPE_CHECKING:
    from groundstation.flightdata import FlightData
    from groundstation.vehicle import Vehicle

F = Callable[..., Any]
LOGS = Path("logs")


@dataclass(frozen=True, slots=True)
class Result:
    """What a command found: the JSON document, the same for people, and the exit status (docs/formats.md)."""

    document: Mapping[str, Any]
    text: str
    exit_status: int = 0


def example(line: str) -> str:
    r"""An epilog that click leaves alone."""
    return f"\b\nExample:\n  {line}"


def json_option(function: F) -> F:
    """``--json``; read by ``groundstation.cli.main``, which prints the document."""
    return click.option(
        "--json", "as_json", is_flag=True, expose_value=False, help="Print one JSON document and nothing else."
    )(function)


def logs_option(function: F) -> F:
    """``--logs``: where flights are kept."""
    return click.option(
        "--logs",
        type=click.Path(path_type=Path),
        default=LOGS,
        show_default=True,
        help="Folder that holds the flights.",
    )(function)


def seconds_pair(value: str) -> tuple[float, float]:
    """``12.0:13.5`` as two numbers.

    Raises:
        BadInput: it is no pair, or runs backwards.
    """
    try:
        start, end = (float(part) for part in value.split(":"))
    except ValueError:
        raise BadInput(f"'{value}' is no stretch of time; write start:end in seconds, e.g. 12.0:13.5.") from None
    if not start < end:
        raise BadInput(f"'{value}' ends before it starts; write start:end in seconds, e.g. 12.0:13.5.")
    return start, end


def assignments(pairs: tuple[str, ...]) -> dict[str, float]:
    """``name=number`` options as a dictionary.

    Raises:
        BadInput: one of them is something else.
    """
    out: dict[str, float] = {}
    for pair in pairs:
        name, _, number = pair.partition("=")
        try:
            out[name] = float(number)
        except ValueError:
            raise BadInput(f"'{pair}' sets nothing; write name=number, e.g. speed_max_m_s=0.8.") from None
    return out


class ProgressLine:
    """Progress on standard error: one line rewritten on a terminal, a line now and then elsewhere."""

    def __init__(self, every_s: float = 1.0, clock: Callable[[], float] = time.monotonic):
        self._terminal = sys.stderr.isatty()
        self._every_s = 0.1 if self._terminal else every_s
        self._clock = clock
        self._last_s = -1e9
        self._width = 0
        self._word = ""

    def fraction(self, fraction: float, text: str) -> None:
        """Progress of a computation."""
        self._show(f"{100 * fraction:3.0f} %  {text}", force=fraction >= 1.0)

    def say(self, text: str) -> None:
        """A line of a flight's progress; one that begins with another word than the last always shows."""
        word = text.split(maxsplit=1)[0] if text else ""
        self._show(text, force=word != self._word)
        self._word = word

    def _show(self, text: str, *, force: bool) -> None:
        now = self._clock()
        if not force and now - self._last_s < self._every_s:
            return
        self._last_s = now
        if self._terminal:
            print(f"\r{text[:200].ljust(self._width)}", end="", file=sys.stderr, flush=True)
            self._width = len(text)
        else:
            print(text, file=sys.stderr, flush=True)

    def end(self) -> None:
        """Leave the line."""
        if self._terminal and self._width:
            print(file=sys.stderr)
            self._width = 0


def load_vehicle_option(value: str | None) -> Vehicle | None:
    """The vehicle named on the command line: a file, or one that ships."""
    from groundstation import api

    return None if value is None else api.load_vehicle(value)


def load_flights(
    paths: tuple[Path, ...], vehicle: str | None, start_s: float | None = None, end_s: float | None = None
) -> list[FlightData]:
    """Read flights of any format, with the vehicle of the command line over the recorded one."""
    from groundstation import api

    declared = load_vehicle_option(vehicle)
    return [api.load_flight(path, vehicle=declared, start_s=start_s, end_s=end_s) for path in paths]


def result_folder(path: Path, logs: Path) -> Path:
    """Where results go: beside an MCAP recording; for any other input a folder of its own in ``logs``."""
    from groundstation.recording import flight_file

    path = flight_file(path)
    if path.suffix == ".mcap":
        return path.parent
    return logs / (path.name if path.is_dir() else path.stem)
