"""Memory that was freed goes back to the system between the stages of an analysis."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import cache

from groundstation.identification.preparation import Prepared

FEW = 2**18
"""Samples of flights that are so short that what they leave is little, and wanted again soon."""


def released(flights: Sequence[Prepared]) -> None:
    """After a stage of the analysis of long flights, give back what the C library keeps of freed arrays.

    It maps large arrays one by one and gives them back when they are freed; but those of less than 32 MB, most of an
    hour of flight, stay with the process. Only glibc does that, and has a call against it.
    """
    trim = _trim() if sum(len(flight.record.t_s) for flight in flights) > FEW else None
    if trim is not None:
        trim(0)


@cache
def _trim() -> Callable[[int], int] | None:
    """``malloc_trim``, where there is one."""
    try:
        found = ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):
        return None
    found.argtypes, found.restype = [ctypes.c_size_t], ctypes.c_int
    return found
