"""From the streams of a flight to what the dynamic fit needs: one clock, biases out, motion and plan at the IMU's stamps.

The IMU's clock is the reference. Where there is no IMU, rates and accelerations are differenced from poses or from the
vehicle's own state, and the noise model learns what that costs. Nothing is extrapolated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput, NotIdentifiable, Refused
from groundstation.flightdata import FlightData, Stream
from groundstation.frames import (
    quat_conjugate,
    quat_continuous,
    quat_exp,
    quat_log,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
)
from groundstation.identification.alignment import arrival_difference, motor_offset, with_one_stamp
from groundstation.identification.clock import coarse_offset, rates_from_attitude
from groundstation.identification.instruments import FlownMotion, planned_motion
from groundstation.identification.processing import clean, flown_stretches
from groundstation.identification.reconstruction import Compatibility, body_motion, reconstruct
from groundstation.identification.record_model import BodyWrench, DynamicRecord, PlannedMotion
from groundstation.identification.results import Clock
from groundstation.identification.stretches import GAP_S, Stretch, gaps, runs_of, told, within
from groundstation.model.prediction import FlightStates
from groundstation.model.rotors import (
    cumulative,
    declared_thrust,
    hover_value,
    interpolate_columns,
    motor_input,
)
from groundstation.model.signals import Signals

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FIT_RATE_HZ = 150.0
MEASURED_RATE_HZ = 30.0
SHORTEST_S = 4.0
SETTLING_S = 0.3
"""After which rotors behind a lag have forgotten what nobody recorded: five of the slowest lags."""
UNKNOWN_ACCEL_BIAS_M_S2 = 0.1
"""Standard deviation of an accelerometer bias nobody measured: 10 mg, a consumer MEMS sensor's turn-on bias."""


@dataclass(frozen=True, slots=True)
class Prepared:
    """One flight, ready for the dynamic fit and for diagnosis.

    Attributes:
        record: rates, specific force and motors.
        planned: the motion that was asked for, where a plan or setpoints are known.
        compatibility: kinematic findings, where poses and IMU both exist.
        quaternion, position_m, velocity_m_s: smoothed motion of the declared origin at the record's stamps; NaN if unknown.
        causal_quaternion, causal_position_m, causal_velocity_m_s: the same from the past alone.
        voltage_v, charge_as: battery at the record's stamps; NaN if unknown.
        source: "imu", "poses" or "state": where rates and accelerations come from.
        window_s: start and end of what is used, on the record's clock.
        stretches: the runs without a hole that it consists of.
        excluded_s: stretches (start, end) that the user left out, on the record's clock.
    """

    flight: FlightData
    record: DynamicRecord
    planned: PlannedMotion | None
    compatibility: Compatibility | None
    quaternion: Array
    position_m: Array
    velocity_m_s: Array
    causal_quaternion: Array
    causal_position_m: Array
    causal_velocity_m_s: Array
    voltage_v: Array
    charge_as: Array
    clock: Clock | None
    source: str
    window_s: tuple[float, float]
    notes: tuple[str, ...]
    stretches: tuple[Stretch, ...] = ()
    excluded_s: tuple[tuple[float, float], ...] = ()

    def signals(self, up_s: float, down_s: float, delay_s: float, slope: float = 0.0) -> Signals:
        """What forces can depend on, at the record's stamps, for a given lag and delay."""
        record, motors = self.record, self.record.motors
        lagged = motors.lagged(up_s, down_s, slope)
        query = record.t_s - delay_s

        def at(values: Array) -> Array:
            return interpolate_columns(query, motors.start_s, motors.step_s, values)

        rate = np.gradient(lagged, motors.step_s, axis=0)
        return Signals(
            t_s=record.t_s - record.t_s[0],
            position_m=self.position_m,
            velocity_world_m_s=self.velocity_m_s,
            quaternion=self.quaternion,
            rate_rad_s=record.rate_rad_s,
            motor=at(motors.value),
            lagged=at(lagged),
            lagged_rate=at(rate),
            thrust_n=at(declared_thrust(record.vehicle, lagged)),
            voltage_v=self.voltage_v,
            charge_as=self.charge_as,
        )


def prepare(flight: FlightData, *, exclude: Sequence[tuple[float, float]] = ()) -> Prepared:
    """Bring a flight's streams together.

    Args:
        exclude: segments (start, end) to leave out, on the IMU's clock.

    Raises:
        Refused: the flight is too short, has no motion data, or its clocks cannot be aligned.
    """
    notes: list[str] = []
    motors = clean(flight.motors)
    vehicle = flight.vehicle
    measured = vehicle.rotors.input == "rotor_speed" and vehicle.rotors.speed_source == "telemetry"
    stretches = flown_stretches(flight, 0.0)
    flown_s = sum(end - start for start, end in stretches)
    if flown_s < SHORTEST_S:
        raise NotIdentifiable(
            f"the flight is too short: {flown_s:.1f} s in the air, {SHORTEST_S:.0f} s is the least.",
            "Fly the excitation for 20 s or more.",
        )
    inputs = motor_input(motors.t_s, motors.values, measured=measured, hover=hover_value(vehicle))
    motion = _motion(flight, notes)
    if motion.source == "imu" and motion.compatibility is None:
        flight = replace(flight, mocap=None)
    offset, said = motor_offset(flight, motion, inputs)
    notes += said
    if offset != 0.0:
        inputs = replace(inputs, start_s=inputs.start_s - offset)
    t = motion.t_s
    on_motors = t + offset
    settled = SETTLING_S if not measured else 0.0
    lost = gaps(motors.t_s)
    keep = within(on_motors, stretches) & ~within(on_motors, lost, (0.0, settled))
    keep &= (t >= inputs.start_s + SETTLING_S) & (t < inputs.t_s[-1] - 0.1)
    if motion.source != "imu":
        # Differences across a gap, and those of their differences, tell nothing of the motion beside it.
        step = float(np.median(np.diff(t)))
        keep &= ~within(t, gaps(t), (2.5 * step, 2.5 * step))
    for first, last in exclude:
        keep &= (t < first) | (t > last)
    if keep.sum() < SHORTEST_S * motion.rate_hz:
        raise NotIdentifiable(
            f"the streams share {keep.sum() / motion.rate_hz:.1f} s of flight, {SHORTEST_S:.0f} s is the least.",
            "Record IMU and motors over the whole flight, or leave out less.",
        )
    used = runs_of(t, keep)
    notes += _share_note(flight, motors, t, keep, used, lost)
    start_s = stretches[0][0] - offset
    record = DynamicRecord(
        vehicle=vehicle,
        t_s=t,
        keep=keep,
        rate_rad_s=motion.rate,
        force_m_s2=motion.force,
        force_bias_std=motion.force_bias_std,
        motors=inputs,
        block=max(1, round(motion.rate_hz / (MEASURED_RATE_HZ if measured else FIT_RATE_HZ))),
    )
    voltage, charge = _battery(flight, t)
    return Prepared(
        flight=flight,
        record=record,
        planned=planned_motion(flight, motion, keep, start_s, stand_in=measured),
        compatibility=motion.compatibility,
        quaternion=motion.smooth[0],
        position_m=motion.smooth[1],
        velocity_m_s=motion.smooth[2],
        causal_quaternion=motion.causal[0],
        causal_position_m=motion.causal[1],
        causal_velocity_m_s=motion.causal[2],
        voltage_v=voltage,
        charge_as=charge,
        clock=motion.clock,
        source=motion.source,
        window_s=(float(t[keep][0]), float(t[keep][-1])),
        notes=tuple(notes),
        stretches=used,
        excluded_s=tuple(exclude),
    )


def prepare_all(flights: Sequence[FlightData], exclude: Sequence[tuple[float, float]] = ()) -> list[Prepared]:
    """:func:`prepare` each flight.

    Raises:
        BadInput: a stretch to leave out lies in none of the flights.
    """
    prepared = [prepare(flight, exclude=exclude) for flight in flights]
    for first, last in exclude:
        if not any(np.any((p.record.t_s >= first) & (p.record.t_s <= last)) for p in prepared):
            spans = " and ".join(f"{p.record.t_s[0]:.2f} to {p.record.t_s[-1]:.2f} s" for p in prepared)
            raise BadInput(
                f"there is nothing to leave out from {first:g} to {last:g} s: stamps run from {spans}; give times within them."
            )
    return prepared


def _share_note(
    flight: FlightData, motors: Stream, t: Array, keep: Mask, used: Sequence[Stretch], lost: Sequence[Stretch]
) -> list[str]:
    """The share of the recording that is used, where that is not all of a known excitation."""
    if flight.window_s is not None and not lost:
        return []
    recorded = float(motors.t_s[-1] - motors.t_s[0])
    step = np.diff(t, append=t[-1])
    used_s = float(np.sum(step[keep & (step < GAP_S)]))
    missing = sum(end - start for start, end in lost)
    why = [f"{len(lost)} gaps of the motors' stream ({missing:.1f} s)"] if lost else []
    if flight.window_s is None:
        why.append("ground, and a second beside it")
    return [told(used_s, recorded, len(used), why if used_s < 0.98 * recorded else ())]


def flight_states(flight: FlightData, *, own: bool = False) -> FlightStates:
    """Starts and references of a flight for prediction.

    Args:
        flight: recorded.
        own: take both from the vehicle's own estimate (``state.csv``) instead of the smoothed motion.

    Raises:
        BadInput: ``own`` was asked of a flight without a state stream.
    """
    prepared = prepare(flight)
    return own_states(prepared) if own else smoothed_states(prepared)


def own_states(prepared: Prepared) -> FlightStates:
    """Starts and references from the vehicle's own estimate.

    Raises:
        BadInput: there is none.
    """
    flight, record = prepared.flight, prepared.record
    if flight.state is None or len(flight.state) < 50:
        raise BadInput(f"{flight.name}: there is no state.csv to start from; leave out --state own.")
    state = clean(flight.state)
    x = state.values
    parts = (x[:, :3], x[:, 3:6], quat_continuous(x[:, 6:10]), x[:, 10:13])
    voltage = np.interp(state.t_s, record.t_s, prepared.voltage_v)
    return FlightStates(
        state.t_s, *parts, *parts, record.motors, voltage, prepared.window_s, record.vehicle, prepared.stretches
    )


def smoothed_states(prepared: Prepared) -> FlightStates:
    """Starts from the past alone, and the smoothed motion to judge by."""
    record = prepared.record
    q, causal = quat_continuous(prepared.quaternion), quat_continuous(prepared.causal_quaternion)
    return FlightStates(
        record.t_s,
        prepared.causal_position_m, prepared.causal_velocity_m_s, causal, record.rate_rad_s,
        prepared.position_m, prepared.velocity_m_s, q, record.rate_rad_s,
        record.motors, prepared.voltage_v, prepared.window_s, record.vehicle, prepared.stretches,
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Motion(FlownMotion):
    causal: tuple[Array, Array, Array]
    force_bias_std: Array
    compatibility: Compatibility | None
    clock: Clock | None


def _motion(flight: FlightData, notes: list[str]) -> _Motion:
    pose = None if flight.mocap is None else clean(flight.mocap)
    state = None if flight.state is None else clean(flight.state)
    if flight.imu is not None and len(flight.imu) > 50:
        return _from_imu(flight, clean(flight.imu), pose, state, notes)
    if pose is not None and len(pose) > 50:
        notes.append(
            "There is no IMU: rates and accelerations are differences of motion-capture poses, which is noisier."
        )
        return _from_poses(flight, pose)
    if state is not None and len(state) > 50:
        notes.append("There is no IMU: rates and accelerations come from the vehicle's own state estimate.")
        return _from_state(flight, state)
    raise Refused(
        "the flight has no motion data: neither imu, mocap nor state holds 50 samples.", "Record one of them."
    )


def _from_imu(flight: FlightData, imu: Stream, pose: Stream | None, state: Stream | None, notes: list[str]) -> _Motion:
    t, gyro, accel = imu.t_s, imu.values[:, :3], imu.values[:, 3:6]
    lever = np.asarray(flight.vehicle.imu.position_m)
    unknown = (np.full((len(t), 4), np.nan), np.full((len(t), 3), np.nan), np.full((len(t), 3), np.nan))
    fixed_clock = False
    if (pose is None or len(pose) < 50) and state is not None and len(state) >= 50:
        pose = Stream(state.t_s, state.values[:, [0, 1, 2, 6, 7, 8, 9]], (), state.received_s)
        notes.append("There is no motion capture: the vehicle's own state stands in for it.")
        fixed_clock = True
    compatibility = clock = None
    smooth = causal = unknown
    rate, force = gyro, accel
    bias_std = np.full(3, UNKNOWN_ACCEL_BIAS_M_S2)
    if pose is not None and len(pose) >= 50:
        pose, offset = _aligned(flight, imu, pose, notes)
    if pose is None or len(pose) < 50:
        notes.append(
            "There are no poses: attitude, velocity and the accelerometer's bias are unknown, so the mass is only as sure as "
            f"a bias of {UNKNOWN_ACCEL_BIAS_M_S2:.1f} m/s^2 leaves it, and drag, wind and ground effect cannot be told."
        )
    else:
        compatibility = reconstruct(
            t, gyro, accel, pose.t_s, pose.values[:, :3], pose.values[:, 3:7],
            offset_s=offset, gravity_m_s2=flight.vehicle.gravity_m_s2,
            mocap_rotation_rad=np.asarray(flight.vehicle.mocap.rotation_rad),
        )  # fmt: skip
        v, s = compatibility.values, compatibility.std
        if not fixed_clock:
            told = (None, None) if flight.online is None else flight.online.at(0.5 * float(t[0] + t[-1]))
            clock = Clock(v["mocap_minus_imu_s"], s["mocap_minus_imu_s"], v["clock_drift"], s["clock_drift"], *told)
            notes += _disagreement(clock)
        rate = gyro - np.array([v[f"gyro_bias_{a}_rad_s"] for a in "xyz"])
        force = accel - np.array([v[f"accel_bias_{a}_m_s2"] for a in "xyz"])
        bias_std = np.array([s[f"accel_bias_{a}_m_s2"] for a in "xyz"])
        smooth = body_motion(compatibility, rate, lever)
        causal = body_motion(compatibility, rate, lever, causal=True)
        dropped = int((~compatibility.kept).sum())
        if dropped:
            notes.append(
                f"{dropped} of {len(compatibility.kept)} poses lay outside the IMU's record or did not fit it and were left out."
            )
    if np.any(lever != 0.0):
        force = force - _lever_arm(t, rate, lever)
    return _Motion(t, rate, force, smooth, "imu", imu.rate_hz(), causal, bias_std, compatibility, clock)


def _disagreement(clock: Clock) -> list[str]:
    """What to say where the clocks of the link and of the motion differ by more than both allow."""
    if clock.agrees is not False or clock.online_s is None or clock.online_error_s is None:
        return []
    return [
        f"The link had motion capture {1e3 * clock.online_s:+.2f} +- {1e3 * clock.online_error_s:.2f} ms from the IMU, the motion says "
        f"{1e3 * clock.mocap_minus_imu_s:+.2f} +- {1.96e3 * clock.std_s:.2f} ms: the stamps have a delay that the link does not know "
        "(`groundstation calibrate` measures it). The motion's was used."
    ]


def _aligned(flight: FlightData, imu: Stream, pose: Stream, notes: list[str]) -> tuple[Stream | None, float]:
    """Poses with one stamp for both their halves, and their coarse offset; none where nothing aligns their clock with the IMU's."""
    expected = arrival_difference(pose, imu)
    t, gyro, accel = imu.t_s, imu.values[:, :3], imu.values[:, 3:6]
    try:
        source = "motion capture" if flight.mocap is not None else "the vehicle's own attitude"
        offset, _ = coarse_offset(t, gyro, pose.t_s, pose.values[:, 3:7], expected_s=expected or 0.0, source=source)
    except Refused as refusal:
        notes.append(f"The poses are left out: {refusal}")
        return None, 0.0
    pose, said = with_one_stamp(pose, offset, t, accel, flight.vehicle.gravity_m_s2)
    notes += said
    return pose, offset


def _lever_arm(t: Array, rate: Array, lever: Array) -> Array:
    """omega_dot x r + omega x (omega x r), rates low-passed at 20 Hz before they are differenced, shape (k, 3)."""
    from scipy.signal import butter, sosfiltfilt

    sample_hz = 1.0 / float(np.median(np.diff(t)))
    smooth = sosfiltfilt(butter(2, min(20.0, 0.4 * sample_hz), fs=sample_hz, output="sos"), rate, axis=0)
    derivative = np.gradient(smooth, t, axis=0)
    return np.cross(derivative, lever) + np.cross(smooth, np.cross(smooth, lever))


def _from_poses(flight: FlightData, pose: Stream) -> _Motion:
    t, p = pose.t_s, pose.values[:, :3]
    rotation = quat_exp(np.asarray(flight.vehicle.mocap.rotation_rad))
    q = quat_multiply(pose.values[:, 3:7], quat_conjugate(rotation))
    p = p - quat_rotate(q, np.asarray(flight.vehicle.mocap.position_m))
    rate, middle = rates_from_attitude(t, q)
    velocity = np.diff(p, axis=0) / np.diff(t)[:, None]
    half = quat_multiply(q[:-1], quat_exp(0.5 * quat_log(quat_multiply(quat_conjugate(q[:-1]), q[1:]))))
    acceleration = np.gradient(velocity, middle, axis=0)
    force = quat_rotate_inverse(half, acceleration + np.array([0.0, 0.0, flight.vehicle.gravity_m_s2]))
    motion = (half, 0.5 * (p[1:] + p[:-1]), velocity)
    rate_hz = 1.0 / float(np.median(np.diff(t)))
    return _Motion(middle, rate, force, motion, "poses", rate_hz, motion, np.full(3, 1e-4), None, None)


def _from_state(flight: FlightData, state: Stream) -> _Motion:
    t, x = state.t_s, state.values
    q, velocity, rate = x[:, 6:10], x[:, 3:6], x[:, 10:13]
    force = quat_rotate_inverse(q, np.gradient(velocity, t, axis=0) + np.array([0.0, 0.0, flight.vehicle.gravity_m_s2]))
    motion = (q, x[:, :3], velocity)
    return _Motion(t, rate, force, motion, "state", state.rate_hz(), motion, np.full(3, 1e-3), None, None)


def _battery(flight: FlightData, t: Array) -> tuple[Array, Array]:
    if flight.battery is None or len(flight.battery) < 2:
        return np.full(len(t), np.nan), np.full(len(t), np.nan)
    battery = clean(Stream(flight.battery.t_s, flight.battery.values[:, :1], ("voltage_v",)))
    voltage = np.interp(t, battery.t_s, battery.values[:, 0]) if len(battery) > 1 else np.full(len(t), np.nan)
    current = (
        flight.battery.values[:, 1] if flight.battery.values.shape[1] > 1 else np.full(len(flight.battery), np.nan)
    )
    known = np.isfinite(current)
    charge = np.full(len(t), np.nan)
    if known.sum() > 1:
        stamps = flight.battery.t_s[known]
        drawn = cumulative(current[known, None], 1.0, held=False)[:, 0] * float(np.median(np.diff(stamps)))
        charge = np.interp(t, stamps, drawn)
    return voltage, charge


def damping_terms(prepared: Prepared) -> tuple[list[BodyWrench], PlannedMotion | None]:
    """Linear damping of the three rates and of climb, free in every fit, and the plan with their planned values.

    Every vehicle has some; left out, it passes for rotor lag and lengthens the moments of inertia. Its regressor stands at
    a right angle to the acceleration's, so freeing it costs mass and inertia next to nothing.
    """
    record = prepared.record
    vehicle = record.vehicle
    count = len(record.t_s)
    climb = quat_rotate_inverse(prepared.quaternion, prepared.velocity_m_s)[:, 2]
    sources = [(3, record.rate_rad_s[:, 0]), (4, record.rate_rad_s[:, 1]), (5, record.rate_rad_s[:, 2]), (2, climb)]
    plan = prepared.planned
    terms: list[BodyWrench] = []
    planned: list[Array] = []
    moments = np.diag(vehicle.inertia_tensor())
    scales = (*(5.0 * moments), vehicle.mass_kg)
    names = ("damping_x_nms", "damping_y_nms", "damping_z_nms", "damping_climb_kg_s")
    for index, ((column, values), name, scale) in enumerate(zip(sources, names, scales, strict=True)):
        if not np.isfinite(values).all():
            continue
        wrench = np.zeros((count, 6))
        wrench[:, column] = -values
        terms.append(BodyWrench(name, wrench, prior_std=float(scale)))
        if plan is not None:
            wished = np.zeros((count, 6))
            wished[:, column] = -(plan.rate_rad_s[:, index] if index < 3 else plan.velocity_body_m_s[:, 2])
            planned.append(wished)
    return terms, None if plan is None else replace(plan, extra=tuple(planned))
