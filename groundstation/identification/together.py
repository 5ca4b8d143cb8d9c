"""What is worked out of each of several flights, on as many cores as there are.

Compiled kernels and operations on arrays let other threads go on beside them, and each flight is worked out as it is
alone: numbers are those of one flight after the other.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import TypeVar

One = TypeVar("One")
Made = TypeVar("Made")


def cores() -> int:
    """How many this process may use: those of the machine that it may run on, and no more than OMP_NUM_THREADS, which
    limits the threads of the linear algebra, too.
    """
    found = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return min(found, int(asked)) if asked.isdigit() and int(asked) else found


def of_each(made: Callable[[One], Made], items: Sequence[One]) -> list[Made]:
    """What is made of each item, in their order; what one raises is raised."""
    workers = min(cores(), len(items))
    if workers < 2:
        return [made(item) for item in items]
    contexts = [copy_context() for _ in items]  # NumPy keeps there what it does about infinities
    with ThreadPoolExecutor(workers, thread_name_prefix="flight") as pool:
        begun = [pool.submit(context.run, made, item) for context, item in zip(contexts, items, strict=True)]
        return [future.result() for future in begun]
