"""The flights of one diagnosis, and what is put right in all of them before any force is looked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from groundstation.diagnosis.curve import exponent_error, with_thrust_exponent
from groundstation.diagnosis.kinematic import kinematic_findings, with_imu_aligned
from groundstation.diagnosis.results import Finding
from groundstation.flightdata import FlightData
from groundstation.identification.preparation import Prepared, prepare_all
from groundstation.identification.work import Work
from groundstation.options import AnalysisOptions
from groundstation.vehicle import Vehicle


@dataclass(frozen=True, slots=True)
class Case:
    """Flights of one vehicle, each with its streams on one clock.

    Attributes:
        vehicle: as declared.
        suspects: under suspicion, pooled.
        healthy: of the same vehicle in its healthy state; they share its mass and tensor, and no candidate acts on
            them.
        unseen: flights that no estimate sees; findings are judged on them.
    """

    vehicle: Vehicle
    suspects: tuple[Prepared, ...]
    healthy: tuple[Prepared, ...]
    unseen: tuple[Prepared, ...]

    def map(self, change: Callable[[Prepared], Prepared]) -> Case:
        """The same with every flight changed."""
        suspects, healthy, unseen = (tuple(map(change, group)) for group in (self.suspects, self.healthy, self.unseen))
        return replace(self, suspects=suspects, healthy=healthy, unseen=unseen)


def case_of(flights: Sequence[FlightData], options: AnalysisOptions, work: Work) -> Case:
    """The flights, prepared.

    Raises:
        BadInput: a stretch to leave out lies in none of the flights.
        Refused: a flight holds too little to say anything.
    """
    groups = (
        work.prepared(flights, options.exclude),
        prepare_all(options.references),
        prepare_all(options.held_out),
    )
    return Case(flights[0].vehicle, *map(tuple, groups))


def sensors(case: Case) -> tuple[Case, list[Finding]]:
    """What gyro, accelerometer and motion capture say of each other; an IMU that is turned is put straight in every
    flight.
    """
    findings = kinematic_findings(case.suspects[0])
    return straightened(case, findings), findings


def straightened(case: Case, findings: Sequence[Finding]) -> Case:
    """With an IMU that was found turned put straight in every flight."""
    return case.map(lambda flight: with_imu_aligned(flight, findings))


def thrust_exponent(case: Case) -> tuple[Case, float]:
    """Departure of the thrust curve's exponent from the declared one, 0 for most flights; every flight by the curve it
    gives.
    """
    departure = exponent_error(case.suspects[0])
    return case.map(lambda flight: with_thrust_exponent(flight, departure)), departure
