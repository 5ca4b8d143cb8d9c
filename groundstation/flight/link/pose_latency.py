r"""How late the poses are stamped, measured in flight from the attitude: poses against the vehicle's estimate. Pure.

A pose stamped ``t`` that shows the vehicle at ``t - L`` has the attitude :math:`q(t)\exp(-L\omega(t))`. The small
rotation from the estimate to the pose, in the body, is therefore :math:`e_k = c - L\,\omega_k` with a constant c (how
the rigid body lies in the vehicle), and L is the slope of a line, least squares over all poses and axes (textbook
linear regression; first order in :math:`L\omega`, so that 30 ms at 0.5 Hz are off by 0.3 %). The estimate follows the
gyros over the plan's periods, whatever delay the estimator was told; its stamps are mapped to the host's clock by
TIMESYNC.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import sqrt

from drivers.mavlink.geometry import turned
from drivers.samples import Quaternion, State, Vector3
from groundstation.flight.station import MocapSource

LEAST_POSES = 200
"""Some seconds of them."""
_LEAST_RAD_S = 0.05
"""Root mean square of the body rate vector about its mean; a hover has less, and tells nothing."""
_REACH_S = 0.05
"""A state is turned by its rate to the pose's stamp over so long at most."""
_KEPT_S = 0.5


@dataclass(frozen=True, slots=True)
class Latency:
    """What was found.

    Attributes:
        seconds: from exposure to stamp.
        std_s: its standard error, without what TIMESYNC does not know.
    """

    seconds: float
    std_s: float


class PoseLatency:
    """Of one flight; sums alone are kept."""

    def __init__(self) -> None:
        self._states: deque[tuple[float, State]] = deque()
        self._poses: deque[tuple[float, Quaternion]] = deque()
        self._count = 0
        self._e, self._w = [0.0] * 3, [0.0] * 3
        self._ew, self._ww, self._ee = [0.0] * 3, [0.0] * 3, [0.0] * 3

    def state(self, host_s: float, state: State) -> None:
        """The vehicle's estimate, with its stamp on the host's clock."""
        self._states.append((host_s, state))
        while host_s - self._states[0][0] > _KEPT_S:
            self._states.popleft()
        while self._poses and self._poses[0][0] <= host_s:
            self._compare(*self._poses.popleft())

    def pose(self, stamp_s: float, quaternion: Quaternion) -> None:
        """A pose, with its stamp on the host's clock; it waits for the estimate of its instant."""
        self._poses.append((stamp_s, quaternion))
        while stamp_s - self._poses[0][0] > _KEPT_S:
            self._poses.popleft()

    def result(self) -> Latency | None:
        """None before there was motion enough."""
        n = self._count
        if n < LEAST_POSES:
            return None
        spread = sum(ww - w * w / n for ww, w in zip(self._ww, self._w, strict=True))
        if spread < n * _LEAST_RAD_S**2:
            return None
        both = sum(ew - e * w / n for ew, e, w in zip(self._ew, self._e, self._w, strict=True))
        total = sum(ee - e * e / n for ee, e in zip(self._ee, self._e, strict=True))
        slope = both / spread
        residual = max(0.0, total - slope * both)
        return Latency(-slope, sqrt(residual / (3 * n - 4) / spread))

    def _compare(self, stamp_s: float, quaternion: Quaternion) -> None:
        near = min(self._states, key=lambda item: abs(item[0] - stamp_s), default=None)
        if near is None or abs(near[0] - stamp_s) > _REACH_S:
            return
        host_s, state = near
        there = turned(state.quaternion, state.rate_rad_s, stamp_s - host_s)
        self._count += 1
        for i, (e, w) in enumerate(zip(_rotation(there, quaternion), state.rate_rad_s, strict=True)):
            self._e[i] += e
            self._w[i] += w
            self._ew[i] += e * w
            self._ww[i] += w * w
            self._ee[i] += e * e


def _rotation(a: Quaternion, b: Quaternion) -> Vector3:
    """The small rotation from a to b in a's body frame: twice the vector part of conj(a) b, of the nearer sign."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    w = aw * bw + ax * bx + ay * by + az * bz
    sign = 2.0 if w >= 0.0 else -2.0
    return (
        sign * (aw * bx - ax * bw - ay * bz + az * by),
        sign * (aw * by - ay * bw - az * bx + ax * bz),
        sign * (aw * bz - az * bw - ax * by + ay * bx),
    )


def latency_sentence(found: Latency, clock_error_s: float, mocap: MocapSource) -> str:
    """What the recording shall say of it: as declared, or what to write; of a calibrated system, that it is to be
    calibrated again.
    """
    declared_s = mocap.latency_s
    error_s = sqrt((2.0 * found.std_s) ** 2 + clock_error_s**2)
    measured = f"poses are stamped {1e3 * found.seconds:.1f} ms (+- {1e3 * error_s:.1f} ms) after their exposure"
    if abs(found.seconds - declared_s) <= max(error_s, 1e-3) or (found.seconds < 0.0 and mocap.calibration is None):
        return f"{measured}; {1e3 * declared_s:.1f} ms are declared"
    if mocap.calibration is not None:
        taken_ms = 1e3 * mocap.calibration.delay_s
        return f"{measured}, though the calibration takes {taken_ms:.1f} ms off; run `groundstation calibrate` again"
    return (
        f"{measured}, and {1e3 * declared_s:.1f} ms are declared; write into [mocap] of the station file: "
        f"latency_s = {round(found.seconds, 3):g}"
    )
