"""A worn vehicle, flown over seeds, moments of take-off and both shipped plans: is the right rotor named first, and how
surely?

``configs/scenarios/worn.toml`` hides a rotor that loses 6 % beside an offset of the centre of mass. Every flight draws
its seed of noise and how long the vehicle stands before it climbs. Kept in docs/results/worn.json; run with ``python -m
benchmarks.worn``.
"""

from __future__ import annotations

import argparse
import json
import secrets
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.writing import write_whole
from studies.worn import PLANS, WAIT_S, fly, summary


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.worn", description="A worn vehicle over seeds and moments of take-off."
    )
    parser.add_argument("--flights", type=int, default=100, help="of each plan")
    parser.add_argument("--seed", type=int, default=None, help="master seed (default: a fresh one, printed)")
    parser.add_argument("--out", type=Path, default=None, help="write rows and figures here, as JSON")
    options = parser.parse_args(argv)
    master = secrets.randbits(32) if options.seed is None else options.seed
    print("master seed", master, flush=True)
    random = np.random.default_rng(master)
    rows: list[dict[str, Any]] = []
    for number in range(options.flights):
        for plan in PLANS:
            seed, wait_s = int(random.integers(2**31)), round(float(random.uniform(*WAIT_S)), 3)
            row = fly(plan, seed, wait_s)
            rows.append(row)
            told = ", ".join(f"{f['effect']} {f['rotor'] or ''} {f['confidence']:.3f}" for f in row["findings"])
            print(f"{number + 1} {plan} {seed} {wait_s:.3f} s: {row['verdict']}: {told}", flush=True)
            if options.out is not None:
                figures = {name: summary([r for r in rows if r["plan"] == name]) for name in PLANS}
                document = {"master_seed": master, "figures": figures, "all": summary(rows), "rows": rows}
                write_whole(options.out, json.dumps(document, indent=1))
    for name in PLANS:
        print(name, summary([row for row in rows if row["plan"] == name]))
    print("all", summary(rows))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
