"""What is wrong with a tracked body, from its poses alone: flips, swaps, gaps, a world that stands on its side.

Pure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

from drivers.mocap.health import Summary

Array = NDArray[np.float64]

FLIP_RAD = 0.8
"""A hand turns 10 rad/s at most, a tenth of this in a frame at 120 Hz; symmetric markers flip by 90 or 180 degrees."""
FLIP_WITHIN_M = 0.05
JUMP_M = 0.1
"""Between two frames; 12 m/s at 120 Hz, which nothing here flies."""
UNSEEN = 0.02
LATE_S = 0.05
SHARPLY_TURNED = 5.0
"""Times the median turn of a frame that a flip must exceed, so that slow cameras and fast hands flip nothing."""


@dataclass(frozen=True, slots=True)
class Track:
    """Poses of one body in order of their stamps: (k,), (k, 3), (k, 4)."""

    name: str
    t_s: Array
    position: Array
    quaternion: Array


def faults(track: Track, summary: Summary, others: Sequence[Track] = (), needed_hz: float = 50.0) -> list[str]:
    """One sentence for each thing that is wrong."""
    out: list[str] = []
    if len(track.t_s) < 2:
        return [f"'{track.name}' is not seen"]
    if summary.rate_hz < needed_hz:
        out.append(f"'{track.name}' comes at {summary.rate_hz:.0f} Hz, {needed_hz:.0f} Hz are needed")
    if summary.unseen > UNSEEN:
        out.append(
            f"'{track.name}' is lost in {100 * summary.unseen:.0f} % of the frames (longest "
            f"{summary.longest_gap_s:.2f} s)"
        )
    if summary.latency_p99_s > LATE_S:
        out.append(f"'{track.name}' arrives {1e3 * summary.latency_p99_s:.0f} ms late at p99: look at the network")
    swapped = swaps(track, others)
    flipped = len(flips(track))
    if swapped:
        out.append(f"'{track.name}' is swapped with '{swapped}': make their markers differ")
    elif flipped:
        out.append(f"'{track.name}' flips ({flipped} times): its markers are symmetric; move one")
    return out


def flips(track: Track) -> NDArray[np.intp]:
    """Indices of frames whose attitude jumps where the position does not, (n,)."""
    dots = np.abs(np.einsum("ki,ki->k", track.quaternion[1:], track.quaternion[:-1]))
    angle = 2.0 * np.arccos(np.clip(dots, 0.0, 1.0))
    moved = np.linalg.norm(np.diff(track.position, axis=0), axis=1)
    sharp = angle > max(FLIP_RAD, SHARPLY_TURNED * float(np.median(angle)))
    return np.flatnonzero(sharp & (moved < FLIP_WITHIN_M)) + 1


def swaps(track: Track, others: Sequence[Track]) -> str:
    """Name of another body whose place this one jumps to while that one jumps to this one's; empty without."""
    jumps = np.flatnonzero(np.linalg.norm(np.diff(track.position, axis=0), axis=1) > JUMP_M)
    for index in jumps:
        for other in others:
            there = np.searchsorted(other.t_s, track.t_s[index], side="right") - 1
            after = np.searchsorted(other.t_s, track.t_s[index + 1], side="right") - 1
            if there < 0 or after <= there:
                continue
            taken = np.linalg.norm(track.position[index + 1] - other.position[there])
            given = np.linalg.norm(other.position[after] - track.position[index])
            if max(taken, given) < JUMP_M:
                return other.name
    return ""


def upright(up: Array) -> str:
    """What to do about the axis that the specific force points along in the poses' world; empty while that is z.

    Args:
        up: unit vector, from :func:`groundstation.identification.handheld.up_axis`.
    """
    angle = float(np.arccos(np.clip(up[2], -1.0, 1.0)))
    if angle < 0.02:
        return ""
    if angle < 0.2:
        return f"z is {angle * 180 / pi:.1f} degrees off gravity: `groundstation calibrate` measures and corrects it"
    if np.arccos(np.clip(up[1], -1.0, 1.0)) < 0.2:
        return 'y points up: write `up = "y"` under [mocap] in the station file'
    return f"gravity points along {(-up).round(2).tolist()}: lay the ground plane again, with z up"


def body_row(summary: Summary) -> Mapping[str, float | None]:
    """The figures of a body for a document."""
    figures = {
        "rate_hz": summary.rate_hz,
        "latency_p50_s": summary.latency_p50_s,
        "latency_p99_s": summary.latency_p99_s,
        "jitter_s": summary.jitter_s,
        "missing_frames": float(summary.missing),
        "unseen_share": summary.unseen,
        "longest_gap_s": summary.longest_gap_s,
        "residual_m": summary.residual_m,
    }
    return {key: None if value != value else value for key, value in figures.items()}
