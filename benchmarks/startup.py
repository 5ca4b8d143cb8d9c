"""How long the command takes to be there: medians of several starts, as a process.

Run with ``python -m benchmarks.startup``.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time

RUNS = 7
COMMANDS = (("--help",), ("plan", "--help"), ("doctor", "--json"))


def start_s(arguments: tuple[str, ...]) -> float:
    """Wall seconds of one run."""
    began = time.perf_counter()
    command = [sys.executable, "-P", "-m", "groundstation.cli", *arguments]
    subprocess.run(command, capture_output=True, check=True)
    return time.perf_counter() - began


def main() -> None:
    """Print the medians."""
    for arguments in COMMANDS:
        start_s(arguments)
        median = statistics.median(start_s(arguments) for _ in range(RUNS))
        print(f"groundstation {' '.join(arguments):<16} {1e3 * median:6.0f} ms (median of {RUNS})")


if __name__ == "__main__":
    main()
