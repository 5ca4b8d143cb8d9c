"""What every method does to a flight's streams first: clean samples, the stretches in the air, poses of the vehicle's
origin.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import NotIdentifiable
from groundstation.flightdata import FlightData, Stream
from groundstation.frames import quat_conjugate, quat_exp, quat_multiply, quat_rotate
from groundstation.identification.stretches import SHORTEST_S, Stretch, airborne
from groundstation.identification.wrench import declared_wrench
from groundstation.vehicle import Mocap

Array = NDArray[np.float64]
Segments = Sequence[Stretch]

TRANSIENT_S = 10.0
"""Left out at the start, as in the paper (10 s < t < 50 s), but at most a fifth of the window."""


def clean(stream: Stream, exclude: Segments = ()) -> Stream:
    """Samples with finite values and strictly increasing stamps, outside the excluded segments."""
    keep = np.isfinite(stream.values).all(axis=1) & np.isfinite(stream.t_s)
    for first, last in exclude:
        keep &= (stream.t_s < first) | (stream.t_s > last)
    kept = stream if keep.all() else stream.select(keep)
    latest = np.maximum.accumulate(np.concatenate([[-np.inf], kept.t_s[:-1]]))
    rising = kept.t_s > latest
    return kept if rising.all() else kept.select(rising)


def origin_poses(
    mounting: Mocap, position_m: Annotated[Array, "k 3"], quaternion: Annotated[Array, "k 4"]
) -> tuple[Annotated[Array, "k 3"], Annotated[Array, "k 4"]]:
    """Position (k, 3) and attitude (k, 4) of the declared origin from those of the tracked frame.

    q_b = q_m q_bm^-1 and p_b = p_m - R(q_b) r, where the vehicle file declares the rotation q_bm from the body to the
    tracked frame and the tracked point r in the body.
    """
    q = quat_multiply(quaternion, quat_conjugate(quat_exp(np.asarray(mounting.rotation_rad))))
    return position_m - quat_rotate(q, np.asarray(mounting.position_m)), q


def flown_stretches(flight: FlightData, transient_s: float | None = None) -> tuple[tuple[float, float], ...]:
    """What is used of a flight: the known excitation less the transient, or every stretch in the air
    (:mod:`.stretches`).

    Raises:
        NotIdentifiable: the vehicle did not fly.
    """
    if flight.window_s is not None:
        start, end = flight.window_s
        return ((start + (min(TRANSIENT_S, 0.2 * (end - start)) if transient_s is None else transient_s), end),)
    found = stretches_in_the_air(flight)
    if not found:
        if not np.any(_thrust(flight)[1] > 0.0):
            raise NotIdentifiable("The rotors never made thrust.", "Record a flight.")
        raise NotIdentifiable(f"The vehicle was in the air for less than {SHORTEST_S + 2.0:.0f} s.", "Fly longer.")
    return found


def stretches_in_the_air(flight: FlightData) -> tuple[Stretch, ...]:
    """Stretches in the air by thrust alone, on the motors' clock; none where thrust tells of none."""
    return airborne(*_thrust(flight))


def _thrust(flight: FlightData) -> tuple[Array, Array]:
    """Stamps of the motors (k,) and the thrust by the declared constants, N."""
    motors = clean(flight.motors)
    return motors.t_s, declared_wrench(flight.vehicle, motors, flight.battery, motors.t_s)[:, 0]


def excitation_window(flight: FlightData, transient_s: float | None = None) -> tuple[float, float]:
    """First start and last end of what is used of a flight.

    Raises:
        NotIdentifiable: the vehicle did not fly.
    """
    stretches = flown_stretches(flight, transient_s)
    return stretches[0][0], stretches[-1][1]
