"""``groundstation identify``, ``predict``, ``diagnose`` and ``report``: work on recorded flights."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import click

from groundstation.commands.common import (
    ProgressLine,
    Result,
    example,
    json_option,
    load_flights,
    logs_option,
    require_there,
    result_folder,
    seconds_pair,
)
from groundstation.errors import NotIdentifiable, Refused

FLIGHT = click.Path(path_type=Path)


def flight_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """What every command on recorded flights takes."""
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
    for option in reversed(options):
        function = option(function)
    return function


def first_of_all(document: Mapping[str, Any]) -> list[str]:
    """What the declaration checks say, before every number."""
    checks = document["declarations"]
    loud = [text for text in document["warnings"] if text.startswith("declaration ")]
    for verdict in ("cannot tell", "agrees"):
        names = ", ".join(check["name"] for check in checks if check["verdict"] == verdict)
        loud += [f"declarations, {verdict}: {names}"] if names else []
    return loud


@click.command(epilog=example("groundstation identify flight.mcap --exclude 12.0:13.5 --json"))
@flight_options
def identify(
    flights: tuple[Path, ...],
    vehicle: str | None,
    start_s: float | None,
    end_s: float | None,
    everything: bool,
    exclude: tuple[str, ...],
    accepted: tuple[str, ...],
    logs: Path,
) -> Result:
    """Estimate mass, inertia and the rest from one flight, or from several together, with intervals.

    FLIGHTS are MCAP recordings, bundle folders, PX4 ULog, ArduPilot DataFlash, blackbox, ROS 2 bags or Crazyflie usd
    logs.
    """
    left_out = tuple(seconds_pair(pair) for pair in exclude)
    loaded = load_flights(flights, vehicle, start_s, end_s, everything)
    from groundstation.identification.declarations import go_on

    go_on(loaded, accepted)
    from groundstation import api
    from groundstation.analysis.analyse import identification_document, write_identification
    from groundstation.flight.client.rehearse import result_table

    line = ProgressLine()
    with line.ticking("identifying"):
        found = api.identify(loaded, exclude=left_out, progress=line.fraction)
    folder = result_folder(flights[0], logs)
    folder.mkdir(parents=True, exist_ok=True)
    files = write_identification(folder, found, loaded[0].vehicle)
    document = identification_document(found)
    truth = loaded[0].truth.parameters() if loaded[0].truth is not None else {}
    lines = [
        *first_of_all(document),
        *([f"prediction: {found.prediction['summary']}"] if found.prediction else []),
        *dict.fromkeys(found.quality),
        *(f"warning: {text}" for text in found.warnings if not text.startswith("declaration ")),
        f"best: {found.best}" + (f" ({found.best_reason})" if found.best_reason else ""),
        result_table(document, loaded[0].vehicle.parameters(), truth),
        *(f"not revealed: {name}: {remedy}" for name, remedy in found.not_identifiable.items()),
        *(f"written: {path}" for path in files.values()),
    ]
    if not any(method.parameters for method in found.methods.values()):
        raise NotIdentifiable("these flights reveal none of the parameters.", "", tuple(found.not_identifiable))
    return Result(document, "\n".join(lines))


@click.command(epilog=example("groundstation diagnose flight.mcap --reference healthy.mcap"))
@flight_options
@click.option("--reference", multiple=True, type=FLIGHT, help="Healthy flight of the same vehicle (repeatable).")
@click.option("--held-out", multiple=True, type=FLIGHT, help="Flight kept for judging (repeatable).")
@click.option(
    "--model",
    type=FLIGHT,
    default=None,
    help="identification.toml of an earlier flight: what it holds is known, findings are what it lacks.",
)
def diagnose(
    flights: tuple[Path, ...],
    vehicle: str | None,
    start_s: float | None,
    end_s: float | None,
    everything: bool,
    exclude: tuple[str, ...],
    accepted: tuple[str, ...],
    logs: Path,
    reference: tuple[Path, ...],
    held_out: tuple[Path, ...],
    model: Path | None,
) -> Result:
    """Find what the declared vehicle lacks: trace the residual to effects, with the error before and after."""
    left_out = tuple(seconds_pair(pair) for pair in exclude)
    loaded = load_flights(flights, vehicle, start_s, end_s, everything)
    from groundstation.identification.declarations import go_on

    go_on(loaded, accepted)
    references, judges = load_flights(reference, vehicle), load_flights(held_out, vehicle)
    from groundstation import api
    from groundstation.analysis.analyse import with_next_flight, write_identification
    from groundstation.analysis.documents import write_json
    from groundstation.diagnosis.published import published
    from groundstation.reporting.exports import read_model
    from groundstation.reporting.units import readable

    known = None if model is None else read_model(model, loaded[0].vehicle if vehicle is not None else None)
    line = ProgressLine()
    with line.ticking("diagnosing"):
        found = api.diagnose(
            loaded, exclude=left_out, references=references, held_out=judges, model=known, progress=line.fraction
        )
        try:
            base, refused = api.identify(loaded, exclude=left_out, progress=line.fraction), ""
        except Refused as error:
            base, refused = None, f"no model file: {error}"
    folder = result_folder(flights[0], logs)
    folder.mkdir(parents=True, exist_ok=True)
    if base is not None:
        found = published(found, base.not_identifiable)
        files = write_identification(folder, base, loaded[0].vehicle, found)
    else:
        files = {}
    found, plan = with_next_flight(folder, found, loaded[0].vehicle)
    written = write_json(folder / "diagnosis.json", found.to_dict())
    effects = {name for finding in found.findings for name in (finding.effect, *finding.alternatives)}
    lines = [
        *first_of_all(found.to_dict()),
        f"verdict: {found.verdict}" + (f" ({readable(found.reason)})" if found.reason else ""),
        *(f"{finding.effect} ({finding.confidence:.0%}): {finding.evidence}" for finding in found.findings),
        *(
            readable(
                f"unexplained: {item.share:.0%} of {item.channel}, varies with "
                f"{', '.join(item.depends_on) or 'nothing known'}"
            )
            for item in found.unexplained
        ),
        *(f"warning: {text}" for text in found.warnings if not text.startswith("declaration ")),
        *([f"next flight: {readable(found.next_flight, effects)}"] if found.next_flight else []),
        *([refused] if refused else []),
        f"written: {written}",
        *(f"written: {path}" for path in files.values()),
        *([f"written: {plan}"] if plan is not None else []),
    ]
    return Result(found.to_dict(), "\n".join(lines), Refused.exit_status if found.verdict == "refused" else 0)


def _arguments(flights: tuple[Path, ...], options: Mapping[str, object], everything: bool) -> str:
    """Flights and options as they were given, quoted for a shell."""
    given = [str(part) for name, value in options.items() if value is not None for part in (name, value)]
    given += ["--all"] if everything else []
    return shlex.join([*map(str, flights), *given])


@click.command(epilog=example("groundstation report logs/2025-01-31T12-00-00-qball2/flight.mcap"))
@flight_options
@click.option("--reference", multiple=True, type=FLIGHT, help="Healthy flight of the same vehicle (repeatable).")
@click.option("--held-out", multiple=True, type=FLIGHT, help="Flight kept for judging (repeatable).")
def report(
    flights: tuple[Path, ...],
    vehicle: str | None,
    start_s: float | None,
    end_s: float | None,
    everything: bool,
    exclude: tuple[str, ...],
    accepted: tuple[str, ...],
    logs: Path,
    reference: tuple[Path, ...],
    held_out: tuple[Path, ...],
) -> Result:
    """Identify and diagnose, and write the HTML report."""
    left_out = tuple(seconds_pair(pair) for pair in exclude)
    loaded = load_flights(flights, vehicle, start_s, end_s, everything)
    from groundstation.identification.declarations import go_on

    go_on(loaded, accepted)
    from groundstation import api
    from groundstation.analysis.analyse import identification_document
    from groundstation.reporting.card import landing_card

    line = ProgressLine()
    before, judges = load_flights(reference, vehicle), load_flights(held_out, vehicle)
    with line.ticking("analysing"):
        done = api.analyse(
            loaded,
            result_folder(flights[0], logs),
            exclude=left_out,
            references=before,
            held_out=judges,
            progress=line.fraction,
            source=_arguments(flights, {"--vehicle": vehicle, "--from": start_s, "--to": end_s}, everything),
        )
    files = {name: str(path) for name, path in done.files.items()}
    first = done.identification.to_dict()
    document = {
        "schema": "groundstation.report/1",
        "flight": done.identification.flight,
        "declarations": first["declarations"],
        "files": files,
    }
    card = landing_card(
        identification_document(done.identification, done.diagnosis),
        done.diagnosis.to_dict(),
        loaded[0].vehicle.parameters(),
        planned=done.files["next_flight"].name if "next_flight" in done.files else "",
    )
    document["card"] = list(card)
    lines = [*first_of_all(first), *(f"{name:<16} {path}" for name, path in files.items()), "", *card]
    return Result(document, "\n".join(lines))


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
def predict(
    model: Path,
    flight: Path,
    horizon: float,
    state: str,
    use: str,
    save: Path | None,
    vehicle: str | None,
    start_s: float | None,
    end_s: float | None,
) -> Result:
    """Simulate open loop from every sample of FLIGHT with MODEL (identification.toml), and say how far off it is."""
    require_there(model)
    loaded = load_flights((flight,), vehicle, start_s, end_s)[0]
    from groundstation import api
    from groundstation.reporting.exports import read_model

    line = ProgressLine()
    document = read_model(model, loaded.vehicle if vehicle is not None else None)
    kind: Literal["prediction", "physical"] = "physical" if use == "physical" else "prediction"
    found = api.predict(document, loaded, horizon_s=horizon, own_state=state == "own", use=kind, progress=line.fraction)
    line.end()
    if save is not None:
        from groundstation.recording.csvfile import write_csv

        columns, rows = found.rows()
        write_csv(save, columns, list(rows.T))
    return Result(found.to_dict(), found.to_text())
