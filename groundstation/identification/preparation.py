"""From a flight to what the dynamic fit needs: its motion (:mod:`.motion`), motors and plan on one clock, and what of
it is used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput, NotIdentifiable
from groundstation.flightdata import FlightData, Stream
from groundstation.identification.alignment import motor_offset
from groundstation.identification.instruments import planned_motion
from groundstation.identification.motion import Motion, motion_of
from groundstation.identification.parts import kept
from groundstation.identification.reconstruction import Compatibility
from groundstation.identification.record import DynamicRecord, PlannedMotion
from groundstation.identification.results import Clock
from groundstation.identification.streams import clean, flown_stretches
from groundstation.identification.stretches import GAP_S, Stretch, gaps, runs_of, used_note, within
from groundstation.identification.together import of_each
from groundstation.model.rotors import (
    MotorInput,
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
SEARCHED_S = 300.0
"""Of a flight, in which searches look."""
LEAST_S = 4.0
"""Of flight that a dynamic fit needs."""
SETTLING_S = 0.3
"""After which rotors behind a lag have forgotten what nobody recorded: five of the slowest lags."""


@dataclass(frozen=True, slots=True)
class Prepared:
    """One flight, ready for the dynamic fit and for diagnosis.

    Attributes:
        record: rates, specific force and motors.
        planned: the motion that was asked for, where a plan or setpoints are known.
        compatibility: kinematic findings, where poses and IMU both exist.
        quaternion, position_m, velocity_m_s: smoothed motion of the declared origin at the record's stamps; NaN if
            unknown.
        causal_quaternion, causal_position_m, causal_velocity_m_s: the same from the past alone; of a long flight in
            single precision.
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
    excluded_s: tuple[Stretch, ...] = ()

    @classmethod
    def of(
        cls,
        flight: FlightData,
        motion: Motion,
        record: DynamicRecord,
        planned: PlannedMotion | None,
        excluded_s: tuple[Stretch, ...],
        notes: tuple[str, ...],
    ) -> Prepared:
        """From a flight, its motion and the record of what is used."""
        voltage, charge = _battery(flight, record.t_s)
        used = record.t_s[record.keep]
        return cls(
            flight=flight,
            record=record,
            planned=planned,
            compatibility=motion.compatibility,
            quaternion=motion.smooth[0],
            position_m=motion.smooth[1],
            velocity_m_s=motion.smooth[2],
            causal_quaternion=kept(motion.causal[0]),
            causal_position_m=kept(motion.causal[1]),
            causal_velocity_m_s=kept(motion.causal[2]),
            voltage_v=voltage,
            charge_as=charge,
            clock=motion.clock,
            source=motion.source,
            window_s=(float(used[0]), float(used[-1])),
            notes=notes,
            stretches=runs_of(record.t_s, record.keep),
            excluded_s=excluded_s,
        )

    def liveliest(self) -> Prepared:
        """The SEARCHED_S in a row in which the vehicle turns most, for what is searched for and not estimated; a
        shorter flight as it is.
        """
        record = self.record
        count = round(SEARCHED_S / float(np.median(np.diff(record.t_s))))
        if len(record.t_s) <= count:
            return self
        steps = np.diff(record.rate_rad_s, axis=0, prepend=record.rate_rad_s[:1])
        turned = np.cumsum(np.where(record.keep, np.sum(np.nan_to_num(steps) ** 2, axis=1), 0.0))
        first = int(np.argmax(turned[count:] - turned[:-count]))
        return self._part(slice(first, first + count))

    def _part(self, samples: slice) -> Prepared:
        """Some of the samples: views."""
        record = self.record.part(samples)
        along = ("quaternion", "position_m", "velocity_m_s", "voltage_v", "charge_as")
        causal = ("causal_quaternion", "causal_position_m", "causal_velocity_m_s")
        cut: dict[str, Array] = {name: getattr(self, name)[samples] for name in (*along, *causal)}
        planned = None if self.planned is None else self.planned.part(samples)
        return replace(self, record=record, planned=planned, stretches=runs_of(record.t_s, record.keep), **cut)

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


def prepare(flight: FlightData, *, exclude: Sequence[Stretch] = ()) -> Prepared:
    """Bring a flight's streams together.

    Args:
        exclude: segments (start, end) to leave out, on the IMU's clock.

    Raises:
        Refused: the flight is too short, has no motion data, or its clocks cannot be aligned.
    """
    motors, stretches, measured = clean(flight.motors), _in_the_air(flight), flight.vehicle.rotors.measured
    inputs = motor_input(motors.t_s, motors.values, measured=measured, hover=hover_value(flight.vehicle))
    motion = motion_of(flight)
    if motion.source == "imu" and motion.compatibility is None:
        flight = replace(flight, mocap=None)
    offset, said = motor_offset(flight, motion, inputs)
    if offset != 0.0:
        inputs = replace(inputs, start_s=inputs.start_s - offset)
    lost = gaps(motors.t_s)
    keep = _kept(motion, inputs, offset, stretches, lost, exclude)
    record = DynamicRecord(
        vehicle=flight.vehicle,
        t_s=motion.t_s,
        keep=keep,
        rate_rad_s=motion.rate,
        force_m_s2=motion.force,
        force_bias_std=motion.force_bias_std,
        motors=inputs,
        block=max(1, round(motion.rate_hz / (MEASURED_RATE_HZ if measured else FIT_RATE_HZ))),
    )
    planned = planned_motion(flight, motion, keep, stretches[0][0] - offset, stand_in=measured)
    notes = (*motion.notes, *said, *_share_note(flight, motors, record, lost))
    return Prepared.of(flight, motion, record, planned, tuple(exclude), notes)


def _in_the_air(flight: FlightData) -> tuple[Stretch, ...]:
    """The stretches of a flight that is long enough."""
    stretches = flown_stretches(flight, 0.0)
    flown_s = sum(end - start for start, end in stretches)
    if flown_s < LEAST_S:
        raise NotIdentifiable(
            f"the flight is too short: {flown_s:.1f} s in the air, {LEAST_S:.0f} s is the least.",
            "Fly the excitation for 20 s or more.",
        )
    return stretches


def _kept(
    motion: Motion,
    inputs: MotorInput,
    offset_s: float,
    stretches: Sequence[Stretch],
    lost: Sequence[Stretch],
    exclude: Sequence[Stretch],
) -> Mask:
    """Which of the motion's samples a fit uses: in the air, motors known, and not left out, (k,).

    Args:
        offset_s: motors' clock minus the motion's. stretches, lost: in the air, and without motors, on the motors'
            clock.
    """
    t = motion.t_s
    on_motors = t + offset_s
    settled = 0.0 if inputs.measured else SETTLING_S
    keep = within(on_motors, stretches) & ~within(on_motors, lost, (0.0, settled))
    keep &= (t >= inputs.start_s + SETTLING_S) & (t < inputs.t_s[-1] - 0.1)
    # Differences across a gap, and those of their differences, tell nothing of the motion beside it.
    step = float(np.median(np.diff(t)))
    keep &= ~within(t, gaps(t), (2.5 * step, 2.5 * step))
    for first, last in exclude:
        keep &= (t < first) | (t > last)
    if keep.sum() < LEAST_S * motion.rate_hz:
        raise NotIdentifiable(
            f"the streams share {keep.sum() / motion.rate_hz:.1f} s of flight, {LEAST_S:.0f} s is the least.",
            "Record IMU and motors over the whole flight, or leave out less.",
        )
    return keep


def prepare_all(
    flights: Sequence[FlightData], exclude: Sequence[Stretch] = (), before: Mapping[int, Prepared] | None = None
) -> list[Prepared]:
    """:func:`prepare` each flight.

    Args:
        before: those that are prepared already, with these stretches left out, by the identity of the flight.

    Raises:
        BadInput: a stretch to leave out lies in none of the flights.
    """
    known = before or {}
    prepared = of_each(lambda flight: known.get(id(flight)) or prepare(flight, exclude=exclude), flights)
    for first, last in exclude:
        if not any(np.any((p.record.t_s >= first) & (p.record.t_s <= last)) for p in prepared):
            spans = " and ".join(f"{p.record.t_s[0]:.2f} to {p.record.t_s[-1]:.2f} s" for p in prepared)
            raise BadInput(
                f"there is nothing to leave out from {first:g} to {last:g} s: stamps run from {spans}; give times "
                "within them."
            )
    return prepared


def _share_note(flight: FlightData, motors: Stream, record: DynamicRecord, lost: Sequence[Stretch]) -> list[str]:
    """The share of the recording that is used, where that is not all of a known excitation."""
    unseen = gaps(record.t_s)
    if flight.window_s is not None and not lost and not unseen:
        return []
    recorded = float(motors.t_s[-1] - motors.t_s[0])
    t, keep = record.t_s, record.keep
    step = np.diff(t, append=t[-1])
    used_s = float(np.sum(step[keep & (step < GAP_S)]))
    why = [
        f"{len(found)} gaps of the {whose} stream ({sum(end - start for start, end in found):.1f} s)"
        for whose, found in (("motors'", lost), ("motion's", unseen))
        if found
    ]
    if flight.window_s is None:
        why.append("ground, and a second beside it")
    return [used_note(used_s, recorded, len(runs_of(t, keep)), why if used_s < 0.98 * recorded else ())]


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
