"""What all commands share: their result, their options, progress on standard error."""

from __future__ import annotations

import difflib
import functools
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import click

from groundstation.errors import BadInput
from groundstation.texts import file_name, shown

if TYPE_CHECKING:
    from groundstation.flightdata import FlightData
    from groundstation.vehicle import Vehicle

F = Callable[..., Any]
LOGS = Path("logs")
SAME_LINE_S = 10.0
"""How often a line that says the same again is printed where it cannot be rewritten."""


@dataclass(frozen=True, slots=True)
class Result:
    """What a command found: the JSON document, the same for people, and the exit status (docs/formats.md)."""

    document: Mapping[str, Any]
    text: str
    exit_status: int = 0


def example(line: str) -> str:
    r"""An epilog that click leaves alone."""
    return f"\b\nExample:\n  {line}"


def packed(kind: type[Any]) -> Callable[[Callable[..., Result]], Callable[..., Result]]:
    """A decorator of a command: options that a dataclass has fields for reach it as one object of that, its first
    argument; objects of such decorators above it follow.
    """
    names = {field.name for field in fields(kind)}

    def decorate(function: Callable[..., Result]) -> Callable[..., Result]:
        @functools.wraps(function)
        def command(*packs: object, **values: object) -> Result:
            own = {name: values.pop(name) for name in names & set(values)}
            return function(kind(**own), *packs, **values)

        return command

    return decorate


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


_LARGE = 20_000_000
"""Bytes of a log that takes seconds to read, which is said before."""
_QUIET_S = 1.5
"""Nobody waits two seconds without a word."""


def suggestion(given: str, known: Iterable[str]) -> str:
    """What was probably meant, else all there is, as a sentence."""
    near = difflib.get_close_matches(given.lower(), list(known), n=2, cutoff=0.55)
    return f"Did you mean {' or '.join(near)}?" if near else f"There are {', '.join(known)}."


class Choice(click.Choice[str]):
    """A choice whose fault names the nearest value; ``others`` are names that people use for one of them."""

    def __init__(self, choices: Sequence[str], others: Mapping[str, str] | None = None):
        super().__init__(choices)
        self._others = dict(others or {})

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The value, or a fault with a suggestion."""
        if value in self.choices:
            return value
        meant = self._others.get(value.lower())
        hint = f"Did you mean {meant}?" if meant else suggestion(value, self.choices)
        self.fail(f"'{value}' is not one of them. {hint}", param, ctx)


class ProgressLine:
    """Progress on standard error: on a terminal one line that is rewritten and fits, with the time left; else a line
    now and then.
    """

    _open: ClassVar[ProgressLine | None] = None

    def __init__(self, every_s: float = 1.0, clock: Callable[[], float] = time.monotonic):
        self._terminal = sys.stderr.isatty()
        self._every_s = 0.1 if self._terminal else every_s
        self._clock = clock
        self._last_s = -1e9
        self._width = 0
        self._word = ""
        self._began: float | None = None
        self._last_text = ""
        self._shown = ""

    def fraction(self, fraction: float, text: str) -> None:
        """Progress of a computation."""
        text = shown(text)
        self._last_text = text
        self._show(f"{100 * fraction:3.0f} %  {self._left(fraction)}{text}", force=fraction >= 1.0)

    def _left(self, fraction: float) -> str:
        """Time left, once a second and a twentieth of the work are behind; it assumes that the work goes on as it
        went.
        """
        now = self._clock()
        if self._began is None:
            self._began = now
        spent = now - self._began
        if fraction >= 1.0 or fraction < 0.05 or spent < 1.0:
            return ""
        left = spent * (1.0 - fraction) / fraction
        return f"{left:.0f} s left  " if left < 100.0 else f"{left / 60.0:.0f} min left  "

    def say(self, text: str) -> None:
        """A line of a flight's progress; one that begins with another word than the last always shows."""
        text = shown(text)
        word = text.split(maxsplit=1)[0] if text else ""
        self._show(text, force=word != self._word)
        self._word = word

    def _show(self, text: str, *, force: bool) -> None:
        now = self._clock()
        quiet_s = SAME_LINE_S if text == self._shown and not self._terminal else self._every_s
        if not force and now - self._last_s < quiet_s:
            return
        self._last_s, self._shown = now, text
        if self._terminal:
            shown = text[: max(shutil.get_terminal_size().columns - 1, 20)]
            print(f"\r{shown.ljust(self._width)}", end="", file=sys.stderr, flush=True)
            self._width = len(shown)
            ProgressLine._open = self
        else:
            print(text, file=sys.stderr, flush=True)

    @contextmanager
    def ticking(self, text: str) -> Iterator[None]:
        """Say how long something takes that tells nothing of itself, whenever the line was quiet for a second and a
        half.
        """
        done, begun = threading.Event(), self._clock()

        def tick() -> None:
            while not done.wait(0.25):
                self.quiet(text, begun)

        thread = threading.Thread(target=tick, name="progress", daemon=True)
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join()
            self.end()

    def quiet(self, text: str, begun_s: float) -> None:
        """Say how long it has been going on, where the line was quiet for too long."""
        now = self._clock()
        if now - max(self._last_s, begun_s) >= _QUIET_S:
            self._show(f"{self._last_text or text}: {now - begun_s:.0f} s", force=True)

    def end(self) -> None:
        """Leave the line."""
        if self._terminal and self._width:
            print(file=sys.stderr)
            self._width = 0
        ProgressLine._open = None

    @classmethod
    def end_open(cls) -> None:
        """Leave the line that is being written, whosever it is: what follows begins a line of its own."""
        if cls._open is not None:
            cls._open.end()


def load_vehicle_option(value: str | None) -> Vehicle | None:
    """The vehicle named on the command line: a file, or one that ships."""
    from groundstation import api

    return None if value is None else api.load_vehicle(value)


def require_there(path: Path) -> None:
    """Refuse a path that leads nowhere before anything heavy is loaded.

    Raises:
        BadInput: there is nothing.
    """
    if not path.exists():
        raise BadInput(f"{path}: there is no such file or folder.")


def load_flights(
    paths: tuple[Path, ...],
    vehicle: str | None,
    start_s: float | None = None,
    end_s: float | None = None,
    everything: bool = False,
) -> list[FlightData]:
    """Read flights of any format, with the vehicle of the command line over the recorded one; progress meanwhile."""
    from groundstation import api

    for path in paths:
        require_there(path)
    declared = load_vehicle_option(vehicle)
    flights: list[FlightData] = []
    for path in paths:
        line = ProgressLine()
        if path.is_file() and path.stat().st_size > _LARGE:
            line.say(f"reading {path.name} ({path.stat().st_size / 1e6:.0f} MB)")
        with line.ticking(f"reading {path.name}"):
            flights.append(api.load_flight(path, vehicle=declared, start_s=start_s, end_s=end_s, everything=everything))
    return flights


def result_folder(path: Path, logs: Path) -> Path:
    """Where results go: beside an MCAP recording; for any other input a folder of its own in ``logs``."""
    from groundstation.recording import flight_file

    path = flight_file(path)
    if path.suffix == ".mcap":
        return path.parent
    place = path.resolve()
    return logs / file_name(place.name if place.is_dir() else place.stem)
