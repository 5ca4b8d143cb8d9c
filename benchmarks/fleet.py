"""A fleet's flights made, worked through and trended: one core, two workers, a Dask cluster whose worker is killed; one
table.

    python -m benchmarks.fleet --flights 200 --json docs/results/fleet.json
    python -m benchmarks.fleet --part drawn --part trends --json docs/results/fleet.json

Flights are simulated (20 s of excitation, 200 Hz) and written as MCAP by the batch's own runner. Then the same
recordings are identified and diagnosed three times from nothing, and the tables compared to the last digit. The trend
flies one vehicle 30 times with its mass 2 % up from flight 18 on and rotor 2 losing 0.3 % more a flight; fleets without
a change are drawn from the flights of that vehicle without either, 30 of them at random for each fleet. Since those
fleets share flights, others are drawn as estimates alone, each independent of all others: seven parameters, standard
deviations and a scatter between flights of their own. Parts that were not asked for keep their figures in the JSON
file.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.diagnosis import diagnose
from groundstation.fleet import batch
from groundstation.fleet.runner import run
from groundstation.fleet.trends import trend
from groundstation.identification.pipeline import identify
from groundstation.identification.results import MASS_AND_TENSOR
from groundstation.paths import find_config
from groundstation.recording import write_mcap
from groundstation.reporting.exports import model_document
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from studies.flown import flight_data
from studies.hidden import world
from studies.study import draw

STEPS = ("identify", "diagnose")
FLIGHTS, CHANGED, SHARE, AGEING = 30, 17, 1.02, 0.003


def make(item: tuple[str, int]) -> str:
    """Fly one vehicle of the study and write its recording."""
    folder, seed = item
    flight, _, _ = draw(seed, share=0.5, rate_hz=200.0)
    path = Path(folder) / f"flight-{seed}" / "flight.mcap"
    path.parent.mkdir(parents=True)
    write_mcap(flight, path)
    return str(path)


@contextmanager
def cluster() -> Iterator[tuple[str, list[int]]]:
    """A Dask scheduler and two workers on loopback: address and the workers' process ids."""
    script = (
        "from distributed import LocalCluster; import sys\n"
        "if __name__ == '__main__':\n"
        "    c = LocalCluster(n_workers=2, threads_per_worker=1, host='127.0.0.1', dashboard_address=None, "
        "processes=True)\n"
        "    print(c.scheduler_address, *(n.pid for n in c.workers.values()), flush=True); sys.stdin.read()\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdin is not None
    address, *pids = process.stdout.readline().split()
    try:
        yield address, [int(p) for p in pids]
    finally:
        process.stdin.close()
        process.wait(60)


def worked(recordings: list[str], out: Path, kill: list[int] | None = None, **how: Any) -> tuple[float, str]:
    """Seconds and table (as JSON) of a batch from nothing; a worker is killed when a third is done."""
    for marker in Path(recordings[0]).parent.parent.rglob(batch.BATCH_FILE):
        marker.unlink()
    began, done = time.perf_counter(), []
    for result in batch.results(batch.tasks(recordings, str(out), None, STEPS), **how):
        done.append(result)
        if kill and len(done) == len(recordings) // 3:
            os.kill(kill[0], signal.SIGKILL)
    return time.perf_counter() - began, json.dumps(batch.table(done))


def one_of_a_fleet(item: tuple[int, float, float]) -> dict[str, tuple[float, float]]:
    """Canonical parameters (value, std) of one flight of an x500 whose mass and second rotor are as told."""
    seed, mass_share, loss = item
    random = np.random.default_rng([19, seed])
    vehicle = load_vehicle(find_config("vehicles", "x500"))
    hidden = {"weak_rotor": {"rotor": 2, "loss": loss}} if loss > 0.0 else {}
    scenario = world(np.random.default_rng(190), hidden, vehicle)
    truth = scenario.truth.model_copy(update={"mass_factor": scenario.truth.mass_factor * mass_share})
    plan = load_plan(find_config("plans", "qball2"))
    plan = plan.model_copy(update={"periods": 0.5 * plan.periods})
    flight = flight_data(
        simulate(vehicle, plan, scenario.model_copy(update={"truth": truth}), int(random.integers(2**31))), f"{seed}"
    )
    found, diagnosis = identify([flight]), diagnose([flight])
    document = model_document(found, vehicle, diagnosis)
    out = {
        name: (e["value"], e["std"])
        for name, e in document["parameters"].items()
        if name in MASS_AND_TENSOR and e["std"] > 0
    }
    for finding in diagnosis.findings:
        for name, estimate in finding.parameters.items():
            if estimate.std > 0:
                out[f"{finding.effect}{f'_{finding.rotor}' if finding.rotor else ''}.{name}"] = (
                    estimate.value,
                    estimate.std,
                )
    return out


def collected(items: list[tuple[int, float, float]], workers: int) -> list[dict[str, tuple[float, float]]]:
    """Flights in order; one that failed is left out."""
    found = sorted(run(one_of_a_fleet, items, workers=workers), key=lambda o: o.index)
    return [o.value for o in found if o.value is not None]


def changes(flights: list[dict[str, tuple[float, float]]]) -> dict[str, dict[str, Any]]:
    """What the trends name over flights in order."""
    names = {name for f in flights for name in f}
    series = {name: [(i, *f[name]) for i, f in enumerate(flights) if name in f] for name in names}
    long = {name: s for name, s in series.items() if len(s) >= 4}
    out = {}
    for name, s in sorted(long.items()):
        change = trend([v for _, v, _ in s], [d for _, _, d in s], parameters=len(long)).change
        if change is not None:
            out[name] = {
                "kind": change.kind,
                "flight": s[change.at][0] + 1,
                "size": change.size,
                "std": change.std,
                "probability": change.probability,
            }
    return out


def drawn_fleets(seed: int, fleets: int) -> dict[str, Any]:
    """How many fleets of estimates without any change are said to have one; 30 flights, mass and tensor each."""
    random = np.random.default_rng(seed)
    false = 0
    for _ in range(fleets):
        std = random.lognormal(0.0, 0.3, (FLIGHTS, len(MASS_AND_TENSOR)))
        scatter = random.uniform(0.0, 2.0, len(MASS_AND_TENSOR))
        values = random.normal(0.0, np.hypot(std, scatter))
        flights = [
            {n: (float(v), float(s)) for n, v, s in zip(MASS_AND_TENSOR, row, stds, strict=True)}
            for row, stds in zip(values, std, strict=True)
        ]
        false += bool(changes(flights))
    return {"fleets": fleets, "false": false, "seed": seed}


def trends(workers: int, seed: int, clean: int, fleets: int) -> dict[str, Any]:
    """The planted change, and how many fleets without one are said to have one."""
    planted = [(i, SHARE if i >= CHANGED else 1.0, AGEING * i) for i in range(FLIGHTS)]
    found = changes(collected(planted, workers))
    pool = collected([(1000 + i, 1.0, 0.0) for i in range(clean)], workers)
    random = np.random.default_rng(seed)
    false = sum(bool(changes([pool[i] for i in random.permutation(len(pool))[:FLIGHTS]])) for _ in range(fleets))
    return {"planted": found, "fleets": fleets, "false": false, "pool": len(pool), "seed": seed}


def runs(flights: int, seed: int) -> dict[str, Any]:
    """Flights made, then worked through three times: seconds of each, and whether the three tables are one."""
    with tempfile.TemporaryDirectory() as folder:
        items = [(folder, seed + i) for i in range(flights)]
        made = sorted(run(make, items, workers=2), key=lambda o: o.index)
        recordings = [o.value for o in made if o.value is not None]
        size = sum(Path(path).stat().st_size for path in recordings) / max(len(recordings), 1)
        one, first = worked(recordings, Path(folder), workers=1)
        two, second = worked(recordings, Path(folder), workers=2)
        with cluster() as (address, pids):
            dask, third = worked(recordings, Path(folder), kill=pids, scheduler=address)
    return {
        "flights": len(recordings),
        "seed": seed,
        "bytes_a_flight": round(size),
        "one_core_s": one,
        "two_workers_s": two,
        "dask_with_a_worker_killed_s": dask,
        "efficiency_at_2": one / two / 2.0,
        "same_table": first == second == third,
    }


def main() -> None:
    """The parts asked for; figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--part", action="append", choices=("runs", "trends", "drawn"), help="default: all")
    parser.add_argument("--flights", type=int, default=200)
    parser.add_argument("--seed", type=int, default=31_001, help="of the first flight")
    parser.add_argument("--clean", type=int, default=60, help="flights without a change, from which fleets are drawn")
    parser.add_argument("--fleets", type=int, default=100)
    parser.add_argument("--workers", type=int, default=2, help="of the trends' flights")
    parser.add_argument("--json", type=Path, default=None)
    arguments = parser.parse_args()
    out: dict[str, Any] = {}
    if arguments.json is not None and arguments.json.is_file():
        out = json.loads(arguments.json.read_text())
    parts = arguments.part or ("drawn", "trends", "runs")
    if "drawn" in parts:
        out["drawn"] = drawn_fleets(arguments.seed, arguments.fleets)
    if "trends" in parts:
        out["trends"] = trends(arguments.workers, arguments.seed, arguments.clean, arguments.fleets)
    if "runs" in parts:
        out["runs"] = runs(arguments.flights, arguments.seed)
    print(json.dumps(out, indent=1))
    if arguments.json is not None:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps(out, indent=1) + "\n")


if __name__ == "__main__":
    main()
