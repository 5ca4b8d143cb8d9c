"""Which parts of a recording are flight: stretches in the air, gaps in the streams, and the share that a fit uses.

Thrust by the declared constants decides, relative to the flight's own, so that no constant of the vehicle enters.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Stretch = tuple[float, float]

DIP_S = 1.0
"""At less than half its thrust for a second a vehicle falls 2.5 m or more; what is shorter is a manoeuvre, what is
longer the ground.
"""
CONTACT_S = 1.0
"""Left out beside the ground: landing gear carries weight and the air below is squeezed."""
SHORTEST_S = 2.0
"""A stretch that is shorter, ground contact left out, holds no manoeuvre."""
GAP_S = 0.1
GAP_STEPS = 3.0
"""Interpolating over 0.1 s of a 0.5 Hz motion is 1.2 % off at worst; a stream that is slower throughout has no gaps for
that.
"""


def airborne(t_s: Array, thrust: Array) -> tuple[Stretch, ...]:
    """Stretches in the air: over half of the thrust flown with, dips of under a second bridged, ground contact left
    out.

    Args:
        t_s: increasing stamps, shape (k,).
        thrust: of all rotors, shape (k,).

    Returns:
        start and end of each stretch; none where the rotors never made thrust long enough.
    """
    if not len(t_s) or not np.any(thrust > 0.0):
        return ()
    # The median of what is plainly thrust: half a record may be ground, and a few samples may be spikes.
    usual = float(np.median(thrust[thrust > 0.3 * np.quantile(thrust, 0.99)]))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], thrust > 0.5 * usual, [False]]).astype(int)))
    runs: list[tuple[int, int]] = []
    for first, last in zip(edges[::2], edges[1::2] - 1, strict=True):
        if runs and t_s[first] - t_s[runs[-1][1]] < DIP_S:
            runs[-1] = runs[-1][0], int(last)
        else:
            runs.append((int(first), int(last)))
    found: list[Stretch] = []
    for first, last in runs:
        begin = float(t_s[first]) + (0.0 if first == 0 else CONTACT_S)
        end = float(t_s[last]) - (0.0 if last == len(t_s) - 1 else CONTACT_S)
        if end - begin >= SHORTEST_S:
            found.append((begin, end))
    return tuple(found)


def gaps(t_s: Array) -> tuple[Stretch, ...]:
    """Start and end of each pause between stamps of over 0.1 s and three usual steps."""
    if len(t_s) < 3:
        return ()
    step = np.diff(t_s)
    wide = np.flatnonzero(step > max(GAP_S, GAP_STEPS * float(np.median(step))))
    return tuple((float(t_s[i]), float(t_s[i + 1])) for i in wide)


def parts_of(t_s: Array) -> list[slice]:
    """The samples between one gap and the next; one slice where there are none."""
    lost = gaps(t_s)
    edges = [0, *np.searchsorted(t_s, [end for _, end in lost]).tolist(), len(t_s)]
    return [slice(first, last) for first, last in pairwise(edges)]


def within(t_s: Array, stretches: Sequence[Stretch], margin_s: tuple[float, float] = (0.0, 0.0)) -> Mask:
    """Which times lie in any stretch, lengthened by a margin before and after, shape (k,)."""
    inside = np.zeros(len(t_s), dtype=bool)
    for first, last in stretches:
        inside |= (t_s >= first - margin_s[0]) & (t_s <= last + margin_s[1])
    return inside


def runs_of(t_s: Array, keep: Mask) -> tuple[Stretch, ...]:
    """First and last time of each run of kept samples without a hole of over a tenth of a second."""
    t = t_s[keep]
    if not len(t):
        return ()
    breaks = np.flatnonzero(np.diff(t) > max(GAP_S, GAP_STEPS * float(np.median(np.diff(t_s)))))
    starts, ends = np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [len(t) - 1]])
    return tuple((float(t[a]), float(t[b])) for a, b in zip(starts, ends, strict=True))


def used_note(used_s: float, recorded_s: float, pieces: int, left_out: Sequence[str]) -> str:
    """What share of a recording is used, in one sentence."""
    where = "" if pieces == 1 else f", in {pieces} stretches"
    why = "" if not left_out else f"; left out: {', '.join(left_out)}"
    return f"{used_s:.1f} of {recorded_s:.1f} s recorded are used ({used_s / recorded_s:.0%}){where}{why}."
