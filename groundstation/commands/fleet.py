"""``groundstation flights`` and ``batch``: what lies in the logs, how it moves, and work on many recordings."""

from __future__ import annotations

import os
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from groundstation.commands.common import Choice, ProgressLine, Result, example, json_option, logs_option, packed
from groundstation.errors import BadInput
from groundstation.json_types import Document

if TYPE_CHECKING:
    from groundstation.fleet.catalogue import Catalogue

MOVED = 3.0
"""Combined standard deviations from which a change from flight to flight is worth a word."""
SORTS = ("date", "flight", "vehicle", "state", "verdict", "mass")


@dataclass(frozen=True, slots=True)
class Shown:
    """What ``flights`` is asked for, option by option."""

    vehicle: str | None
    since: str | None
    finding: str | None
    tag: str | None
    sort: str
    trend: bool
    compare: tuple[str, str] | None
    report: Path | None
    sql: str | None
    target: Path | None


@dataclass(frozen=True, slots=True)
class Notes:
    """What ``flights`` writes beside the named flights."""

    add_tag: tuple[str, ...]
    remove_tag: tuple[str, ...]
    note: str | None

    def any(self) -> bool:
        """Whether there is something to write."""
        return bool(self.add_tag or self.remove_tag or self.note is not None)


@dataclass(frozen=True, slots=True)
class Work:
    """What ``batch`` does, option by option."""

    do: str
    vehicle: str | None
    workers: int | None
    memory_gb: float | None
    scheduler: str | None
    output: str
    table: Path | None


@click.command(epilog=example("groundstation flights --vehicle x500 --since 2025-01-01 --trend"))
@click.argument("chosen", nargs=-1, metavar="[FLIGHT]...")
@click.option("--vehicle", default=None, help="Only flights of this vehicle.")
@click.option("--since", default=None, metavar="DATE", help="Only flights from this date on (2025-01-31).")
@click.option("--finding", default=None, metavar="EFFECT", help="Only flights with this finding, e.g. rotor_drag.")
@click.option("--tag", default=None, help="Only flights with this tag.")
@click.option("--sort", type=Choice(SORTS), default="date", show_default=True, help="Order of the list.")
@click.option("--trend", is_flag=True, help="How parameters moved over each vehicle's flights, with control limits.")
@click.option("--compare", nargs=2, default=None, metavar="A B", help="Two tags, or two flights, against each other.")
@click.option("--report", type=click.Path(path_type=Path, dir_okay=False), help="Write a fleet report (HTML) here.")
@click.option(
    "--sql",
    default=None,
    metavar="SELECT",
    help="Ask with SQL; tables: flights, parameters, findings, quality, inputs.",
)
@click.option(
    "--export", "target", type=click.Path(path_type=Path, dir_okay=False), help="All parameters as .parquet or .csv."
)
@click.option("--add-tag", multiple=True, metavar="TAG", help="Tag the named FLIGHTs (repeatable).")
@click.option("--remove-tag", multiple=True, metavar="TAG", help="Take a tag off the named FLIGHTs (repeatable).")
@click.option("--note", default=None, help="Note a sentence beside the named FLIGHTs.")
@click.option("--rebuild", is_flag=True, help="Read every flight again.")
@logs_option
@json_option
@packed(Notes)
@packed(Shown)
def flights(shown: Shown, notes: Notes, chosen: tuple[str, ...], rebuild: bool, logs: Path) -> Result:
    """List what lies in the logs, and how parameters moved from flight to flight.

    FLIGHT names a flight (its name or its folder in the logs); without one all are listed.
    """
    from groundstation.fleet.catalogue import Catalogue, Filter

    _check_date(shown.since)
    if notes.any() and not chosen:
        raise BadInput(
            "name the flights to tag or note, e.g. `groundstation flights 2025-01-31T12-00-00-x500 --add-tag payload`."
        )
    catalogue = Catalogue(logs, rebuild=rebuild)
    if notes.any():
        _annotate(catalogue, chosen, notes)
        catalogue = Catalogue(logs)
    head = [catalogue.note] if catalogue.note else []
    if shown.sql is not None:
        return _asked(catalogue, shown.sql)
    if shown.target is not None:
        catalogue.export(shown.target)
        return Result({"schema": "groundstation.flights/1", "written": str(shown.target)}, f"written: {shown.target}")
    if shown.trend or shown.compare or shown.report is not None:
        return _fleet(catalogue, shown)
    rows = catalogue.rows(Filter(shown.vehicle, shown.since, shown.finding, shown.tag))
    if chosen:
        _check_named(catalogue, chosen)
        rows = [row for row in rows if _is_named(row, chosen)]
    empty = f"no flights in {logs}; make one with `groundstation rehearse`"
    if not rows and (count := len(catalogue.rows())):
        empty = f"none of the {count} flights in {logs} is like that; `groundstation flights --logs {logs}` lists them"
    key = {"mass": _mass}.get(shown.sort, lambda row: str(row[shown.sort] or ""))
    rows.sort(key=lambda row: (key(row), row["date"], row["flight"]))
    text = "\n".join([*head, *(_flight_line(row) for row in rows)] or [empty])
    return Result({"schema": "groundstation.flights/1", "flights": rows}, text)


def _check_date(since: str | None) -> None:
    """Refuse a date that is none: texts are compared, and any text is later than every date or none."""
    try:
        date.fromisoformat((since or "2025-01-31")[:10])
    except ValueError:
        raise BadInput(f"'{since}' is no date; write it as 2025-01-31.") from None


def _is_named(row: Document, chosen: tuple[str, ...]) -> bool:
    names = {row["flight"], row["folder"], Path(row["folder"]).name}
    return any(name.rstrip("/") in names for name in chosen)


def _check_named(catalogue: Catalogue, chosen: tuple[str, ...]) -> None:
    rows = catalogue.rows()
    for name in chosen:
        if not any(_is_named(row, (name,)) for row in rows):
            raise BadInput(f"'{name}' is no flight in {catalogue.logs}; `groundstation flights` lists them.")


def _mass(row: Document) -> str:
    mass = row["parameters"].get("mass_kg")
    return f"{mass['value']:020.9f}" if mass else ""


def _annotate(catalogue: Catalogue, chosen: tuple[str, ...], notes: Notes) -> None:
    from groundstation.fleet.rows import set_notes

    _check_named(catalogue, chosen)
    for row in catalogue.rows():
        if _is_named(row, chosen):
            set_notes(Path(row["folder"]), add=notes.add_tag, remove=notes.remove_tag, note=notes.note)


def _asked(catalogue: Catalogue, sql: str) -> Result:
    columns, rows = catalogue.sql(sql)
    document = {"schema": "groundstation.query/1", "columns": columns, "rows": [list(map(_plain, row)) for row in rows]}
    widths = [max([len(c), *(len(str(row[i])) for row in rows)]) for i, c in enumerate(columns)]
    lines = [
        "  ".join(str(cell).ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in (columns, *rows)
    ]
    return Result(document, "\n".join(lines))


def _plain(value: Any) -> Any:
    return value if value is None or isinstance(value, (bool, int, float, str, list, dict)) else str(value)


def _fleet(catalogue: Catalogue, shown: Shown) -> Result:
    from groundstation.fleet.report import compare, comparison_lines, trend_document, trend_lines, write_fleet_report

    vehicles, pair = [shown.vehicle] if shown.vehicle else catalogue.vehicles(), shown.compare
    lines: list[str] = []
    document: dict[str, Any] = {"schema": "groundstation.fleet/1"}
    if shown.trend:
        lines += [line for each in vehicles for line in trend_lines(catalogue, each)]
        document["vehicles"] = [trend_document(catalogue, each) for each in vehicles]
    if pair:
        found = compare(catalogue, *pair)
        lines += comparison_lines(found, *pair)
        document["difference"] = {n: {"size": d.size, "std": d.std, "p": p} for n, (d, p) in found.items()}
    if shown.report is not None:
        write_fleet_report(shown.report, catalogue, pair)
        lines.append(f"written: {shown.report}")
        document["report"] = str(shown.report)
    return Result(document, "\n".join(lines))


def _flight_line(row: Document) -> str:
    """One flight: when, what, how it ended, its mass, and what moved by more than chance allows."""
    mass = row["parameters"].get("mass_kg")
    said = f"mass {mass['value']:.4g} kg" if mass else row["reason"]
    moved = [f"{name} {change:+.1f}" for name, change in (row.get("moved") or {}).items() if abs(change) > MOVED]
    tail = f"; moved (in standard deviations): {', '.join(moved)}" if moved else ""
    tags = f" [{', '.join(row['tags'])}]" if row["tags"] else ""
    return f"{row['date'][:19]}  {row['flight']:<36} {row['state']:<10} {row['verdict'] or '-':<12} {said}{tags}{tail}"


@click.command(epilog=example("groundstation batch 'logs/**' other/*.ulg --vehicle x500 --do identify,diagnose"))
@click.argument("patterns", nargs=-1, required=True, metavar="RECORDINGS...")
@click.option("--do", default="identify,diagnose,report", show_default=True, help="Steps, separated by commas.")
@click.option("--vehicle", default=None, help="Vehicle file or shipped name, for recordings that carry none.")
@click.option(
    "--workers", type=click.IntRange(1, 256), default=None, help="Processes on this machine.  [default: one a core]"
)
@click.option("--memory-gb", type=click.FloatRange(0.5), default=None, help="Memory that one process may take.")
@click.option(
    "--scheduler", default=None, metavar="ADDRESS", help="Dask scheduler to run on, e.g. tcp://127.0.0.1:8786."
)
@click.option(
    "--output",
    default="logs",
    show_default=True,
    help="Folder, or URL of one, for results of recordings that are no MCAP.",
)
@click.option(
    "--table", type=click.Path(path_type=Path, dir_okay=False), help="Write all parameters as .parquet or .csv."
)
@json_option
@packed(Work)
def batch(asked: Work, patterns: tuple[str, ...]) -> Result:
    """Identify, diagnose and report many RECORDINGS (paths, patterns with **, URLs), in parallel; run again to go on.

    What is done and unchanged is not done again. A recording that fails does not stop the others.
    """
    from groundstation.fleet import batch as work
    from groundstation.paths import find_config

    steps = tuple(step.strip() for step in asked.do.split(",") if step.strip())
    if unknown := [step for step in steps if step not in work.STEPS] or ([] if steps else ["nothing"]):
        raise BadInput(f"--do: {unknown[0]} is no step; there are {', '.join(work.STEPS)}.")
    found = work.find(patterns)
    declared = None if asked.vehicle is None else find_config("vehicles", asked.vehicle)
    wanted = work.tasks(found, asked.output, declared, steps)
    count = asked.workers or os.cpu_count() or 1
    line = ProgressLine()
    done = []
    memory = None if asked.memory_gb is None else int(asked.memory_gb * 1e9)
    for result in work.results(wanted, workers=count, scheduler=asked.scheduler, memory_bytes=memory):
        done.append(result)
        line.fraction(len(done) / len(wanted), f"{len(done)} of {len(wanted)}: {result.source}")
    line.end()
    if asked.table is not None:
        work.write_table(asked.table, done)
    counts = {state: sum(r.state == state for r in done) for state in ("done", "refused", "bad", "failed")}
    before = sum(not r.fresh for r in done)
    lines = [f"{r.state}: {r.source}: {r.sentence}" for r in sorted(done, key=lambda r: r.source) if r.sentence]
    total = ", ".join(f"{n} {state}" for state, n in counts.items() if n) or "nothing to do"
    lines.append(f"{len(done)} recordings: {total}" + (f" ({before} were done before)" if before else ""))
    return Result({**work.document(done), "counts": counts}, "\n".join(lines), 1 if counts["failed"] else 0)
