"""One road from streams to motion: rates, specific force and the smoothed path of the declared origin, on one clock.

The IMU's clock is the reference. Where there is no IMU, rates and accelerations are differenced from poses or from the
vehicle's own state, and the noise model learns what that costs. Nothing is extrapolated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import Refused
from groundstation.flightdata import FlightData, Stream
from groundstation.frames import (
    lever_arm,
    quat_conjugate,
    quat_exp,
    quat_log,
    quat_multiply,
    quat_rotate_inverse,
)
from groundstation.identification.alignment import arrival_difference, with_one_stamp
from groundstation.identification.attitude_fit import Recording
from groundstation.identification.clock import coarse_offset, rates_from_attitude
from groundstation.identification.instruments import FlownMotion
from groundstation.identification.reconstruction import Compatibility, body_motion, reconstruct
from groundstation.identification.results import Clock
from groundstation.identification.streams import clean, origin_poses, stretches_in_the_air
from groundstation.identification.stretches import within
from groundstation.linear_filters import both_ways, low_pass

Array = NDArray[np.float64]
Path = tuple[Array, Array, Array]

LEAST = 50
"""Samples that a stream needs to tell of a motion."""
WORST_ACCEL_BIAS_M_S2 = 1.5
"""Bias of an accelerometer that flies, at the very most (0.15 g): three of the deviations that a reconstruction begins
with. A larger one is an error of the reconstruction.
"""
UNKNOWN_ACCEL_BIAS_M_S2 = 0.1
"""Standard deviation of an accelerometer bias nobody measured: 10 mg, a consumer MEMS sensor's turn-on bias."""


@dataclass(frozen=True, slots=True)
class Motion(FlownMotion):
    """A flight's motion with what is known beside it.

    Attributes:
        causal: as ``smooth``, from the past alone.
        force_bias_std: what is left unknown of the specific force's bias, (3,).
        compatibility: kinematic findings, where poses and IMU both exist.
        clock: of motion capture against the IMU, where both exist.
        notes: a sentence each.
    """

    causal: Path
    force_bias_std: Array
    compatibility: Compatibility | None
    clock: Clock | None
    notes: tuple[str, ...]


def motion_of(flight: FlightData) -> Motion:
    """What a flight's streams say of its motion.

    Raises:
        Refused: no stream tells of it.
    """
    pose = None if flight.mocap is None else clean(flight.mocap)
    state = None if flight.state is None else clean(flight.state)
    if flight.imu is not None and len(flight.imu) > LEAST:
        return _from_imu(flight, clean(flight.imu), pose, state)
    if pose is not None and len(pose) > LEAST:
        return _from_poses(flight, pose)
    if state is not None and len(state) > LEAST:
        return _from_state(flight, state)
    raise Refused(
        f"the flight has no motion data: neither imu, mocap nor state holds {LEAST} samples.", "Record one of them."
    )


@dataclass(frozen=True, slots=True)
class _Tracked:
    """Poses beside an IMU, their stamps' coarse difference, and whether they have a clock of their own."""

    pose: Stream
    offset_s: float
    own_clock: bool


def _tracked(
    flight: FlightData, imu: Stream, pose: Stream | None, state: Stream | None
) -> tuple[_Tracked | None, list[str]]:
    """Poses of motion capture, or the vehicle's own state in their place; none where nothing aligns them with the
    IMU.
    """
    notes: list[str] = []
    own_clock = True
    if (pose is None or len(pose) < LEAST) and state is not None and len(state) >= LEAST:
        pose = Stream(state.t_s, state.values[:, [0, 1, 2, 6, 7, 8, 9]], (), state.received_s)
        notes.append("There is no motion capture: the vehicle's own state stands in for it.")
        own_clock = False
    if pose is None or len(pose) < LEAST:
        return None, notes
    expected = arrival_difference(pose, imu)
    t, gyro, accel = imu.t_s, imu.values[:, :3], imu.values[:, 3:6]
    try:
        source = "motion capture" if flight.mocap is not None else "the vehicle's own attitude"
        offset, _ = coarse_offset(t, gyro, pose.t_s, pose.values[:, 3:7], expected_s=expected or 0.0, source=source)
    except Refused as refusal:
        return None, [*notes, f"The poses are left out: {refusal}"]
    pose, said = with_one_stamp(pose, offset, t, accel, flight.vehicle.gravity_m_s2)
    notes += said
    return (None if len(pose) < LEAST else _Tracked(pose, offset, own_clock)), notes


def _from_imu(flight: FlightData, imu: Stream, pose: Stream | None, state: Stream | None) -> Motion:
    """Rates and specific force of the IMU, less the biases that poses show."""
    tracked, notes = _tracked(flight, imu, pose, state)
    found = _unaided(imu, notes) if tracked is None else _aided(flight, imu, tracked, notes)
    lever = np.asarray(flight.vehicle.imu.position_m)
    if np.any(lever != 0.0):
        found = replace(found, force=found.force - _felt_beside(found.t_s, found.rate, lever))
    return found


def _unaided(imu: Stream, notes: Sequence[str]) -> Motion:
    """The IMU alone."""
    count = len(imu.t_s)
    unknown = (np.full((count, 4), np.nan), np.full((count, 3), np.nan), np.full((count, 3), np.nan))
    note = (
        "There are no poses: attitude, velocity and the accelerometer's bias are unknown, so the mass is only as sure "
        f"as a bias of {UNKNOWN_ACCEL_BIAS_M_S2:.1f} m/s^2 leaves it, and drag, wind and ground effect cannot be told."
    )
    return Motion(
        t_s=imu.t_s,
        rate=imu.values[:, :3],
        force=imu.values[:, 3:6],
        smooth=unknown,
        source="imu",
        rate_hz=imu.rate_hz(),
        causal=unknown,
        force_bias_std=np.full(3, UNKNOWN_ACCEL_BIAS_M_S2),
        compatibility=None,
        clock=None,
        notes=(*notes, note),
    )


def _aided(flight: FlightData, imu: Stream, tracked: _Tracked, notes: Sequence[str]) -> Motion:
    """IMU and poses reconstructed into one motion.

    On the ground a knock turns the vehicle faster than a gyro follows, and a hand or a stop moves it: poses from there
    would be made up for by clocks, biases and tilt.
    """
    t, gyro, accel, vehicle = imu.t_s, imu.values[:, :3], imu.values[:, 3:6], flight.vehicle
    pose = _in_the_air(flight, tracked)
    rotation = np.asarray(vehicle.mocap.rotation_rad)
    found = reconstruct(
        Recording(t, gyro, accel, pose.t_s, pose.values[:, :3], pose.values[:, 3:7], rotation),
        offset_s=tracked.offset_s,
        gravity_m_s2=vehicle.gravity_m_s2,
    )
    value, std, lever = found.values, found.std, np.asarray(vehicle.imu.position_m)
    clock = _clock(flight, found, 0.5 * float(t[0] + t[-1])) if tracked.own_clock else None
    rate = gyro - np.array([value[f"gyro_bias_{axis}_rad_s"] for axis in "xyz"])
    dropped = int((~found.kept).sum())
    left_out = f"{dropped} of {len(found.kept)} poses lay outside the IMU's record or did not fit it and were left out."
    bias, bias_std = (np.array([each[f"accel_bias_{axis}_m_s2"] for axis in "xyz"]) for each in (value, std))
    # What walks from none for a time T has a mean that is off by a variance of T / 3.
    bias_std = np.hypot(bias_std, found.accel_walk * np.sqrt(float(pose.t_s[-1] - pose.t_s[0]) / 3.0))
    untold = (bias_std > UNKNOWN_ACCEL_BIAS_M_S2) | np.any(np.abs(bias) > WORST_ACCEL_BIAS_M_S2)
    if untold.any():
        axes = [axis for axis, left in zip("xyz", untold, strict=True) if left]
        left_open = [f"accel_bias_{axis}_m_s2" for axis in axes]
        found = replace(found, revealed=tuple(name for name in found.revealed if name not in left_open))
        notes = [
            *notes,
            f"By the poses the accelerometer would be off by {np.linalg.norm(bias[untold]):.2f} m/s^2 along "
            f"{', '.join(axes)}, which they tell no better than what a sensor may be off by anyway "
            f"({UNKNOWN_ACCEL_BIAS_M_S2:.1f} m/s^2), or which none is off by. It is left open.",
        ]
        bias, bias_std = np.where(untold, 0.0, bias), np.where(untold, UNKNOWN_ACCEL_BIAS_M_S2, bias_std)
    return Motion(
        t_s=t,
        rate=rate,
        force=accel - bias,
        smooth=body_motion(found, rate, lever),
        source="imu",
        rate_hz=imu.rate_hz(),
        causal=body_motion(found, rate, lever, causal=True),
        force_bias_std=bias_std,
        compatibility=found.without_path(),
        clock=clock,
        notes=(*notes, *([] if clock is None else _disagreement(clock)), *([left_out] if dropped else [])),
    )


def _in_the_air(flight: FlightData, tracked: _Tracked) -> Stream:
    """Poses in the air; all where too few are."""
    flown = within(tracked.pose.t_s - tracked.offset_s, stretches_in_the_air(flight))
    return tracked.pose if flown.all() or flown.sum() < LEAST else tracked.pose.select(flown)


def _clock(flight: FlightData, found: Compatibility, at_s: float) -> Clock:
    """Motion capture against the IMU, by the motion and as the link knew it at a time."""
    value, std = found.values, found.std
    online = (None, None) if flight.online is None else flight.online.at(at_s)
    return Clock(
        value["mocap_minus_imu_s"], std["mocap_minus_imu_s"], value["clock_drift"], std["clock_drift"], *online
    )


def _disagreement(clock: Clock) -> list[str]:
    """What to say where the clocks of the link and of the motion differ by more than both allow."""
    if clock.agrees is not False or clock.online_s is None or clock.online_error_s is None:
        return []
    return [
        f"The link had motion capture {1e3 * clock.online_s:+.2f} +- {1e3 * clock.online_error_s:.2f} ms from the IMU, "
        f"the motion says {1e3 * clock.mocap_minus_imu_s:+.2f} +- {1.96e3 * clock.std_s:.2f} ms: the stamps have a "
        "delay that the link does not know (`groundstation calibrate` measures it). The motion's was used."
    ]


def _felt_beside(t: Array, rate: Array, lever: Array) -> Array:
    """What an accelerometer beside the origin feels, rates low-passed at 20 Hz before they are differenced, shape (k,
    3).
    """
    sample_hz = 1.0 / float(np.median(np.diff(t)))
    smooth = both_ways(low_pass(2, min(20.0, 0.4 * sample_hz), sample_hz), rate)
    return lever_arm(smooth, np.gradient(smooth, t, axis=0), lever)


def _from_poses(flight: FlightData, pose: Stream) -> Motion:
    """Rates and specific force differenced from poses, between their stamps."""
    t = pose.t_s
    p, q = origin_poses(flight.vehicle.mocap, pose.values[:, :3], pose.values[:, 3:7])
    rate, middle = rates_from_attitude(t, q)
    velocity = np.diff(p, axis=0) / np.diff(t)[:, None]
    half = quat_multiply(q[:-1], quat_exp(0.5 * quat_log(quat_multiply(quat_conjugate(q[:-1]), q[1:]))))
    acceleration = np.gradient(velocity, middle, axis=0)
    force = quat_rotate_inverse(half, acceleration + np.array([0.0, 0.0, flight.vehicle.gravity_m_s2]))
    path = (half, 0.5 * (p[1:] + p[:-1]), velocity)
    note = "There is no IMU: rates and accelerations are differences of motion-capture poses, which is noisier."
    rate_hz = 1.0 / float(np.median(np.diff(t)))
    return Motion(middle, rate, force, path, "poses", rate_hz, path, np.full(3, 1e-4), None, None, (note,))


def _from_state(flight: FlightData, state: Stream) -> Motion:
    """Rates and specific force of the vehicle's own estimate."""
    t, x = state.t_s, state.values
    q, velocity, rate = x[:, 6:10], x[:, 3:6], x[:, 10:13]
    force = quat_rotate_inverse(q, np.gradient(velocity, t, axis=0) + np.array([0.0, 0.0, flight.vehicle.gravity_m_s2]))
    path = (q, x[:, :3], velocity)
    note = "There is no IMU: rates and accelerations come from the vehicle's own state estimate."
    return Motion(t, rate, force, path, "state", state.rate_hz(), path, np.full(3, 1e-3), None, None, (note,))
