"""``groundstation campaign``: flight after flight until it is known."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from groundstation.commands.common import ProgressLine, Result, example, json_option, logs_option, packed
from groundstation.errors import BadInput, Refused

if TYPE_CHECKING:
    from groundstation.campaign.campaign import Campaign
    from groundstation.flight.client.interrupts import Interrupts

FOLDER = click.Path(path_type=Path, file_okay=False)


@dataclass(frozen=True, slots=True)
class Order:
    """What the command line says of a campaign."""

    vehicle: str | None
    scenario: str | None
    link: str | None
    station: str
    yes_simulated: bool
    until: str
    at_most: int
    seed: int
    given: tuple[Path, ...]
    resume: Path | None
    logs: Path

    def begun(self, line: ProgressLine) -> Campaign:
        """The campaign to go on with: a new one with the flights that are given, or the one to resume."""
        from groundstation.campaign.campaign import begin, load_campaign, take_in

        if self.resume is not None:
            self._check_flown()
            return load_campaign(self.resume)
        if self.vehicle is None:
            raise BadInput("name the vehicle with --vehicle, or a campaign that was begun with --resume.")
        self._check_flown()
        stand = begin(self.logs, self.vehicle, self.until, at_most=self.at_most, seed=self.seed)
        for flight in self.given:
            stand = take_in(stand, flight, "given", say=line.say).save()
        return stand

    def _check_flown(self) -> None:
        """Refuse a campaign that could not fly before its folder is made.

        Raises:
            BadInput: nothing or two things fly, no such scenario ships, or nobody is at the terminal of a real vehicle.
        """
        from groundstation.paths import find_config

        if (self.scenario is None) == (self.link is None):
            raise BadInput(
                "say what flies: --scenario NAME for the simulated drone, or --link ADDRESS for a vehicle on MAVLink."
            )
        if self.scenario is not None:
            find_config("scenarios", self.scenario)
        if self.link is not None and not self.yes_simulated and not sys.stdin.isatty():
            raise BadInput(
                "a real vehicle is armed only by somebody at a terminal; a simulated one with --yes-simulated."
            )


@click.command(epilog=example("groundstation campaign --vehicle x500 --scenario hall --until ixx,iyy,izz:2%,mass:0.5%"))
@click.option("--vehicle", default=None, help="Vehicle file, or the name of a shipped one.")
@click.option("--scenario", default=None, help="Fly the simulated drone in this scenario (file or shipped name).")
@click.option("--link", default=None, help="Fly on this MAVLink link; each flight is confirmed by typing FLY.")
@click.option("--station", default="default", show_default=True, help="Station file for --link.")
@click.option("--yes-simulated", is_flag=True, help="What flies on the link is a simulation: do not ask before arming.")
@click.option("--until", default="ixx,iyy,izz:2%,mass:0.5%", show_default=True, help="95 % half widths to reach.")
@click.option("--at-most", type=click.IntRange(1, 50), default=5, show_default=True, help="Most flights to fly.")
@click.option("--seed", type=int, default=1, show_default=True, help="Seed of plans and of simulated flights.")
@click.option(
    "--from", "given", multiple=True, type=click.Path(path_type=Path), help="Begin with this flight (repeatable)."
)
@click.option("--resume", type=FOLDER, default=None, help="Go on with the campaign in this folder.")
@logs_option
@json_option
@packed(Order)
def campaign(order: Order) -> Result:
    """Fly, judge the model on the new flight, find what is missing, plan what settles it, until the targets are met.

    It ends when nothing is left open, the targets are met, and the model predicts a flight that no estimate has seen as
    well as its own; or it says what was not reached. Killed at any moment, --resume goes on.
    """
    from groundstation.campaign.campaign import autopilot_limits, run
    from groundstation.campaign.ending import SETTLED
    from groundstation.campaign.report import lines, write_campaign_report
    from groundstation.flight.client.interrupts import Interrupts

    line = ProgressLine()
    stand = order.begun(line)
    with Interrupts() as stop:
        flyer = _Flyer(stand, order, line, stop)
        limits = autopilot_limits(stand.vehicle) if order.link is not None else {}
        stand = run(stand, flyer, say=line.say, **limits)
    line.end()
    report = write_campaign_report(stand.folder / "report.html", stand)
    document = {
        "schema": "groundstation.campaign/1",
        "folder": str(stand.folder),
        "outcome": stand.outcome,
        "sentence": stand.sentence,
        "flights": [r.folder for r in stand.rounds],
        "estimates": dict(stand.rounds[-1].estimates) if stand.rounds else {},
    }
    text = "\n".join([*lines(stand), f"report: {report}", f"model: {stand.folder / f'model-{len(stand.rounds)}.toml'}"])
    return Result(document, text, 0 if stand.outcome == SETTLED else Refused.exit_status)


class _Flyer:
    """The simulated drone, or a vehicle on a link that somebody confirms each time."""

    def __init__(self, stand: Campaign, order: Order, line: ProgressLine, stop: Interrupts):
        from groundstation.campaign.campaign import VEHICLE

        self._stand, self._order, self._line, self._stop = stand, order, line, stop
        self._vehicle, self._logs = stand.folder / VEHICLE, order.logs.resolve()

    def place(self) -> Path:
        """A folder's name for a new flight."""
        from groundstation.flight.client.client import new_flight_folder

        return new_flight_folder(self._logs, self._stand.vehicle.name)

    def was_flown(self, folder: Path) -> bool:
        """Whether the core of that folder ended its flight as planned; one that is under way is followed to its end."""
        from groundstation.campaign.campaign import was_flown
        from groundstation.flight.client.rehearse import rejoin

        rejoin(folder, say=self._line.say, confirm=self._confirmed, stop=self._stop)
        return was_flown(folder)

    def fly(self, plan: Path, folder: Path) -> None:
        """Fly a plan."""
        from groundstation.flight.client.client import FlightOrder
        from groundstation.flight.client.rehearse import LinkOrder, fly, linked_vehicle, simulated_drone
        from groundstation.paths import find_config

        self._stop.check()
        folder.mkdir(parents=True)
        kept = folder / "plan.toml"
        kept.write_bytes(plan.read_bytes())
        if self._order.scenario is not None:
            scenario = find_config("scenarios", self._order.scenario).resolve()
            seed = self._stand.seed + int(plan.stem.rpartition("-")[2])
            drone = simulated_drone(self._vehicle, scenario, seed)
        else:
            drone = linked_vehicle(
                folder,
                self._vehicle,
                LinkOrder(str(self._order.link), self._order.station, set_parameters=self._order.yes_simulated),
            )
        order = FlightOrder(folder, kept, self._vehicle, drone, analyse=False)
        fly(order, say=self._line.say, confirm=self._confirmed, stop=self._stop)

    def _confirmed(self) -> bool:
        from groundstation.commands.flying import _typed_confirmation

        asks = self._order.link is not None and not self._order.yes_simulated
        return not asks or _typed_confirmation(self._line)
