"""How visible is what was hidden? Expected t and share of the wrench, from a joint estimate that is told all of it.

An invented field of the room is told by the simulator's own formula; thrust with memory has no formula of a wrench and
counts as visible.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from groundstation.diagnosis.base import for_evidence
from groundstation.diagnosis.columns import Candidate
from groundstation.diagnosis.effect import Effect, ParameterInfo, library
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.flight_evidence import FlightEvidence
from groundstation.diagnosis.pool import candidates
from groundstation.flightdata import FlightData
from groundstation.frames import quat_rotate_inverse
from groundstation.identification.dynamic_fit import fit_dynamics
from groundstation.identification.preparation import prepare
from groundstation.model.signals import Signals
from groundstation.vehicle import Vehicle
from sim.effects.surroundings import magnet, wall
from sim.scenario import scenario_from_dict
from studies.hidden import Table

FIELDS = ("attracting_wall", "magnet")
"""Invented ones that are a force at a place: the simulator's own formula says how detectable they are."""


def visibility(flight: FlightData, hidden: Sequence[tuple[str, Table]]) -> list[tuple[float, float]]:
    """Expected t and RMS share of each hidden effect, when the diagnosis is told all of them."""
    seen = {name: (math.inf, math.nan) for name, _ in hidden}
    modelled = [(name, table) for name, table in hidden if name in library() or name in FIELDS]
    if not modelled:
        return list(seen.values())
    suspect = for_evidence(prepare(flight))
    fitted = fit_dynamics([suspect])
    vehicle = suspect.record.vehicle
    plain = Evidence([FlightEvidence(suspect, fitted.best, fitted.options)])
    told = [_told(name, table, plain) for name, table in modelled]
    evidence = Evidence([FlightEvidence(suspect, fitted.best, fitted.options, told)])
    chosen = [(c, columns) for c in told if (columns := evidence.columns(c)) is not None]
    solution, first = evidence.solve(chosen), 0
    weight = vehicle.mass_kg * vehicle.gravity_m_s2
    scale = np.array([weight] * 3 + [weight * vehicle.arm_m()] * 3)
    for candidate, columns in chosen:
        count = len(candidate.effect.parameters)
        telling = candidate.effect.telling()
        t = math.sqrt(max(solution.wald(first, telling) - len(telling), 0.0))
        values, _ = solution.part(first, count)
        seen[candidate.identifier] = t, float(np.max(columns.wrench_rms @ np.abs(values) / scale))
        first += count
    return list(seen.values())


def _told(name: str, table: Table, evidence: Evidence) -> Candidate:
    """The library's model of a hidden effect: the right rotor, and the instant or length that serve best."""
    flight = evidence.flights[0]
    if name in FIELDS:
        return Candidate(_field(name, table), {})
    pool = [
        (candidate, columns)
        for candidate in candidates(flight.prepared.record.vehicle, flight.excited, [library()[name]])
        if candidate.settings.get("rotor") == table.get("rotor")
        and (columns := evidence.columns(candidate)) is not None
    ]
    return max(pool, key=lambda entry: evidence.solve([entry]).wald(0, range(len(entry[0].effect.parameters))))[0]


def _field(name: str, table: Table) -> Effect:
    """An invented field of the room by the simulator's own formula, at the poses that were measured; its one parameter
    is one.
    """
    scenario = scenario_from_dict({"name": name, "effects": {name: table}})

    def wrench(signals: Signals, vehicle: Vehicle, settings: Mapping[str, float]) -> np.ndarray:
        force, torque = np.zeros((2, len(signals.t_s), 3))
        for index, (place, q) in enumerate(zip(signals.position_m.tolist(), signals.quaternion.tolist(), strict=True)):
            if name == "magnet":
                force[index], torque[index] = magnet(scenario.effects.magnet, tuple(place), tuple(q))
            else:
                field = scenario.effects.attracting_wall
                force[index] = wall(
                    field, tuple(place), (math.cos(field.azimuth_rad), math.sin(field.azimuth_rad), 0.0)
                )
        return np.concatenate([quat_rotate_inverse(signals.quaternion, force), torque], axis=1)[:, :, None]

    return Effect(
        identifier=name,
        equation="the simulator's",
        source="invented",
        parameters=(ParameterInfo("times", lambda vehicle: 10.0),),
        confused_with=(),
        manoeuvre="",
        sentence="",
        wrench=wrench,
    )
