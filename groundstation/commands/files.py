"""``groundstation export``, ``convert`` and ``flights``."""

from __future__ import annotations

from pathlib import Path

import click

from groundstation.commands.common import Result, example, json_option, logs_option

ANY = click.Path(path_type=Path)


@click.command(epilog=example("groundstation convert flight.mcap bundle/"))
@click.argument("source", type=ANY)
@click.argument("target", type=ANY)
@click.option("--vehicle", default=None, help="Vehicle file or shipped name, for a log that carries none.")
@json_option
def convert(source: Path, target: Path, vehicle: str | None) -> Result:
    """Convert between MCAP recordings and flight bundles; every sample and time stamp is kept."""
    from groundstation.recording import convert as run

    lost = run(source, target, vehicle=vehicle)
    document = {
        "schema": "groundstation.convert/1",
        "source": str(source),
        "target": str(target),
        "not_held": list(lost),
    }
    return Result(document, "\n".join([f"written: {target}", *(f"not held: {text}" for text in lost)]))


@click.command(epilog=example("groundstation flights --logs logs"))
@logs_option
@json_option
def flights(logs: Path) -> Result:
    """List what lies in the logs, and how parameters moved from flight to flight."""
    from groundstation.recording import catalogue

    rows = catalogue(logs)
    return Result(
        {"schema": "groundstation.flights/1", "flights": rows}, "\n".join(map(str, rows)) or f"no flights in {logs}"
    )


@click.command(epilog=example("groundstation export identification.toml --format px4 --output params.txt"))
@click.argument("identification", type=ANY)
@click.option("--format", "form", required=True, help="toml, json, or a simulator's name.")
@click.option("--output", type=click.Path(path_type=Path), required=True, help="File to write.")
@json_option
def export(identification: Path, form: str, output: Path) -> Result:
    """Write the identified parameters in the format of a simulator or autopilot."""
    from groundstation.reporting.exports import export as run

    notes = run(identification, form, output)
    document = {"schema": "groundstation.export/1", "format": form, "file": str(output), "notes": list(notes)}
    return Result(document, "\n".join([f"written: {output}", *notes]))
