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

from groundstation.diagnosis.effect import Effect, ParameterInfo, Settings, blank, from_thrust
from groundstation.diagnosis.pendulum_search import SCANNED, likely_pendulums
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
SEARCHED_EVERY = 2
"""Of those, the ones that a search takes."""


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


def _pulled(signals: Signals, vehicle: Vehicle, settings: Settings, planned: Signals | None) -> Array:
    """Body wrench of one kilogram, (k, 6); along a plan, where there is one, of a load that hangs as it did."""
    from groundstation.diagnosis.pendulum import pull_per_mass

    at, hook = _grid(signals.t_s), _hook(settings)
    t_s, velocity, constants = signals.t_s[at], _velocity(signals, at, hook), _constants(vehicle, settings)
    if not np.isfinite(velocity).all():
        return np.full((len(signals.t_s), 6), np.nan)
    _, states = pull_per_mass(t_s, velocity, *constants)
    if planned is None:
        acceleration, quaternion = _lifted(signals, at, vehicle), signals.quaternion
    else:
        acceleration, quaternion = np.gradient(_velocity(planned, at, hook), t_s, axis=0), planned.quaternion
    pull = _pull(states, velocity, acceleration, constants)
    return _on_body(quaternion, resampled(signals.t_s, t_s, pull), hook)


def _lifted(signals: Signals, at: Index, vehicle: Vehicle) -> Array:
    """Acceleration as the thrust makes it, in the world, (k, 3), of a mass that the mean thrust holds up.

    The measured one holds the disturbance, which a column made of it would explain away with the mass.
    """
    lift = quat_rotate(signals.quaternion[at], from_thrust(vehicle, signals.thrust_n[at])[:, :3])
    flying = lift[:, 2] > 0.5 * np.median(lift[:, 2])
    share = vehicle.gravity_m_s2 / max(float(np.mean(lift[flying, 2])) if flying.any() else 0.0, 1e-9)
    return lift * share - [0.0, 0.0, vehicle.gravity_m_s2]


def _pull(states: Array, velocity: Array, acceleration: Array, constants: tuple[float, float, float]) -> Array:
    """Pull per mass in the world, (k, 3), of directions and rates (k, 6) at a velocity and acceleration of the hook."""
    gravity, length, air = constants
    along, rate = states[:, :3], states[:, 3:]
    push = -acceleration - air * (velocity + length * rate) - [0.0, 0.0, gravity]
    tension = length * np.sum(rate * rate, axis=1) + np.sum(along * push, axis=1)
    return tension[:, None] * along


def _wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> Array:
    return _columns(signals, vehicle, settings, None)


def _columns(signals: Signals, vehicle: Vehicle, settings: Settings, planned: Signals | None) -> Array:
    """Of the load and of the changes of its settings, (k, 6, 4)."""
    out, full = blank(signals, len(PARAMETERS)), _full(settings)
    out[:, :, 0] = about = _pulled(signals, vehicle, full, planned)
    for column, (name, step) in enumerate(STEPS.items(), 1):
        size = step * full[name] if name == LENGTH_M else step
        moved = _pulled(signals, vehicle, {**full, name: full[name] + size}, planned)
        out[:, :, column] = (moved - about) / size
    return out


def _instrument(signals: Signals, planned: Signals, vehicle: Vehicle, settings: Settings) -> Array:
    """Where the load hangs follows from the motion of the last seconds; how hard it pulls, from the plan."""
    return _columns(signals, vehicle, settings, planned)


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
    """Lengths nearby, and air that resists less and more."""
    full = _full(settings)
    near = ((0.995, 1.0), (1.005, 1.0), (1.0, 0.7), (1.0, 1.4))
    return tuple({**full, LENGTH_M: full[LENGTH_M] * r, AIR_1_S: full[AIR_1_S] * c} for r, c in near)


def _searched(signals: Signals, keep: NDArray[np.bool_], vehicle: Vehicle) -> tuple[Settings, ...]:
    """The likeliest pendulums."""
    from groundstation.diagnosis.pendulum import pull_per_mass

    at = _grid(signals.t_s)[::SEARCHED_EVERY]
    t_s, origin = signals.t_s[at], _velocity(signals, at, np.zeros(3))
    by_depth = _velocity(signals, at, np.array([0.0, 0.0, -1.0])) - origin

    def pull(length_m: float, air_1_s: float, depth_m: float) -> Array:
        velocity = origin + depth_m * by_depth
        return pull_per_mass(t_s, velocity, float(vehicle.gravity_m_s2), length_m, air_1_s)[0]

    found = likely_pendulums(signals, keep, at, vehicle, pull)
    return tuple({LENGTH_M: length, AIR_1_S: air, DEPTH_M: depth} for length, air, depth in found)


def _change(name: str, setting: str, spread: float, form: float) -> ParameterInfo:
    return ParameterInfo(name, lambda v: spread * TYPICAL_SHARE * v.mass_kg, companion=True, changes=setting, form=form)


PARAMETERS = (
    ParameterInfo("load_kg", lambda v: 0.3 * v.mass_kg, (0.0, MOST_KG), form=0.03),
    _change("load_length_kg_m", LENGTH_M, 0.1, 0.01),
    _change("load_air_kg_s", AIR_1_S, 0.3, 0.4),
    _change("load_depth_kg_m", DEPTH_M, 0.1, 0.3),
)
"""A load is no point, its cable gives way, and what damps it may be the hook and not the air. On six flights in MuJoCo,
where it is the hook, load, length and damping lay up to 4, 1.3 and 40 % off.
"""

EFFECT = Effect(
    identifier="slung_load",
    equation="L s'' = (1 - s s^T) q - L |s'|^2 s, F = m_l s (L |s'|^2 + s^T q), q = g - a - c (v + L s')",
    source="Newton's law for a point mass on a taut cable; Bisgaard 2008, thesis Aalborg, ch. 3",
    parameters=PARAMETERS,
    wrench=_wrench,
    instrument=_instrument,
    sentence="A load of {load_kg:g} swings {length_m:m} below the vehicle.",
    confused_with=("wind", "payload_change"),
    manoeuvre="a brisk sideways stop, then hover still for ten seconds and watch the swing ring down",
    variants=lambda signals, vehicle: tuple({LENGTH_M: float(length)} for length in np.geomspace(0.15, 4.0, 22)),
    searched=_searched,
    scanned=SCANNED,
    finer=_finer,
    settled=_settled,
    begun=_begun,
)
