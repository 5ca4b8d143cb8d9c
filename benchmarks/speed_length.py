"""Section of ``benchmarks.speed``: what ``identify`` and ``diagnose`` take of a flight of twenty seconds to an hour.

python -m benchmarks.speed length
"""

from __future__ import annotations

from benchmarks.speed import Row
from benchmarks.speed_estimation import SEED, in_process

TITLE = "Length of a flight"
ABOUT = (
    f"Study flight {SEED} (`python -m benchmarks.study`) at 500 Hz, as long as stated. Processor time of one core of "
    "the first call in a process, imports not counted; the most memory that the process held, with the flight itself "
    "(210 MB for an hour) and all imports. The goals are those for an hour; the yardstick is the plain loop of the "
    "section above."
)
RATE_HZ = 500.0
LENGTHS_S = (20.0, 60.0, 300.0, 1200.0, 3600.0)
GOALS_S = {"identify": 60.0, "diagnose": 120.0}
GOAL_MB = 2048.0


def measure() -> list[Row]:
    """Both tasks at each length."""
    rows: list[Row] = []
    for name, goal_s in GOALS_S.items():
        for length_s in LENGTHS_S:
            hour = length_s == LENGTHS_S[-1]
            found = in_process(name, length_s, RATE_HZ, 0)
            ratio = found["first_s"] / found["loop_s"]
            rows.append(Row(f"{name}, {length_s:g} s", found["first_s"], "s", goal_s if hour else None, ratio))
            rows.append(Row(f"{name}, {length_s:g} s, memory", found["peak_mb"], "MB", GOAL_MB if hour else None))
    return rows
