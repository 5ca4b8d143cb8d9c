"""Studies over many flights: on the cores of this machine, or on a Dask cluster, by the runner that ``groundstation
batch`` uses.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from groundstation.fleet.runner import Outcome, run

Item = TypeVar("Item")
Value = TypeVar("Value")


def add_options(parser: argparse.ArgumentParser) -> None:
    """``--workers`` and ``--scheduler``."""
    parser.add_argument("--workers", type=int, default=1, help="processes on this machine")
    parser.add_argument("--scheduler", default=None, help="address of a Dask scheduler, e.g. tcp://127.0.0.1:8786")


def outcomes(
    function: Callable[[Item], Value], items: Sequence[Item], options: argparse.Namespace
) -> Iterator[Outcome[Item, Value]]:
    """Outcomes in the items' order, as soon as their turn has come; a line on standard error for each that failed."""
    ready: dict[int, Outcome[Item, Value]] = {}
    turn = 0
    for outcome in run(function, items, workers=options.workers, scheduler=options.scheduler):
        if outcome.failure:
            print(f"item {outcome.index}: {outcome.failure}", file=sys.stderr, flush=True)
        ready[outcome.index] = outcome
        while turn in ready:
            yield ready.pop(turn)
            turn += 1
