r"""Mass and moments of flights without a plan: by the equations turned round, below 1.5 Hz.

There the fits to the rates give moments that are wrong by any factor at intervals that deny it: telemetry that is
filtered or late has lost the torque, a lag that is fitted takes the phase of feedback, and drag, flapping and damping
pass for inertia. What is left is feedback: the controller answers the disturbance, so motion and disturbance are
correlated by some :math:`\rho`, and a regression is off by :math:`\rho \sigma_e / \sigma_x`, with :math:`\sigma_e`
what is left of the output and :math:`\sigma_x` of the regressor beside the others. No data of one flight tell
:math:`\rho`; a bound on it goes into the interval (plausibly exogenous regressors: Conley, Hansen and Rossi 2012).

Without velocities the columns of flapping, inflow and lift are empty: what these do stays in :math:`\sigma_e`, and so
in the interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.dynamic_fit import CURVE
from groundstation.identification.identifiability import UNREVEALED, quiet_axes
from groundstation.identification.lagged_instruments import Equation
from groundstation.identification.low_frequency import (
    lightness_equation,
    moment_equations,
    parts_of,
    slow,
    without_plan,
)
from groundstation.identification.prediction_error import Fitted
from groundstation.identification.preparation import Prepared
from groundstation.identification.results import MASS_AND_TENSOR
from groundstation.identification.uncertainty import coloured_covariance
from groundstation.model.parameters import with_values

Array = NDArray[np.float64]

FEEDBACK = 0.25
"""Standard deviation of the correlation that feedback leaves between motion and disturbance in the band: between -0.54
and 0.59 in 36 simulated flights of 18 vehicles (benchmarks.unplanned, seeds 4000 to 4017), of which 95 % lay within a
half.
"""
LEAST = 0.1
"""Of the declared moment, below which an estimate is none."""
MOMENTS = ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")
LOW = "LF"
LOW_NOTE = (
    "Low frequencies: torque and thrust regressed on the motion below 1.5 Hz, with what feedback can do in the "
    "intervals."
)
LOW_REASON = (
    "LF: neither plan nor setpoints are recorded, and a fit to the fast motion takes what the air does, feedback and "
    "late rotor values for mass and inertia; below 1.5 Hz it is right. Feedback from disturbances is in the intervals. "
    "Products of inertia are not told."
)


@dataclass(frozen=True, slots=True)
class _Told:
    """One parameter by one part: value, deviation by its noise, and by feedback."""

    value: float
    noise: float
    feedback: float


def applies(prepared: Sequence[Prepared]) -> bool:
    """Neither plan nor setpoints are recorded of any of them."""
    return all(without_plan(item) for item in prepared)


def by_low_frequencies(prepared: Sequence[Prepared], fitted: Fitted) -> Fitted:
    """The fit with mass and moments by low frequencies, products of inertia unknown.

    Args:
        prepared: the flights.
        fitted: of them, by the declared constants.
    """
    by_flight = [parts_of(slow(_by_thrust(item, fitted), fitted.parameters)) for item in prepared]
    parts = [part for each in by_flight for part in each]
    quiet = np.repeat(quiet_axes(prepared), [len(each) for each in by_flight], axis=0)
    trace = float(np.trace(parts[0].tensor))
    found = dict.fromkeys(MASS_AND_TENSOR, (0.0, trace))
    found["mass_kg"] = _mass([lightness_equation(part) for part in parts], prepared)
    equations = [moment_equations(part) for part in parts]
    for axis, name in enumerate(MOMENTS):
        value, std = _pooled(
            [_plain(each[axis]) for each, silent in zip(equations, quiet[:, axis], strict=True) if not silent]
        )
        own = float(parts[0].tensor[axis, axis])
        # What is nowhere near a rigid body's is unknown: the declared value stands in, as unsure as it is large. So is
        # what would be known well only beside its own size: feedback blows up a moment, and its interval along.
        found[name] = (value, std) if LEAST * own < value and std < UNREVEALED * own else (own, own)
    names, values, covariance = list(fitted.names), fitted.values.copy(), fitted.covariance.copy()
    for name, (value, std) in found.items():
        index = names.index(name)
        values[index] = value
        covariance[index] = covariance[:, index] = 0.0
        covariance[index, index] = std**2
    extra = names[len(names) - len(fitted.parameters.extra) :]
    p = with_values(fitted.parameters, names, values, extra)
    return replace(fitted, parameters=p, values=values, covariance=covariance)


def _by_thrust(prepared: Prepared, fitted: Fitted) -> Prepared:
    """The same with thrust as declared, or by the curve that the fit found: the anchor is applied to what comes out."""
    vehicle = prepared.record.vehicle
    rotors, settings = vehicle.rotors, vehicle.identification.model_copy(update={"anchor": "thrust"})
    if rotors.thrust_curve is not None and CURVE[0] in fitted.names:
        found = (c + fitted.value(name) for c, name in zip(rotors.thrust_curve, CURVE, strict=True))
        rotors = rotors.model_copy(update={"thrust_curve": tuple(map(float, found))})
    update = {"identification": settings, "rotors": rotors}
    return replace(prepared, record=replace(prepared.record, vehicle=vehicle.model_copy(update=update)))


def _mass(equations: Sequence[Equation], prepared: Sequence[Prepared]) -> tuple[float, float]:
    """Mass by one over its inverse, with the accelerometer's bias and what the effects beside it leave open. Where none
    shows, the declared one, as unsure as it is large.
    """
    vehicle = prepared[0].record.vehicle
    value, std = _pooled([_plain(equation) for equation in equations])
    if not np.isfinite(std) or value <= 0.0:
        return vehicle.mass_kg, vehicle.mass_kg
    bias = min(float(item.record.force_bias_std[2]) for item in prepared) / vehicle.gravity_m_s2
    return 1.0 / value, float(np.hypot(std / value, bias)) / value


def _plain(equation: Equation) -> _Told | None:
    """Least squares of the first column beside the others; None where nothing is left of it."""
    used = equation.used
    if used.sum() < 4 * (equation.columns.shape[1] + equation.known.shape[1]):
        return None
    beside = np.column_stack([equation.columns[used, 1:], equation.known[used]])
    size: Array = np.linalg.norm(beside, axis=0) + 1e-300
    beside = beside / size
    x, y = (
        v - beside @ np.linalg.lstsq(beside, v, rcond=1e-8)[0]
        for v in (equation.columns[used, 0], equation.output[used])
    )
    power = float(x @ x)
    if power <= 1e-12 * float(np.sum(equation.columns[used, 0] ** 2)):
        return None
    value = float(x @ y) / power
    left = y - value * x
    influence, residual = np.zeros((len(used), 1, 1)), np.zeros((len(used), 1))
    influence[used, 0, 0], residual[used, 0] = x / power, left
    noise = float(np.sqrt(coloured_covariance(influence, residual, equation.step_s)[0, 0]))
    return _Told(value, noise, FEEDBACK * float(np.sqrt(left @ left / power)))


def _pooled(parts: Sequence[_Told | None]) -> tuple[float, float]:
    """Weighted mean and its deviation: noise and scatter between parts average out, feedback, of one sign, does not."""
    known = [part for part in parts if part is not None]
    if not known:
        return 0.0, np.inf
    values = np.array([part.value for part in known])
    feedback = np.array([part.feedback for part in known])
    total = np.hypot([part.noise for part in known], feedback)
    weight = total**-2 / np.sum(total**-2)
    value = float(weight @ values)
    noise = float(np.sqrt(np.sum((weight * [part.noise for part in known]) ** 2)))
    freedom = len(known) - 1
    scale = float(np.sqrt(np.sum(((values - value) / total) ** 2) / freedom)) if freedom else 1.0
    return value, float(np.hypot(noise, weight @ feedback)) * max(1.0, scale)
