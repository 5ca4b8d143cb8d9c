"""``groundstation identify``, ``predict``, ``diagnose`` and ``report``: work on recorded flights."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from groundstation.commands.common import (
    ProgressLine,
    Result,
    example,
    json_option,
    load_flights,
    logs_option,
    packed,
    require_there,
    result_folder,
    seconds_pair,
)
from groundstation.errors import NotIdentifiable, Refused
from groundstation.json_types import Document

if TYPE_CHECKING:
    from groundstation.diagnosis.results import Diagnosis
    from groundstation.flightdata import FlightData
    from groundstation.identification.results import Identification
    from groundstation.identification.work import Work

FLIGHT = click.Path(path_type=Path)
LACKING = "The intervals hold if the model lacks nothing that these flights show; to look for it:"


@dataclass(frozen=True, slots=True)
class Given:
    """Recorded flights as the command line names them, and what of them is used."""

    flights: tuple[Path, ...]
    vehicle: str | None
    start_s: float | None
    end_s: float | None
    everything: bool
    exclude: tuple[str, ...]
    accepted: tuple[str, ...]
    logs: Path
    reference: tuple[Path, ...] = ()
    held_out: tuple[Path, ...] = ()

    def loaded(self) -> tuple[list[FlightData], Work]:
        """The flights, unless their data contradict a declaration that was not accepted, and the work on them so
        far.
        """
        from groundstation.identification.declarations import go_on
        from groundstation.identification.work import Work

        found, work = load_flights(self.flights, self.vehicle, self.start_s, self.end_s, self.everything), Work()
        go_on(work.checked(found[0]), self.accepted)
        return found, work

    def excluded(self) -> tuple[tuple[float, float], ...]:
        """Stretches to leave out, s."""
        return tuple(seconds_pair(pair) for pair in self.exclude)

    def beside(self) -> tuple[list[FlightData], list[FlightData]]:
        """Healthy flights, and flights kept for judging."""
        return load_flights(self.reference, self.vehicle), load_flights(self.held_out, self.vehicle)

    def arguments(self) -> list[str]:
        """The words that name flights and what of them is used on a command line, without what is left out."""
        named = {"--vehicle": self.vehicle, "--from": self.start_s, "--to": self.end_s}
        words = [str(part) for name, value in named.items() if value is not None for part in (name, value)]
        words += ["--all"] if self.everything else []
        return [*map(str, self.flights), *words, *_each("--accept-declaration", self.accepted)]

    def folder(self) -> Path:
        """Where results go; made here."""
        folder = result_folder(self.flights[0], self.logs)
        folder.mkdir(parents=True, exist_ok=True)
        return folder


def _each(option: str, values: Sequence[str]) -> list[str]:
    """The words that give a repeatable option each of its values."""
    return [word for value in values for word in (option, value)]


def flight_options(function: Callable[..., Result]) -> Callable[..., Result]:
    """What every command on recorded flights takes; the function gets it as one :class:`Given`."""
    options = (
        click.argument("flights", nargs=-1, required=True, type=FLIGHT),
        click.option("--vehicle", default=None, help="Vehicle file or shipped name; overrides the recorded one."),
        click.option("--from", "start_s", type=float, default=None, help="Use the flights from this time on, s."),
        click.option("--to", "end_s", type=float, default=None, help="Use the flights up to this time, s."),
        click.option("--all", "everything", is_flag=True, help="Use all of a flight of more than ten minutes."),
        click.option("--exclude", multiple=True, metavar="START:END", help="Leave a stretch out, s (repeatable)."),
        click.option(
            "--accept-declaration",
            "accepted",
            multiple=True,
            metavar="NAME",
            help="Go on although the data contradict this declaration (repeatable; docs/declarations.md).",
        ),
        logs_option,
        json_option,
    )
    decorated = packed(Given)(function)
    for option in reversed(options):
        decorated = option(decorated)
    return decorated


def beside_options(function: Callable[..., Result]) -> Callable[..., Result]:
    """Flights that a diagnosis compares with."""
    held_out = click.option("--held-out", multiple=True, type=FLIGHT, help="Flight kept for judging (repeatable).")
    reference = click.option(
        "--reference", multiple=True, type=FLIGHT, help="Healthy flight of the same vehicle (repeatable)."
    )
    return reference(held_out(function))


def first_of_all(document: Document) -> list[str]:
    """What the declaration checks say, before every number."""
    checks = document["declarations"]
    loud = [text for text in document["warnings"] if text.startswith("declaration ")]
    for verdict in ("cannot tell", "agrees"):
        names = ", ".join(check["name"] for check in checks if check["verdict"] == verdict)
        loud += [f"declarations, {verdict}: {names}"] if names else []
    return loud


@click.command(epilog=example("groundstation identify flight.mcap --exclude 12.0:13.5 --json"))
@flight_options
def identify(given: Given) -> Result:
    """Estimate mass, inertia and the rest from one flight, or from several together, with intervals.

    FLIGHTS are MCAP recordings, bundle folders, PX4 ULog, ArduPilot DataFlash, blackbox, ROS 2 bags or Crazyflie usd
    logs.
    """
    exclude, (loaded, work) = given.excluded(), given.loaded()
    from groundstation import api
    from groundstation.analysis.analyse import identification_document, write_identification

    line = ProgressLine()
    with line.ticking("identifying"):
        found = api.identify(loaded, exclude=exclude, progress=line.fraction, work=work)
    files = write_identification(given.folder(), found, loaded[0].vehicle)
    document = identification_document(found)
    lines = [*_identification_lines(found, document, loaded[0]), *(f"written: {path}" for path in files.values())]
    again = shlex.join([*given.arguments(), *_each("--exclude", given.exclude)])
    lines.append(f"{LACKING} groundstation diagnose {again}")
    if not any(method.parameters for method in found.methods.values()):
        raise NotIdentifiable("these flights reveal none of the parameters.", "", tuple(found.not_identifiable))
    return Result(document, "\n".join(lines))


def _identification_lines(found: Identification, document: Document, flight: FlightData) -> list[str]:
    """What ``identify`` prints of its result."""
    from groundstation.flight.client.rehearse import result_table

    truth = flight.truth.parameters() if flight.truth is not None else {}
    return [
        *first_of_all(document),
        *([f"prediction: {found.prediction['summary']}"] if found.prediction else []),
        *dict.fromkeys(found.quality),
        *(f"warning: {text}" for text in found.warnings if not text.startswith("declaration ")),
        f"best: {found.best}" + (f" ({found.best_reason})" if found.best_reason else ""),
        result_table(document, flight.vehicle.parameters(), truth),
        *(f"not revealed: {name}: {remedy}" for name, remedy in found.not_identifiable.items()),
    ]


@click.command(epilog=example("groundstation diagnose flight.mcap --reference healthy.mcap"))
@flight_options
@beside_options
@click.option(
    "--model",
    type=FLIGHT,
    default=None,
    help="identification.toml of an earlier flight: what it holds is known, findings are what it lacks.",
)
def diagnose(given: Given, model: Path | None) -> Result:
    """Find what the declared vehicle lacks: trace the residual to effects, with the error before and after."""
    exclude, (loaded, work) = given.excluded(), given.loaded()
    references, judges = given.beside()
    from groundstation import api
    from groundstation.analysis.analyse import with_next_flight, write_identification
    from groundstation.analysis.documents import write_json
    from groundstation.diagnosis.published import published
    from groundstation.identification.results import MASS_AND_TENSOR
    from groundstation.reporting.exports import read_model

    vehicle = loaded[0].vehicle
    known = None if model is None else read_model(model, vehicle if given.vehicle is not None else None)
    line = ProgressLine()
    base, refused, files = None, [], {}
    with line.ticking("diagnosing"):
        try:
            base = api.identify(loaded, exclude=exclude, progress=line.fraction, work=work)
            hidden = base.not_identifiable
        except Refused as error:
            refused, hidden = [f"no model file: {error}"], dict.fromkeys(MASS_AND_TENSOR, error.reason)
        found = api.diagnose(
            loaded,
            exclude=exclude,
            references=references,
            held_out=judges,
            model=known,
            progress=line.fraction,
            work=work,
        )
    folder, found = given.folder(), published(found, hidden)
    if base is not None:
        files = write_identification(folder, base, vehicle, found)
    found, plan = with_next_flight(folder, found, vehicle)
    written = [write_json(folder / "diagnosis.json", found.to_dict()), *files.values(), *([plan] if plan else [])]
    lines = [*_diagnosis_lines(found), *refused, *(f"written: {path}" for path in written)]
    return Result(found.to_dict(), "\n".join(lines), Refused.exit_status if found.verdict == "refused" else 0)


def _diagnosis_lines(found: Diagnosis) -> list[str]:
    """What ``diagnose`` prints of its result."""
    from groundstation.reporting.units import readable

    effects = {name for finding in found.findings for name in (finding.effect, *finding.alternatives)}
    return [
        *first_of_all(found.to_dict()),
        f"verdict: {found.verdict}" + (f" ({readable(found.reason)})" if found.reason else ""),
        *(f"{finding.effect} ({finding.confidence:.0%}): {finding.sentence}" for finding in found.findings),
        *(
            readable(
                f"unexplained: {item.share:.0%} of {item.channel}, varies with "
                f"{', '.join(item.depends_on) or 'nothing known'}"
            )
            for item in found.unexplained
        ),
        *(f"warning: {text}" for text in found.warnings if not text.startswith("declaration ")),
        *([f"next flight: {readable(found.next_flight, effects)}"] if found.next_flight else []),
    ]


@click.command(epilog=example("groundstation report logs/2025-01-31T12-00-00-qball2/flight.mcap"))
@flight_options
@beside_options
def report(given: Given) -> Result:
    """Identify and diagnose, and write the HTML report."""
    exclude, (loaded, _) = given.excluded(), given.loaded()
    references, judges = given.beside()
    from groundstation import api
    from groundstation.analysis.analyse import identification_document
    from groundstation.reporting.card import landing_card

    line = ProgressLine()
    with line.ticking("analysing"):
        done = api.analyse(
            loaded,
            result_folder(given.flights[0], given.logs),
            exclude=exclude,
            references=references,
            held_out=judges,
            progress=line.fraction,
            source=shlex.join(given.arguments()),
        )
    files = {name: str(path) for name, path in done.files.items()}
    first = done.identification.to_dict()
    card = landing_card(
        identification_document(done.identification, done.diagnosis),
        done.diagnosis.to_dict(),
        loaded[0].vehicle.parameters(),
        planned=done.files["next_flight"].name if "next_flight" in done.files else "",
    )
    document = {
        "schema": "groundstation.report/1",
        "flight": done.identification.flight,
        "declarations": first["declarations"],
        "files": files,
        "card": list(card),
    }
    lines = [*first_of_all(first), *(f"{name:<16} {path}" for name, path in files.items()), "", *card]
    return Result(document, "\n".join(lines))


@dataclass(frozen=True, slots=True)
class Ahead:
    """What is predicted of a flight, from what, and with which part of the model."""

    horizon: float
    state: Literal["smoothed", "own"]
    use: Literal["prediction", "physical"]
    save: Path | None
    vehicle: str | None
    start_s: float | None
    end_s: float | None


@click.command(epilog=example("groundstation predict identification.toml other.mcap --horizon 0.5 --json"))
@click.argument("model", type=FLIGHT)
@click.argument("flight", type=FLIGHT)
@click.option("--horizon", type=float, default=0.5, show_default=True, help="Seconds to predict.")
@click.option("--state", type=click.Choice(["smoothed", "own"]), default="smoothed", show_default=True,
              help="Start from and judge by the smoothed state, or the vehicle's own estimate.")  # fmt: skip
@click.option(
    "--use",
    type=click.Choice(["prediction", "physical"]),
    default="prediction",
    show_default=True,
    help="The model that predicts best, or the physical one; without a [prediction] section it is the physical one.",
)
@click.option("--save", type=click.Path(path_type=Path, dir_okay=False), default=None, help="CSV of predicted states.")
@click.option("--vehicle", default=None, help="Vehicle file or shipped name; overrides the recorded one.")
@click.option("--from", "start_s", type=float, default=None, help="Use the flight from this time on, s.")
@click.option("--to", "end_s", type=float, default=None, help="Use the flight up to this time, s.")
@json_option
@packed(Ahead)
def predict(asked: Ahead, model: Path, flight: Path) -> Result:
    """Simulate open loop from every sample of FLIGHT with MODEL (identification.toml), and say how far off it is."""
    require_there(model)
    loaded = load_flights((flight,), asked.vehicle, asked.start_s, asked.end_s)[0]
    from groundstation import api
    from groundstation.reporting.exports import read_model

    line = ProgressLine()
    document = read_model(model, loaded.vehicle if asked.vehicle is not None else None)
    found = api.predict(
        document,
        loaded,
        horizon_s=asked.horizon,
        own_state=asked.state == "own",
        use=asked.use,
        progress=line.fraction,
    )
    line.end()
    if asked.save is not None:
        from groundstation.recording.csvfile import write_csv

        columns, rows = found.rows()
        write_csv(asked.save, columns, list(rows.T))
    return Result(found.to_dict(), found.to_text())
