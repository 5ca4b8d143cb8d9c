"""Rehearsal: a simulated flight from plan to report, as a client of the core."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.access import Access
from groundstation.errors import BadInput, FlightAborted, LinkLost, Refused
from groundstation.flight import timeouts
from groundstation.flight.children import Child
from groundstation.flight.client.client import CoreClient, FlightOrder, connect, outcome, running_cores, start_core
from groundstation.flight.client.interrupts import Interrupts
from groundstation.flight.journal import RAW_LOG
from groundstation.flight.link.parameter_journal import left_changed
from groundstation.flight.messages import WAY, CheckStatus, CoreStatus
from groundstation.flight.sequence import FINAL, GIVEN_UP, IN_FLIGHT, Phase
from groundstation.identification.results import Estimate
from groundstation.json_types import Document
from groundstation.reporting.canonical import estimate_in
from groundstation.reporting.units import decimals, fixed, half_width, label, scale_for, split_unit

Say = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class FlightResult:
    """Where a flight's files are, and with what it ended."""

    folder: Path
    exit_status: int
    reason: str

    def files(self) -> dict[str, Path]:
        """What was written, by name; only what is there."""
        names = (
            "flight.mcap",
            "report.html",
            "identification.json",
            "identification.toml",
            "diagnosis.json",
            "next_flight.toml",
        )
        return {name: self.folder / name for name in names if (self.folder / name).is_file()}


def simulated_drone(vehicle: Path, scenario: Path, seed: int, *, real_time: bool = False) -> tuple[str, ...]:
    """Module and arguments of the simulated drone's process."""
    arguments = ("sim", "--vehicle", str(vehicle), "--scenario", str(scenario), "--seed", str(seed))
    return (*arguments, "--real-time") if real_time else arguments


@dataclass(frozen=True, slots=True)
class LinkOrder:
    """How a vehicle is reached, and what the link to it may do.

    Attributes:
        link: address, see ``drivers.mavlink.transports``.
        station: name or file of the station's limits and policy.
        force: checks whose failure does not stop a flight.
        set_parameters: change the vehicle's parameters for the flight, and restore them.
        key_file: of a signed link.
        system: the vehicle's system id; None takes the only one heard.
    """

    link: str
    station: str
    force: tuple[str, ...] = ()
    set_parameters: bool = False
    key_file: Path | None = None
    system: int | None = None


def linked_vehicle(folder: Path, vehicle: Path, order: LinkOrder) -> tuple[str, ...]:
    """Module and arguments of the link process to a MAVLink vehicle; its raw log goes beside the recording."""
    arguments = ["--link", order.link, "--vehicle", str(vehicle), "--station", order.station]
    arguments += ["--raw-log", str(folder / RAW_LOG), "--journal", str(folder.parent / "parameters.journal")]
    for name in order.force:
        arguments += ["--force", name]
    if order.set_parameters:
        arguments.append("--set-parameters")
    if order.system is not None:
        arguments += ["--system", str(order.system)]
    if order.key_file is not None:
        arguments += ["--key-file", str(order.key_file)]
    return ("groundstation.flight.link.process", *arguments)


@dataclass(frozen=True, slots=True)
class Checked:
    """Why it would not fly, empty when it would, and the answers of all checks, as far as they came."""

    reason: str
    checks: tuple[CheckStatus, ...]


def check(order: FlightOrder, *, say: Say) -> Checked:
    """Upload and check, but do not fly."""
    core, endpoint = start_core(replace(order, analyse=False))
    ready: list[bool] = []
    checks: tuple[CheckStatus, ...] = ()

    def body(client: CoreClient) -> None:
        nonlocal checks
        while core.poll() is None:
            status = client.status(0.2)
            if status is None:
                continue
            checks = status.checks or checks
            say(progress_line(status))
            if status.phase == Phase.CHECKED:
                ready.append(client.command("abort").ok)
            if ready or status.phase in FINAL:
                return

    with Interrupts() as stop, stop.ordering(core.interrupt):
        _as_client(core, endpoint, body)
    return Checked("" if ready else outcome(order.folder)[1], checks)


def _as_client(core: Child, endpoint: Access, body: Callable[[CoreClient], None]) -> None:
    """Hold the lease while ``body`` runs, then wait for the core's end; a core that ends in between is no fault here.

    Raises:
        BadInput: the core runs, but does not answer.
    """
    connected = False
    try:
        with connect(endpoint) as client:
            connected = True
            client.take_lease()
            body(client)
    except ConnectionError:
        if not connected and core.poll() is None:
            core.interrupt()
            raise BadInput(
                f"the core did not answer within {timeouts.CORE_CONNECT_S:g} s; the machine may be busy: try again. "
                "Its log is core.log in the flight's folder."
            ) from None
    core.wait()


def fly(
    order: FlightOrder, *, say: Say, confirm: Callable[[], bool] = lambda: True, stop: Interrupts | None = None
) -> FlightResult:
    """Fly a plan through a core and follow it to the report. Ctrl-C is an abort; twice is still an abort.

    Args:
        order: what is flown.
        say: takes lines of progress.
        confirm: asked once everything is checked; the flight is given up when it says no.
        stop: has taken signals since the command began; one that came before now starts nothing.

    Raises:
        FlightAborted: the flight was aborted and the vehicle is down, or nothing was armed; what was flown told
            nothing.
        LinkLost: it ended, and nobody saw the vehicle on the ground.
        Refused: the vehicle or the checks refused to fly.
    """
    if stop is None:
        with Interrupts() as stop:
            return fly(order, say=say, confirm=confirm, stop=stop)
    stop.check()
    with stop.ordering(lambda: None):  # what comes until the client is connected is ordered then
        core, endpoint = start_core(order)

        def body(client: CoreClient) -> None:
            with stop.ordering(lambda: _abort(client, say)):
                follow(client, lambda: core.poll() is not None, say, confirm, stop)

        _as_client(core, endpoint, body)
    folder = order.folder
    status, reason = outcome(folder)
    recording = folder / "flight.mcap"
    if status == FlightAborted.exit_status and GIVEN_UP in reason:
        raise FlightAborted(f"{reason}. The recording is kept; `groundstation report {recording}` analyses it.")
    if status == FlightAborted.exit_status and not (folder / "identification.json").is_file():
        raise FlightAborted(f"aborted: {reason}." + (f" The recording is {recording}" if recording.is_file() else ""))
    if status == LinkLost.exit_status:
        raise LinkLost(f"{reason}. The recording is {recording}{_still_changed(folder)}")
    if status == Refused.exit_status and not (folder / "report.html").is_file():
        raise Refused(reason)
    return FlightResult(folder, status, reason)


def rejoin(folder: Path, *, say: Say, confirm: Callable[[], bool], stop: Interrupts) -> bool:
    """Go on with a flight whose client was killed: its core flew on, or waits for the order to start.

    Returns:
        Whether there was one.
    """
    access = dict(running_cores(folder.parent)).get(folder)
    if access is None:
        return False
    say(f"{folder.name} is still under way; following it to its end")
    with suppress(ConnectionError), connect(access) as client:
        client.take_lease()
        last, heard_s = client.seen, time.monotonic()

        def silent() -> bool:
            nonlocal last, heard_s
            if client.seen is not last:
                last, heard_s = client.seen, time.monotonic()
            return time.monotonic() - heard_s > timeouts.CORE_CONNECT_S

        with stop.ordering(lambda: _abort(client, say)):
            follow(client, silent, say, confirm, stop)
    end = time.monotonic() + timeouts.CORE_CONNECT_S
    while not _has_outcome(folder) and time.monotonic() < end:
        time.sleep(timeouts.STATUS_EVERY_S)
    return True


def _has_outcome(folder: Path) -> bool:
    """Whether a core wrote how its flight ended: the last that it does, after it left the bus."""
    try:
        return bool(outcome(folder))
    except BadInput:
        return False


def _still_changed(folder: Path) -> str:
    """What the flight changed on the vehicle and could not restore, with the values before."""
    changed = left_changed(folder.parent / "parameters.journal")
    return "" if not changed else f". Changed on the vehicle and not restored: {changed}; the next flight restores it"


def _abort(client: CoreClient, say: Say) -> None:
    """The core lands what flies; of a flight that is down it ends the analysis."""
    down = client.seen is not None and client.seen.phase in (Phase.LANDED, Phase.IDENTIFYING)
    say("abort: ending the analysis" if down else "abort: asking the vehicle to land")
    try:
        client.command("abort")
    except ConnectionError as error:
        say(str(error))


def _confirmed(confirm: Callable[[], bool], stop: Interrupts) -> bool:
    """Whether the operator wants it to fly, and has not asked for the end meanwhile."""
    if stop.asked:
        return False
    try:
        with stop.raising():
            said = confirm()
    except KeyboardInterrupt:
        return False
    return said and not stop.asked


def follow(
    client: CoreClient, ended: Callable[[], bool], say: Say, confirm: Callable[[], bool], stop: Interrupts
) -> None:
    """Start the flight once it is checked, and say what happens until the core is gone."""
    asked, shown, last = False, False, ""
    way = ""
    while not ended():
        status = client.status(0.2)
        if status is None:
            continue
        if status.phase == Phase.CHECKED and not asked:
            asked = client.command("start" if _confirmed(confirm, stop) else "abort").ok
        if not way and (way := next((note for note in status.notes if note.startswith(WAY)), "")):
            say(way)
        if status.table and not shown:
            say(f"preliminary: {table_line(status.table)}")
            shown = True
        line = progress_line(status)
        if line != last:
            say(line)
            last = line
        if status.phase in FINAL:
            return


def table_line(table: Mapping[str, tuple[float, float, float, float]]) -> str:
    """The estimates of a status in one line, those that are known."""
    rows = {name: row for name, row in table.items() if math.isfinite(row[1])}
    return ", ".join(f"{label(name)} {row[1]:.4g} ({row[2]:.4g} .. {row[3]:.4g})" for name, row in rows.items())


def progress_line(status: CoreStatus) -> str:
    """One line: phase, time left, tracking error, rates, samples, losses; or how far the analysis is."""
    if status.phase in (Phase.LANDED, Phase.IDENTIFYING):
        return f"{status.phase:<11} {100 * status.progress:3.0f} %  {status.text}"
    parts = [f"{status.phase:<11}"]
    if status.phase in IN_FLIGHT:
        parts.append(f"{status.time_left_s:5.1f} s left  off by {100 * status.tracking_error_m:5.1f} cm")
    rates = [f"{name} {stream.rate_hz:.0f}" for name, stream in sorted(status.streams.items()) if stream.rate_hz > 0.5]
    if rates:
        parts.append(f"Hz: {', '.join(rates)}  {status.recorded} samples, {status.lost} lost")
    if status.until is not None:
        parts.append(status.until.proposal.replace("u agrees", "u on the Fly screen agrees") or status.until.text)
    if status.suspects:
        parts.append("likely: " + ", ".join(f"{s.effect} {s.odds:.0f}:1" for s in status.suspects))
    if status.reason:
        parts.append(status.reason)
    return "  ".join(parts)


def result_table(identification: Document, declared: Mapping[str, float], truth: Mapping[str, float]) -> str:
    """Parameters as a table: nominal, true (in simulation), the estimate that every place shows, 95 % interval.

    Args:
        identification: the document of ``identification.json``.
        declared: ``Vehicle.parameters()`` of what was declared.
        truth: that of the true vehicle; empty for a measured flight.
    """
    source, found = estimate_in(identification)
    hidden = set(identification["not_identifiable"])
    rows: list[tuple[str, ...]] = [("parameter", "unit", "nominal", "true", f"estimated ({source})", "95 % interval")]
    for name, nominal in declared.items():
        if name in found or name in hidden:
            rows.append(_row(name, found.get(name), nominal, truth.get(name, math.nan)))
    if not truth:
        rows = [row[:3] + row[4:] for row in rows]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return "\n".join([lines[0], "  ".join("-" * width for width in widths), *lines[1:]])


def _row(name: str, found: Document | None, nominal: float, truth: float) -> tuple[str, str, str, str, str, str]:
    estimate = Estimate(found["value"], found["std"], (found["ci95"][0], found["ci95"][1])) if found else None
    _, unit = split_unit(name)
    scale = scale_for(unit, [value for value in (nominal, truth, estimate.value if estimate else 0.0)])
    places = decimals(half_width(estimate) * scale.factor) if estimate else decimals(0.01 * nominal * scale.factor)

    def show(value: float) -> str:
        return fixed(value * scale.factor, places)

    if estimate is None:
        return label(name), scale.unit, show(nominal), show(truth), "not revealed", ""
    interval = f"{show(estimate.ci95[0])} .. {show(estimate.ci95[1])}"
    return label(name), scale.unit, show(nominal), show(truth), show(estimate.value), interval
