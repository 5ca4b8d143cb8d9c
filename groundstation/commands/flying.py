"""``groundstation sim``, ``rehearse``, ``preflight`` and ``fly``: everything that moves."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from groundstation.commands.common import ProgressLine, Result, example, json_option, logs_option
from groundstation.errors import BadInput, Refused
from groundstation.targets import DEFAULT, parse_targets

if TYPE_CHECKING:
    from groundstation.flight.client.client import FlightOrder
    from groundstation.flight.client.interrupts import Interrupts
    from groundstation.flight.client.rehearse import Checked, FlightResult
    from groundstation.trajectory import Plan
    from groundstation.vehicle import Until, Vehicle

LOG_S = 120.0
"""How long a flight waits for its onboard log; a fetch that breaks off can be continued."""

PLAN_S = 6.0
"""Seconds a rehearsal gives the planner."""
MAVLINK_VEHICLE = "x500"
"""What the simulated autopilot flies unless told otherwise."""


def until_options(function: Callable[..., Result]) -> Callable[..., Result]:
    """How long the excitation lasts, where that is decided in flight."""
    most = click.option(
        "--excitation-at-most-s",
        type=click.FloatRange(min=1.0),
        default=None,
        help="The longest excitation of an --until flight, s; 80 by default.",
    )
    until = click.option("--until", default=None, metavar="TARGETS", help=f"Fly until this is known, e.g. {DEFAULT}.")
    return until(most(function))


@click.command(
    context_settings={"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []},
    epilog=example("groundstation sim --mavlink --profile px4"),
)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
@click.pass_context
def sim(ctx: click.Context, arguments: tuple[str, ...]) -> None:
    """Start the simulated drone as a process that another program flies.

    With --mavlink it is an autopilot on UDP, for `preflight` and `fly`. Without it, it waits for a core on the bus;
    `rehearse` starts one by itself and needs no `sim`. The arguments follow.
    """
    from groundstation.flight.children import module_command

    rest = [argument for argument in arguments if argument != "--mavlink"]
    mavlink = len(rest) < len(arguments)
    if not arguments or "-h" in rest:
        rest = ["--help"]
    if "--help" in rest:
        click.echo(f"{ctx.get_help()}\n")
    elif mavlink and "--vehicle" not in rest:
        rest += ["--vehicle", MAVLINK_VEHICLE]
    sys.stdout.flush()
    # Takes this process's place, so that signals reach the simulator.
    os.execv(sys.executable, module_command("sim.mavlink" if mavlink else "sim", *rest))  # noqa: S606


@click.command(epilog=example("groundstation rehearse --vehicle qball2 --scenario seed"))
@click.option("--vehicle", default="qball2", show_default=True, help="Vehicle file, or the name of a shipped one.")
@click.option("--scenario", default="seed", show_default=True, help="Scenario file, or the name of a shipped one.")
@click.option(
    "--plan", "plan_file", type=click.Path(path_type=Path, dir_okay=False), help="Fly this plan instead of a new one."
)
@click.option(
    "--seed", type=int, default=1, show_default=True, help="Seed of the simulated noise and of the true vehicle."
)
@click.option("--real-time", is_flag=True, help="Let the simulated drone fly at the wall clock's pace.")
@until_options
@logs_option
@json_option
def rehearse(
    vehicle: str, scenario: str, plan_file: Path | None, seed: int, real_time: bool, logs: Path, **until: Any
) -> Result:
    """Fly the whole loop in simulation: plan, upload over zenoh, fly, record, identify, diagnose, report.

    Ctrl-C aborts: before arming nothing is armed, afterwards the simulated drone lands. Killing this program does not
    end the flight.
    """
    from groundstation.flight.client.interrupts import Interrupts

    line = ProgressLine()
    asked = _Rehearsal(vehicle, scenario, plan_file, seed, real_time, logs)
    with Interrupts() as stop:
        flown = _rehearsed(asked, until, line, stop)
    line.end()
    return _flight_result(flown)


@dataclass(frozen=True, slots=True)
class _Rehearsal:
    """The options of :func:`rehearse`."""

    vehicle: str
    scenario: str
    plan_file: Path | None
    seed: int
    real_time: bool
    logs: Path


def _rehearsed(asked: _Rehearsal, until: Mapping[str, Any], line: ProgressLine, stop: Interrupts) -> FlightResult:
    from groundstation.flight.client.client import FlightOrder, new_flight_folder
    from groundstation.flight.client.rehearse import fly as fly_plan
    from groundstation.flight.client.rehearse import simulated_drone
    from groundstation.paths import find_config
    from groundstation.trajectory import load_plan
    from groundstation.vehicle import load_vehicle

    _check_targets(until)
    vehicle_file = find_config("vehicles", asked.vehicle).resolve()
    scenario_file = find_config("scenarios", asked.scenario).resolve()
    declared, plan_file = load_vehicle(vehicle_file), asked.plan_file
    if plan_file is not None:
        chosen = load_plan(plan_file)
        if chosen.vehicle != declared.name:
            line.say(
                f"note: {plan_file} was made for {chosen.vehicle}; the drone checks whether {declared.name} can fly it"
            )
    else:
        chosen = _new_plan(declared, line)
    chosen = _lasting(chosen, declared.until, until, automatic=True)
    stop.check()
    folder = new_flight_folder(asked.logs.resolve(), declared.name)
    plan_path = _keep_plan(chosen, folder)
    drone = simulated_drone(vehicle_file, scenario_file, asked.seed, real_time=asked.real_time)
    return fly_plan(FlightOrder(folder, plan_path, vehicle_file, drone), say=line.say, stop=stop)


def _check_targets(asked: Mapping[str, Any]) -> None:
    """Refuse targets that are none before a plan is made for them."""
    if asked["until"] is not None:
        parse_targets(asked["until"])


def _lasting(chosen: Plan, declared: Until | None, asked: Mapping[str, Any], *, automatic: bool) -> Plan:
    """The plan, and where something is to be known by it, its length left to the flight."""
    from groundstation.flight.until import lasting_until
    from groundstation.vehicle import Until

    if asked["until"] is None and asked["excitation_at_most_s"] is not None and declared is None:
        raise BadInput("--excitation-at-most-s needs targets: give --until, or [until] in the vehicle or station file.")
    given = {} if declared is None else declared.model_dump()
    given |= {} if asked["until"] is None else {"targets": asked["until"]}
    given |= {} if asked["excitation_at_most_s"] is None else {"at_most_s": asked["excitation_at_most_s"]}
    if not given:
        return chosen
    parse_targets(given["targets"])
    return lasting_until(chosen, Until(**given), automatic=automatic)


def _plan_for_link(declared: Vehicle, line: ProgressLine) -> Plan:
    """A plan that an autopilot follows whose tuning is not known."""
    from groundstation.planning import plan_excitation
    from groundstation.planning.plan import AUTOPILOT

    asked = declared.limits.acceleration_max_m_s2
    limits: dict[str, Any] = dict(AUTOPILOT)
    if asked:
        limits["acceleration_max_m_s2"] = min(asked, AUTOPILOT["acceleration_max_m_s2"])
    return plan_excitation(declared, time_budget_s=PLAN_S, progress=line.fraction, **limits)


def _new_plan(declared: Vehicle, line: ProgressLine) -> Plan:
    """A plan for a rehearsal: the paper's problem for its vehicle, the planner's defaults for any other."""
    from groundstation.planning import paper_problem, plan_excitation

    problem: dict[str, Any] = paper_problem()
    if declared.name != problem["vehicle"].name:
        problem = {}
    return plan_excitation(**{**problem, "vehicle": declared}, time_budget_s=PLAN_S, progress=line.fraction)


def _keep_plan(chosen: Plan, folder: Path) -> Path:
    from groundstation.analysis.plans import write_plan

    folder.mkdir(parents=True)
    return write_plan(chosen, folder / "plan.toml")


def _flight_result(flown: FlightResult) -> Result:
    """Where everything is, and the table."""
    import json

    from groundstation import api
    from groundstation.flight.client.rehearse import result_table
    from groundstation.reporting.card import landing_card

    files = flown.files()
    document: dict[str, Any] = {
        "schema": "groundstation.flight/1",
        "folder": str(flown.folder),
        "files": {name: str(path) for name, path in files.items()},
        "exit_status": flown.exit_status,
        "reason": flown.reason,
    }
    lines = [f"{name:<20} {path}" for name, path in files.items()]
    identification, diagnosis, declared = {}, {}, {}
    if "identification.json" in files:
        identification = json.loads(files["identification.json"].read_text(encoding="utf-8"))
        flight = api.load_flight(files["flight.mcap"])
        truth = flight.truth.parameters() if flight.truth is not None else {}
        declared = flight.vehicle.parameters()
        document |= {"identification": identification, "truth": truth}
        lines += ["", result_table(identification, declared, truth)]
    if "diagnosis.json" in files:
        diagnosis = json.loads(files["diagnosis.json"].read_text(encoding="utf-8"))
        document["diagnosis"] = diagnosis
        lines += ["", f"diagnosis: {diagnosis['verdict']}", *(f"  {f['evidence']}" for f in diagnosis["findings"])]
    if identification:
        proposed = "next_flight.toml" if "next_flight.toml" in files else ""
        document["card"] = list(landing_card(identification, diagnosis, declared, planned=proposed))
        lines += ["", *document["card"]]
    if flown.exit_status:
        lines.append(flown.reason)
    return Result(document, "\n".join(lines), flown.exit_status)


def link_options(function: Callable[..., Result]) -> Callable[..., Result]:
    """What a command on a MAVLink link takes."""
    options = (
        click.option(
            "--link",
            required=True,
            metavar="URL",
            help="The MAVLink link: serial:///dev/ttyUSB0:921600, udpin://127.0.0.1:14540 or tcp://HOST:PORT.",
        ),
        click.option("--vehicle", required=True, help="Vehicle file, or the name of a shipped one."),
        click.option(
            "--station", default="default", show_default=True, help="Station file: room, guard limits, policy."
        ),
        click.option(
            "--plan",
            "plan_file",
            type=click.Path(path_type=Path, dir_okay=False),
            help="Fly this plan instead of a new one.",
        ),
        click.option(
            "--system",
            type=click.IntRange(1, 255),
            help="The vehicle's MAVLink system id, where several are on the link.",
        ),
        click.option("--force", multiple=True, metavar="NAME", help="Fly although this check fails; recorded."),
        click.option(
            "--set-parameters", is_flag=True, help="Set what the flight needs on the vehicle; restored afterwards."
        ),
        click.option(
            "--key-file", type=click.Path(path_type=Path, dir_okay=False), help="32-byte MAVLink signing key."
        ),
        until_options,
        logs_option,
        json_option,
    )
    for option in reversed(options):
        function = option(function)
    return function


def _link_flight(
    vehicle: str, plan_file: Path | None, logs: Path, line: ProgressLine, *, automatic: bool = False, **link: Any
) -> FlightOrder:
    """Folder, plan, vehicle and link process of a flight on a MAVLink link; faults are told before a plan is made."""
    from drivers.mavlink.transports import parse_url
    from groundstation.flight.client.client import FlightOrder, new_flight_folder
    from groundstation.flight.client.rehearse import LinkOrder, linked_vehicle
    from groundstation.flight.station import load_station
    from groundstation.paths import find_config
    from groundstation.trajectory import load_plan
    from groundstation.vehicle import load_vehicle

    _check_targets(link)
    try:
        parse_url(link["link"])
    except ValueError as error:
        raise BadInput(f"{error}.") from None
    station = load_station(link["station"])
    vehicle_file = find_config("vehicles", vehicle).resolve()
    declared = load_vehicle(vehicle_file)
    chosen = load_plan(plan_file) if plan_file is not None else _plan_for_link(declared, line)
    until = {name: link.pop(name) for name in ("until", "excitation_at_most_s")}
    chosen = _lasting(chosen, declared.until or station.until, until, automatic=automatic)
    folder = new_flight_folder(logs.resolve(), declared.name)
    drone = linked_vehicle(folder, vehicle_file, LinkOrder(**link))
    return FlightOrder(folder, _keep_plan(chosen, folder), vehicle_file, drone)


@click.command(epilog=example("groundstation preflight --link udpin://127.0.0.1:14540 --vehicle x500"))
@link_options
def preflight(vehicle: str, plan_file: Path | None, logs: Path, **link: Any) -> Result:
    """Check everything that can be checked before a flight; each failure with reason and remedy. Nothing is armed."""
    from groundstation.flight.client.rehearse import check

    line = ProgressLine()
    flight = _link_flight(vehicle, plan_file, logs, line, **link)
    found = check(flight, say=line.say)
    line.end()
    document = {
        "schema": "groundstation.preflight/1",
        "ok": not found.reason,
        "reason": found.reason,
        "checks": [{"name": c.name, "ok": c.ok, "text": c.text} for c in found.checks],
        "folder": str(flight.folder),
    }
    return Result(document, preflight_text(found), Refused.exit_status if found.reason else 0)


def preflight_text(found: Checked) -> str:
    """Failed checks a line each, then the names of those that passed."""
    failed = [f"{c.name}: {c.text}" for c in found.checks if not c.ok]
    if found.reason and not failed:
        return found.reason
    passed = ", ".join(c.name for c in found.checks if c.ok)
    head = f"not ready to fly: {len(failed)} of {len(found.checks)} checks failed" if found.reason else "ready to fly"
    return "\n".join([head, *(f"  {line}" for line in failed), *([f"passed: {passed}"] if passed else [])])


@click.command(epilog=example("groundstation fly --link udpin://127.0.0.1:14540 --vehicle x500 --yes-simulated"))
@link_options
@click.option("--yes-simulated", is_flag=True, help="What flies is a simulation: do not ask before arming.")
@click.option(
    "--take-over",
    type=click.Choice(["land", "hold"]),
    help="A vehicle is in flight, and its station ended: land it, or hold it for a minute and land; its folder goes "
    "on.",
)
def fly(
    vehicle: str, plan_file: Path | None, logs: Path, yes_simulated: bool, take_over: str | None, **link: Any
) -> Result:
    """Check, upload and fly on a MAVLink link, record, and after landing identify, diagnose and report.

    Ctrl-C aborts: before arming nothing is armed, afterwards the vehicle lands. Killing this program does not end the
    flight. A vehicle that is in flight already is refused, and gets no heartbeat that would hold its failsafe off.
    """
    from groundstation.flight.client.interrupts import Interrupts
    from groundstation.flight.client.rehearse import fly as fly_plan

    if not yes_simulated and not sys.stdin.isatty():
        raise BadInput("a real vehicle is armed only by somebody at a terminal; a simulated one with --yes-simulated.")
    line = ProgressLine()
    link["set_parameters"] |= yes_simulated  # asked for on a real vehicle, a matter of course on a simulated one
    with Interrupts() as stop:
        if take_over is not None:
            flight = _interrupted(vehicle, logs, line, take_over, **link)
            return _flight_result(fly_plan(flight, say=line.say, stop=stop))
        flight = _link_flight(vehicle, plan_file, logs, line, automatic=yes_simulated, **link)
        stop.check()
        try:
            flown = fly_plan(
                flight, say=line.say, confirm=lambda: yes_simulated or _typed_confirmation(line), stop=stop
            )
        except Refused as error:
            how = _offered(str(error), line)
            if not how:
                raise
            flight = _interrupted(vehicle, logs, line, how, **link)
            return _flight_result(fly_plan(flight, say=line.say, stop=stop))
    _fetch_log(link["link"], flight.vehicle, flown, line, link["key_file"])
    line.end()
    return _flight_result(flown)


def _interrupted(vehicle: str, logs: Path, line: ProgressLine, take_over: str, **link: Any) -> FlightOrder:
    """Folder, plan, vehicle and link process of a flight that its station left in the air."""
    from groundstation.flight.client.client import FlightOrder, interrupted_flight, new_flight_folder
    from groundstation.flight.client.rehearse import LinkOrder, linked_vehicle
    from groundstation.paths import find_config
    from groundstation.vehicle import load_vehicle

    vehicle_file = find_config("vehicles", vehicle).resolve()
    name = load_vehicle(vehicle_file).name
    folder = interrupted_flight(logs.resolve(), name)
    if folder is None or not (folder / "plan.toml").is_file():
        line.say(f"no interrupted flight of {name} in {logs}; recording into a folder of its own")
        folder, plan = new_flight_folder(logs.resolve(), name), find_config("plans", "paper_table2").resolve()
        folder.mkdir(parents=True)
    else:
        line.say(f"going on with {folder}")
        plan = folder / "plan.toml"
    order = LinkOrder(**{name: value for name, value in link.items() if name not in ("until", "excitation_at_most_s")})
    drone = linked_vehicle(folder, vehicle_file, order)
    return FlightOrder(folder, plan, vehicle_file, drone, take_over=take_over)


def _fetch_log(url: str, vehicle: Path, flown: FlightResult, line: ProgressLine, key_file: Path | None) -> None:
    """The onboard log beside the recording; without it, what came over the link is all there is, and that is said."""
    from groundstation.errors import GroundStationError
    from groundstation.flight.link.onboard_log import LogRequest, fetch_onboard_log
    from groundstation.vehicle import load_vehicle

    try:
        request = LogRequest(timeout_s=LOG_S, key_file=key_file)
        path = fetch_onboard_log(url, load_vehicle(vehicle), flown.folder, line.fraction, request=request)
        line.say(f"onboard log: {path}; `groundstation identify {path} --vehicle {vehicle}` uses its rates")
    except (GroundStationError, ConnectionError, ValueError) as error:
        line.say(f"no onboard log ({error}); identified from what came over the link")
    except KeyboardInterrupt:
        line.say("no onboard log (stopped by Ctrl-C); identified from what came over the link")


def _offered(refusal: str, line: ProgressLine) -> str:
    """What the operator at a terminal wants done with a vehicle that is in flight; empty leaves it to its own
    failsafe.
    """
    from groundstation.flight.messages import IN_FLIGHT

    if not refusal.startswith(IN_FLIGHT) or not sys.stdin.isatty():
        return ""
    line.end()
    print(f"{refusal}\nType LAND or HOLD to take it over, anything else to leave it to its failsafe: ", file=sys.stderr)
    return {"LAND": "land", "HOLD": "hold"}.get(sys.stdin.readline().strip(), "")


def _typed_confirmation(line: ProgressLine) -> bool:
    """Whether the operator typed the word."""
    line.end()
    print(
        "Everything is checked. Is the area clear? Type FLY to arm and take off, anything else to stop: ",
        file=sys.stderr,
    )
    return sys.stdin.readline().strip() == "FLY"
