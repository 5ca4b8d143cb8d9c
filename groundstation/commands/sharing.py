"""``groundstation station``: share this station with other machines, and make, keep and withdraw passes."""

from __future__ import annotations

import datetime
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from drivers.secure import GATE_PORT, PASS_ROLES, POSES_PORT, PassRole
from groundstation.commands.common import Choice, ProgressLine, Result, example, json_option, logs_option
from groundstation.errors import BadInput, GroundStationError, LinkLost, Refused
from groundstation.json_types import JsonObject

if TYPE_CHECKING:
    from groundstation.flight.share.passes import Pass

SCHEMA = "groundstation.station/1"
ANYWHERE = "0.0.0.0"  # noqa: S104 - listened on with certificates alone
GATE_NICE = 5
"""Below what flies: whoever floods the gate takes no processor time from link and core."""
SYSTEMS = ("natnet", "qtm", "vicon", "vrpn", "zenoh", "ros2", "mavlink")


@dataclass(frozen=True, slots=True)
class Asked:
    """The options beside the one that says what to do."""

    role: PassRole
    address: tuple[str, ...]
    out: Path | None
    listen: str | None
    host: str
    logs: Path

    def endpoint(self, port: int) -> str:
        """Where to listen.

        Raises:
            BadInput: the port is none.
        """
        from groundstation.flight.share.remote import place_of

        host, given = place_of(self.listen or ANYWHERE)
        return f"tls/{host}:{given if self.listen and ':' in self.listen else port}"


@click.command(epilog=example("groundstation station --invite laptop --role operate"))
@click.option("--share", is_flag=True, help="Share this station's flights with who has a pass, until Ctrl-C.")
@click.option("--invite", metavar="NAME", help="Make a pass for another machine.")
@click.option("--withdraw", metavar="NAME", help="From now on the pass of that name is good for nothing.")
@click.option("--accept", metavar="FILE", help="Keep a pass that another station gave.")
@click.option("--watch", metavar="HOST", help="Print what another station says, until Ctrl-C or the flight's end.")
@click.option("--abort", metavar="HOST", help="Abort the flight of another station: the vehicle lands.")
@click.option(
    "--poses", metavar="SYSTEM", type=Choice(SYSTEMS), help="Give this computer's motion capture to the station."
)
@click.option(
    "--role", type=Choice(PASS_ROLES), default="watch", show_default=True,
    help="With --invite. watch may watch and abort; operate may also take the lease and arm; poses is a camera "
         "computer.",
)  # fmt: skip
@click.option(
    "--address", multiple=True,
    help="With --share: more names or numbers of this computer. With --role poses: those of the camera computer.",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False), help="With --invite: file of the pass [NAME.pass]."
)
@click.option("--listen", metavar="ADDRESS[:PORT]", help="With --share and --poses: where to listen; else everywhere.")
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="With --poses: the capture system's server.",
)
@logs_option
@json_option
def station(
    role: str, address: tuple[str, ...], out: Path | None, listen: str | None, host: str, logs: Path, **what: Any
) -> Result:
    """Several machines: share this station, and say who may watch, operate or give poses. Without an option: who has a
    pass.

    A station listens beyond this machine only with certificates, for the passes it gave. At the station `--invite`
    makes a pass, a file to be carried to the other machine; there `--accept` keeps it, and `groundstation --station
    HOST` opens the UI.
    """
    asked = [name for name, value in what.items() if value]
    if len(asked) > 1:
        raise click.UsageError(f"--{' and --'.join(asked)} are different things to do; give one.")
    options = Asked(cast("PassRole", role), address, out, listen, host, logs)
    return _DOES[asked[0]](what[asked[0]], options) if asked else _list()


def _list() -> Result:
    from groundstation.flight.share import passes

    given, kept = passes.listed(), passes.accepted()
    document = {
        "schema": SCHEMA,
        "name": passes.station_name(),
        "given": [
            {"name": name, "role": e.role, "until": e.until, "withdrawn": e.withdrawn} for name, e in given.items()
        ],
        "accepted": [_row(each) for each in kept],
    }
    lines = [
        f"{e.role:<8} {name:<20} {'withdrawn' if e.withdrawn else f'until {e.until}'}" for name, e in given.items()
    ]
    lines = (
        ["passes given:", *lines] if lines else ["no pass was given; `groundstation station --invite NAME` makes one"]
    )
    if kept:
        lines += [
            "passes for other stations:",
            *(f"{p.role:<8} {p.station:<20} until {p.expires.date()}" for p in kept),
        ]
    return Result(document, "\n".join(lines))


def _row(given: Pass) -> JsonObject:
    return {
        "station": given.station,
        "addresses": list(given.addresses),
        "name": given.name,
        "role": given.role,
        "until": given.expires.date().isoformat(),
    }


def _invite(name: str, asked: Asked) -> Result:
    from groundstation.flight.share import passes

    out = asked.out or Path(f"{name}.pass")
    if out.exists():
        raise BadInput(f"{out}: is there already; give another file with --out.")
    made = passes.invite(name, asked.role, asked.address, _now())
    passes.write_pass(out, made)
    use = "station --poses SYSTEM" if asked.role == "poses" else f"--station {made.station}"
    text = (
        f"{out}: {name} may {_MAY[asked.role]} until {made.expires.date()}.\n"
        f"Carry it to that machine (it holds a private key), there: groundstation station --accept {out.name}; "
        f"then groundstation {use}. Delete the file."
    )
    return Result({"schema": SCHEMA, "file": str(out), **_row(made)}, text)


_MAY = {
    "watch": "watch and abort",
    "operate": "watch, abort, take the lease and arm",
    "poses": "give poses",
}


def _withdraw(name: str, _asked: Asked) -> Result:
    from groundstation.flight.share import passes

    passes.withdraw(name)
    return Result({"schema": SCHEMA, "withdrawn": name}, f"the pass of {name} is good for nothing from now on.")


def _accept(file: str, _asked: Asked) -> Result:
    from groundstation.flight.share import passes

    kept = passes.accept(Path(file))
    return Result(
        {"schema": SCHEMA, **_row(kept)}, f"kept: at {kept.station} this machine is {kept.name} ({kept.role})."
    )


def _share(_yes: bool, asked: Asked) -> Result:
    from groundstation.flight.share.sharing import share

    line, endpoint = ProgressLine(), asked.endpoint(GATE_PORT)
    if hasattr(os, "nice"):
        os.nice(GATE_NICE)
    with _until_stopped() as stop:
        share(asked.logs, endpoint, asked.address, stop, line.say)
    line.end()
    return Result({"schema": SCHEMA, "shared": endpoint}, "no longer shared; a flight goes on.")


def _poses(system: str, asked: Asked) -> Result:
    from groundstation.flight.share import passes
    from groundstation.flight.share.sharing import Cameras, publish_poses

    own = [each for each in passes.accepted() if each.role == "poses"]
    if len(own) != 1:
        raise BadInput(
            f"{len(own)} passes for poses were accepted here, one is needed: at the station "
            "`groundstation station --invite NAME --role poses --address THIS-COMPUTER`, here `--accept FILE`."
        )
    line, endpoint = ProgressLine(), asked.endpoint(POSES_PORT)
    line.say(
        f'poses of {system} at {endpoint}; the station file: system = "zenoh", host = '
        f'"tls/{own[0].addresses[0]}:{POSES_PORT}"'
    )
    with _until_stopped() as stop:
        publish_poses(Cameras(system, asked.host), endpoint, own[0], stop, line.say)
    line.end()
    return Result({"schema": SCHEMA, "poses": endpoint}, "no more poses.")


def _watch(host: str, _asked: Asked) -> Result:
    from groundstation.flight.client.rehearse import progress_line
    from groundstation.flight.sequence import FINAL
    from groundstation.flight.share import passes, remote

    line, status, said = ProgressLine(), None, False
    with _reached(BadInput), _until_stopped() as stop, remote.connect(host, passes.pass_for(host)) as client:
        client.require_heard()
        while not stop.is_set():
            shared = client.shared(0.5)
            if shared is None:
                continue
            status = remote.status_of(shared)
            if status is not None:
                line.say(progress_line(status))
                if status.phase in FINAL:
                    break
            elif not said:
                line.say(f"{shared.station}: no flight is prepared")
                said = True
    line.end()
    document: dict[str, Any] = {"schema": SCHEMA, "host": host}
    if status is None:
        return Result({**document, "flight": None}, "no flight was prepared.")
    document |= {
        "flight": status.flight,
        "phase": status.phase,
        "reason": status.reason,
        "exit_status": status.exit_status,
    }
    return Result(document, f"{status.flight}: {status.phase}{': ' + status.reason if status.reason else ''}")


def _abort(host: str, _asked: Asked) -> Result:
    from groundstation.flight.share import passes, remote

    with _reached(LinkLost), remote.connect(host, passes.pass_for(host)) as client:
        answer = client.command("abort")
    if not answer.ok:
        raise Refused(answer.reason)
    return Result({"schema": SCHEMA, "host": host, "aborted": True}, "abort: asked the vehicle to land")


_DOES: Mapping[str, Callable[[Any, Asked], Result]] = {
    "share": _share,
    "invite": _invite,
    "withdraw": _withdraw,
    "accept": _accept,
    "watch": _watch,
    "abort": _abort,
    "poses": _poses,
}


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.UTC)


@contextmanager
def _reached(kind: type[GroundStationError]) -> Iterator[None]:
    """What keeps a station from being reached, as a fault; of an abort it means that something may still fly."""
    try:
        yield
    except ConnectionError as error:
        raise kind(str(error)) from None


@contextmanager
def _until_stopped() -> Iterator[threading.Event]:
    """Set by Ctrl-C and SIGTERM; what runs ends by itself then."""
    stop = threading.Event()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number in before:
        signal.signal(number, lambda *_: stop.set())
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
