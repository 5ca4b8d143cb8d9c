"""A thrust curve so far from the declared one that nothing can be expanded about the latter.

Thrust and the specific force along z are compared below 1 Hz, where neither lag nor noise matters: of the power laws
T_h (T/T_h)^(1 + e/2) through the declared thrust at hover, which is proportional to the force? If one is by far better
than the declared one, all estimates are made about it, and the difference is a finding.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.effect import library
from groundstation.diagnosis.results import Finding
from groundstation.diagnosis.sentences import filled
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.identification.preparation import Prepared
from groundstation.identification.results import Estimate
from groundstation.linear_filters import both_ways, low_pass
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

EXPONENTS = np.arange(-1.5, 1.51, 0.25)
NAME = "thrust_curve"


def exponent_error(prepared: Prepared) -> float:
    """Difference of the exponent from the declared one; 0 where the declared curve serves or the flight does not
    tell.
    """
    prepared = prepared.liveliest()
    record, rotors = prepared.record, prepared.record.vehicle.rotors
    if rotors.input != "command" or rotors.thrust_curve is None or not np.isfinite(record.force_m_s2).all():
        return 0.0
    rate = 1.0 / float(np.median(np.diff(record.t_s)))
    sections = low_pass(2, THRESHOLDS.curve_low_pass_hz, rate)
    commands = prepared.signals(0.0, 0.0, 0.0).motor
    climb = prepared.velocity_m_s[:, 2] if np.isfinite(prepared.velocity_m_s).all() else np.zeros(len(commands))

    def squared_error(error: float) -> float:
        total = _curve_with_exponent(record.vehicle, error).thrust(commands).sum(axis=1)
        columns = np.column_stack([total, np.gradient(total, record.t_s), climb * total])
        x: Array
        y: Array
        x, y = (both_ways(sections, v)[record.keep] for v in (columns, record.force_m_s2[:, 2]))
        x = x / (np.linalg.norm(x, axis=0) + 1e-30)
        return float(np.sum((y - x @ np.linalg.lstsq(x, y, rcond=1e-8)[0]) ** 2))

    errors = [squared_error(float(e)) for e in EXPONENTS]
    best = int(np.argmin(errors))
    return float(EXPONENTS[best]) if errors[best] < THRESHOLDS.curve_error_share * squared_error(0.0) else 0.0


def with_thrust_exponent(prepared: Prepared, error: float) -> Prepared:
    """The flight as one of a vehicle whose thrust has another exponent."""
    if error == 0.0:
        return prepared
    return replace(
        prepared, record=replace(prepared.record, vehicle=_curve_with_exponent(prepared.record.vehicle, error))
    )


def _curve_with_exponent(vehicle: Vehicle, error: float) -> Vehicle:
    """The declared curve to the power 1 + error/2 about hover, as the parabola that fits it best up to full command."""
    if error == 0.0:
        return vehicle
    hover = vehicle.mass_kg * vehicle.gravity_m_s2 / vehicle.rotors.count
    command = np.linspace(0.05, 1.0, 60)
    declared = np.maximum(vehicle.thrust(command), 1e-9 * hover)
    c2, c1, c0 = np.polyfit(command, hover * (declared / hover) ** (1.0 + 0.5 * error), 2)
    curve = (float(c0), float(c1), float(c2))
    return vehicle.model_copy(update={"rotors": vehicle.rotors.model_copy(update={"thrust_curve": curve})})


def with_exponent(findings: list[Finding], error: float, gain: float) -> list[Finding]:
    """Findings with the exponent that all was estimated about; what was found beside it is added to it."""
    if error == 0.0:
        return findings
    more = next((f for f in findings if f.effect == NAME), None)
    beside = Estimate.normal(0.0, 0.5 * float(EXPONENTS[1] - EXPONENTS[0]))
    if more is not None:
        beside = more.parameters["exponent_error"]
    total = Estimate.normal(error + beside.value, beside.std)
    own = Finding(
        effect=NAME,
        parameters={"exponent_error": total},
        sentence=filled(library()[NAME].sentence, exponent_error=total.value),
        confidence=1.0 if more is None else more.confidence,
        gain=gain,
    )
    return [own, *(f for f in findings if f is not more)]
