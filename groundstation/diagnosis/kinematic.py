"""Findings that need no force model: what gyro, accelerometer and motion capture say of each other.

What each effect of the sensors is read from, how large it has to be and its sentence stand in its file in ``effects/``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.effect import ROTATION, Reading, SensorEffect, catalogue
from groundstation.diagnosis.results import Finding
from groundstation.diagnosis.rivals import posterior
from groundstation.diagnosis.sentences import filled
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.frames import quat_exp, quat_multiply, quat_rotate
from groundstation.identification.preparation import Prepared
from groundstation.identification.reconstruction import Compatibility
from groundstation.identification.results import Estimate

Array = NDArray[np.float64]

TURNED = "imu_misalignment", "mocap_misalignment"
"""One rotation tells of both: that between IMU and marker body."""


def kinematic_findings(prepared: Prepared) -> list[Finding]:
    """Clock offset, misalignments and tilt from flight-path reconstruction; none without poses and an IMU, or where
    its errors are not small.
    """
    found = prepared.compatibility
    if found is None or any(
        abs(found.values.get(f"gyro_scale_{axis}", 0.0)) > THRESHOLDS.sensor_scale_most for axis in "xyz"
    ):
        return []
    lead = _lead_of_imu(prepared, found)
    other = TURNED[1] if lead > 0.0 else TURNED[0]
    out: list[Finding] = []
    for effect in catalogue().values():
        if not isinstance(effect, SensorEffect):
            continue
        for reading in effect.readings:
            rotation = reading.names == ROTATION
            departure = None if rotation and effect.identifier == other else _departure(reading, prepared, found)
            if departure is not None:
                out.append(_finding(effect, reading, departure, {other: abs(lead)} if rotation else {}))
                break
    return out


@dataclass(frozen=True, slots=True)
class _Departure:
    """What a reading differs by from what is declared, and the evidence that it does (chi squared)."""

    size: Array
    parameters: Mapping[str, Estimate]
    evidence: float


def _departure(reading: Reading, prepared: Prepared, found: Compatibility) -> _Departure | None:
    """None where it is too small or too uncertain to matter."""
    if not reading.applies(prepared):
        return None
    size = np.array([found.values[n] for n in reading.names]) - reading.declared(prepared.record.vehicle)
    std = np.array([found.std[n] for n in reading.names])
    evidence = float(np.max(np.abs(size) / std)) ** 2
    if np.linalg.norm(size) <= reading.least or evidence <= THRESHOLDS.sensor_std**2:
        return None
    values = zip(reading.parameters, reading.sign * size, std, strict=True)
    parameters = {n: Estimate.normal(float(v), float(s)) for n, v, s in values}
    for name in reading.beside:
        if abs(found.values[name]) > THRESHOLDS.sensor_std * found.std[name]:
            parameters[name] = Estimate.normal(found.values[name], found.std[name])
    return _Departure(size, parameters, evidence)


def _finding(effect: SensorEffect, reading: Reading, departure: _Departure, rivals: Mapping[str, float]) -> Finding:
    """A finding whose rivals' evidence stands below its own by the given amounts (chi squared)."""
    values = {name: estimate.value for name, estimate in departure.parameters.items()}
    return Finding(
        effect=effect.identifier,
        parameters=departure.parameters,
        sentence=filled(reading.sentence, **values, size=float(np.linalg.norm(departure.size))),
        confidence=posterior([THRESHOLDS.sensor_std**2 - departure.evidence, *(-d for d in rivals.values())]),
        alternatives=tuple(name for name, d in rivals.items() if d < THRESHOLDS.inseparable),
        gain=departure.evidence,
    )


def _lead_of_imu(prepared: Prepared, found: Compatibility) -> float:
    """Which of the two bodies is turned: the thrust, seen by the accelerometer, decides about roll and pitch.

    An IMU turned by e in the body sees the thrust along z - e x z, and the marker body is then turned by -e against it;
    a turned marker body leaves the thrust along z. Rotors stand upright to ``rotor_upright_rad``.

    Returns:
        By how much more (chi squared) it is the IMU; the marker body where negative, or where no thrust is seen.
    """
    seen = _thrust_tilt(prepared)
    if seen is None:
        return 0.0
    rotation = np.array([found.values[n] for n in ROTATION])
    expected = np.array([rotation[1], -rotation[0]])
    return float(np.sum(seen**2) - np.sum((seen - expected) ** 2)) / THRESHOLDS.rotor_upright_rad**2


def with_imu_aligned(prepared: Prepared, findings: Sequence[Finding]) -> Prepared:
    """The flight with an IMU that was found turned put straight, so that no force is blamed for it."""
    imu = next((f for f in findings if f.effect == "imu_misalignment"), None)
    if imu is None:
        return prepared
    back = quat_exp(np.array([imu.parameters[f"rotation_{a}_rad"].value for a in "xyz"]))
    away = back * [1.0, -1.0, -1.0, -1.0]
    record = replace(
        prepared.record,
        rate_rad_s=quat_rotate(back, prepared.record.rate_rad_s),
        force_m_s2=quat_rotate(back, prepared.record.force_m_s2),
    )
    return replace(
        prepared,
        record=record,
        quaternion=quat_multiply(prepared.quaternion, away),
        causal_quaternion=quat_multiply(prepared.causal_quaternion, away),
    )


def _thrust_tilt(prepared: Prepared) -> Array | None:
    """Mean direction of the specific force in the IMU's frame, (x, y) over z."""
    force = prepared.record.force_m_s2[prepared.record.keep]
    if not np.isfinite(force).all() or prepared.source != "imu":
        return None
    mean = force.mean(axis=0)
    return mean[:2] / mean[2]
