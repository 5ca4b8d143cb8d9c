"""Slung load: a mass hangs below the vehicle on a cable and swings, as far as it likes.

The vehicle's recorded velocity drives the pendulum, so its pull is linear in the load's mass. Length, damping by the
air and depth of the hook are settings: a search finds them roughly, and a parameter for the change of each, times the
load's mass, brings them to their values and gives their intervals (Gauss-Newton).

A load that goes over the top forgets where it began: no motion that is known to a percent says where it is half a
minute later. Where no pendulum keeps in step, but the force is that of a load all the same
(:mod:`groundstation.diagnosis.swing`), the cable points where the force that thrust and weight leave points, and the
pull along it follows from how it turns. That takes the vehicle's own mass as a setting.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.effect import Effect, Followed, ParameterInfo, Settings, blank, from_thrust
from groundstation.diagnosis.pendulum_search import LANES, SCANNED, likely_pendulums
from groundstation.diagnosis.swing import DRAG_STD, SHARES, cable, swing_of
from groundstation.diagnosis.thresholds import THRESHOLDS
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
BODY_KG, SEEN_DRAG_KG_S = "body_kg", "seen_drag_kg_s"
"""The vehicle without the load, and its drag, by which the cable is seen where it is not followed."""
SEEN_HZ = 4.0
"""Below which it is seen: a load on some decimetres turns over twice a second."""
STEPS = {LENGTH_M: 0.01, AIR_1_S: 0.02, DEPTH_M: 0.002}
"""Of the differences that the settings' columns are: of the length as a share of it."""
SEARCHED_AIR_1_S = 0.5
"""Damping that the search begins with: it forgets within few swings, so a length a twelfth off still keeps pace."""
AIR_RANGE_1_S = (0.01, 3.0)
SEEN_AIR_1_S = 0.05
"""By which a damping is off that a search tells."""
GRID_S = 0.008
"""Between the instants that the swing is worked out at: short beside any swing."""
SEARCHED_EVERY = 2
"""Of those, the ones that a search takes."""


def _full(settings: Settings) -> Settings:
    """With what a search has not looked for yet."""
    return {AIR_1_S: SEARCHED_AIR_1_S, DEPTH_M: 0.0, **settings}


Moving = tuple[Array, Array]
"""Velocity in the world of the body's origin, and what each metre below it adds, (k, 3) each."""


def _moving(signals: Signals, at: Index | slice) -> Moving:
    """At some of the instants."""
    some = signals.at(at)
    down = np.cross(some.rate_rad_s, [0.0, 0.0, -1.0])
    return np.ascontiguousarray(some.velocity_world_m_s), quat_rotate(some.quaternion, down)


def _pendulum(settings: Settings) -> Array:
    """Length, damping and depth, as the kernel takes them, (3,)."""
    return np.array([settings[LENGTH_M], settings[AIR_1_S], settings[DEPTH_M]])


def _grid(t_s: Array) -> Index:
    """Instants of a flight, ``GRID_S`` apart, its last one among them."""
    every = max(1, round(GRID_S / max(float(np.median(np.diff(t_s))), 1e-6))) if len(t_s) > 1 else 1
    return np.unique(np.r_[0 : len(t_s) : every, len(t_s) - 1])


def _on_body(quaternion: Array, pull: Array, depth_m: float) -> Array:
    """Body wrench of a pull in the world on the hook, (k, 6)."""
    force = quat_rotate_inverse(quaternion, pull)
    wrench = np.zeros((len(force), 6))
    wrench[:, :3], wrench[:, 3], wrench[:, 4] = force, depth_m * force[:, 1], -depth_m * force[:, 0]
    return wrench


@dataclass(frozen=True, slots=True)
class _Swinging:
    """Pulls per kilogram of several loads along a flight.

    Attributes:
        t_s: instants, (k,). depths_m: of the hooks. pulls: in the world at the instants, (k, 3) of each load, along the
            motion there was, and along a plan of loads that hang as they did; None where the motion is not known.
    """

    t_s: Array
    depths_m: Sequence[float]
    pulls: Sequence[Sequence[Array]] | None

    @classmethod
    def along(
        cls, signals: Signals, vehicle: Vehicle, several: Sequence[Settings], ways: Sequence[Signals | None]
    ) -> _Swinging:
        """Of several settings, by the thrust there was (None) or by a plan."""
        at, pendulums = _grid(signals.t_s), np.array([_pendulum(settings) for settings in several])
        t_s, moving, gravity = signals.t_s[at], _moving(signals, at), float(vehicle.gravity_m_s2)
        depths: list[float] = pendulums[:, 2].tolist()
        if not (np.isfinite(moving[0]).all() and np.isfinite(moving[1]).all()):
            return cls(t_s, depths, None)
        states = _states(signals, at, vehicle, several)
        found = list[list[Array]]()
        for planned in ways:
            going, own = None if planned is None else _moving(planned, at), list[Array]()
            for number, depth_m in enumerate(depths):
                velocity = moving[0] + depth_m * moving[1]
                if going is not None:
                    acceleration = np.gradient(going[0] + depth_m * going[1], t_s, axis=0)
                elif BODY_KG in several[number]:
                    seen = states[:, :, number], velocity, several[number]
                    acceleration = _beside_load(signals, at, vehicle, seen)
                else:
                    acceleration = _lifted(signals, at, vehicle)
                constants = (gravity, *pendulums[number, :2].tolist())
                own.append(_pull(states[:, :, number], velocity, acceleration, constants))
            found.append(own)
        return cls(t_s, depths, found)

    def wrench(self, signals: Signals, way: int) -> Annotated[Array, "k 6 n"]:
        """Body wrenches in a part of the flight, of signals as they were or as a plan made them."""
        out = np.full((len(signals.t_s), 6, len(self.depths_m)), np.nan)
        for number, pull in enumerate(() if self.pulls is None else self.pulls[way]):
            at_samples = resampled(signals.t_s, self.t_s, pull)
            out[:, :, number] = _on_body(signals.quaternion, at_samples, self.depths_m[number])
        return out


def _states(signals: Signals, at: Index, vehicle: Vehicle, several: Sequence[Settings]) -> Array:
    """Directions of the cable and their rates, (k, 6, n): followed from the start, or seen where a body's mass is
    given.
    """
    from groundstation.diagnosis.pendulum import pulls_per_mass

    t_s, gravity = signals.t_s[at], float(vehicle.gravity_m_s2)
    origin, deeper = (np.nan_to_num(part) for part in _moving(signals, at))
    body_kg = several[0].get(BODY_KG)
    if body_kg is None:
        pendulums = np.array([_pendulum(settings) for settings in several])
        return pulls_per_mass(t_s, (origin, deeper), gravity, pendulums, True)[1]
    force = np.gradient(origin, t_s, axis=0) + np.array([0.0, 0.0, gravity])
    drag = several[0].get(SEEN_DRAG_KG_S, 0.0) * origin * np.array([1.0, 1.0, 0.0])
    along = cable(_slow(body_kg * force - _lift(signals, at, vehicle) + drag, t_s))
    return np.repeat(np.column_stack([along, np.gradient(along, t_s, axis=0)])[:, :, None], len(several), axis=2)


def _slow(values: Array, t_s: Array) -> Array:
    """The part of columns (k, 3) below SEEN_HZ."""
    from scipy.signal import butter, sosfiltfilt

    rate_hz = 1.0 / max(float(np.median(np.diff(t_s))), 1e-6) if len(t_s) > 1 else 0.0
    if rate_hz < 3.0 * SEEN_HZ or len(t_s) < 20:
        return values
    return np.asarray(sosfiltfilt(butter(2, SEEN_HZ, fs=rate_hz, output="sos"), np.nan_to_num(values), axis=0))


def _lift(signals: Signals, at: Index, vehicle: Vehicle) -> Array:
    """Thrust in the world, (k, 3)."""
    some = signals.at(at)
    return quat_rotate(some.quaternion, from_thrust(vehicle, some.thrust_n)[:, :3])


def _held_n(lift: Array) -> float:
    """What a thrust (k, 3) holds up in the mean."""
    flying = lift[:, 2] > 0.5 * np.median(lift[:, 2])
    return max(float(np.mean(lift[flying, 2])) if flying.any() else 0.0, 1e-9)


def _lifted(signals: Signals, at: Index, vehicle: Vehicle) -> Array:
    """Acceleration as the thrust makes it, in the world, (k, 3), of a mass that the mean thrust holds up.

    The measured one holds the disturbance, which a column made of it would explain away with the mass.
    """
    lift = _lift(signals, at, vehicle)
    return lift * (vehicle.gravity_m_s2 / _held_n(lift)) - np.array([0.0, 0.0, vehicle.gravity_m_s2])


def _beside_load(signals: Signals, at: Index, vehicle: Vehicle, seen: tuple[Array, Array, Settings]) -> Array:
    """Acceleration of the body alone, in the world, (k, 3), as thrust and load make it.

    With the load's mass mu over the body's m, and the pull F per mass of the load that the thrust alone would give, the
    body feels T / m + mu F / (1 + mu): what it feels is part of the pull.

    Args:
        seen: directions and rates of the cable (k, 6), velocity of the hook (k, 3), and settings.
    """
    states, velocity, settings = seen
    lift, down = _lift(signals, at, vehicle), np.array([0.0, 0.0, vehicle.gravity_m_s2])
    more = max(_held_n(lift) / (vehicle.gravity_m_s2 * settings[BODY_KG]), 1.0)
    alone = lift / settings[BODY_KG] - down
    constants = (float(vehicle.gravity_m_s2), settings[LENGTH_M], settings[AIR_1_S])
    return alone + (1.0 - 1.0 / more) * _pull(states, velocity, alone, constants)


def _pull(states: Array, velocity: Array, acceleration: Array, constants: tuple[float, float, float]) -> Array:
    """Pull per mass in the world, (k, 3), of directions and rates (k, 6) at a velocity and acceleration of the hook."""
    gravity, length, air = constants
    along, rate = states[:, :3], states[:, 3:]
    push = -acceleration - air * (velocity + length * rate) - [0.0, 0.0, gravity]
    tension = length * np.sum(rate * rate, axis=1) + np.sum(along * push, axis=1)
    return tension[:, None] * along


def _wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> Array:
    """Of the load and of the changes of its settings, (k, 6, 4)."""
    return _followed(signals, None, vehicle, [settings], False)(signals, None)[0]


def _alone(signals: Signals, vehicle: Vehicle, settings: Settings) -> Array:
    """Of the load, (k, 6, 1)."""
    return _followed(signals, None, vehicle, [settings], True)(signals, None)[0]


def _instrument(signals: Signals, planned: Signals, vehicle: Vehicle, settings: Settings) -> Array:
    """Where the load hangs follows from the motion of the last seconds; how hard it pulls, from the plan."""
    return _followed(signals, planned, vehicle, [settings], False)(signals, planned)[1]


def _followed(
    signals: Signals, planned: Signals | None, vehicle: Vehicle, several: Sequence[Settings], alone: bool
) -> Followed:
    """As :attr:`.Effect.followed` has it: loads that are asked for alone swing side by side, LANES at a time."""
    ways: list[Signals | None] = [None] if planned is None else [None, planned]
    if alone:
        full = [_full(settings) for settings in several]
        swinging = [_Swinging.along(signals, vehicle, full[i : i + LANES], ways) for i in range(0, len(full), LANES)]
        return lambda now, ahead: [
            found.wrench(now, 0)[:, :, number : number + 1]
            for found in swinging
            for number in range(len(found.depths_m))
        ]
    (settings,) = several
    changed, sizes = _changed(settings)
    swing = _Swinging.along(signals, vehicle, changed, ways)

    def wrenches(now: Signals, ahead: Signals | None) -> list[Array]:
        out = [swing.wrench(now, 0)] + ([] if ahead is None else [swing.wrench(ahead, 1)])
        for own in out:
            own[:, :, 1:] = (own[:, :, 1:] - own[:, :, :1]) / sizes
        return out

    return wrenches


def _changed(settings: Settings) -> tuple[list[Settings], Array]:
    """A load's settings, and those with each moved by a step; the steps, (3,)."""
    full = _full(settings)
    sizes = {name: step * full[name] if name == LENGTH_M else step for name, step in STEPS.items()}
    return [full, *({**full, name: full[name] + size} for name, size in sizes.items())], np.array(list(sizes.values()))


def _begun(signals: Signals, vehicle: Vehicle, settings: Settings, index: Index) -> Callable[[Signals], Array]:
    """In windows that start in a flight the load swings on from where it was."""
    from groundstation.diagnosis.pendulum import pulls_moved

    pendulum, at, gravity = _pendulum(_full(settings)), _grid(signals.t_s), float(vehicle.gravity_m_s2)
    depth_m = float(pendulum[2])

    def hook(now: Signals, rows: Index | slice) -> Array:
        origin, deeper = _moving(now, rows)
        return np.nan_to_num(origin + depth_m * deeper)

    states = _states(signals, at, vehicle, [_full(settings)])
    going = np.ascontiguousarray(states[np.clip(np.searchsorted(at, index), 0, len(at) - 1), :, 0])
    last = [signals.t_s[index], hook(signals, index)]

    def wrench(now: Signals) -> Array:
        velocity = hook(now, slice(None))
        pull = pulls_moved(going, (last[1], velocity), now.t_s - last[0], gravity, pendulum)
        last[:] = now.t_s, velocity
        out = blank(now, len(PARAMETERS))
        out[:, :, 0] = _on_body(now.quaternion, pull, depth_m)
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
    from groundstation.diagnosis.pendulum import pulls_per_mass

    at = _grid(signals.t_s)[::SEARCHED_EVERY]
    t_s, moving, gravity = signals.t_s[at], _moving(signals, at), float(vehicle.gravity_m_s2)

    def pull(pendulums: Array) -> Array:
        return pulls_per_mass(t_s, moving, gravity, pendulums, False)[0]

    found = likely_pendulums(signals, keep, at, vehicle, pull)
    if found:
        return tuple({LENGTH_M: length, AIR_1_S: air, DEPTH_M: depth} for length, air, depth in found)
    swing = swing_of(signals, keep, vehicle)
    if swing is None:
        return ()
    air = float(np.clip(swing.air_1_s, *AIR_RANGE_1_S))
    seen = {BODY_KG: swing.body_kg, SEEN_DRAG_KG_S: swing.drag_kg_s}
    return ({LENGTH_M: swing.length_m, AIR_1_S: air, DEPTH_M: 0.0, **seen},)


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
    alone=_alone,
    followed=_followed,
    sentence="A load of {load_kg:g} swings {length_m:m} below the vehicle.",
    confused_with=("wind", "payload_change"),
    manoeuvre="a brisk sideways stop, then hover still for ten seconds and watch the swing ring down",
    variants=lambda signals, vehicle: tuple({LENGTH_M: float(length)} for length in np.geomspace(0.15, 4.0, 22)),
    searched=_searched,
    scanned=SCANNED,
    finer=_finer,
    settled=_settled,
    among=lambda settings: SEEN if BODY_KG in settings else EFFECT,
    begun=_begun,
)


SEEN_COLUMNS = [0, 3]
"""Of the columns, the load and the depth of its hook."""


def _seen_wrench(signals: Signals, vehicle: Vehicle, settings: Settings) -> Array:
    return _wrench(signals, vehicle, settings)[:, :, SEEN_COLUMNS]


def _seen_instrument(signals: Signals, planned: Signals, vehicle: Vehicle, settings: Settings) -> Array:
    return _instrument(signals, planned, vehicle, settings)[:, :, SEEN_COLUMNS]


def _seen_followed(
    signals: Signals, planned: Signals | None, vehicle: Vehicle, several: Sequence[Settings], alone: bool
) -> Followed:
    followed = _followed(signals, planned, vehicle, several, False)
    return lambda now, ahead: [columns[:, :, SEEN_COLUMNS] for columns in followed(now, ahead)]


def _seen_begun(signals: Signals, vehicle: Vehicle, settings: Settings, index: Index) -> Callable[[Signals], Array]:
    swinging = _begun(signals, vehicle, settings, index)
    return lambda now: swinging(now)[:, :, SEEN_COLUMNS]


def _seen_spread(settings: Settings, load_kg: float) -> dict[str, float]:
    """What the search's values are off by."""
    length, air = settings[LENGTH_M], settings[AIR_1_S]
    return {
        BODY_KG: THRESHOLDS.swing_form * load_kg,
        LENGTH_M: THRESHOLDS.swing_form * length,
        AIR_1_S: float(np.hypot(SEEN_AIR_1_S, 0.4 * air)),
        SEEN_DRAG_KG_S: DRAG_STD * settings[BODY_KG],
    }


def _no_finer(settings: Settings) -> tuple[Settings, ...]:
    return ()


def _seen_settled(settings: Settings, values: Array) -> Settings:
    return _settled(settings, np.array([values[0], 0.0, 0.0, values[1]]))


SEEN = replace(
    EFFECT,
    parameters=(replace(PARAMETERS[0], form=THRESHOLDS.swing_form), PARAMETERS[3]),
    wrench=_seen_wrench,
    instrument=_seen_instrument,
    followed=_seen_followed,
    settled=_seen_settled,
    begun=_seen_begun,
    finer=_no_finer,
    scanned=len(SHARES),
    spread=_seen_spread,
)
"""Where the cable is seen: length and damping are those of the search. Along directions that hold noise an estimate of
them would be bent by it.
"""
