"""Whether the marker body still sits where it was calibrated: measured again whenever the vehicle is carried to its
place.

While it stands, gravity tells of a turn about its horizontal axes. After it was carried and turned for a while, the
whole calibration is made anew, in a thread of its own, and compared.
"""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from datetime import date
from math import pi

import numpy as np
from numpy.typing import NDArray

from drivers.samples import Imu, Pose
from groundstation.errors import GroundStationError
from groundstation.flight.station import MarkerCalibration
from groundstation.frames import quat_conjugate, quat_exp, quat_log, quat_multiply, quat_rotate_inverse
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

KEPT_S = 40.0
CARRIED_S = 12.0
"""Of turning until it is measured again; the calibration itself wants 30, a check against a millimetre less."""
TURNING_RAD_S, STILL_RAD_S = 0.4, 0.1
MOVED_M, TURNED_RAD = 0.003, 0.01
"""Moved by less, a marker body changes no parameter by its interval; and 0.6 degrees is what a firm grip may bend it.
"""
SURE = 3.0
STANDING_SAMPLES = 20


@dataclass(frozen=True, slots=True)
class MarkerVerdict:
    """What was found: whether it still holds, and a sentence."""

    ok: bool
    seen: str


class MarkerWatch:
    """Collects what arrives on the ground, and measures again.

    Args:
        calibration: of the station file.
        vehicle: where corrected poses have the marker body.
        today: for how long ago it was.
    """

    def __init__(self, calibration: MarkerCalibration, vehicle: Vehicle, today: date | None = None):
        self._calibration, self._today = calibration, today or date.today()
        self._offset = np.asarray(vehicle.mocap.position_m) - np.asarray(vehicle.imu.position_m)
        self._axes = quat_exp(np.asarray(vehicle.mocap.rotation_rad))
        self._imu: deque[tuple[float, ...]] = deque()
        self._poses: deque[tuple[float, ...]] = deque()
        self._turned_s = 0.0
        self._still_since_s: float | None = None
        self._found: MarkerVerdict | None = None
        self._at_work: threading.Thread | None = None

    def take(self, sample: Imu | Pose, host_s: float) -> None:
        """A sample of the IMU, or a pose as the calibration corrected it."""
        if isinstance(sample, Pose):
            self._poses.append((sample.device_s, *sample.position_m, *sample.quaternion, host_s))
        else:
            self._imu.append((sample.device_s, *sample.gyro_rad_s, *sample.accel_m_s2, host_s))
            self._watch(sample, host_s)
        for kept in (self._imu, self._poses):
            while kept and host_s - kept[0][-1] > KEPT_S:
                kept.popleft()

    def _watch(self, sample: Imu, host_s: float) -> None:
        size = sum(r * r for r in sample.gyro_rad_s) ** 0.5
        step_s = sample.device_s - self._imu[-2][0] if len(self._imu) > 1 else 0.0
        if size > TURNING_RAD_S:
            self._turned_s += min(max(step_s, 0.0), 0.1)
        if size > STILL_RAD_S:
            self._still_since_s = None
        elif self._still_since_s is None:
            self._still_since_s = host_s
        still = self._still_since_s is not None and host_s - self._still_since_s > 1.0
        if still and self._turned_s > CARRIED_S and self._at_work is None:
            self._turned_s = 0.0
            self._at_work = threading.Thread(target=self._measure, args=self._recorded(), daemon=True)
            self._at_work.start()

    def wait(self) -> None:
        """Until a measurement under way is done."""
        if self._at_work is not None:
            self._at_work.join()

    def _recorded(self) -> tuple[Array, Array]:
        return np.array(self._imu), np.array(self._poses)

    def _measure(self, imu: Array, poses: Array) -> None:
        from groundstation.identification.handheld import calibrate_by_hand

        try:
            found = calibrate_by_hand(
                (imu[:, 0], imu[:, 1:4], imu[:, 4:7]),
                (poses[:, 0], poses[:, 1:4], poses[:, 4:8]),
                expected_s=float(np.min(poses[:, 0] - poses[:, -1]) - np.min(imu[:, 0] - imu[:, -1])),
            )
            turned = quat_log(quat_multiply(quat_exp(found.rotation_rad), quat_conjugate(self._axes)))
            moved = found.position_m - self._offset
            self._found = compared(self._calibration, moved, found.position_std_m, turned, self._today)
        except GroundStationError as error:
            self._found = MarkerVerdict(True, f"it was carried, but its place could not be measured: {error}")
        self._at_work = None

    def verdict(self) -> MarkerVerdict:
        """What is known now."""
        standing = self._standing()
        if standing is not None and not standing.ok:
            return standing
        return self._found or standing or MarkerVerdict(True, "no IMU and poses together yet to check it by")

    def _standing(self) -> MarkerVerdict | None:
        """Angle between the accelerometer's upright and the poses', while it stands; None while it moves."""
        imu, poses = list(self._imu)[-STANDING_SAMPLES:], list(self._poses)[-STANDING_SAMPLES:]
        if min(len(imu), len(poses)) < STANDING_SAMPLES or self._still_since_s is None:
            return None
        accel, attitude = np.array(imu)[:, 4:7].mean(axis=0), np.array(poses)[-1, 4:8]
        up = quat_rotate_inverse(quat_multiply(attitude, quat_conjugate(self._axes)), np.array([0.0, 0.0, 1.0]))
        angle = float(np.arccos(np.clip(up @ accel / np.linalg.norm(accel), -1.0, 1.0)))
        if angle > TURNED_RAD + 0.02:  # an accelerometer's bias tilts gravity by a degree
            return MarkerVerdict(
                False,
                f"the marker body is turned by {angle * 180 / pi:.1f} degrees {since(self._calibration, self._today)}",
            )
        return MarkerVerdict(
            True, f"upright to {angle * 180 / pi:.1f} degrees; carry and turn it for 15 s to check its place"
        )


def compared(
    calibration: MarkerCalibration, shift_m: Array, shift_std_m: Array, turn_rad: Array, today: date
) -> MarkerVerdict:
    """What a new measurement left of corrected poses: by how much the marker body is elsewhere than it was."""
    moved = float(np.linalg.norm(shift_m))
    doubt = float(np.linalg.norm(np.hypot(shift_std_m, np.asarray(calibration.position_std_m))))
    turned = float(np.linalg.norm(turn_rad))
    when = since(calibration, today)
    if moved > max(MOVED_M, SURE * doubt):
        return MarkerVerdict(False, f"the marker body moved by {1e3 * moved:.0f} mm (+- {2e3 * doubt:.0f}) {when}")
    if turned > TURNED_RAD:
        return MarkerVerdict(False, f"the marker body turned by {turned * 180 / pi:.1f} degrees {when}")
    return MarkerVerdict(
        True, f"within {1e3 * moved:.1f} mm and {turned * 180 / pi:.1f} degrees of where it was {when}"
    )


def since(calibration: MarkerCalibration, today: date) -> str:
    """As "since Tuesday", or the day itself where that was more than six days ago."""
    try:
        measured = date.fromisoformat(calibration.measured)
    except ValueError:
        return f"since {calibration.measured}"
    days = (today - measured).days
    return (
        "since today's calibration"
        if days == 0
        else f"since {measured:%A}"
        if 0 < days < 7
        else f"since {calibration.measured}"
    )
