r"""Does what is left of the sideways force swing as a load below does? Told where no model of it could be fitted.

A fit without a load carries it as mass, so that the residual force is :math:`R = -m \ddot r`, m the load and r its
place beside the hook: twice integrated it is the place itself. A pendulum obeys
:math:`\ddot r = -\lambda r - c \dot r - a`, so that

.. math:: R = m a + \lambda Q + c \dot Q, \qquad Q = - \iint R

holds at each instant, however far the load has swung before (an equation error; Ljung 1999, ch. 7), with
:math:`\lambda = g / l`. A disturbance has no part m in proportion to the vehicle's own acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.frames import quat_rotate
from groundstation.identification.preparation import Prepared
from groundstation.model.parameters import Parameters

Array = NDArray[np.float64]

BAND_HZ = (0.3, 2.0)
"""Where loads on cables of some decimetres to three metres swing."""
LENGTHS_M = (0.1, 5.0)
LOAD_WITHIN, LENGTH_WITHIN = (0.7, 1.5), (0.55, 1.8)
"""Of the regression's values, where the true ones lay on flights of two simulators: angles were small in none."""


@dataclass(frozen=True, slots=True)
class Swing:
    """A load, roughly: by small angles."""

    load_kg: float
    length_m: float

    def sentence(self) -> str:
        """As a warning."""
        low, high = (self.load_kg * factor for factor in LOAD_WITHIN)
        short, long = (self.length_m * factor for factor in LENGTH_WITHIN)
        return (
            f"What is left of the sideways force swings as a load of {1e3 * low:.2g} to {1e3 * high:.2g} g does on "
            f"{short:.2g} to {long:.2g} m below the vehicle. The mass and its interval take it for part of the "
            "vehicle: take it off, or weigh."
        )


def swing_of(prepared: Prepared, p: Parameters) -> Swing | None:
    """A load that swings below the vehicle; None where nothing does, or where accelerations or thrusts are unknown."""
    record = prepared.record
    signals = prepared.signals(p.lag_up_s, p.lag_down_s, p.delay_s, p.lag_slope)
    force = quat_rotate(signals.quaternion, record.force_m_s2)
    up = quat_rotate(signals.quaternion, np.array([0.0, 0.0, 1.0]))
    thrust = signals.thrust_n.sum(axis=1)
    if len(force) < 1000 or not (np.isfinite(force).all() and np.isfinite(thrust).all()):
        return None
    residual = (p.mass_kg * force - up * thrust[:, None])[:, :2]
    step, kept = float(np.median(np.diff(record.t_s))), record.keep
    left = _band(residual, step, 0)[kept].T.ravel()
    columns = (_band(force[:, :2], step, 0), -_band(residual, step, 2), -_band(residual, step, 1))
    return _judged(left, np.stack([c[kept].T.ravel() for c in columns], axis=1), prepared, p.mass_kg)


def _judged(left: Array, columns: Array, prepared: Prepared, mass_kg: float) -> Swing | None:
    gravity = prepared.record.vehicle.gravity_m_s2
    (load, square, _), *_ = np.linalg.lstsq(columns, left, rcond=None)
    rest = float(np.mean((left - columns @ np.linalg.lstsq(columns, left, rcond=None)[0]) ** 2))
    power = float(np.mean(left**2))
    swings = (
        np.sqrt(power) > THRESHOLDS.swing_share * mass_kg * gravity
        and rest < THRESHOLDS.swing_left * power
        and load > THRESHOLDS.swing_load * mass_kg
        and gravity / LENGTHS_M[1] < square < gravity / LENGTHS_M[0]
    )
    return Swing(float(load), float(gravity / square)) if swings else None


def _band(values: Array, step_s: float, integrals: int) -> Array:
    """The part within the band, integrated so many times, (k, p)."""
    frequency = np.fft.rfftfreq(len(values), step_s)
    inside = (frequency > BAND_HZ[0]) & (frequency < BAND_HZ[1])
    gain = np.zeros(len(frequency), dtype=complex)
    gain[inside] = (2j * np.pi * frequency[inside]) ** -integrals
    return np.fft.irfft(np.fft.rfft(values - values.mean(axis=0), axis=0) * gain[:, None], len(values), axis=0)
