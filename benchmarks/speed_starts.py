"""Section of ``benchmarks.speed``: how soon the command is there, and a first plan, each as a process of its own."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys

from benchmarks import startup
from benchmarks.speed import Row

TITLE = "Start-up, and a first plan"
ABOUT = (
    "Processor time of whole processes with their imports, medians of three; the terminal UI in a pseudo-terminal "
    "until its first screen stands. The yardstick is a process that imports NumPy, in the same run: on a busy machine "
    "both take longer. The plan is the paper's problem from a cold start; its goal holds for an idle machine."
)
RUNS = 3


def _process_s(*arguments: str) -> float:
    def once() -> float:
        before = os.times()
        command = [sys.executable, "-P", *arguments]
        subprocess.run(command, capture_output=True, check=True, env=startup.environment())
        return startup.children_s(before)

    once()
    return statistics.median(once() for _ in range(RUNS))


def measure() -> list[Row]:
    """Every start."""
    yardstick = _process_s("-c", "import numpy")
    found = {name: processor for name, (_, processor) in startup.medians(RUNS).items()}
    found["groundstation plan --paper"] = _process_s("-m", "groundstation.cli", "plan", "--paper")
    goals = {"groundstation plan --paper": 1.0}
    return [Row(name, value, "s", goals.get(name, 0.5), value / yardstick) for name, value in found.items()]
