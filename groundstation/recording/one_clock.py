"""Steps of the clock that stamps a log (set by GPS or NTP, or begun anew): the longest part on one clock is used.

A step back makes two times one, and after a leap of years nothing belongs to what was before. Which samples of two
streams belong together is then told by their order alone, so that a part between two steps is used, and told.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from groundstation.flightdata import FlightData, Stream

Array = NDArray[np.float64]
Piece = tuple[int, int]
"""First sample of a part, and the first after it."""

LEAP_S = 60.0
"""Stamps that leap ahead by this are of another time: no logger that goes on is quiet for as long.

A shorter leap cannot be told from a gap, which no fit goes across either.
"""
BESIDE = 5
"""Samples on both sides that agree on a step: stamps that stray are no step, nor are some that came out of order."""
MOST_STEPS = 20
"""Of a clock; stamps that step more often are no clock's."""


def on_one_clock(flight: FlightData) -> FlightData:
    """The flight between two steps of its clock where the motors' stream is longest, with a note; as it is without a
    step.
    """
    streams = flight.streams()
    pieces = {name: _pieces(name, stream) for name, stream in streams.items()}
    stepped = [name for name, found in pieces.items() if len(found) > 1]
    if not stepped:
        return flight
    motors = pieces["motors"]
    chosen = max(range(len(motors)), key=lambda k: motors[k][1] - motors[k][0])
    kept = {name: _part_of(stream, streams["motors"], motors, chosen) for name, stream in streams.items()}
    lead = "motors" if "motors" in stepped else stepped[0]
    note = f"{', '.join(stepped)}: {_told(streams[lead].t_s, pieces[lead])}"
    left = dict.fromkeys(name for name, stream in kept.items() if not len(stream) and name != "motors")
    return replace(flight, **(kept | left), notes=(*flight.notes, note))


def _pieces(name: str, stream: Stream) -> list[Piece]:
    """The parts of a stream on one clock; poses that tell their arrivals are mended by those instead."""
    return [(0, len(stream))] if name == "mocap" and stream.received_s is not None else pieces_of(stream.t_s)


def pieces_of(t_s: Array, beside: int = BESIDE, most: int = MOST_STEPS) -> list[Piece]:
    """The parts of a stream between steps back and leaps ahead of its stamps; one where there are none, or too many.

    Args:
        t_s: stamps in the order of the log.
        beside: samples on both sides that must agree.
        most: steps that there may be.
    """
    index = np.flatnonzero(np.isfinite(t_s))
    t = t_s[index]
    if len(t) < 2 * beside:
        return [(0, len(t_s))]
    windows = np.lib.stride_tricks.sliding_window_view(t, beside)
    before, after = windows[:-beside], windows[beside:]
    back = after.max(axis=1) < before.min(axis=1)
    ahead = after.min(axis=1) > before.max(axis=1) + LEAP_S
    steps = index[np.flatnonzero(back | ahead) + beside].tolist()
    return list(pairwise([0, *steps, len(t_s)])) if len(steps) <= most else [(0, len(t_s))]


def _part_of(stream: Stream, motors: Stream, of_motors: list[Piece], chosen: int) -> Stream:
    """The part of a stream that belongs to a part of the motors': by arrival, by order, or by its stamps."""
    wanted = slice(*of_motors[chosen])
    if stream is motors:
        return stream.select(wanted)
    if stream.received_s is not None and motors.received_s is not None:
        first, last = np.nanmin(motors.received_s[wanted]), np.nanmax(motors.received_s[wanted])
        return stream.select((stream.received_s >= first) & (stream.received_s <= last))
    for beside in (BESIDE, 2, 1):  # a slow stream steps back by few samples
        pieces = pieces_of(stream.t_s, beside)
        if len(pieces) == len(of_motors):
            return stream.select(slice(*pieces[chosen]))
    pieces = pieces_of(stream.t_s)
    start, end = np.nanmin(motors.t_s[wanted]), np.nanmax(motors.t_s[wanted])
    inside = (stream.t_s >= start) & (stream.t_s <= end)
    if not inside.any():  # another clock, which the motors' says nothing of
        inside[:] = True
    best = slice(*max(pieces, key=lambda piece: np.count_nonzero(inside[slice(*piece)])))
    return stream.select(best).select(inside[best])


def _told(t_s: Array, pieces: list[Piece]) -> str:
    steps = [f"{t_s[end] - t_s[end - 1]:+.6g} s after {t_s[end - 1]:.2f} s" for _, end in pieces[:-1]]
    return (
        f"the clock steps by {', '.join(steps)} (set by GPS or NTP, or begun anew); the longest part on one clock is "
        "used. Choose another with --from and --to, or cut the log there."
    )
