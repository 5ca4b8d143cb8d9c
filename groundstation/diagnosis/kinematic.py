"""Findings that need no force model: what gyro, accelerometer and motion capture say of each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.results import Finding
from groundstation.identification.preparation import Prepared
from groundstation.identification.results import Estimate

Array = NDArray[np.float64]

CERTAIN = 5.0
"""Standard deviations from nothing that make a kinematic finding."""
LEAST_OFFSET_S = 2e-3
LEAST_ANGLE_RAD = np.deg2rad(0.3)
LEAST_SHIFT_M = 5e-3


def kinematic_findings(prepared: Prepared, thrust_tilt_rad: Array | None = None) -> list[Finding]:
    """Clock offset, misalignments and tilt from flight-path reconstruction.

    Args:
        prepared: the flight.
        thrust_tilt_rad: mean direction of the specific force in the IMU's frame, (x, y) over z; tells a turned IMU (it sees
            the thrust turned) from a turned marker body (it does not).
    """
    found = prepared.compatibility
    if found is None:
        return []
    vehicle = prepared.record.vehicle
    values, std = found.values, found.std
    out: list[Finding] = []

    def group(names: tuple[str, ...], declared: Array, least: float) -> tuple[Array, Array, bool]:
        value = np.array([values[n] for n in names]) - declared
        spread = np.array([std[n] for n in names])
        return value, spread, bool(np.linalg.norm(value) > least and np.max(np.abs(value) / spread) > CERTAIN)

    if prepared.clock is not None:
        offset, spread, certain = group(("mocap_minus_imu_s",), np.zeros(1), LEAST_OFFSET_S)
        if certain:
            parameters = {"mocap_minus_imu_s": Estimate.normal(offset[0], spread[0])}
            if abs(values["clock_drift"]) > CERTAIN * std["clock_drift"]:
                parameters["clock_drift"] = Estimate.normal(values["clock_drift"], std["clock_drift"])
            out.append(
                Finding(
                    "clock_offset",
                    parameters,
                    f"Motion capture stamps an instant {offset[0] * 1e3:+.1f} ms from the IMU's stamp: rates and attitude line up "
                    "only when shifted.",
                    0.999,
                )
            )
    rotation, spread, certain = group(
        ("mocap_rotation_x_rad", "mocap_rotation_y_rad", "mocap_rotation_z_rad"), np.zeros(3), LEAST_ANGLE_RAD
    )
    if certain:
        out.append(_misalignment(rotation, spread, thrust_tilt_rad))
    lever = np.asarray(vehicle.mocap.position_m) - np.asarray(vehicle.imu.position_m)
    shift, spread, certain = group(
        ("mocap_position_x_m", "mocap_position_y_m", "mocap_position_z_m"), lever, LEAST_SHIFT_M
    )
    if certain and not any(f.effect == "mocap_misalignment" for f in out):
        parameters = {f"offset_{a}_m": Estimate.normal(v, s) for a, v, s in zip("xyz", shift, spread, strict=True)}
        out.append(
            Finding(
                "mocap_misalignment",
                parameters,
                f"The tracked point lies {np.linalg.norm(shift) * 1e3:.0f} mm from where it was declared: positions swing with attitude.",
                0.99,
            )
        )
    tilt, spread, certain = group(("mocap_tilt_x_rad", "mocap_tilt_y_rad"), np.zeros(2), LEAST_ANGLE_RAD)
    if certain:
        parameters = {f"tilt_{a}_rad": Estimate.normal(v, s) for a, v, s in zip("xy", tilt, spread, strict=True)}
        out.append(
            Finding(
                "mocap_tilt",
                parameters,
                f"Motion capture's vertical is tilted by {np.degrees(np.linalg.norm(tilt)):.2f} degrees against gravity: a steady "
                "horizontal acceleration that the accelerometer does not feel.",
                0.99,
            )
        )
    return out


def _misalignment(rotation: Array, spread: Array, thrust_tilt: Array | None) -> Finding:
    """Which of the two bodies is turned: the thrust, seen by the accelerometer, decides about roll and pitch."""
    angle = np.degrees(np.linalg.norm(rotation))
    imu = False
    told = False
    if thrust_tilt is not None and np.linalg.norm(rotation[:2]) > LEAST_ANGLE_RAD:
        # An IMU turned by e in the body sees thrust along -e x z; the marker is then turned by -e against the IMU.
        expected = np.array([rotation[1], -rotation[0]])
        with_imu = np.linalg.norm(thrust_tilt - expected)
        without = np.linalg.norm(thrust_tilt)
        imu, told = bool(with_imu < without), bool(abs(with_imu - without) > 0.3 * np.linalg.norm(expected))
    name, other = ("imu_misalignment", "mocap_misalignment") if imu else ("mocap_misalignment", "imu_misalignment")
    sign = -1.0 if imu else 1.0
    return Finding(
        name,
        {f"rotation_{a}_rad": Estimate.normal(sign * v, s) for a, v, s in zip("xyz", rotation, spread, strict=True)},
        f"{'IMU' if imu else 'Marker body'} and {'body' if imu else 'IMU'} are turned against each other by {angle:.2f} degrees.",
        0.99 if told else 0.6,
        () if told else (other,),
    )
