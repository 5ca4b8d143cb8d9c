"""What many flights cost: docs/results/scale.md, made from what benchmarks.fleet and benchmarks.catalogue measured.

    python -m benchmarks.scale docs/results

Nothing is measured here. What 100 000 flights would cost is worked out from what these figures say of one, and said to
be so.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

FLIGHTS, NODES = 100_000, 100
PLANTED = {"mass_kg": 0.03971, "weak_rotor_2.loss": 0.003}
"""By benchmarks.fleet: 2 % of the true mass of its x500, and the loss a flight."""


def read(path: Path) -> dict[str, Any]:
    """A JSON document; empty where there is none yet."""
    return json.loads(path.read_text()) if path.is_file() else {}


def runs(found: dict[str, Any]) -> list[str]:
    """Work: one core, two workers, a cluster that loses one."""
    one, count = found["one_core_s"], found["flights"]
    each = one / count
    hours = FLIGHTS * each / 3600.0 / NODES
    same = "the same to the last digit" if found["same_table"] else "**not the same**"
    return [
        f"{count} simulated flights of 20 s at 200 Hz (seeds from {found['seed']}), identified and diagnosed:",
        "",
        "| how | wall time | flights per core-hour |",
        "|---|---|---|",
        f"| one core | {one:.0f} s | {3600.0 / each:.0f} |",
        f"| two local workers | {found['two_workers_s']:.0f} s | {3600.0 * count / found['two_workers_s'] / 2:.0f} |",
        f"| Dask, two workers, one killed when a third was done | {found['dask_with_a_worker_killed_s']:.0f} s | |",
        "",
        f"The three tables are {same}. Efficiency at two workers: {found['efficiency_at_2']:.2f} of linear. These are "
        "wall times of a machine with two cores "
        "that others used at the same time; at four workers nothing can be told here.",
        "",
        f"A recording has {found['bytes_a_flight'] / 1e6:.1f} MB. It is read once by the worker that has it; what goes "
        f"back is a row of some kilobytes. {FLIGHTS} such flights are {FLIGHTS * found['bytes_a_flight'] / 1e9:.0f} GB "
        f"to read and, at this speed, {FLIGHTS * each / 3600.0:.0f} core-hours: {hours:.1f} hours on {NODES} nodes "
        "with one core each. Worked out, not run.",
    ]  # fmt: skip


def catalogue(found: dict[str, Any]) -> list[str]:
    """Listing and SQL by the number of flights."""
    counts = sorted(found, key=int)
    names = [name for name in found[counts[0]] if name != "seed"]
    lines = [
        "Flights are made, not flown: folders with the documents of an identified and diagnosed flight, 54 estimates "
        "each. Wall times of a machine of two cores that others used too; the plain loop of the same run says how fast "
        "it was.",
        "",
    ]
    lines += [
        "| what | " + " | ".join(f"{int(c):,} flights".replace(",", " ") for c in counts) + " |",
        "|---|" + "---|" * len(counts),
    ]
    for name in names:
        unit = "" if "MB" in name else " s"
        lines.append(
            f"| {name} | "
            + " | ".join(f"{found[c][name]:.3g}{unit}" if name in found[c] else "–" for c in counts)
            + " |"
        )
    return lines


def trends(found: dict[str, Any]) -> list[str]:
    """The planted changes and the fleets without one."""
    lines = []
    if "trends" in found:
        t = found["trends"]
        lines.append(
            "30 flights of one x500, its mass 2 % up (39.7 g) from flight 18 on, its rotor 2 weaker by 0.3 % each "
            "flight:"
        )
        lines += [
            "",
            "| parameter | kind | from flight | size ± standard deviation | planted | off by, in standard deviations |",
            "|---|---|---|---|---|---|",
        ]
        for name, c in t["planted"].items():
            off = f"{(c['size'] - PLANTED[name]) / c['std']:+.1f}" if name in PLANTED else "–"
            planted = f"{PLANTED[name]:.5f}" if name in PLANTED else "nothing"
            lines.append(
                f"| {name} | {c['kind']} | {c['flight']} | {c['size']:.5f} ± {c['std']:.5f} | {planted} | {off} |"
            )
        lines += [
            "",
            "A drift is told from the first flight that has the parameter: the weak rotor is a finding from the fifth "
            "flight on. A loss that is too small to be named reads as mass on the first flights, which the mass's own "
            "intervals allow for.",
            f"Of {t['fleets']} fleets of 30 flights without a change, drawn from {t['pool']} flown ones, {t['false']} "
            "were said to have one.",
        ]
    if "drawn" in found:
        lines.append(
            f"Of {found['drawn']['fleets']} fleets drawn as independent estimates (seed {found['drawn']['seed']}), "
            f"{found['drawn']['false']} were."
        )
    return lines


def page(fleet: dict[str, Any], listed: dict[str, Any]) -> str:
    """Markdown."""
    parts = [
        "# Many flights: what they cost",
        "",
        "Made by `python -m benchmarks.scale docs/results` from fleet.json and catalogue.json beside it.",
    ]
    if "runs" in fleet:
        parts += ["", "## Work", "", *runs(fleet["runs"])]
    if listed:
        parts += ["", "## Catalogue", "", *catalogue(listed)]
    if told := trends(fleet):
        parts += ["", "## Trends", "", *told]
    parts += [
        "", "## Where it breaks first", "",
        "The catalogue is one file that is read whole and written whole. What grows with the number of flights is its "
        "first reading (each folder's JSON is parsed once) and the check at each listing which folders changed (one "
        "stat a folder). Work itself has no part that grows faster than the number of flights; on a cluster the "
        "storage's bandwidth comes next, as each recording is read once.",
    ]  # fmt: skip
    return "\n".join(parts) + "\n"


def main() -> None:
    """Read, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    text = page(read(folder / "fleet.json"), read(folder / "catalogue.json"))
    (folder / "scale").with_suffix(".md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
