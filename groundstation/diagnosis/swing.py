r"""Does the force that thrust and weight leave pull as a load below does, however far it swings? A search in one
unknown, without following the load through the flight.

With m the vehicle's own mass, f its specific force, T the thrust and k its drag, the cable pulls with :math:`P = m f -
T + k v`, and so points along :math:`s = P / |P|`. Newton's law for the load, of mass :math:`m_l` on a cable of length
L in air that resists it by c times its velocity, added to that for the vehicle, is

.. math:: T = (m + m_l) f + m_l L (\ddot s + c \dot s) + (m_l c + k) v

at each instant and any swing (Goldstein, Poole, Safko 2002, ch. 1: constraint forces). All of it but m and k is linear
(variable projection: Golub and Pereyra 1973). Equation errors (Ljung 1999, ch. 7) forget nothing of where a load
began, which one that goes over the top does within half a second. Where the cable is slack its direction is
interpolated.

The equation is taken once integrated, in a band: below it drifts and a steady wind, above it the noise of directions.
That noise is a regressor's, so that the coefficient of :math:`\ddot s` is short by the share of the power that it
makes, which is what the equation leaves (the reliability ratio; Fuller 1987, Measurement Error Models, ch. 1).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.effect import from_thrust
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.frames import quat_rotate
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

BAND_HZ = (0.3, 3.0)
"""Where loads on cables of some decimetres to three metres swing and turn over."""
SHORTEST_M = 0.1
RATE_HZ = 50.0
"""At which it is looked at."""
LEAST_S, EDGE_S = 8.0, 1.0
"""Of a flight that is looked at, and left out at its ends: the band's filter goes round there."""
SLACK = 0.3
"""Of the median pull, below which it does not say where the cable points."""
SHARES = np.linspace(0.01, 0.3, 30)
"""Of the whole mass, that a load is tried with at first."""
SEARCHED = np.array([0.6, -0.2]), np.array([1.0 - 0.5 * SHARES[0], 2.0])
"""Least and most of the vehicle's own share of the whole mass, and of its drag over the mass, 1/s."""
STEPS, ROUNDS = np.array([2e-3, 1e-2]), 8
"""Differences of the mass, as a share, and of the drag, 1/s times the mass; steps of Gauss and Newton."""

DRAG_STD = 0.02
"""Of the drag, 1/s times the mass: where there was none, 0.03 kg/s of 1.8 kg was found."""


@dataclass(frozen=True, slots=True)
class Swing:
    """A load, roughly.

    Attributes:
        air_1_s: by which the air damps it.
        body_kg: the vehicle without it. drag_kg_s: of the vehicle, level.
        left: share of the squared force that it leaves.
    """

    load_kg: float
    length_m: float
    air_1_s: float
    body_kg: float
    drag_kg_s: float
    left: float

    def hangs(self, gravity_m_s2: float) -> bool:
        """Whether it is a load at all: lighter than the heaviest that was tried, swinging within the band, in air that
        does not drive it.

        A search that ends at its edge, or beside what the equation was looked at in, has found no minimum.
        """
        if self.length_m < SHORTEST_M or self.load_kg >= (1.0 - SEARCHED[0][0] - 1e-6) * (self.load_kg + self.body_kg):
            return False
        swing_hz = float(np.sqrt(gravity_m_s2 * (1.0 + self.load_kg / self.body_kg) / self.length_m)) / (2.0 * np.pi)
        driven = self.air_1_s < -THRESHOLDS.swing_driven * 2.0 * np.pi * swing_hz
        return BAND_HZ[0] < swing_hz < BAND_HZ[1] and not driven

    def sentence(self) -> str:
        """As a warning."""
        low, high = (self.load_kg * (1.0 + side * 1.96 * THRESHOLDS.swing_form) for side in (-1.0, 1.0))
        return (
            f"What is left of the force swings as a load of {1e3 * low:.3g} to {1e3 * high:.3g} g does on "
            f"{self.length_m:.2g} m below the vehicle. It is not told from the mass, whose interval holds it: take it "
            "off, or weigh."
        )


@dataclass(frozen=True, slots=True)
class _Seen:
    """Evenly sampled: specific force, thrust and velocity in the world, (n, 3), and which instants count, (n,)."""

    step_s: float
    force: Array
    thrust: Array
    velocity: Array
    used: Mask

    @property
    def whole_kg(self) -> float:
        """What the mean thrust holds up."""
        return float(self.thrust[:, 2].mean() / self.force[:, 2].mean())

    def band(self, values: Array, *powers: int) -> list[Array]:
        """The part within the band, differentiated so many times, of the instants that count, (3 used,) each."""
        frequency = np.fft.rfftfreq(len(values), self.step_s)
        inside = (frequency > BAND_HZ[0]) & (frequency < BAND_HZ[1])
        spectrum, found = np.fft.rfft(values - values.mean(axis=0), axis=0), list[Array]()
        for power in powers:
            gain = np.zeros(len(frequency), dtype=complex)
            gain[inside] = (2j * np.pi * frequency[inside]) ** power
            found.append(np.fft.irfft(spectrum * gain[:, None], len(values), axis=0)[self.used].ravel())
        return found


def swing_of(signals: Signals, keep: Mask, vehicle: Vehicle, others: Array | None = None) -> Swing | None:
    """A load that swings below the vehicle; None where nothing does, or where velocities or thrusts are unknown.

    Args:
        keep: samples in use, (k,).
        others: body force of effects that were found, (k, 3); it counts with the thrust.
    """
    seen = _seen(signals, keep, vehicle, others)
    if seen is None:
        return None
    whole, level = seen.whole_kg, seen.velocity * [1.0, 1.0, 0.0]
    (thrust,) = seen.band(seen.thrust, -1)
    known = [seen.band(values, -1)[0] for values in (seen.force, level, seen.velocity - level)]

    def fitted(x: Array) -> tuple[Array, Array]:
        """What mass and drag, as shares, leave of the thrust, and the coefficients of all that is linear."""
        along = cable(x[0] * whole * seen.force - seen.thrust + x[1] * whole * level)
        columns = np.column_stack([*known, *seen.band(along, 1, 0)])
        coefficients = np.asarray(np.linalg.lstsq(columns, thrust, rcond=1e-9)[0], dtype=np.float64)
        rest: Array = thrust - columns @ coefficients
        return rest, coefficients

    best = _searched(lambda x: fitted(x)[0])
    rest, coefficients = fitted(best)
    alone: Array = np.column_stack(known)
    without: Array = thrust - alone @ np.asarray(np.linalg.lstsq(alone, thrust, rcond=1e-9)[0], dtype=np.float64)
    left = float(rest @ rest) / float(without @ without)
    load, turned = whole * (1.0 - float(best[0])), float(coefficients[3]) / max(1.0 - left, 0.1)
    found = Swing(
        load, turned / load, float(coefficients[4] / coefficients[3]), whole - load, float(best[1]) * whole, left
    )
    sideways: Array = (found.body_kg * seen.force - seen.thrust)[seen.used, :2]
    size = float(np.sqrt(np.mean(sideways**2) * 2.0))
    swings = (
        size > THRESHOLDS.swing_share * whole * vehicle.gravity_m_s2
        and found.left < THRESHOLDS.swing_left
        and load > THRESHOLDS.swing_load * whole
        and found.hangs(vehicle.gravity_m_s2)
    )
    return found if swings else None


def cable(pull: Array) -> Array:
    """Unit vectors along a pull, (n, 3); where it is weak, between those beside it."""
    size: Array = np.linalg.norm(pull, axis=1)
    taut = np.flatnonzero(size > SLACK * float(np.median(size)))
    if not len(taut):
        return np.tile([0.0, 0.0, -1.0], (len(pull), 1))
    between = np.arange(len(pull))
    along = np.column_stack([np.interp(between, taut, pull[taut, i] / size[taut]) for i in range(3)])
    length: Array = np.maximum(np.linalg.norm(along, axis=1), 1e-9)
    return along / length[:, None]


def _searched(left: Callable[[Array], Array]) -> Array:
    """Mass and drag as shares of the whole mass, (2,), that leave least: a scan, then Gauss and Newton."""
    starts = [np.array([1.0 - share, 0.0]) for share in SHARES]
    x: Array = min(starts, key=lambda start: float(np.sum(left(start) ** 2)))
    rest = left(x)
    for _ in range(ROUNDS):
        slopes = np.column_stack([(left(x + step) - rest) / step.sum() for step in np.diag(STEPS)])
        step = np.clip(-np.linalg.lstsq(slopes, rest, rcond=1e-9)[0], [-0.05, -0.2], [0.05, 0.2])
        trials = [np.clip(x + share * step, *SEARCHED) for share in (1.0, 0.5, 0.25)]
        before = float(rest @ rest)
        better = next((each for each in trials if float(np.sum(left(each) ** 2)) < before), None)
        if better is None:
            break
        x, rest = better, left(better)
        if float(rest @ rest) > (1.0 - 1e-4) * before:
            break
    return x


def _seen(signals: Signals, keep: Mask, vehicle: Vehicle, others: Array | None) -> _Seen | None:
    used = np.flatnonzero(keep)
    if not len(used):
        return None
    rows = slice(int(used[0]), int(used[-1]) + 1)
    now = signals.at(rows)
    t_s, velocity = now.t_s, now.velocity_world_m_s
    step = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 1.0
    every = max(1, round(1.0 / (RATE_HZ * step)))
    count = len(t_s) // every
    if count * every * step < LEAST_S or not np.isfinite(velocity).all():
        return None
    body: Array = from_thrust(vehicle, now.thrust_n)[:, :3]
    thrust = quat_rotate(now.quaternion, body if others is None else body + others[rows])
    if not np.isfinite(thrust).all() or thrust[:, 2].mean() <= 0.0:
        return None

    def thinned(values: Array) -> Array:
        return values[: count * every].reshape(count, every, -1).mean(axis=1)

    force = np.gradient(velocity, t_s, axis=0) + np.array([0.0, 0.0, vehicle.gravity_m_s2])
    inside = thinned(keep[rows].astype(float))[:, 0] > 1.0 - 1e-9
    edge = round(EDGE_S * RATE_HZ)
    inside[:edge], inside[-edge:] = False, False
    if inside.sum() < 0.5 * LEAST_S * RATE_HZ:
        return None
    return _Seen(step * every, thinned(force), thinned(thrust), thinned(velocity), inside)
