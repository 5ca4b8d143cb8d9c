"""Section of ``benchmarks.speed``: processor time and memory of ``identify`` and ``diagnose`` of a minute of flight.

    python -m benchmarks.speed_estimation TASK LENGTH_S RATE_HZ [RUNS]     one measurement, as JSON

Each measurement is a process of its own, so that its memory is its own. The yardstick is the least-squares sum of
:mod:`benchmarks.estimators` sample by sample in Python over 10 s at 500 Hz, in the same process.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.speed import ROOT, Row
from groundstation.flightdata import (
    BATTERY_COLUMNS,
    IMU_COLUMNS,
    MOCAP_COLUMNS,
    SETPOINT_COLUMNS,
    STATE_COLUMNS,
    FlightData,
    Stream,
    motor_columns,
)
from studies.estimators import loop_least_squares, problem
from studies.timing import seconds

TITLE = "Identification and diagnosis"
SEED = 2001
"""Of the study: rotors by command, so lag and delay are free, which is the slower case."""
ABOUT = (
    f"Study flight {SEED} (`python -m benchmarks.study`), flown for as long as stated at 500 Hz: mass, six inertias, "
    "lag and dead time free. Processor time of one core, of the second and later calls in a process (warm) or of the "
    "whole process with its imports (cold). *identify* is all methods with intervals; *with prediction* adds the "
    "choice and fit of the prediction model; *diagnose* goes from the streams to findings and forecasts, *diagnose_on* "
    "from what an identification of the same flight left. The yardstick is a plain least-squares loop over 10 s in the "
    "same process."
)
PLAN_S = 40.0
"""Of the study's plan at its own number of periods."""
MINUTE_S = 60.0
MINUTES: tuple[tuple[str, float | None], ...] = (
    ("preliminary", 0.3),
    ("identify", 0.5),
    ("with_prediction", None),
    ("diagnose", 1.0),
    ("diagnose_on", 1.0),
)
"""Tasks on a minute of flight, and the most seconds each should take."""


STREAMS = ("imu", "mocap", "motors", "battery", "setpoint", "state")


def flown(length_s: float, rate_hz: float) -> Path:
    """The flight's arrays in a file, kept from run to run, so that the simulator is in nobody's memory."""
    folder = Path(tempfile.gettempdir()) / "groundstation-speed"
    path = folder / f"{SEED}-{length_s:g}-{rate_hz:g}.npz"
    if not path.exists():
        from studies.study import draw

        flight = draw(SEED, length_s / PLAN_S, rate_hz)[0]
        arrays = {name: stream for name in STREAMS if (stream := getattr(flight, name)) is not None}
        parts = {
            f"{name}_{part}": getattr(stream, part) for name, stream in arrays.items() for part in ("t_s", "values")
        }
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(path, window_s=np.array(flight.window_s), **parts)
    return path


def read(path: Path, length_s: float) -> FlightData:
    """The flight of the file."""
    from studies.study import draw_plan, draw_vehicle

    random = np.random.default_rng([4, SEED])
    vehicle = draw_vehicle(random)
    plan = draw_plan(random, bool(random.random() < 0.5))
    plan = plan.model_copy(update={"periods": length_s / PLAN_S * plan.periods})
    columns = {
        "imu": IMU_COLUMNS,
        "mocap": MOCAP_COLUMNS,
        "motors": motor_columns(vehicle.rotors.input, vehicle.rotors.count),
        "battery": BATTERY_COLUMNS,
        "setpoint": SETPOINT_COLUMNS,
        "state": STATE_COLUMNS,
    }
    with np.load(path) as found:
        streams = {
            name: Stream(found[f"{name}_t_s"], found[f"{name}_values"], columns[name])
            for name in STREAMS
            if f"{name}_t_s" in found
        }
        start, end = found["window_s"].tolist()
    return FlightData(
        name=path.stem,
        vehicle=vehicle,
        plan=plan,
        window_s=(start, end),
        imu=streams.get("imu"),
        mocap=streams.get("mocap"),
        motors=streams["motors"],
        battery=streams.get("battery"),
        setpoint=streams.get("setpoint"),
        state=streams.get("state"),
    )


def yardstick_s() -> float:
    """Processor time of the plain loop."""
    gamma, upsilon, _ = problem()
    return seconds(lambda: loop_least_squares(gamma[:5000], upsilon[:5000]))


def _task(name: str, flight: FlightData) -> Callable[[], object]:
    if name == "preliminary":
        from groundstation.analysis.analyse import preliminary

        return lambda: preliminary(flight)
    from groundstation.diagnosis import diagnose
    from groundstation.identification.pipeline import identify
    from groundstation.identification.work import Work

    if name == "diagnose":
        return lambda: diagnose([flight])
    if name == "diagnose_on":
        work = Work()
        identify([flight], work=work)
        return lambda: diagnose([flight], work=work)

    return lambda: identify([flight], predictive=name == "with_prediction")


def one(name: str, length_s: float, rate_hz: float, runs: int) -> dict[str, float]:
    """Time and memory of one task in this process; the first call counts as cold."""
    path = flown(length_s, rate_hz)
    task = _task(name, read(path, length_s))
    first = seconds(task)
    cold = time.process_time()
    warm = statistics.median(seconds(task) for _ in range(runs)) if runs else first
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {
        "first_s": first,
        "cold_s": cold,
        "warm_s": warm,
        "peak_mb": peak / 1024.0,
        "loop_s": yardstick_s(),
    }


def in_process(name: str, length_s: float, rate_hz: float, runs: int) -> dict[str, float]:
    """One measurement in a process of its own, which keeps bytecode as an installation does: without any, a cold start
    takes seconds more of processor.
    """
    flown(length_s, rate_hz)
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    command = [sys.executable, "-P", "-m", "benchmarks.speed_estimation", name, str(length_s), str(rate_hz), str(runs)]
    done = subprocess.run(
        command, cwd=ROOT, env={**kept, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def measure() -> list[Row]:
    """All of it; longer flights are the section ``length``."""
    rows: list[Row] = []
    for name, goal in MINUTES:
        found = in_process(name, MINUTE_S, 500.0, 3)
        rows.append(Row(f"{name}, 60 s, warm", found["warm_s"], "s", goal, found["warm_s"] / found["loop_s"]))
        if name in ("identify", "with_prediction"):
            goal = 1.5 if name == "with_prediction" else None
            rows.append(Row(f"{name}, 60 s, cold", found["cold_s"], "s", goal, found["cold_s"] / found["loop_s"]))
        rows.append(Row(f"{name}, 60 s, memory", found["peak_mb"], "MB"))
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task", choices=[name for name, _ in MINUTES])
    parser.add_argument("length_s", type=float)
    parser.add_argument("rate_hz", type=float)
    parser.add_argument("runs", type=int, nargs="?", default=0)
    options = parser.parse_args()
    print(json.dumps(one(options.task, options.length_s, options.rate_hz, options.runs)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
