"""The nano-drone benchmark's flights: identify and predict as anyone runs them, against constant velocity and the
declared vehicle.

    python -m benchmarks.nanodrone ../shared/data/nanodrone [--raw FOLDER] [--out docs/results/nanodrone.json]

Trains on five flights and tests on ``random2_20251017_run4``; then each flight is left out once, and the model of the
other five predicts it; then each single flight predicts ``random2`` (itself by ``multisine_20251017_run1``). 0.5 s
ahead, own state, mean error norm. About two minutes of computing per model.

``--raw`` takes a folder of the benchmark's own CSV files (idsia-robotics/nanodrone-sysid-benchmark, branch
``model_export``, ``data/real/raw/csv``) of flights that are not in the data folder. The model of the five predicts
each, and each by itself predicts the others and ``random2``.
"""

from __future__ import annotations

import argparse
import csv
import json
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from groundstation import api
from groundstation.errors import Refused
from groundstation.flightdata import IMU_COLUMNS, MOCAP_COLUMNS, STATE_COLUMNS, motor_columns

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


ABOVE_M = 0.3
"""Height between which a raw file's flight is taken, as the bundles' is."""
RAD_S = 2.0 * np.pi / 60.0 / 6.0
"""Of a rotor with twelve poles, for each electrical revolution per minute."""
STATE = ("x", "y", "z", "vx", "vy", "vz", "qw", "qx", "qy", "qz", "wx", "wy", "wz")


def bundle(raw: Path, vehicle: Path, folder: Path) -> Path:
    """A raw CSV file of the benchmark as a flight bundle: 100 Hz, its accelerations turned into the body."""
    with raw.open(newline="") as file:
        rows = list(csv.DictReader(file))

    def columns(*names: str) -> Any:
        return np.array([[float(row[name] or "nan") for name in names] for row in rows])

    high = np.flatnonzero(columns("z")[:, 0] > ABOVE_M)
    part = slice(high[0], high[-1] + 1)
    state, place = columns(*STATE)[part], columns("x_poses", "y_poses", "z_poses")[part]
    time = columns("t")[part] - columns("t")[high[0]]
    turn = Rotation.from_quat(state[:, [7, 8, 9, 6]])
    force = turn.inv().apply(columns("ax", "ay", "az")[part])
    new = np.concatenate([[True], np.any(np.diff(place, axis=0) != 0.0, axis=1)])
    speeds = columns(*(f"m{i}_erpm" for i in (1, 2, 3, 4)))[part] * RAD_S
    out = folder / raw.stem
    out.mkdir(parents=True)
    for name, header, values in (
        ("imu", f"t_s,{','.join(IMU_COLUMNS)}", np.hstack([time, state[:, 10:], force])),
        ("mocap", f"t_s,{','.join(MOCAP_COLUMNS)}", np.hstack([time, place, state[:, 6:10]])[new]),
        ("motors", f"t_s,{','.join(motor_columns('rotor_speed', 4))}", np.hstack([time, speeds])),
        ("state", f"t_s,{','.join(STATE_COLUMNS)}", np.hstack([time, state])),
    ):
        known = values[np.isfinite(values).all(axis=1)]
        np.savetxt(out / f"{name}.csv", known, delimiter=",", fmt="%.9g", header=header, comments="")
    shutil.copyfile(vehicle, out / "vehicle.toml")
    return out


def unseen(raw: Path, flights: dict[str, Any], vehicle: Path) -> list[dict[str, Any]]:
    """Rows of flights outside the data folder."""
    found: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as scratch:
        new = {p.stem: api.load_flight(bundle(p, vehicle, Path(scratch))) for p in sorted(raw.glob("*.csv"))}
        five = model_of([flight for name, flight in flights.items() if name != TEST])
        found += [row(f"five flights -> {name}", five, flight) for name, flight in new.items()]
        print(table(found), flush=True)
        for name, flight in new.items():
            model = model_of([flight])
            others = {TEST: flights[TEST], **{key: each for key, each in new.items() if key != name}}
            found += [row(f"{name} -> {key}", model, each) for key, each in others.items()]
            print(table(found[-len(others) :]), flush=True)
    return found


def main() -> None:
    """Load, identify, predict, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/results/nanodrone.json"))
    parser.add_argument("--only", choices=["five", "left-out", "single", "raw"], default=None)
    parser.add_argument("--raw", type=Path, default=None, help="folder of raw CSV files of other flights")
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
    if options.raw is not None:
        rows += unseen(options.raw, flights, options.data / TEST / "vehicle.toml")
    for label, numbers in GIVEN.items():
        print(f"{label} on {TEST}: " + ", ".join(f"{x:.3f}" for x in numbers))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(
        json.dumps({"schema": "groundstation.benchmark/1", "given": GIVEN, "rows": rows}, indent=1) + "\n"
    )


if __name__ == "__main__":
    main()
