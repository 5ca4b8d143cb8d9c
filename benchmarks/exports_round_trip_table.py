"""The table of round trips in the page on exports, made from docs/results/exports_round_trip.json.

`python -m benchmarks.exports_round_trip_table`
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from groundstation.identification.results import MASS_AND_TENSOR

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results" / "exports_round_trip.json"
PAGE = ROOT / "docs/exports.md"
CERTAIN = 2.7
"""Largest of seven standard normal numbers, exceeded by chance in 5 % of runs."""
FORMATS = {
    "rotorpy": "rotorpy", "mujoco": "mjcf", "pybullet": "pybullet", "crazyflow": "crazyflow", "px4": "px4-sih",
    "arducopter": "ardupilot-sitl", "arducopter, little yaw": "ardupilot-sitl",
}  # fmt: skip
"""Format by reader."""


def reader(name: str, told: Mapping[str, Any]) -> str:
    """A reader with its version."""
    version, variant = str(told["version"]), name.partition(", ")[2]
    shown = version if " " in version else f"{name} {version}"
    return f"{shown}, {variant}" if variant else shown


def tables(results: Mapping[str, Any]) -> str:
    """Both tables: who flew and how it agrees, then each number."""
    readers = {name: told for name in FORMATS if (told := results["readers"].get(name))}
    lines = [
        "| format | reader | flown | not held | worst z of seven | furthest off | agreement |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    lines += [
        f"| `{FORMATS[name]}` | {reader(name, told)} | {told.get('flown', '20 s of excitation')} | "
        f"{told.get('lacks', '–')} | {told['worst_z']:.2f} | {100.0 * furthest(told['parameters']):.1f} % | "
        f"{'agrees' if told['agrees'] else 'differs'} |"
        for name, told in readers.items()
    ]
    heads = [reader(name, told) for name, told in readers.items()]
    lines += ["", f"| exported → again ± 95 % (z) | {' | '.join(heads)} |", "| --- |" + " --- |" * len(heads)]
    lines += [
        f"| {parameter} | {' | '.join(_cell(told['parameters'].get(parameter)) for told in readers.values())} |"
        for parameter in MASS_AND_TENSOR
    ]
    return "\n".join(lines)


def furthest(parameters: Mapping[str, Mapping[str, float]]) -> float:
    """Largest difference: of the mass as a share of it, of the tensor's entries as a share of its largest moment."""
    largest = max(row["exported"] for name, row in parameters.items() if name in MASS_AND_TENSOR[1:])
    sizes = dict.fromkeys(MASS_AND_TENSOR[1:], largest) | {"mass_kg": parameters["mass_kg"]["exported"]}
    return max(abs(row["again"] - row["exported"]) / sizes[n] for n, row in parameters.items() if n in sizes)


def _cell(row: Mapping[str, float] | None) -> str:
    if row is None:
        return "not revealed"
    return f"{row['exported']:.5g} → {row['again']:.5g} ± {1.96 * row['std']:.2g} ({row['z']:+.2f})"


def main() -> None:
    """Put the tables into the page, between its marks."""
    text = PAGE.read_text(encoding="utf-8")
    made = tables(json.loads(RESULTS.read_text(encoding="utf-8")))
    marks = re.compile(r"(<!-- round trips: .*? -->\n).*?(\n<!-- end of round trips -->)", re.S)
    PAGE.write_text(marks.sub(lambda m: f"{m[1]}\n{made}\n{m[2]}", text), encoding="utf-8")


if __name__ == "__main__":
    main()
