"""Tether: a spring or steady pull toward a point."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from groundstation.diagnosis.effect import Effect, Followed, ParameterInfo, Settings, blank, weight
from groundstation.frames import quat_rotate_inverse
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

MOST_N = 1000.0
"""Ten times the weight of 10 kg: more than rotors hold against."""


def _wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> np.ndarray:
    return _about(np.mean(signals.position_m, axis=0), signals)


def _followed(
    signals: Signals, planned: Signals | None, vehicle: Vehicle, several: Sequence[Settings], alone: bool
) -> Followed:
    """In a part of a flight the tether still hangs at the middle of the whole."""
    middle, asked = (None if s is None else np.mean(s.position_m, axis=0, dtype=float) for s in (signals, planned))

    def wrenches(now: Signals, ahead: Signals | None) -> list[np.ndarray]:
        pairs = ((middle, now), (asked, ahead))
        return [_about(at, some) for at, some in pairs if at is not None and some is not None]

    return wrenches


def _about(centre: np.ndarray, signals: Signals) -> np.ndarray:
    """Wrench (k, 6, 4) of a tether to a place."""
    out = blank(signals, 4)
    out[:, :3, 0] = quat_rotate_inverse(signals.quaternion, -(signals.position_m - centre))
    for axis in range(3):
        out[:, :3, 1 + axis] = signals.axis_body(axis)
    return out


EFFECT = Effect(
    identifier="tether",
    equation="F_world = F_0 - K (p - p_mean)",
    source="Hooke's law, linearised about the middle of the flight",
    parameters=(
        ParameterInfo("stiffness_n_m", lambda v: weight(v), (0.0, np.inf)),
        ParameterInfo("pull_x_n", lambda v: 0.3 * weight(v), (-MOST_N, MOST_N), companion=True),
        ParameterInfo("pull_y_n", lambda v: 0.3 * weight(v), (-MOST_N, MOST_N), companion=True),
        ParameterInfo("pull_z_n", lambda v: 0.3 * weight(v), (-MOST_N, MOST_N), companion=True),
    ),
    wrench=_wrench,
    followed=_followed,
    sentence="Something pulls the vehicle back with {stiffness_n_m:N} for each metre of displacement.",
    confused_with=("wind", "ground_effect", "rotor_drag"),
    manoeuvre="hover at the corners of the room: a pull that changes with place is a tether, not wind",
)
