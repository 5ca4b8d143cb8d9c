"""Findings that need no force model: what gyro, accelerometer and motion capture say of each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.attribution import INSEPARABLE, posterior
from groundstation.diagnosis.results import Finding
from groundstation.frames import quat_exp, quat_multiply, quat_rotate
from groundstation.identification.preparation import Prepared
from groundstation.identification.results import Estimate

Array = NDArray[np.float64]

CERTAIN = 5.0
"""Standard deviations from nothing that make a kinematic finding."""
LEAST_OFFSET_S = 2e-3
LEAST_ANGLE_RAD = np.deg2rad(0.3)
LEAST_SHIFT_M = 5e-3
TRUE_RAD = np.deg2rad(0.3)
"""How upright rotors stand in a frame, one standard deviation."""


def kinematic_findings(prepared: Prepared) -> list[Finding]:
    """Clock offset, misalignments and tilt from flight-path reconstruction; none without poses and an IMU."""
    found = prepared.compatibility
    if found is None:
        return []
    vehicle = prepared.record.vehicle
    values, std = found.values, found.std
    out: list[Finding] = []

    def group(names: Sequence[str], declared: Array, least: float) -> tuple[Array, Array, float]:
        """Values beside what is declared, their standard deviations, and the evidence (0 where too small to matter)."""
        value = np.array([values[n] for n in names]) - declared
        spread = np.array([std[n] for n in names])
        evidence = float(np.max(np.abs(value) / spread)) ** 2 if np.linalg.norm(value) > least else 0.0
        return value, spread, evidence if evidence > CERTAIN**2 else 0.0

    if prepared.clock is not None:
        offset, spread, evidence = group(("mocap_minus_imu_s",), np.zeros(1), LEAST_OFFSET_S)
        if evidence:
            parameters = {"mocap_minus_imu_s": Estimate.normal(float(offset[0]), float(spread[0]))}
            if abs(values["clock_drift"]) > CERTAIN * std["clock_drift"]:
                parameters["clock_drift"] = Estimate.normal(values["clock_drift"], std["clock_drift"])
            text = (
                f"Motion capture stamps an instant {offset[0] * 1e3:+.1f} ms from the IMU's stamp: rates and attitude line up "
                "only when shifted."
            )
            out.append(_finding("clock_offset", parameters, text, evidence))
    rotation, spread, evidence = group([f"mocap_rotation_{a}_rad" for a in "xyz"], np.zeros(3), LEAST_ANGLE_RAD)
    if evidence:
        out.append(_misalignment(prepared, rotation, spread, evidence))
    lever = np.asarray(vehicle.mocap.position_m) - np.asarray(vehicle.imu.position_m)
    shift, spread, evidence = group([f"mocap_position_{a}_m" for a in "xyz"], lever, LEAST_SHIFT_M)
    if evidence and not any(f.effect == "mocap_misalignment" for f in out):
        parameters = _named("offset_{}_m", shift, spread)
        text = (
            f"The tracked point lies {np.linalg.norm(shift) * 1e3:.0f} mm from where it was declared: positions swing with "
            "attitude."
        )
        out.append(_finding("mocap_misalignment", parameters, text, evidence))
    tilt, spread, evidence = group(("mocap_tilt_x_rad", "mocap_tilt_y_rad"), np.zeros(2), LEAST_ANGLE_RAD)
    if evidence:
        text = (
            f"Motion capture's vertical is tilted by {np.degrees(np.linalg.norm(tilt)):.2f} degrees against gravity: a steady "
            "horizontal acceleration that the accelerometer does not feel."
        )
        out.append(_finding("mocap_tilt", _named("tilt_{}_rad", tilt, spread), text, evidence))
    return out


def turned(prepared: Prepared, findings: Sequence[Finding]) -> Prepared:
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


def _named(pattern: str, values: Array, std: Array) -> dict[str, Estimate]:
    return {pattern.format(a): Estimate.normal(float(v), float(s)) for a, v, s in zip("xyz", values, std, strict=False)}


def _finding(
    effect: str,
    parameters: Mapping[str, Estimate],
    text: str,
    evidence: float,
    rivals: Mapping[str, float] | None = None,
) -> Finding:
    """A finding whose rivals' evidence stands below its own by the given amounts (chi squared)."""
    behind = dict(rivals or {})
    return Finding(
        effect=effect,
        parameters=parameters,
        evidence=text,
        confidence=posterior([CERTAIN**2 - evidence, *(-d for d in behind.values())]),
        alternatives=tuple(name for name, d in behind.items() if d < INSEPARABLE),
        gain=evidence,
    )


def _misalignment(prepared: Prepared, rotation: Array, spread: Array, evidence: float) -> Finding:
    """Which of the two bodies is turned: the thrust, seen by the accelerometer, decides about roll and pitch.

    An IMU turned by e in the body sees the thrust along z - e x z, and the marker body is then turned by -e against it; a turned
    marker body leaves the thrust along z. Rotors stand upright to TRUE_RAD.
    """
    expected = np.array([rotation[1], -rotation[0]])
    seen = _thrust_tilt(prepared)
    lead = 0.0 if seen is None else float(np.sum(seen**2) - np.sum((seen - expected) ** 2)) / TRUE_RAD**2
    imu = lead > 0.0
    name, other = ("imu_misalignment", "mocap_misalignment") if imu else ("mocap_misalignment", "imu_misalignment")
    text = (
        f"{'IMU' if imu else 'Marker body'} and {'body' if imu else 'IMU'} are turned against each other by "
        f"{np.degrees(np.linalg.norm(rotation)):.2f} degrees."
    )
    parameters = _named("rotation_{}_rad", -rotation if imu else rotation, spread)
    return _finding(name, parameters, text, evidence, {other: abs(lead)})


def _thrust_tilt(prepared: Prepared) -> Array | None:
    """Mean direction of the specific force in the IMU's frame, (x, y) over z."""
    force = prepared.record.force_m_s2[prepared.record.keep]
    if not np.isfinite(force).all() or prepared.source != "imu":
        return None
    mean = force.mean(axis=0)
    return mean[:2] / mean[2]
