"""One flight, one answer: every place that shows a flight's estimate shows the same digits.

Used by tests and by a benchmark.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from html import unescape
from pathlib import Path

from groundstation.documents import read_identification
from groundstation.fleet.catalogue import Catalogue
from groundstation.flight.client.rehearse import result_table
from groundstation.identification.results import Estimate
from groundstation.reporting.canonical import estimate_in, estimate_of
from groundstation.reporting.exports import export
from groundstation.reporting.units import interval_text, label, scale_for, split_unit
from groundstation.tui.documents import flight_row, method_table
from groundstation.tui.results import read_results
from groundstation.vehicle import Vehicle

SHOWN = ("mass_kg", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")


def places(folder: Path, vehicle: Vehicle, printed: str = "") -> dict[str, Callable[[str, Estimate], bool]]:
    """Each place by name, with whether it shows an estimate of the document to the last digit.

    Args:
        folder: of an analysed flight, in a folder of flights.
        printed: what the command line said; as it would print it by default.
    """
    document = read_identification(folder / "identification.json")
    model = tomllib.loads((folder / "identification.toml").read_text(encoding="utf-8"))
    report = unescape((folder / "report.html").read_text(encoding="utf-8"))
    wiki = (folder / "report.md").read_text(encoding="utf-8")
    results = read_results(folder)
    declared = vehicle.parameters()
    text = printed or result_table(document, declared, {})
    _, rows = method_table(results.identification, declared, 2)
    view = {row[0]: row[3] for row in rows}
    row = next(row for row in Catalogue(folder.parent).rows() if Path(row["folder"]).name == folder.name)
    table = {line.split(",")[0]: line.split(",") for line in export(model, "csv").splitlines()}
    sdf = json.loads(export(model, "json"))

    def head(name: str, estimate: Estimate) -> bool:
        scale = scale_for(split_unit(name)[1], [estimate.value])
        return f">{interval_text(estimate, scale)} <" in report

    return {
        "command line": lambda n, e: _digits(n, e) in _line(text, label(n)),
        "UI, Identify": lambda n, e: view[label(n)].split(" ")[0] == _digits(n, e),
        "UI, Flights": lambda n, e: (
            row["parameters"][n]["value"] == e.value
            and (n != "mass_kg" or flight_row(row)[-1].startswith(f"{e.value:.4g}"[:4]))
        ),
        "identification.toml": lambda n, e: model["parameters"][n] == {"value": e.value, "std": e.std},
        "report, head": head,
        "report.md": lambda n, e: (
            f"| {interval_text(e, scale_for(split_unit(n)[1], [e.value, declared[n]]))} |" in wiki
        ),
        "export csv": lambda n, e: float(table[n][1]) == e.value and float(table[n][2]) == e.std,
        "export json": lambda n, e: sdf["parameters"][n]["value"] == e.value,
        "predict": lambda n, e: _predicted(model, vehicle)[n] == e.value,
    }


def _digits(name: str, estimate: Estimate) -> str:
    return interval_text(estimate, scale_for(split_unit(name)[1], [estimate.value])).split(" ")[0]


def _line(text: str, start: str) -> str:
    return next(line for line in text.splitlines() if line.startswith(f"{start} "))


def _predicted(model: dict, vehicle: Vehicle) -> dict[str, float]:
    from groundstation.model.vehicle_model import model_from_document

    physical = model_from_document(model, vehicle)
    return {
        "mass_kg": physical.mass_kg,
        **{f"i{a}{a}_kg_m2": float(physical.tensor[i, i]) for i, a in enumerate("xyz")},
    }


def disagreements(folder: Path, vehicle: Vehicle, printed: str = "") -> list[str]:
    """Places that show another number than ``identification.json`` holds, by parameter."""
    known = estimate_in(read_identification(folder / "identification.json"))[1]
    found = {name: estimate for name in SHOWN if (estimate := estimate_of(known.get(name))) is not None}
    assert found, f"{folder}: reveals none of {SHOWN}"
    shown = places(folder, vehicle, printed)
    return [
        f"{place}: {name}"
        for place, agrees in shown.items()
        for name, estimate in found.items()
        if not agrees(name, estimate)
    ]
