"""Run one function over many items: on this machine's cores, one process each, or on a Dask cluster. Nothing is lost,
nothing stops it.

A worker that dies (killed, out of memory) costs no other item: what it held is tried once more, alone, and then counts
as failed. Results do not depend on who computed them: each process computes with one thread, so sums are taken in one
order.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from groundstation.errors import BadInput

Item = TypeVar("Item")
Value = TypeVar("Value")

TRIES = 2
"""How often an item may kill the worker that has it alone.

In company nobody knows which item did it, so that does not count.
"""
ITEMS_A_WORKER = 50
"""Items after which a local worker is replaced, so that memory which a library keeps does not add up."""
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True, slots=True)
class Outcome(Generic[Item, Value]):
    """What became of an item: its value, or a sentence that says why there is none."""

    index: int
    item: Item
    value: Value | None
    failure: str
    seconds: float


def run(
    function: Callable[[Item], Value],
    items: Sequence[Item],
    *,
    workers: int = 1,
    scheduler: str | None = None,
    memory_bytes: int | None = None,
) -> Iterator[Outcome[Item, Value]]:
    """Outcomes as they come in, in no order.

    Args:
        function: of a module (workers import it); what it raises becomes the item's failure.
        workers: processes on this machine; not read with a scheduler.
        scheduler: address of a Dask scheduler, e.g. ``tcp://127.0.0.1:8786``.
        memory_bytes: that a local worker may take; past it the item fails, not the machine.

    Raises:
        BadInput: the scheduler does not answer, or Dask is not installed.
    """
    if scheduler is not None:
        yield from _on_cluster(function, items, scheduler)
    else:
        yield from _on_cores(function, items, max(1, workers), memory_bytes)


def timed(function: Callable[[Item], Value], item: Item) -> tuple[Value | None, str, float]:
    """Value, failure and seconds of one item; what a worker runs."""
    began = time.perf_counter()
    try:
        return function(item), "", time.perf_counter() - began
    except MemoryError:
        return None, "it needs more memory than a worker may take", time.perf_counter() - began
    except Exception as error:
        return None, f"{type(error).__name__}: {error}", time.perf_counter() - began


def _limit(memory_bytes: int | None) -> None:
    """A worker's start: its memory is bounded where the system can."""
    if memory_bytes is not None:
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, (memory_bytes, memory_bytes))


def _pool(workers: int, memory_bytes: int | None) -> ProcessPoolExecutor:
    for name in THREADS:
        os.environ[name] = "1"
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(
        workers, context, initializer=_limit, initargs=(memory_bytes,), max_tasks_per_child=ITEMS_A_WORKER
    )


def _on_cores(
    function: Callable[[Item], Value], items: Sequence[Item], workers: int, memory_bytes: int | None
) -> Iterator[Outcome[Item, Value]]:
    waiting = list(range(len(items)))[::-1]
    alone: list[int] = []
    deaths = dict.fromkeys(waiting, 0)
    held: dict[Future[Any], int] = {}
    pool = _pool(workers, memory_bytes)
    try:
        while waiting or alone or held:
            while len(held) < workers and (waiting or (alone and not held)):
                by_itself = not waiting
                index = alone.pop() if by_itself else waiting.pop()
                held[pool.submit(timed, function, items[index])] = index
                if by_itself:
                    break
            done, _ = wait(held, return_when=FIRST_COMPLETED)
            finished = [future for future in done if not isinstance(future.exception(), BrokenProcessPool)]
            for future in finished:
                index = held.pop(future)
                yield Outcome(index, items[index], *future.result())
            if len(finished) == len(done):
                continue
            lost = list(held.values())
            for index in lost:
                deaths[index] += len(lost) == 1
                if deaths[index] < TRIES:
                    alone.append(index)
                else:
                    yield Outcome(index, items[index], None, "the process that worked on it died", 0.0)
            held.clear()
            pool.shutdown(wait=False, cancel_futures=True)
            pool = _pool(workers, memory_bytes)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _on_cluster(
    function: Callable[[Item], Value], items: Sequence[Item], scheduler: str
) -> Iterator[Outcome[Item, Value]]:
    try:
        from distributed import Client, as_completed
    except ModuleNotFoundError:
        raise BadInput("--scheduler needs Dask; install it: pip install 'groundstation[cluster]'.") from None
    try:
        client = Client(scheduler, timeout="10s", set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise BadInput(
            f"no Dask scheduler answers at {scheduler} ({error}); start one with `dask scheduler`."
        ) from None
    with client:
        futures = {client.submit(timed, function, item, pure=False, retries=0): i for i, item in enumerate(items)}
        for future in as_completed(futures, loop=client.loop):
            index = futures[future]
            if future.status == "finished":
                yield Outcome(index, items[index], *future.result())
            else:
                yield Outcome(index, items[index], None, f"the cluster lost it: {future.exception()}", 0.0)
