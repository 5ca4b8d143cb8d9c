"""Steps of a device's clock within one recording: found by arrival times, and cut.

A stamp and its arrival differ by the clocks' offset plus a transit, and the smallest difference of half a second hardly
moves. Where it jumps and stays, the device's clock was set, or its server restarted.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.flightdata import Stream

Array = NDArray[np.float64]

BLOCK_S = 0.5
STEP_S = 0.01
"""Below, a step is within what the fit's own drift and the jitter of arrivals take; NTP sets clocks by 128 ms and more.
"""
BESIDE = 5
"""Blocks on each side that must agree: congestion does not last longer on the networks that a flight is flown on."""
CUT_S = 0.05
MOST = 10


def cut_steps(stream: Stream, name: str = "motion capture") -> tuple[Stream, list[str]]:
    """The stream on its clock as it was at first, without the samples beside each step, and a sentence for each.

    Args:
        stream: in order of arrival; without arrival times it is given back as it is.
        name: for people.
    """
    notes: list[str] = []
    for _ in range(MOST):
        found = _first_step(stream)
        if found is None:
            break
        index, jump_s = found
        assert stream.received_s is not None  # noqa: S101 - found by them
        stamps = stream.t_s.copy()
        stamps[index:] += jump_s
        beside = np.abs(stream.received_s - stream.received_s[index]) < CUT_S
        notes.append(
            f"The clock of {name} stepped by {-1e3 * jump_s:+.0f} ms, {stream.t_s[index - 1] - stream.t_s[0]:.1f} s "
            "into the recording (set by NTP, or its server restarted); stamps after it were moved back, "
            f"{int(beside.sum())} samples beside it cut."
        )
        moved = Stream(stamps, stream.values, stream.columns, stream.received_s)
        stream = moved.select(~beside)
    return stream, notes


def _first_step(stream: Stream) -> tuple[int, float] | None:
    """Index of the first sample on the new clock, and what its stamps lack; None without a step."""
    received = stream.received_s
    if received is None or len(stream) < 50 or not np.all(np.isfinite(received)):
        return None
    late = received - stream.t_s
    block = ((received - received[0]) / BLOCK_S).astype(int)
    starts = np.flatnonzero(np.diff(block, prepend=-1))
    least = np.minimum.reduceat(late, starts)
    for k in range(BESIDE, len(least) - BESIDE + 1):
        before, after = least[k - BESIDE : k], least[k : k + BESIDE]
        if k + BESIDE < len(least) and abs(np.median(least[k + 1 : k + 1 + BESIDE]) - np.median(after)) > 0.5 * STEP_S:
            continue  # the step is within this block: the next one shows it whole
        jump_s = float(np.median(after) - np.median(before))
        if abs(jump_s) > STEP_S and max(np.ptp(before), np.ptp(after[1:])) < 0.3 * abs(jump_s):
            low, high = starts[max(0, k - 2)], starts[k] if k + 1 >= len(starts) else starts[k + 1]
            middle = 0.5 * (np.median(before) + np.median(after))
            new = (late[low:high] - middle) * np.sign(jump_s) > 0.0
            old = np.flatnonzero(~new)
            return int(low + (old[-1] + 1 if len(old) else 0)), jump_s
    return None
