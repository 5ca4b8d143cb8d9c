"""The nano-drone benchmark's flights: identify and predict as anyone runs them, against constant velocity and the
declared vehicle.

    python -m benchmarks.nanodrone ../shared/data/nanodrone [--out docs/results/nanodrone.json]

Trains on five flights and tests on ``random2_20251017_run4``; then each flight is left out once, and the model of the
other five predicts it; then each single flight predicts ``random2`` (itself by ``multisine_20251017_run1``). 0.5 s
ahead, own state, mean error norm. About two minutes of computing per model.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from groundstation import api
from groundstation.errors import Refused

TEST = "random2_20251017_run4"
QUANTITIES = ("position_m", "velocity_m_s", "attitude_rad", "body_rate_rad_s")
GIVEN = {
    "throw-away script": (0.057, 0.329, 0.131, 0.428),
    "the same without rotor torque": (0.067, 0.350, 0.118, 0.387),
}
"""Of the task, on random2."""


def model_of(flights: Sequence[Any]) -> dict[str, Any] | None:
    """The model file of the flights; None where they are refused."""
    try:
        found = api.identify(flights)
    except Refused:
        return None
    return api.model_document(found, flights[0].vehicle)


def row(label: str, model: dict[str, Any] | None, flight: Any) -> dict[str, Any]:
    """Mean errors 0.5 s ahead of the model's own choice and of constant velocity."""
    if model is None:
        return {"case": label, "refused": True}
    found = api.predict(model, flight, own_state=True)
    errors = {name: {q: e["mean_norm"] for q, e in by["0.5"].items()} for name, by in found.error.items()}
    return {"case": label, "flight": flight.name, "windows": found.windows, "predictor": found.predictor,
            "worse": found.to_dict()["worse_than_constant_velocity"], **errors}  # fmt: skip


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown of the rows."""
    lines = [
        "| case | predictor | windows | position, m | velocity, m/s | attitude, rad | rate, rad/s |",
        "|---|---|---|---|---|---|---|",
    ]
    for each in rows:
        if each.get("refused"):
            lines.append(f"| {each['case']} | refused | | | | | |")
            continue
        for name, who in (("model", each["predictor"]), ("constant_velocity", "constant velocity")):
            numbers = " | ".join(f"{each[name][q]:.4f}" for q in QUANTITIES)
            lines.append(f"| {each['case']} | {who} | {each['windows']} | {numbers} |")
    return "\n".join(lines)


def main() -> None:
    """Load, identify, predict, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/results/nanodrone.json"))
    parser.add_argument("--only", choices=["five", "left-out", "single"], default=None)
    options = parser.parse_args()
    flights = {p.name: api.load_flight(p) for p in sorted(options.data.iterdir()) if p.is_dir()}
    rows: list[dict[str, Any]] = []
    for name in flights if options.only in (None, "left-out") else (TEST,) if options.only == "five" else ():
        others = [flight for key, flight in flights.items() if key != name]
        rows.append(row(f"five flights -> {name}", model_of(others), flights[name]))
        print(table(rows[-1:]), flush=True)
    for name in flights if options.only in (None, "single") else ():
        target = TEST if name != TEST else "multisine_20251017_run1"
        rows.append(row(f"{name} -> {target}", model_of([flights[name]]), flights[target]))
        print(table(rows[-1:]), flush=True)
    for label, numbers in GIVEN.items():
        print(f"{label} on {TEST}: " + ", ".join(f"{x:.3f}" for x in numbers))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(
        json.dumps({"schema": "groundstation.benchmark/1", "given": GIVEN, "rows": rows}, indent=1) + "\n"
    )


if __name__ == "__main__":
    main()
