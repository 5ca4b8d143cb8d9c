"""Faults of a measured Crazyflie by mean thrusts alone: which rotor, which kind, and how sure? CrazyPAD's flights.

    python -m benchmarks.crazypad FOLDER [--out docs/results/crazypad.json]

FOLDER holds a folder for each set of flights, as in AerialRoboticsUUST/CrazyPAD's `data/motor_data` (Masalimov et al.,
Data 2024, 9, 79; MIT) or in shared/data/crazypad: `normal_flight` and faults, named by what was done to which rotor.
The flights of a set are pooled; references are the healthy flights of the same individual (E8, E9), and of the other.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from groundstation import api
from groundstation.diagnosis.trim import compare_trims
from groundstation.errors import GroundStationError
from groundstation.identification.preparation import Prepared, prepare

HEALTHY = "normal_flight"
SURE = 0.9


def fault_of(name: str) -> tuple[str, frozenset[int]]:
    """Kind of a set, and its rotors."""
    kind = "load" if "weight" in name else "tape" if "tape" in name else "none" if name == HEALTHY else "cut"
    return kind, frozenset(map(int, re.findall(r"[Mm](\d)(?!m)", name)))


def judged(name: str, found: Any) -> dict[str, Any]:
    """What is kept of a set: what was named, how surely, and how right that is."""
    kind, rotors = fault_of(name)
    named = frozenset(f.rotor for f in found.findings)
    effects = {f.effect for f in found.findings}
    right_kind = effects == {"com_offset" if kind == "load" else "weak_rotor"}
    if kind == "none":
        outcome = "false alarm" if named else "healthy"
    elif not named:
        outcome = "missed"
    elif named == rotors or (effects == {"com_offset"} and named <= rotors):
        outcome = "right" if right_kind else "right rotor, other kind"
    else:
        outcome = "one of them" if named & rotors else "wrong rotor"
    confidence = max((f.confidence for f in found.findings), default=None)
    told = [f.sentence for f in found.findings]
    return {
        "outcome": outcome,
        "rotors": sorted(rotors),
        "named": sorted(named),
        "effects": sorted(effects),
        "confidence": confidence,
        "told": told,
        "explained": found.explained,
        "notes": list(found.notes),
    }


def prepared_sets(folder: Path) -> dict[tuple[str, str], list[Prepared]]:
    """Flights by set and individual."""
    vehicle = api.load_vehicle("crazyflie21")
    out: dict[tuple[str, str], list[Prepared]] = {}
    for path in sorted(folder.glob("*/*")):
        if re.fullmatch(r"E\d+_log\d+", path.name):
            try:
                prepared = prepare(api.load_flight(path, vehicle=vehicle))
            except GroundStationError as refusal:
                print(f"left out: {path.parent.name}/{path.name}: {refusal}", flush=True)
                continue
            out.setdefault((path.parent.name, path.name.partition("_")[0]), []).append(prepared)
    return out


def rows_of(sets: Mapping[tuple[str, str], list[Prepared]]) -> list[dict[str, Any]]:
    """Every set by references of its own individual and of another; healthy flights one by one, the others as
    references.
    """
    individuals = sorted({individual for _, individual in sets})
    rows: list[dict[str, Any]] = []
    for (name, individual), flights in sets.items():
        for other in individuals:
            references = sets.get((HEALTHY, other), [])
            for suspects, healthy in _pairs(name, flights, references, own=other == individual):
                if len(healthy) < 4:
                    continue
                row = {"set": name, "individual": individual, "references": other}
                rows.append(row | judged(name, compare_trims(suspects, healthy)))
                print(json.dumps(rows[-1], ensure_ascii=False), flush=True)
    return rows


def _pairs(
    name: str, flights: list[Prepared], references: list[Prepared], *, own: bool
) -> list[tuple[list[Prepared], list[Prepared]]]:
    if name != HEALTHY:
        return [(flights, references)]
    return [([one], [each for each in references if each is not one]) for one in flights] if own else []


def summary(rows: Sequence[Mapping[str, Any]]) -> str:
    """Counts by kind and references, and what was surely wrong."""
    lines = ["| fault | references | sets | right | right rotor, other kind | one of them | wrong rotor | missed |",
             "|---|---|---|---|---|---|---|---|"]  # fmt: skip
    columns = ("right", "right rotor, other kind", "one of them", "wrong rotor", "missed")
    for own in (True, False):
        for kind in ("cut", "tape", "load"):
            mine = [r for r in rows if (r["individual"] == r["references"]) == own and fault_of(r["set"])[0] == kind]
            counts = " | ".join(str(sum(r["outcome"] == c for r in mine)) for c in columns)
            lines.append(f"| {kind} | {'own' if own else 'of another'} | {len(mine)} | {counts} |")
    healthy = [r for r in rows if r["set"] == HEALTHY]
    lines.append(f"healthy flights one by one: {len(healthy)}, a fault named in "
                 f"{sum(r['outcome'] == 'false alarm' for r in healthy)}")  # fmt: skip
    sure = [r for r in rows if (r["confidence"] or 0.0) > SURE]
    off = [r for r in sure if r["outcome"] not in ("right", "right rotor, other kind")]
    lines.append(f"named at more than {SURE:.0%}: {len(sure)}, of these not the rotors that were changed: {len(off)}")
    return "\n".join(lines)


def main() -> None:
    """Load, compare, count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, help="keep the rows as JSON")
    options = parser.parse_args()
    rows = rows_of(prepared_sets(options.folder))
    print(summary(rows))
    if options.out:
        document = {"schema": "groundstation.benchmark.crazypad/1", "rows": rows}
        options.out.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
