"""The documents that the analysis left in a flight's folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from groundstation.errors import BadInput
from groundstation.json_types import JsonObject
from groundstation.outside import read_json

if TYPE_CHECKING:
    from groundstation.trajectory import Plan


@dataclass(frozen=True, slots=True)
class FlightResults:
    """What is known of a flight.

    Attributes:
        folder: of the flight.
        identification, diagnosis: the documents; empty where there is none.
        refusal: why there is no identification.
        evolution: how the estimates moved during the flight; empty where the analysis wrote none.
        next_flight: the plan that the diagnosis proposes.
        declared: parameters as the vehicle file declares them; empty where its vehicle does not ship.
    """

    folder: Path
    identification: Mapping[str, Any] = field(default_factory=dict)
    diagnosis: Mapping[str, Any] = field(default_factory=dict)
    refusal: str = ""
    evolution: Mapping[str, Any] = field(default_factory=dict)
    next_flight: Plan | None = None
    declared: Mapping[str, float] = field(default_factory=dict)

    @property
    def report(self) -> Path | None:
        """The report, if there is one."""
        path = self.folder / "report.html"
        return path if path.is_file() else None


def read_results(folder: Path) -> FlightResults:
    """Read what there is; a file that is damaged counts as absent."""
    from groundstation.documents import read_diagnosis, read_identification
    from groundstation.trajectory import load_plan

    names = ("identification.json", "diagnosis.json", "refused.json", "evolution.json")
    readers = (read_identification, read_diagnosis, _table, _table)
    identification, diagnosis, refused, evolution = (
        _document(read, folder / name) for read, name in zip(readers, names, strict=True)
    )
    refusal = " ".join(str(refused[key]) for key in ("reason", "remedy") if refused.get(key))
    name = str(identification.get("vehicle") or "")
    try:
        proposed = load_plan(folder / "next_flight.toml")
    except BadInput:
        proposed = None
    return FlightResults(folder, identification, diagnosis, refusal, evolution, proposed, _declared(name))


def _table(path: Path) -> JsonObject:
    document = read_json(path, "a result")
    return document if isinstance(document, dict) else {}


def _document(read: Callable[[Path], JsonObject], path: Path) -> JsonObject:
    try:
        return read(path)
    except BadInput:
        return {}


def _declared(name: str) -> Mapping[str, float]:
    """Nominal parameters of a shipped vehicle."""
    from groundstation.paths import shipped_config
    from groundstation.vehicle import load_vehicle

    try:
        return load_vehicle(shipped_config("vehicles", name)).parameters()
    except BadInput:
        return {}
