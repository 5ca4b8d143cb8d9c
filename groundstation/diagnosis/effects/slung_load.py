"""Slung load: a pendulum hangs below the vehicle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.effect import Effect, ParameterInfo, Settings, blank, from_thrust
from groundstation.frames import quat_rotate_inverse
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

MOST_KG = 10.0
"""The heaviest vehicle's own mass."""


def _wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> np.ndarray:
    from scipy.signal import cont2discrete, lfilter

    step = float(np.median(np.diff(signals.t_s))) if len(signals.t_s) > 1 else 1.0
    natural = np.sqrt(vehicle.gravity_m_s2 / settings["length_m"])
    damping = 0.03
    # swing angle times length, driven by the vehicle's horizontal speed: l theta'' + 2 z w l theta' + g theta = -a
    swings = [-1.0, 0.0], [1.0, 2.0 * damping * natural, natural**2]
    b, a = cont2discrete(swings, step, method="bilinear")[:2]  # pyright: ignore
    velocity = signals.velocity_world_m_s - signals.velocity_world_m_s[:1]
    swing: NDArray[np.float64] = lfilter(np.ravel(b), a, velocity, axis=0)
    force = natural**2 * swing
    upward = from_thrust(vehicle, signals.thrust_n)[:, 2] * signals.up_body()[:, 2] / vehicle.mass_kg
    force[:, 2] = -upward  # it rises and falls with the vehicle: what holds it up is its share of the lift
    out = blank(signals)
    out[:, :3, 0] = quat_rotate_inverse(signals.quaternion, force)
    return out


EFFECT = Effect(
    identifier="slung_load",
    equation="s'' + 2 z w s' + w^2 s = -a_xy, w^2 = g/l; F = m_l (w^2 s_x, w^2 s_y, -(g + z'')) on the vehicle",
    source="Bisgaard 2008, thesis Aalborg, ch. 3, linearised for small swing",
    parameters=(ParameterInfo("load_kg", lambda v: 0.3 * v.mass_kg, (0.0, MOST_KG)),),
    wrench=_wrench,
    sentence="A load of {load_kg:g} swings {length_m:m} below the vehicle.",
    confused_with=("wind", "payload_change"),
    manoeuvre="a brisk sideways stop, then hover still for ten seconds and watch the swing ring down",
    variants=lambda signals, vehicle: tuple({"length_m": float(length)} for length in np.geomspace(0.15, 4.0, 22)),
    finer=lambda settings: tuple({"length_m": settings["length_m"] * ratio} for ratio in (0.89, 0.94, 1.0, 1.06, 1.12)),
)
