"""What may be named: every effect of the library that applies, in the settings worth trying on these flights."""

from __future__ import annotations

from collections.abc import Iterable

from groundstation.diagnosis.columns import Candidate
from groundstation.diagnosis.effect import Effect, library
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.flight_evidence import FlightEvidence
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle


def candidates(vehicle: Vehicle, signals: Signals, effects: Iterable[Effect] | None = None) -> list[Candidate]:
    """Every effect that applies, in every variant; those of a search of the flight are left to :func:`searched`."""
    chosen = library().values() if effects is None else effects
    return [
        Candidate(effect.of(settings), settings)
        for effect in chosen
        if effect.applies(vehicle) and (effects is not None or effect.searched is None)
        for settings in effect.variants(signals, vehicle)
    ]


def searched(flight: FlightEvidence) -> list[Candidate]:
    """Effects in the settings that a search of the flight gives."""
    record, p = flight.prepared.record, flight.parameters
    effects = [each for each in library().values() if each.searched is not None and each.applies(record.vehicle)]
    if not effects:
        return []
    some = flight.prepared.liveliest()
    whole = some is flight.prepared
    signals = flight.signals if whole else some.signals(p.lag_up_s, p.lag_down_s, p.delay_s, p.lag_slope)
    return [
        Candidate(effect.of(settings), settings)
        for effect in effects
        if effect.searched is not None
        for settings in effect.searched(signals, some.record.keep, record.vehicle)
    ]


def pool_of(vehicle: Vehicle, evidence: Evidence, *, references: bool) -> list[Candidate]:
    """Everything that may be named; beside healthy flights a load that was there all along, too."""
    begun = [candidate for flight in evidence.flights[: evidence.suspects] for candidate in flight.begun]
    pool = [*candidates(vehicle, evidence.flights[0].excited), *searched(evidence.flights[0]), *begun]
    if references:
        before = {"at_s": -1.0, "within_s": 1.0}
        pool.append(Candidate(library()["payload_change"].of(before), before))
    return pool
