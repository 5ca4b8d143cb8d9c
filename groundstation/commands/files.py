"""``groundstation export``, ``convert`` and ``flights``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from groundstation.commands.common import Result, example, json_option, logs_option
from groundstation.errors import BadInput
from groundstation.writing import write_whole

MOVED = 3.0
"""Combined standard deviations from which a change from flight to flight is worth a word."""
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
    text = (
        "\n".join(_flight_line(row) for row in rows) or f"no flights in {logs}; make one with `groundstation rehearse`"
    )
    return Result({"schema": "groundstation.flights/1", "flights": rows}, text)


def _flight_line(row: Mapping[str, Any]) -> str:
    """One flight: when, what, how it ended, its mass, and what moved by more than chance allows."""
    mass = row["parameters"].get("mass_kg")
    told = f"mass {mass['value']:.4g} kg" if mass else row["reason"]
    moved = [f"{name} {change:+.1f}" for name, change in (row.get("moved") or {}).items() if abs(change) > MOVED]
    tail = f"; moved (in standard deviations): {', '.join(moved)}" if moved else ""
    return f"{row['date'][:19]}  {row['flight']:<36} {row['state']:<10} {row['verdict'] or '-':<12} {told}{tail}"


@click.command(epilog=example("groundstation export identification.toml --format mjcf --output vehicle.xml"))
@click.argument("model", type=ANY)
@click.option(
    "--format", "form", required=True, help="toml, json, csv, vehicle, px4-sih, sdf, urdf, mjcf, rotorpy or scenario."
)
@click.option("--output", type=click.Path(path_type=Path, dir_okay=False), help="File to write; else standard output.")
@click.option("--vehicle", default=None, help="Vehicle file or shipped name; overrides the model's.")
@json_option
def export(model: Path, form: str, output: Path | None, vehicle: str | None) -> Result:
    """Write an identified MODEL (identification.toml) in the format of a simulator or autopilot."""
    from groundstation import api

    text = api.export(model, form, vehicle=vehicle)
    document: dict[str, Any] = {"schema": "groundstation.export/1", "format": form}
    if output is None:
        return Result({**document, "content": text}, text.rstrip("\n"))
    try:
        write_whole(output, text)
    except OSError as error:
        raise BadInput(
            f"{output}: cannot be written ({error.strerror}); name a file in a folder that exists."
        ) from None
    return Result({**document, "file": str(output)}, f"written: {output}")
