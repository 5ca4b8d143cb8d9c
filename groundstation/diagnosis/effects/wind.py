"""Wind: steady air motion, felt through drag as a steady horizontal force in the world."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import Effect, ParameterInfo, blank, weight
from groundstation.frames import quat_rotate_inverse
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle


def _wrench(signals: Signals, vehicle: Vehicle, settings: object) -> np.ndarray:
    out = blank(signals, 2)
    count = len(signals.t_s)
    for axis in range(2):
        steady = np.broadcast_to(np.eye(3)[axis], (count, 3))
        out[:, :3, axis] = quat_rotate_inverse(signals.quaternion, steady)
    return out


EFFECT = Effect(
    identifier="wind",
    equation="F_world = d w (w: air velocity; d: the drag it is felt through), beside -d v",
    source="Tomic et al. 2022, Simultaneous estimation of wind and drag, sec. III",
    parameters=(
        ParameterInfo("force_world_x_n", lambda v: 0.3 * weight(v)),
        ParameterInfo("force_world_y_n", lambda v: 0.3 * weight(v)),
    ),
    wrench=_wrench,
    sentence="A steady push of {force_world_x_n} N along x and {force_world_y_n} N along y stays where it is when the vehicle turns: air moves.",
    confused_with=("tether", "mocap_tilt", "constant_wrench"),
    manoeuvre="yaw through a full turn while hovering, then fly with and against the push",
)
