"""A flight exactly as it was recorded: every sample and time stamp of every stream, blemishes included.

This is what the readers of all formats yield and the writers of both own formats take; repairs come after
(:mod:`groundstation.recording.repair`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import tomli_w

from groundstation.errors import BadInput
from groundstation.flightdata import (
    BATTERY_COLUMNS,
    IMU_COLUMNS,
    MOCAP_COLUMNS,
    SETPOINT_COLUMNS,
    STATE_COLUMNS,
    WRENCH_COLUMNS,
    Array,
    FlightData,
    Stream,
    motor_columns,
)
from groundstation.outside import parse_toml
from groundstation.trajectory import Plan, plan_from_dict, plan_to_dict
from groundstation.vehicle import Vehicle, vehicle_from_dict, vehicle_to_dict

STREAMS = ("imu", "motors", "mocap", "battery", "setpoint", "state")
COLUMNS = {
    "imu": IMU_COLUMNS,
    "mocap": MOCAP_COLUMNS,
    "battery": BATTERY_COLUMNS,
    "setpoint": SETPOINT_COLUMNS,
    "state": STATE_COLUMNS,
}
MotorKind = Literal["rotor_speed", "command", "wrench"]
MOTOR_KINDS: tuple[MotorKind, ...] = ("rotor_speed", "command", "wrench")
LOG_COLUMNS = {"events": ("kind", "text"), "raw": ("direction", "data_hex"), "status": ("phase", "armed", "text")}
"""Streams of texts: what happened, the frames of a link, the vehicle's status."""

VEHICLE_FILE, PLAN_FILE, TRUTH_FILE = "vehicle.toml", "plan.toml", "truth.toml"


@dataclass(frozen=True, slots=True)
class Texts:
    """Samples that are texts. Times as in :class:`Stream`; ``rows`` has one tuple per sample."""

    t_s: Array
    rows: tuple[tuple[str, ...], ...]
    columns: tuple[str, ...]
    received_s: Array | None = None

    def __len__(self) -> int:
        return len(self.rows)


@dataclass(frozen=True, slots=True)
class Recording:
    """Everything a recording holds.

    Attributes:
        name: of the flight.
        streams: the streams of the docs/formats.md, with its columns in its order.
        extras: other columns of numbers, under the name of their stream (same times), and streams of other names.
        texts: other columns of texts under the name of their stream, and "events", "raw", "status".
        files: vehicle.toml, plan.toml, truth.toml where known, and every other file, verbatim.
        metadata: scenario name, versions and the like.
        window_s: start and end of the excitation on the motors' clock.
        notes: what was lost or derived on the way in, one sentence each.
        left_out: what the source holds, or held before it was damaged, and this does not.
    """

    name: str
    streams: Mapping[str, Stream] = field(default_factory=dict)
    extras: Mapping[str, Stream] = field(default_factory=dict)
    texts: Mapping[str, Texts] = field(default_factory=dict)
    files: Mapping[str, bytes] = field(default_factory=dict)
    metadata: Mapping[str, str] = field(default_factory=dict)
    window_s: tuple[float, float] | None = None
    notes: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

    def vehicle(self, source: str) -> Vehicle | None:
        """The declared vehicle, where the recording carries one.

        Raises:
            BadInput: it carries one that is wrong.
        """
        return _vehicle(self.files[VEHICLE_FILE], f"{source}/{VEHICLE_FILE}") if VEHICLE_FILE in self.files else None

    def truth(self, source: str) -> Vehicle | None:
        """The simulated drone's true vehicle, where there is one (for reports alone)."""
        try:
            return _vehicle(self.files[TRUTH_FILE], f"{source}/{TRUTH_FILE}") if TRUTH_FILE in self.files else None
        except BadInput:
            return None  # a file of that name that means something else is none of ours

    def plan(self, source: str) -> Plan | None:
        """The plan that was flown, where the recording carries one in this program's form."""
        try:
            return (
                plan_from_dict(parse_toml(self.files[PLAN_FILE], source), source) if PLAN_FILE in self.files else None
            )
        except BadInput:
            return None  # as above


def _vehicle(data: bytes, source: str) -> Vehicle:
    return vehicle_from_dict(parse_toml(data, source), source)


def vehicle_file(vehicle: Vehicle) -> bytes:
    """A vehicle as the bytes of a vehicle file."""
    return tomli_w.dumps(vehicle_to_dict(vehicle)).encode()


def plan_file(plan: Plan) -> bytes:
    """A plan as the bytes of a plan file."""
    return tomli_w.dumps(plan_to_dict(plan)).encode()


def motor_kind(columns: tuple[str, ...]) -> MotorKind:
    """Which kind of motor values a stream's columns hold."""
    if columns == WRENCH_COLUMNS:
        return "wrench"
    return "rotor_speed" if columns == motor_columns("rotor_speed", len(columns)) else "command"


def recording_of(flight: FlightData) -> Recording:
    """The recording that holds a flight, as :func:`write_bundle` and the MCAP writer take it."""
    files = {VEHICLE_FILE: vehicle_file(flight.vehicle)}
    if flight.plan is not None:
        files[PLAN_FILE] = plan_file(flight.plan)
    if flight.truth is not None:
        files[TRUTH_FILE] = vehicle_file(flight.truth)
    return Recording(
        name=flight.name,
        streams=flight.streams(),
        extras=flight.extras,
        files=files,
        metadata=flight.metadata,
        window_s=flight.window_s,
        notes=flight.notes,
    )
