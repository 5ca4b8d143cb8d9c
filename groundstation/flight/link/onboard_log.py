r"""The onboard log after landing: which one it is, fetch it with progress, resume a fetch that broke off.

What came is kept in ``NAME.part`` until the log is whole, so that a second try goes on where the first stopped. Logs
are told apart by time stamp, because ids are in no order of time; without stamps the highest id counts.

    python -P -m groundstation.flight.link.onboard_log --link udpin://127.0.0.1:14540 \\
        --vehicle x500 --folder logs/FLIGHT
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.mavlink.dialect import message_id
from drivers.mavlink.exchange import Ask, Conversation
from drivers.mavlink.logs import LogEntry, LogError, Logs
from drivers.mavlink.transports import Transport, open_transport
from groundstation.errors import BadInput, GroundStationError, Refused
from groundstation.flight import timeouts
from groundstation.flight.link.arguments import bandwidth_of
from groundstation.flight.link.link_core import LinkCore, Options
from groundstation.flight.link.prepare import acknowledges_interval
from groundstation.flight.link.profiles import Profile
from groundstation.flight.link.signing_memory import signing_memory
from groundstation.flight.station import load_station
from groundstation.paths import find_config
from groundstation.vehicle import Vehicle, load_vehicle
from groundstation.writing import write_whole


def newest(entries: list[LogEntry]) -> LogEntry | None:
    """The log of the flight just flown."""
    return max(entries, key=lambda e: (e.time_utc_s, e.number), default=None)


def silenced(profile: Profile) -> Generator[Ask, Any, None]:
    """Switch off what a flight had asked for: on a line it takes three quarters of what a log could use."""
    for wish in profile.streams:
        yield Ask((profile.interval(message_id(wish.name), 0.0),), acknowledges_interval, 0.5, 2)


@dataclass(frozen=True, slots=True)
class LogRequest:
    """Which log is fetched, and how.

    Attributes:
        number: of the log; None the newest.
        timeout_s: for the whole fetch.
        key_file: of a signed link.
    """

    number: int | None = None
    timeout_s: float = 600.0
    key_file: Path | None = None


NEWEST = LogRequest()


def fetch_onboard_log(
    url: str,
    vehicle: Vehicle,
    folder: Path,
    progress: Callable[[float, str], None] = lambda _f, _t: None,
    *,
    request: LogRequest = NEWEST,
    clock: Callable[[], float] = time.monotonic,
) -> Path:
    """Fetch an onboard log into ``folder/onboard.ulg`` or ``.bin``.

    Raises:
        Refused: no vehicle, no log, or it stopped; what came so far is kept, and the next call goes on from there.
        ConnectionError: the link cannot be opened.
    """
    transport = open_transport(url)
    options = Options(bytes_per_s=bandwidth_of(url), keep_raw=False, quiet=True)
    key_file = request.key_file
    memory = None if key_file is None else signing_memory(key_file, folder.parent / "signing.json")
    core = LinkCore(vehicle, load_station(), options, None if memory is None else memory.signing)
    core.datagrams = transport.datagrams
    line = _Line(core, transport, clock, clock(), request.timeout_s)
    try:
        profile = line.profile_heard()
        if options.bytes_per_s is not None:
            line.run(silenced(profile))
        logs = Logs(profile.system, profile.component)
        entry = _wanted(line.run(logs.list()), request.number)
        data = _fetched(line, logs, entry, folder / f"onboard-{entry.number}.part", progress)
        path = folder / f"onboard{profile.log_suffix}"
        write_whole(path, data)
        (folder / f"onboard-{entry.number}.part").unlink(missing_ok=True)
        return path
    finally:
        transport.close()
        if memory is not None:
            memory.write()


@dataclass(frozen=True, slots=True)
class _Line:
    """The link of a fetch: one conversation after another, until the time is up."""

    core: LinkCore
    transport: Transport
    clock: Callable[[], float]
    begun_s: float
    timeout_s: float

    def turn(self) -> None:
        """Read, answer and write once."""
        if not self.core.waiting:
            self.transport.wait(timeouts.LOG_FETCH_WAIT_S)
        for data in self.core.step(self.clock(), self.transport.read()).send:
            self.transport.write(data)
        if self.core.peer is not None:
            self.transport.answer(self.core.peer)

    def profile_heard(self) -> Profile:
        """The autopilot's profile, once it is heard."""
        found_by = self.clock() + timeouts.LOG_FETCH_HEARD_S
        while self.core.view is None:
            if self.clock() > found_by:
                raise Refused(
                    "no vehicle is heard on the link.", self.transport.trouble or "Check it, and fetch again."
                )
            self.turn()
        return self.core.view.profile

    def run(self, steps: Generator[Any, Any, Any]) -> Any:
        """The result of a conversation with the vehicle."""
        talk: Conversation[Any] = self.core.converse(steps)
        while not talk.done:
            if self.clock() > self.begun_s + self.timeout_s:
                talk.cancel()
                raise Refused(f"the log did not come within {self.timeout_s:g} s.")
            self.turn()
        if talk.error is not None:
            raise talk.error
        return talk.result


def _wanted(entries: list[LogEntry], number: int | None) -> LogEntry:
    entry = newest(entries) if number is None else next((e for e in entries if e.number == number), None)
    if entry is None:
        known = ", ".join(str(e.number) for e in entries) or "none"
        raise Refused("the vehicle offers no such log.", f"Logs on board: {known}. Is logging switched on?")
    return entry


def _fetched(line: _Line, logs: Logs, entry: LogEntry, part: Path, progress: Callable[[float, str], None]) -> bytes:
    """The whole log, from where ``part`` stopped; what came stays in ``part`` when it breaks off again."""
    data = bytearray(part.read_bytes() if part.is_file() else b"")
    begun, had = line.clock(), len(data)

    def tell(count: int, size: int) -> None:
        speed = (count - had) / max(line.clock() - begun, 1e-3)
        told = f"{count / 1e6:.1f} of {size / 1e6:.1f} MB, {speed / 1e3:.0f} kB/s"
        progress(count / size, f"onboard log {entry.number}: {told}")

    try:
        line.run(logs.fetch(entry, data, tell))
    except (LogError, Refused) as error:
        write_whole(part, bytes(data))
        raise Refused(f"{error}", f"{len(data)} of {entry.size} bytes are in {part}; fetch again to go on.") from None
    return bytes(data)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point: fetch a log, or go on with one."""
    parser = argparse.ArgumentParser(prog="groundstation.flight.link.onboard_log", description=__doc__)
    parser.add_argument("--link", required=True)
    parser.add_argument("--vehicle", required=True)
    parser.add_argument("--folder", type=Path, required=True, help="where it goes, e.g. beside the flight's recording")
    parser.add_argument("--key-file", type=Path, help="32-byte signing key, as for the flight")
    parser.add_argument("--number", type=int, help="of the log; default the newest")
    options = parser.parse_args(arguments)
    try:
        vehicle = load_vehicle(find_config("vehicles", options.vehicle))
        path = fetch_onboard_log(
            options.link,
            vehicle,
            options.folder,
            lambda _f, text: print(text, file=sys.stderr),
            request=LogRequest(options.number, key_file=options.key_file),
        )
    except GroundStationError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    except (ValueError, ConnectionError) as error:
        print(error, file=sys.stderr)
        return BadInput.exit_status
    print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
