"""Slung load: a mass hangs below the vehicle on a cable and swings, as far as it likes.

The vehicle's recorded velocity drives the pendulum, so its pull is linear in the load's mass. Length, damping by the
air and depth of the hook are settings: a search finds them roughly, and a parameter for the change of each, times the
load's mass, brings them to their values and gives their intervals (Gauss-Newton).

A load that goes over the top forgets where it began: no motion that is known to a percent says where it is half a
minute later, and it is not found here (:mod:`groundstation.diagnosis.swing` warns of it).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.effect import Effect, ParameterInfo, Settings, blank
from groundstation.flightdata import resampled
from groundstation.frames import quat_rotate, quat_rotate_inverse
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_KG = 10.0
"""The heaviest vehicle's own mass."""
TYPICAL_SHARE = 0.05
"""Of the vehicle's mass that a load has: the scale on which changes of its settings are shrunk."""
LENGTH_M, AIR_1_S, DEPTH_M = "length_m", "air_1_s", "depth_m"
STEPS = {LENGTH_M: 0.01, AIR_1_S: 0.02, DEPTH_M: 0.002}
"""Of the differences that the settings' columns are: of the length as a share of it."""
SEARCHED_AIR_1_S = 0.5
"""Damping that the search begins with: it forgets within few swings, so a length a twelfth off still keeps pace."""
AIR_RANGE_1_S = (0.01, 3.0)
GRID_S = 0.008
"""Between the instants that the swing is worked out at: short beside any swing."""


def _full(settings: Settings) -> Settings:
    """With what a search has not looked for yet."""
    return {AIR_1_S: SEARCHED_AIR_1_S, DEPTH_M: 0.0, **settings}


def _hook(settings: Settings) -> Array:
    """Where the cable is tied, in the body, (3,)."""
    return np.array([0.0, 0.0, -settings[DEPTH_M]])


def _velocity(signals: Signals, at: Index | slice, hook: Array) -> Array:
    """Of the hook in the world at some of the instants, (k, 3)."""
    beside = quat_rotate(signals.quaternion[at], np.cross(signals.rate_rad_s[at], hook))
    return np.ascontiguousarray(signals.velocity_world_m_s[at] + beside)


def _constants(vehicle: Vehicle, settings: Settings) -> tuple[float, float, float]:
    """Gravity, length and damping, as the kernel takes them."""
    return float(vehicle.gravity_m_s2), float(settings[LENGTH_M]), float(settings[AIR_1_S])


def _grid(t_s: Array) -> Index:
    """Instants of a flight, ``GRID_S`` apart, its last one among them."""
    every = max(1, round(GRID_S / max(float(np.median(np.diff(t_s))), 1e-6))) if len(t_s) > 1 else 1
    return np.unique(np.r_[0 : len(t_s) : every, len(t_s) - 1])


def _on_body(quaternion: Array, pull: Array, hook: Array) -> Array:
    """Body wrench of a pull in the world, (k, 6)."""
    force = quat_rotate_inverse(quaternion, pull)
    return np.concatenate([force, np.cross(hook, force)], axis=1)


def _pulled(signals: Signals, vehicle: Vehicle, settings: Settings) -> Array:
    """Body wrench of one kilogram, (k, 6)."""
    from groundstation.diagnosis.pendulum import pull_per_mass

    at, hook = _grid(signals.t_s), _hook(settings)
    t_s, velocity = signals.t_s[at], _velocity(signals, at, hook)
    if not np.isfinite(velocity).all():
        return np.full((len(signals.t_s), 6), np.nan)
    pull, _ = pull_per_mass(t_s, velocity, *_constants(vehicle, settings))
    return _on_body(signals.quaternion, resampled(signals.t_s, t_s, pull), hook)


def _wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> Array:
    out, full = blank(signals, len(PARAMETERS)), _full(settings)
    out[:, :, 0] = about = _pulled(signals, vehicle, full)
    for column, (name, step) in enumerate(STEPS.items(), 1):
        size = step * full[name] if name == LENGTH_M else step
        out[:, :, column] = (_pulled(signals, vehicle, {**full, name: full[name] + size}) - about) / size
    return out


def _begun(signals: Signals, vehicle: Vehicle, settings: Settings, index: Index) -> Callable[[Signals], Array]:
    """In windows that start in a flight the load swings on from where it was."""
    from groundstation.diagnosis.pendulum import pull_per_mass, pulls_moved

    full = _full(settings)
    hook, constants, at = _hook(full), _constants(vehicle, full), _grid(signals.t_s)
    _, states = pull_per_mass(signals.t_s[at], np.nan_to_num(_velocity(signals, at, hook)), *constants)
    going = states[np.clip(np.searchsorted(at, index), 0, len(at) - 1)]
    last = [signals.t_s[index], np.nan_to_num(_velocity(signals, index, hook))]

    def wrench(now: Signals) -> Array:
        velocity = np.nan_to_num(_velocity(now, slice(None), hook))
        pull = pulls_moved(going, (last[1], velocity), now.t_s - last[0], *constants)
        last[:] = now.t_s, velocity
        out = blank(now, len(PARAMETERS))
        out[:, :, 0] = _on_body(now.quaternion, pull, hook)
        return out

    return wrench


def _settled(settings: Settings, values: Array) -> Settings:
    """The settings moved by what the changes of each say; no further than they are linear."""
    full = _full(settings)
    if values[0] <= 0.0:
        return full
    length, air, depth = (float(v) / float(values[0]) for v in values[1:])
    least, most = AIR_RANGE_1_S
    return {
        **full,
        LENGTH_M: full[LENGTH_M] + float(np.clip(length, -0.1 * full[LENGTH_M], 0.1 * full[LENGTH_M])),
        AIR_1_S: float(np.clip(full[AIR_1_S] + np.clip(air, -0.5 * full[AIR_1_S], full[AIR_1_S]), least, most)),
        DEPTH_M: full[DEPTH_M] + float(np.clip(depth, -0.1, 0.1)),
    }


def _finer(settings: Settings) -> tuple[Settings, ...]:
    """Lengths nearby, in air that resists as much, half as much and twice as much: the less, the sharper the swing."""
    full = _full(settings)
    near = [(ratio, 0.5) for ratio in (0.96, 0.98, 1.0, 1.02, 1.04)] + [(0.98, 1.0), (1.02, 1.0), (1.0, 2.0)]
    return tuple({**full, LENGTH_M: full[LENGTH_M] * r, AIR_1_S: full[AIR_1_S] * c} for r, c in near)


def _change(name: str, setting: str, spread: float) -> ParameterInfo:
    return ParameterInfo(name, lambda v: spread * TYPICAL_SHARE * v.mass_kg, companion=True, changes=setting)


PARAMETERS = (
    ParameterInfo("load_kg", lambda v: 0.3 * v.mass_kg, (0.0, MOST_KG)),
    _change("load_length_kg_m", LENGTH_M, 0.1),
    _change("load_air_kg_s", AIR_1_S, 0.3),
    _change("load_depth_kg_m", DEPTH_M, 0.1),
)

EFFECT = Effect(
    identifier="slung_load",
    equation="L s'' = (1 - s s^T) q - L |s'|^2 s, F = m_l s (L |s'|^2 + s^T q), q = g - a - c (v + L s')",
    source="Newton's law for a point mass on a taut cable; Bisgaard 2008, thesis Aalborg, ch. 3",
    parameters=PARAMETERS,
    wrench=_wrench,
    sentence="A load of {load_kg:g} swings {length_m:m} below the vehicle.",
    confused_with=("wind", "payload_change"),
    manoeuvre="a brisk sideways stop, then hover still for ten seconds and watch the swing ring down",
    variants=lambda signals, vehicle: tuple({LENGTH_M: float(length)} for length in np.geomspace(0.15, 4.0, 22)),
    finer=_finer,
    settled=_settled,
    begun=_begun,
)
