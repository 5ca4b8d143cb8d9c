"""The catalogue: what lies in the logs, and how parameters moved from flight to flight. Data only; others print it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from groundstation.documents import read_diagnosis, read_identification
from groundstation.errors import BadInput
from groundstation.outside import read_json

Row = dict[str, Any]


def catalogue(logs: str | Path) -> list[Row]:
    """One row per flight that lies below a folder, oldest first, each compared with the vehicle's flight before.

    A row has ``flight``, ``folder``, ``date`` (of the recording, ISO 8601, UTC), ``vehicle``, ``state`` ("identified",
    "refused" or "recorded"), ``verdict`` of the diagnosis, ``reason``, ``best``, ``parameters`` (value and std of the
    best method) and ``moved`` (change of each since the flight before, in its combined standard deviations).
    """
    folders = {path.parent for name in _SIGNS for path in Path(logs).rglob(name)}
    rows = sorted((_row(folder) for folder in folders), key=lambda row: (row["date"], row["flight"]))
    return with_moves(rows)


_SIGNS = ("flight.mcap", "identification.json", "refused.json")


def _row(folder: Path) -> Row:
    identification = _document(read_identification, folder / "identification.json")
    diagnosis = _document(read_diagnosis, folder / "diagnosis.json")
    refusal = _document(_table, folder / "refused.json")
    best = identification.get("best")
    method = identification.get("methods", {}).get(best, {})
    found = {**identification.get("model", {}), **method.get("parameters", {})}
    oldest = next(path for name in _SIGNS if (path := folder / name).exists())
    return {
        "flight": identification.get("flight", folder.name),
        "folder": str(folder),
        "date": datetime.fromtimestamp(oldest.stat().st_mtime, UTC).isoformat(timespec="seconds"),
        "vehicle": identification.get("vehicle"),
        "state": "identified" if identification else "refused" if refusal else "recorded",
        "verdict": diagnosis.get("verdict"),
        "reason": str(refusal.get("reason") or diagnosis.get("reason") or ""),
        "best": best,
        "parameters": {name: {"value": e["value"], "std": e["std"]} for name, e in found.items() if _usable(e)},
    }


def _table(path: Path) -> Row:
    document = read_json(path, "a result")
    return document if isinstance(document, dict) else {}


def _document(read: Callable[[Path], Row], path: Path) -> Row:
    """A JSON document; empty where there is none or it is damaged (a crash while it was written)."""
    try:
        return read(path)
    except BadInput:
        return {}


def _usable(estimate: Any) -> bool:
    """Whether a spread was written with the value."""
    return math.isfinite(estimate["std"])


def with_moves(rows: Sequence[Row]) -> list[Row]:
    """The rows with ``moved``: (value - previous) / sqrt(std^2 + previous std^2) against the same vehicle's last flight."""
    last: dict[str, Row] = {}
    out = []
    for row in rows:
        before = last.get(row["vehicle"] or "", {}).get("parameters", {})
        moved = {
            name: (now["value"] - before[name]["value"]) / math.hypot(now["std"], before[name]["std"])
            for name, now in row["parameters"].items()
            if name in before and math.hypot(now["std"], before[name]["std"]) > 0.0
        }
        out.append({**row, "moved": moved})
        if row["parameters"]:
            last[row["vehicle"] or ""] = row
    return out


def parameter_history(rows: Sequence[Row], vehicle: str, parameter: str) -> list[tuple[str, float, float]]:
    """Flight, value and standard deviation of a parameter over a vehicle's flights, in the rows' order."""
    return [
        (row["flight"], row["parameters"][parameter]["value"], row["parameters"][parameter]["std"])
        for row in rows
        if row["vehicle"] == vehicle and parameter in row["parameters"]
    ]
