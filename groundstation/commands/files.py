"""``groundstation export`` and ``convert``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from groundstation.commands.common import Choice, ProgressLine, Result, example, json_option, load_vehicle_option
from groundstation.errors import BadInput
from groundstation.writing import write_whole

ANY = click.Path(path_type=Path)
FORMAT_NAMES = (
    *("toml", "json", "csv", "vehicle", "scenario", "px4-sih", "sdf", "urdf", "mjcf", "rotorpy"),
    *("ardupilot-sitl", "pybullet", "crazyflow", "crazyflie", "agilicious", "webots", "matlab", "ros2"),
)
"""Keys of :data:`groundstation.reporting.exports.FORMATS`, which are heavy to import; a test holds the two together."""
OTHER_NAMES = {
    "mujoco": "mjcf",
    "gazebo": "sdf",
    "px4": "px4-sih",
    "ros": "ros2",
    "ardupilot": "ardupilot-sitl",
    "gym-pybullet-drones": "pybullet",
    "cflib": "crazyflie",
    "flightmare": "agilicious",
    "simulink": "matlab",
}
"""What people call a format by its reader."""


@click.command(epilog=example("groundstation convert flight.mcap bundle/"))
@click.argument("source", type=ANY)
@click.argument("target", type=ANY, required=False)
@click.option("--vehicle", default=None, help="Vehicle file or shipped name, for a log that carries none.")
@click.option("--map", "mapped", type=ANY, help="Map file: which columns of any log are which stream.")
@click.option("--map-template", "template", is_flag=True, help="Print a map file for SOURCE, to be filled in.")
@json_option
def convert(source: Path, target: Path | None, vehicle: str | None, mapped: Path | None, template: bool) -> Result:
    """Convert between MCAP recordings and flight bundles, and logs into them; every sample and time stamp is kept."""
    if template:
        from groundstation.recording.mapping import template as write

        text = write(source, load_vehicle_option(vehicle))
        return Result({"schema": "groundstation.map_template/1", "source": str(source), "map": text}, text.rstrip())
    if target is None:
        raise BadInput("convert needs a TARGET: an MCAP file (.mcap) or a folder for a flight bundle.")
    from groundstation.recording import convert as run

    with ProgressLine().ticking(f"converting {source.name}"):
        lost = run(source, target, vehicle=vehicle, mapped=mapped)
    document = {
        "schema": "groundstation.convert/1",
        "source": str(source),
        "target": str(target),
        "not_held": list(lost),
    }
    return Result(document, "\n".join([f"written: {target}", *(f"not held: {text}" for text in lost)]))


@click.command(epilog=example("groundstation export identification.toml --format mjcf --output vehicle.xml"))
@click.argument("model", type=ANY)
@click.option(
    "--format",
    "form",
    required=True,
    type=Choice(FORMAT_NAMES, OTHER_NAMES),
    metavar="FORMAT",
    help=f"What reads it: {', '.join(FORMAT_NAMES)}.",
)
@click.option("--output", type=click.Path(path_type=Path, dir_okay=False), help="File to write; else standard output.")
@click.option("--vehicle", default=None, help="Vehicle file or shipped name; overrides the model's.")
@json_option
def export(model: Path, form: str, output: Path | None, vehicle: str | None) -> Result:
    """Write an identified MODEL (identification.toml) in the format of a simulator or autopilot.

    `--format matlab` is a script; with an output that ends in .mat it is a MAT-file.
    """
    from groundstation import api

    if output is not None and output.suffix == ".mat" and form == "matlab":
        return _mat_file(model, output, vehicle)
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


def _mat_file(model: Path, output: Path, vehicle: str | None) -> Result:
    from groundstation.reporting.exports import mat_file

    data = mat_file(model, load_vehicle_option(vehicle))
    try:
        write_whole(output, data)
    except OSError as error:
        raise BadInput(
            f"{output}: cannot be written ({error.strerror}); name a file in a folder that exists."
        ) from None
    return Result({"schema": "groundstation.export/1", "format": "matlab", "file": str(output)}, f"written: {output}")


@click.command(epilog=example("groundstation compare logs/flight-a logs/flight-b --output compare.html"))
@click.argument("flights", nargs=-1, required=True, type=ANY)
@click.option(
    "--output",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path("compare.html"),
    show_default=True,
    help="Page to write, with Markdown beside it; a name in .md writes Markdown alone.",
)
@json_option
def compare(flights: tuple[Path, ...], output: Path) -> Result:
    """Put two identified FLIGHTS or more on one page: what agrees, and what changed by how much.

    FLIGHTS are folders with an identification.json, or the recordings beside one; each need not be of the same vehicle.
    """
    from groundstation.reporting.compare import comparison_rows, read_flown, summary, write_comparison

    written = write_comparison(output, flights)
    known = [read_flown(folder) for folder in flights]
    rows = comparison_rows(known)
    document = {
        "schema": "groundstation.comparison/1",
        "flights": [flight.name for flight in known],
        "summary": summary(known),
        "rows": [list(row) for row in rows],
        "file": str(written),
    }
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))] if rows else []
    table = ["  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return Result(document, "\n".join([summary(known), "", *table, "", f"written: {written}"]))
