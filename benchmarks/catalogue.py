"""Time of the catalogue over many flights: first reading, listing, SQL over all parameters. The flights are made, not
flown.

    python -m benchmarks.catalogue --flights 10000 --json docs/results/catalogue.json

Beside each time stands a plain loop of the same run (parse every flight's JSON once), since times of a shared machine
mean little alone.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from groundstation.fleet.catalogue import FILE, Catalogue, Filter
from groundstation.fleet.report import trend_lines

METHODS = ("LS", "GD", "FMLS", "FMGD", "OE", "FE", "IV")
NAMES = ("mass_kg", "ixx_kg_m2", "ixy_kg_m2", "ixz_kg_m2", "iyy_kg_m2", "iyz_kg_m2", "izz_kg_m2")
MODEL = ("rotor_lag_up_s", "rotor_lag_down_s", "gyro_bias_x_rad_s", "accel_bias_x_m_s2", "input_delay_s")
QUERIES = {
    "mean of every parameter by method": "SELECT method, name, avg(value), avg(std) FROM parameters GROUP BY ALL",
    "worst moment of each vehicle": "SELECT vehicle, max(std / value) FROM parameters WHERE name LIKE 'i__\\_kg\\_m2' "
    "ESCAPE '\\' GROUP BY ALL",
    "findings by effect": "SELECT effect, count(*), avg(confidence) FROM findings GROUP BY ALL",
}


def make(logs: Path, count: int, random: np.random.Generator) -> None:
    """Folders with the documents of an identified and diagnosed flight: 54 estimates each."""
    for number in range(count):
        day = f"2026-{1 + number // 2500 % 12:02}-{1 + number // 90 % 28:02}"
        folder = logs / f"{day}T{number % 24:02}-{number % 60:02}-{number // 60 % 60:02}-{number}"
        folder.mkdir(parents=True)
        (folder / "flight.mcap").touch()
        draws = iter(random.normal(1.0, 0.01, 200))
        estimate = lambda: {"value": float(v := next(draws)), "std": 0.01, "ci95": [v - 0.02, v + 0.02]}  # noqa: B023, E731
        document = {
            "schema": "groundstation.identification/1",
            "flight": folder.name,
            "vehicle": f"vehicle-{number % 20}",
            "best": "IV",
            "methods": {m: {"parameters": {n: estimate() for n in NAMES}} for m in METHODS},
            "model": {n: estimate() for n in MODEL},
            "quality": ["3 samples repaired."],
        }
        (folder / "identification.json").write_text(json.dumps(document))
        found = (
            [{"effect": "rotor_drag", "confidence": 0.99, "parameters": {"d_x_kg_s": estimate()}}] if number % 3 else []
        )
        (folder / "diagnosis.json").write_text(
            json.dumps({"verdict": "explained" if found else "clean", "findings": found})
        )


def timed(function: Callable[[], object]) -> float:
    """Seconds of one call."""
    began = time.perf_counter()
    function()
    return time.perf_counter() - began


def measure(count: int, seed: int) -> dict[str, float]:
    """Seconds by name."""
    with tempfile.TemporaryDirectory() as folder:
        logs = Path(folder)
        make(logs, count, np.random.default_rng(seed))
        out = {"plain loop: parse every identification.json": timed(
            lambda: [json.loads(p.read_text()) for p in logs.glob("*/identification.json")]
        )}  # fmt: skip
        out["first reading of all flights"] = timed(lambda: Catalogue(logs))
        out["listing: all flights"] = timed(lambda: Catalogue(logs).rows())
        out["listing: one vehicle"] = timed(lambda: Catalogue(logs).rows(Filter(vehicle="vehicle-3")))
        out["listing: one finding since a date"] = timed(
            lambda: Catalogue(logs).rows(Filter(finding="rotor_drag", since="2026-02"))
        )
        catalogue = Catalogue(logs)
        for name, query in QUERIES.items():
            out[f"SQL: {name}"] = timed(lambda query=query: catalogue.sql(query))
        if count <= 10_000:
            out["trends of one vehicle's flights"] = timed(lambda: trend_lines(catalogue, "vehicle-3"))
        out["file, MB"] = (logs / FILE).stat().st_size / 1e6
    return out


def main() -> None:
    """Make, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--flights", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=19)
    parser.add_argument("--json", type=Path, default=None, help="keep the figures here, by number of flights")
    arguments = parser.parse_args()
    found = measure(arguments.flights, arguments.seed)
    print(f"{arguments.flights} flights made (seed {arguments.seed})")
    for name, value in found.items():
        print(f"{name:<50} {value:8.3f}{'' if 'MB' in name else ' s'}")
    if arguments.json is not None:
        kept = json.loads(arguments.json.read_text()) if arguments.json.is_file() else {}
        kept[str(arguments.flights)] = {"seed": arguments.seed, **{k: round(v, 4) for k, v in found.items()}}
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    main()
