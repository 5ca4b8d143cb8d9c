"""The onboard log after landing: which one it is, fetch it with progress, resume a fetch that broke off.

What came is kept in ``NAME.part`` until the log is whole, so that a second try goes on where the first stopped. Logs are told
apart by time stamp, because ids are in no order of time; without stamps the highest id counts.

    python -P -m groundstation.flight.link.onboard_log --link udpin://127.0.0.1:14540 --vehicle x500 --folder logs/FLIGHT
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any

from drivers.mavlink.dialect import message_id
from drivers.mavlink.exchange import Ask, Conversation
from drivers.mavlink.logs import LogEntry, LogError, Logs
from drivers.mavlink.transports import open_transport
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


def fetch_onboard_log(
    url: str,
    vehicle: Vehicle,
    folder: Path,
    progress: Callable[[float, str], None] = lambda _f, _t: None,
    *,
    number: int | None = None,
    timeout_s: float = 600.0,
    key_file: Path | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> Path:
    """Fetch the newest onboard log (or one by number) into ``folder/onboard.ulg`` or ``.bin``.

    Raises:
        Refused: no vehicle, no log, or it stopped; what came so far is kept, and the next call goes on from there.
        ConnectionError: the link cannot be opened.
    """
    transport = open_transport(url)
    options = Options(bytes_per_s=bandwidth_of(url), keep_raw=False, quiet=True)
    memory = None if key_file is None else signing_memory(key_file, folder.parent / "signing.json")
    core = LinkCore(vehicle, load_station(), options, None if memory is None else memory.signing)
    core.datagrams = transport.datagrams
    deadline = clock() + timeout_s

    def turn() -> None:
        if not core.waiting:
            transport.wait(timeouts.LOG_FETCH_WAIT_S)
        for data in core.step(clock(), transport.read()).send:
            transport.write(data)
        if core.peer is not None:
            transport.answer(core.peer)

    def run(steps: Generator[Any, Any, Any]) -> Any:
        talk: Conversation[Any] = core.converse(steps)
        while not talk.done:
            if clock() > deadline:
                talk.cancel()
                raise Refused(f"the log did not come within {timeout_s:g} s.")
            turn()
        if talk.error is not None:
            raise talk.error
        return talk.result

    try:
        found_by = clock() + timeouts.LOG_FETCH_HEARD_S
        while core.view is None:
            if clock() > found_by:
                raise Refused("no vehicle is heard on the link.", transport.trouble or "Check it, and fetch again.")
            turn()
        profile = core.view.profile
        if options.bytes_per_s is not None:
            run(silenced(profile))
        logs = Logs(profile.system, profile.component)
        entries: list[LogEntry] = run(logs.list())
        entry = newest(entries) if number is None else next((e for e in entries if e.number == number), None)
        if entry is None:
            known = ", ".join(str(e.number) for e in entries) or "none"
            raise Refused("the vehicle offers no such log.", f"Logs on board: {known}. Is logging switched on?")
        part = folder / f"onboard-{entry.number}.part"
        data = bytearray(part.read_bytes() if part.is_file() else b"")
        begun, had = clock(), len(data)

        def tell(count: int, size: int) -> None:
            speed = (count - had) / max(clock() - begun, 1e-3)
            progress(
                count / size,
                f"onboard log {entry.number}: {count / 1e6:.1f} of {size / 1e6:.1f} MB, {speed / 1e3:.0f} kB/s",
            )

        try:
            run(logs.fetch(entry, data, tell))
        except (LogError, Refused) as error:
            write_whole(part, bytes(data))
            raise Refused(
                f"{error}", f"{len(data)} of {entry.size} bytes are in {part}; fetch again to go on."
            ) from None
        path = folder / f"onboard{profile.log_suffix}"
        write_whole(path, bytes(data))
        part.unlink(missing_ok=True)
        return path
    finally:
        transport.close()
        if memory is not None:
            memory.write()


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
            number=options.number,
            key_file=options.key_file,
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
