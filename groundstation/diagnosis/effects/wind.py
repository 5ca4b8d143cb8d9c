"""Wind: steady air motion, felt through drag as a steady horizontal force in the world."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, Settings, blank, weight
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

MOST_N = 1000.0
"""Ten times the weight of 10 kg: more than rotors hold against."""


def _wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> np.ndarray:
    out = blank(signals, 2)
    ratio = settings["drag_ratio"]
    felt = np.array([np.sqrt(ratio), 1.0 / np.sqrt(ratio), 0.0]) if ratio else np.ones(3)
    for axis in range(2):
        out[:, :3, axis] = signals.axis_body(axis) * felt
    return out


def _variants(signals: Signals, vehicle: Vehicle) -> tuple[Settings, ...]:
    """Felt alike in all directions (0), or in the rotors' plane only, by more along body x or along y."""
    return tuple({"drag_ratio": ratio} for ratio in (0.0, 0.5, 0.7, 0.85, 1.0, 1.2, 1.4, 2.0))


EFFECT = Effect(
    identifier="wind",
    equation="F_world = d w (w: air velocity; d: the drag it is felt through), beside -d v",
    source="Tomic et al. 2022, Simultaneous estimation of wind and drag, sec. III",
    parameters=(
        ParameterInfo("force_world_x_n", lambda v: 0.3 * weight(v), (-MOST_N, MOST_N)),
        ParameterInfo("force_world_y_n", lambda v: 0.3 * weight(v), (-MOST_N, MOST_N)),
    ),
    wrench=_wrench,
    pointwise=True,
    sentence=(
        "Wind pushes with {force_world_x_n:N|toward +x|toward −x} and {force_world_y_n:N|toward +y|toward −y} of the "
        "room, whichever way the vehicle points."
    ),
    rests_on=("rotor_drag", "body_drag"),
    confused_with=("tether", "mocap_tilt", "constant_wrench"),
    variants=_variants,
    manoeuvre="yaw through a full turn while hovering, then fly with and against the push",
)
