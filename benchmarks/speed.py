"""How fast the station is: sections of measurements, kept in docs/results/speed.json and shown by its page beside it.

    python -m benchmarks.speed SECTION [...]            measure sections anew and write file and table
    python -m benchmarks.speed SECTION --before         keep what is measured as the "before" of the section
    python -m benchmarks.speed --table                  write the table anew from the file

A section is a module ``benchmarks.speed_NAME`` with ``TITLE``, ``ABOUT`` (what is measured, and what each tool
computes) and ``measure() -> list[Row]``. Ratios are of one run on one machine; the load that stood beside it is in the
file.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: processor time of one core

import argparse
import importlib
import json
import platform
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "docs" / "results" / "speed.json"
TABLE = FILE.with_suffix(".md")
SECTIONS = ("estimation", "length", "starts", "peers")
"""In the order of the page."""


@dataclass(frozen=True, slots=True)
class Row:
    """One measurement.

    Attributes:
        what: in words; it names the row, so that before and after meet.
        value, unit: as measured.
        goal: most that it should be (of a rate, least); None where there is none.
        ratio: to the yardstick of the section, measured in the same process; None where there is none.
    """

    what: str
    value: float
    unit: str
    goal: float | None = None
    ratio: float | None = None


def circumstances() -> dict[str, Any]:
    """Machine, load and time of a run."""
    describe = ["git", "describe", "--always", "--dirty"]
    commit = subprocess.run(describe, cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()
    return {
        "date": time.strftime("%Y-%m-%d"),
        "commit": commit,
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}",
        "load": round(os.getloadavg()[0], 1),
    }


def measured(name: str) -> dict[str, Any]:
    """A section, measured now."""
    module = importlib.import_module(f"benchmarks.speed_{name}")
    return {**circumstances(), "rows": [asdict(row) for row in module.measure()]}


def _number(value: float | None, unit: str = "") -> str:
    return "" if value is None else f"{value:.3g} {unit}".strip()


def _section(name: str, found: Mapping[str, Any]) -> list[str]:
    module = importlib.import_module(f"benchmarks.speed_{name}")
    out = [f"## {module.TITLE}", "", module.ABOUT, ""]
    for label in ("before", "now"):
        if label in found:
            run = found[label]
            out += [
                f"{label.capitalize()}: {run['date']}, commit {run['commit']}, {run['machine']}, load {run['load']}.",
                "",
            ]
    before = {row["what"]: row for row in found.get("before", {}).get("rows", ())}
    out += ["| measured | before | now | goal | now, in yardsticks |", "| --- | --- | --- | --- | --- |"]
    now = found.get("now", {}).get("rows", ())
    names = [row["what"] for row in now] + [what for what in before if what not in {row["what"] for row in now}]
    rows = {row["what"]: row for row in now}
    for what in names:
        one, old = rows.get(what), before.get(what)
        goal = (one or old or {}).get("goal")
        cells = [
            what,
            "" if old is None else _number(old["value"], old["unit"]),
            "" if one is None else _number(one["value"], one["unit"]),
            "" if goal is None else _number(goal, (one or old or {})["unit"]),
            "" if one is None else _number(one["ratio"]),
        ]
        out.append(f"| {' | '.join(cells)} |")
    return [*out, ""]


def table(document: Mapping[str, Any]) -> str:
    """The page."""
    head = [
        "# Speed",
        "",
        "Written by `python -m benchmarks.speed` from `docs/results/speed.json`. Times differ from machine to machine "
        "and with its load;",
        "ratios of one run are the point.",
        "",
    ]
    body = [line for name in SECTIONS if name in document for line in _section(name, document[name])]
    return "\n".join([*head, *body]).rstrip() + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", help="what to measure")
    parser.add_argument("--before", action="store_true", help="keep it as the state to compare with")
    parser.add_argument("--table", action="store_true", help="write the page from the file alone")
    options = parser.parse_args()
    if unknown := set(options.sections) - set(SECTIONS):
        parser.error(f"there is no section {', '.join(sorted(unknown))}; sections are {', '.join(SECTIONS)}")
    document: dict[str, Any] = json.loads(FILE.read_text()) if FILE.exists() else {}
    for name in () if options.table else options.sections or SECTIONS:
        document.setdefault(name, {})["before" if options.before else "now"] = measured(name)
        FILE.write_text(json.dumps(document, indent=1) + "\n")
    TABLE.write_text(table(document))
    print(table(document))
    return 0


if __name__ == "__main__":
    sys.exit(main())
