"""From the streams of a flight to the signals of the regression model (seed II-C).

Every stream is brought onto one uniform grid on the IMU's clock, low-passed forward and backward with one cut-off,
differentiated by central differences (33) and expressed in the body. How streams are brought together:

- positions linearly, attitudes by slerp, gyro and accelerometer linearly;
- rotor speeds that were measured linearly; what was commanded (speeds asked for, normalised commands, wrenches) as held
  until the next value, averaged over each grid cell so that nothing aliases and nothing leads;
- nothing is extrapolated: the grid ends where the shortest needed stream ends, and samples inside a gap are not used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.errors import NotIdentifiable
from groundstation.flightdata import FlightData, Stream
from groundstation.frames import (
    lever_arm,
    quat_conjugate,
    quat_continuous,
    quat_multiply,
    quat_normalise,
    quat_rotate_inverse,
    slerp,
)
from groundstation.identification.filters import central_difference, zero_phase_low_pass
from groundstation.identification.streams import Segments, clean, flown_stretches, origin_poses
from groundstation.identification.stretches import SHORTEST_S, gaps, within
from groundstation.identification.wrench import declared_wrench
from groundstation.linear_filters import power_spectrum
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

MARGIN_S = 2.0
"""Processed beyond the window where there are data, so that filters have settled inside it."""


@dataclass(frozen=True, slots=True)
class SeedSignals:
    """What the regressors need, on a uniform grid of k samples on the IMU's clock. Absent quantities are None.

    Attributes:
        t_s: grid, seconds.
        used: inside the window, outside gaps and excluded segments.
        period_s: grid spacing.
        cutoff_hz: of the zero-phase low-pass that every signal went through.
        wrench: [F_z, tau_x, tau_y, tau_z] by the declared constants, N and N m, shape (k, 4).
        rate: body rates, rad/s, shape (k, 3).
        rate_derivative: their derivatives, rad/s^2, shape (k, 3).
        specific_force: dv/dt + omega x v + g R^T e_z at the origin, m/s^2, shape (k, 3).
        velocity_body: m/s, shape (k, 3).
        gravity_body: g R^T e_z, m/s^2, shape (k, 3).
        rate_derivative_noise: standard deviation that sensor noise leaves in ``rate_derivative``, rad/s^2, shape (3,).
        specific_force_source: "accelerometer", "positions", "state", or "" when there is none.
        window_s: first and last used time.
        notes: choices and what missing streams leave out, one sentence each.
    """

    t_s: Annotated[Array, "k"]
    used: Annotated[NDArray[np.bool_], "k"]
    period_s: float
    cutoff_hz: float
    wrench: Annotated[Array, "k 4"]
    rate: Annotated[Array, "k 3"]
    rate_derivative: Annotated[Array, "k 3"]
    specific_force: Annotated[Array, "k 3"] | None
    velocity_body: Annotated[Array, "k 3"] | None
    gravity_body: Annotated[Array, "k 3"] | None
    rate_derivative_noise: Annotated[Array, "3"]
    specific_force_source: str
    window_s: tuple[float, float]
    notes: tuple[str, ...]

    def without_series(self) -> SeedSignals:
        """The numbers alone, where the regressions hold what is as long as the flight."""
        none = self.rate[:0]
        return replace(
            self,
            t_s=self.t_s[:0],
            used=self.used[:0],
            wrench=self.wrench[:0],
            rate=none,
            rate_derivative=none,
            specific_force=None,
            velocity_body=None,
            gravity_body=None,
        )


@dataclass(frozen=True, slots=True)
class _Pose:
    """Pose samples on the IMU's clock, of the vehicle's origin."""

    t_s: Array
    position_m: Array
    quaternion: Array
    velocity_world_m_s: Array | None
    source: str

    def rate_hz(self) -> float:
        return float(1.0 / np.median(np.diff(self.t_s)))


@dataclass(frozen=True, slots=True)
class _Grid:
    """A uniform grid and the filter that every signal on it goes through."""

    t_s: Array
    period_s: float
    cutoff_hz: float

    def smooth(self, x: Array) -> Array:
        return zero_phase_low_pass(x, self.cutoff_hz, self.period_s)

    def resample(self, stamps_s: Array, values: Array) -> Array:
        return self.smooth(interpolate(self.t_s, stamps_s, values))

    def derivative(self, x: Array) -> Array:
        return central_difference(x, self.period_s)


@dataclass(frozen=True, slots=True)
class _Rates:
    rate: Array
    derivative: Array
    derivative_noise: Array


@dataclass(frozen=True, slots=True)
class _Translation:
    """What poses tell of the translation, in the body."""

    velocity: Array
    gravity: Array
    specific_force: Array


@dataclass(frozen=True, slots=True)
class _Motion:
    """Rates, the translation where poses show it, and what to say of both."""

    rates: _Rates
    translation: _Translation | None
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _SpecificForce:
    """At the origin, (k, 3), where it comes from, and what to say of it."""

    value: Array | None
    source: str
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Processing:
    """How a flight's streams are brought together.

    Attributes:
        mocap_minus_imu_s: motion-capture stamp minus IMU stamp of one and the same instant.
        exclude: segments [start, end] on the IMU's clock that are not used.
        cutoff_hz: of the low-pass; None: see :func:`default_cutoff_hz`.
        period_s: grid spacing; None: the IMU's (or the state's, or 2 ms), between 1 and 20 ms.
        transient_s: left out at the start of a known excitation; None: 10 s, at most a fifth of it.
        accelerometer: may be used where poses are there too; the paper has none.
    """

    mocap_minus_imu_s: float = 0.0
    exclude: Segments = ()
    cutoff_hz: float | None = None
    period_s: float | None = None
    transient_s: float | None = None
    accelerometer: bool = True


@dataclass(frozen=True, slots=True)
class _Streams:
    """A flight's good samples on the IMU's clock."""

    motors: Stream
    imu: Stream | None
    state: Stream | None
    pose: _Pose | None

    @classmethod
    def of(cls, flight: FlightData, processing: Processing) -> _Streams:
        exclude = processing.exclude
        return cls(
            motors=clean(flight.motors, exclude),
            imu=None if flight.imu is None else clean(flight.imu, exclude),
            state=None if flight.state is None else clean(flight.state, exclude),
            pose=_pose(flight, processing.mocap_minus_imu_s, exclude),
        )

    @property
    def inertial(self) -> Stream | None:
        """Where rates come from, if not from poses."""
        return self.imu or self.state

    def stamps(self) -> list[Array]:
        """Of every stream that is used."""
        return [stream.t_s for stream in (self.motors, self.inertial, self.pose) if stream is not None]


def process_flight(flight: FlightData, processing: Processing | None = None) -> SeedSignals:
    """Bring a flight's streams together and differentiate them.

    Args:
        flight: the recorded streams; motors, IMU and state are taken to share a clock.
        processing: how; None: as :class:`Processing` has it.

    Raises:
        NotIdentifiable: the streams overlap for less than 2 s, or hold no motion at all.
    """
    processing = processing or Processing()
    streams = _Streams.of(flight, processing)
    stretches = flown_stretches(flight, processing.transient_s)
    grid = _grid(flight, streams, (stretches[0][0], stretches[-1][1]), processing)
    wrench = grid.smooth(declared_wrench(flight.vehicle, streams.motors, flight.battery, grid.t_s))
    motion = _motion(grid, streams, flight.vehicle)
    used = _used(grid, stretches, streams.stamps(), processing.exclude)
    accelerometer = processing.accelerometer or streams.pose is None
    specific = _specific_force(grid, flight.vehicle, streams, motion, used, accelerometer=accelerometer)
    low_pass = f"Zero-phase Butterworth low-pass at {grid.cutoff_hz:.2f} Hz on a {1e3 * grid.period_s:.2f} ms grid."
    seen, t = motion.translation, grid.t_s
    return SeedSignals(
        t_s=t,
        used=used,
        period_s=grid.period_s,
        cutoff_hz=grid.cutoff_hz,
        wrench=wrench,
        rate=motion.rates.rate,
        rate_derivative=motion.rates.derivative,
        specific_force=specific.value,
        velocity_body=None if seen is None else seen.velocity,
        gravity_body=None if seen is None else seen.gravity,
        rate_derivative_noise=motion.rates.derivative_noise,
        specific_force_source=specific.source,
        window_s=(float(t[used][0]), float(t[used][-1])),
        notes=(low_pass, *motion.notes, *specific.notes),
    )


def _motion(grid: _Grid, streams: _Streams, vehicle: Vehicle) -> _Motion:
    """Rates, and the translation where there are poses."""
    pose = streams.pose
    if pose is None:
        rates, notes = _body_rates(grid, streams, None)
        unknown = "No poses: velocity and attitude are unknown; drag, wind and position effects cannot be seen."
        return _Motion(rates, None, (*notes, unknown))
    # Poses hold nothing above half their rate but the images that interpolation makes.
    slow = replace(grid, cutoff_hz=min(grid.cutoff_hz, 0.4 * pose.rate_hz()))
    rotation = quat_normalise(slow.smooth(slerp(grid.t_s, pose.t_s, pose.quaternion)))
    rates, notes = _body_rates(slow if streams.inertial is None else grid, streams, rotation)
    return _Motion(rates, _translation(slow, pose, rotation, rates, vehicle), tuple(notes))


def _used(grid: _Grid, stretches: Segments, stamps: Sequence[Array], exclude: Segments) -> NDArray[np.bool_]:
    """Which instants count: in the air, outside gaps and exclusions, and clear of the filter's ends."""
    t = grid.t_s
    guard = 0.5 / grid.cutoff_hz  # how far the low-pass carries what lies beyond an end
    used = within(t, stretches) & (t >= t[0] + guard) & (t <= t[-1] - guard)
    for series in stamps:
        used &= ~within(t, gaps(series))
    for first, last in exclude:
        used &= (t < first - guard) | (t > last + guard)
    left = np.count_nonzero(used) * grid.period_s
    if left < SHORTEST_S:
        raise NotIdentifiable(
            f"Only {left:.1f} s are left outside gaps and excluded segments.",
            f"Exclude less, or record at least {SHORTEST_S:.0f} s of motion.",
        )
    return used


def _grid(flight: FlightData, streams: _Streams, window: tuple[float, float], processing: Processing) -> _Grid:
    """The grid that all streams cover, around the window, and the low-pass."""
    inertial, stamps = streams.inertial, streams.stamps()
    period_s, cutoff_hz = processing.period_s, processing.cutoff_hz
    if period_s is None:
        period_s = 1.0 / float(np.clip(inertial.rate_hz() if inertial is not None else 500.0, 50.0, 1000.0))
    if any(len(series) == 0 for series in stamps):
        raise NotIdentifiable("A stream is empty on the clock of the others.", "Check the streams' stamps.")
    start = max([window[0] - MARGIN_S, *(series[0] for series in stamps)])
    end = min([window[1] + MARGIN_S, *(series[-1] for series in stamps)])
    if end - start < SHORTEST_S:
        raise NotIdentifiable(
            f"The streams overlap for {max(end - start, 0.0):.1f} s only.",
            f"Record at least {SHORTEST_S:.0f} s of motion.",
        )
    t = np.asarray(start + period_s * np.arange(int((end - start) / period_s + 1e-9) + 1), dtype=float)
    if cutoff_hz is None:
        cutoff_hz = default_cutoff_hz(flight, inertial if flight.imu is not None else None, t)
    slowest = [] if inertial is None else [0.4 * inertial.rate_hz()]
    return _Grid(t, period_s, min([cutoff_hz, 0.4 / period_s, *slowest]))


def _body_rates(grid: _Grid, streams: _Streams, rotation: Array | None) -> tuple[_Rates, list[str]]:
    """Rates from the gyro, else from the vehicle's own state, else from differentiated attitudes."""
    imu, state, pose = streams.imu, streams.state, streams.pose
    if imu is not None:
        rate = grid.resample(imu.t_s, imu.values[:, :3])
        noise = white_noise_std(imu.values[:, :3]) * differentiated_noise_gain(1, grid.cutoff_hz, imu.rate_hz())
        return _Rates(rate, grid.derivative(rate), noise), []
    if state is not None:
        rate = grid.resample(state.t_s, state.values[:, 10:13])
        noise = white_noise_std(state.values[:, 10:13]) * differentiated_noise_gain(1, grid.cutoff_hz, state.rate_hz())
        note = "No IMU: body rates are the vehicle's own estimate."
        return _Rates(rate, grid.derivative(rate), noise), [note]
    if pose is None or rotation is None:
        raise NotIdentifiable("The flight has neither IMU, motion capture nor state.", "Record at least one of them.")
    rate = 2.0 * quat_multiply(quat_conjugate(rotation), grid.derivative(rotation))[:, 1:]
    # A small rotation is twice the vector part of its quaternion.
    noise = 2.0 * white_noise_std(pose.quaternion[:, 1:]) * differentiated_noise_gain(2, grid.cutoff_hz, pose.rate_hz())
    return _Rates(rate, grid.derivative(rate), noise), ["No IMU: body rates are differentiated attitudes."]


def _translation(grid: _Grid, pose: _Pose, rotation: Array, rates: _Rates, vehicle: Vehicle) -> _Translation:
    """Velocity (3), gravity and dv/dt + omega x v + g R^T e_z in the body, from poses (seed II-C.3)."""
    if pose.velocity_world_m_s is None:
        velocity_world = grid.derivative(grid.resample(pose.t_s, pose.position_m))
    else:
        velocity_world = grid.resample(pose.t_s, pose.velocity_world_m_s)
    velocity = quat_rotate_inverse(rotation, velocity_world)
    gravity = quat_rotate_inverse(rotation, np.array([0.0, 0.0, vehicle.gravity_m_s2]))
    return _Translation(velocity, gravity, grid.derivative(velocity) + np.cross(rates.rate, velocity) + gravity)


def _specific_force(
    grid: _Grid, vehicle: Vehicle, streams: _Streams, motion: _Motion, used: NDArray[np.bool_], *, accelerometer: bool
) -> _SpecificForce:
    """From the accelerometer where it is quieter than differentiated poses, which then give it its mean."""
    imu, pose, seen = streams.imu, streams.pose, motion.translation
    if accelerometer and imu is not None and (pose is None or _accelerometer_is_better(imu, pose, grid.cutoff_hz)):
        felt = grid.resample(imu.t_s, imu.values[:, 3:6])
        felt -= lever_arm(motion.rates.rate, motion.rates.derivative, vehicle.imu.position_m)
        if seen is None:
            note = "The accelerometer's bias is unknown without poses and goes into mass."
            return _SpecificForce(felt, "accelerometer", (note,))
        bias = np.mean((felt - seen.specific_force)[used], axis=0)
        note = (
            "Specific force from the accelerometer, which is quieter here than differentiated poses; "
            f"its mean is held to theirs (bias {bias[0]:.3f}, {bias[1]:.3f}, {bias[2]:.3f} m/s^2)."
        )
        return _SpecificForce(felt - bias, "accelerometer", (note,))
    if seen is None or pose is None:
        return _SpecificForce(None, "", ("Nothing tells the specific force, so mass gets no number.",))
    what = "velocities" if pose.source == "state" else "positions"
    return _SpecificForce(seen.specific_force, pose.source, (f"Specific force from differentiated {what}.",))


def default_cutoff_hz(flight: FlightData, imu: Stream | None, t_s: Array) -> float:
    """Ten times the plan's top harmonic, or ten times the frequency below which half of the gyro's power lies.

    Both sides of the regression pass the same filter, so the cut-off costs no bias; it trades the noise of
    differentiated rates against motion above the top harmonic. At least 2 Hz.
    """
    if flight.plan is not None:
        top = len(flight.plan.coefficients.x.a) * flight.plan.base_frequency_rad_s / (2.0 * np.pi)
    elif imu is not None:
        gyro = interpolate(t_s, imu.t_s, imu.values[:, :3])
        step = float(t_s[1] - t_s[0])
        frequency, power = power_spectrum(gyro, 1.0 / step, min(len(t_s), int(8.0 / step)))
        below = np.cumsum(power.sum(axis=1))
        top = float(frequency[np.searchsorted(below, 0.5 * below[-1])])
    else:
        top = 0.5
    return max(2.0, 10.0 * top)


def interpolate(t_s: ArrayLike, stamps_s: Array, values: Array) -> Array:
    """Linear interpolation of the columns of ``values`` (n, d) at ``t_s``; shape (k, d).

    It rounds otherwise than :func:`groundstation.flightdata.resampled`, and the tables of the paper are held to the
    last bit.
    """
    t = np.asarray(t_s, dtype=float)
    right = np.clip(np.searchsorted(stamps_s, t, side="right"), 1, len(stamps_s) - 1)
    left = right - 1
    share = ((t - stamps_s[left]) / (stamps_s[right] - stamps_s[left]))[:, None]
    return values[left] + share * (values[right] - values[left])


def white_noise_std(values: Array) -> Array:
    """Standard deviation of white noise per column, from fourth differences (which motion hardly reaches), robustly.

    The fourth difference of white noise has the variance 1 + 16 + 36 + 16 + 1 = 70 sigma^2; 1.4826 makes a median
    absolute deviation a standard deviation.
    """
    if len(values) < 16:
        return np.zeros((values.shape[1],))
    fourth = np.diff(values, 4, axis=0)
    return 1.4826 * np.median(np.abs(fourth - np.median(fourth, axis=0)), axis=0) / np.sqrt(70.0)


def differentiated_noise_gain(order: int, cutoff_hz: float, rate_hz: float) -> float:
    """What differentiating ``order`` times below the cut-off makes of white noise of unit standard deviation.

    White noise at rate f_s has the density 2/f_s, so the variance is the integral of (2 pi f)^(2n) 2/f_s up to f_c.
    """
    cutoff = min(cutoff_hz, 0.5 * rate_hz)
    power = 2 * order + 1
    return float(np.sqrt(2.0 * (2.0 * np.pi) ** (2 * order) * cutoff**power / (power * rate_hz)))


def _accelerometer_is_better(imu: Stream, pose: _Pose, cutoff_hz: float) -> bool:
    """Compare what noise leaves on z: accelerometer as it is, against poses differentiated once or twice."""
    felt = white_noise_std(imu.values[:, 5:6])[0] * differentiated_noise_gain(0, cutoff_hz, imu.rate_hz())
    order, source = (2, pose.position_m) if pose.velocity_world_m_s is None else (1, pose.velocity_world_m_s)
    seen = white_noise_std(source[:, 2:3])[0] * differentiated_noise_gain(order, cutoff_hz, pose.rate_hz())
    return bool(felt <= seen)


def _pose(flight: FlightData, mocap_minus_imu_s: float, exclude: Segments) -> _Pose | None:
    """Poses of the vehicle's origin on the IMU's clock: motion capture, or the vehicle's own state."""
    if flight.mocap is not None and len(flight.mocap) > 3:
        mounting = flight.vehicle.mocap
        moved = Stream(flight.mocap.t_s - mocap_minus_imu_s, flight.mocap.values, flight.mocap.columns)
        stream = clean(moved, exclude)
        p, q = origin_poses(mounting, stream.values[:, :3], quat_normalise(stream.values[:, 3:7]))
        return _Pose(stream.t_s, p, quat_continuous(q), None, "positions")
    if flight.state is not None and len(flight.state) > 3:
        stream = clean(flight.state, exclude)
        q = quat_continuous(quat_normalise(stream.values[:, 6:10]))
        return _Pose(stream.t_s, stream.values[:, :3], q, stream.values[:, 3:6], "state")
    return None
