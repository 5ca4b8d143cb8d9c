"""IMU or marker body turned in the body, or both: what the vehicle's own motion says where one rotation told of either.

Gyro and poses give the rotation of the two against each other alone, and one of them is taken to be straight. The
rotors tell of the IMU by itself: their torques turn the vehicle about axes of the body. A turn e of the IMU beyond what
it was put straight by shows as -e x omega in its rates, which no tensor makes, since a tensor is symmetric, and as
-e x f in its forces, beside whatever pushes steadily. With rho = m - e, the marker body's turn less the IMU's, what is
left of e is the turn of the one that was taken to be straight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.columns import Candidate, Columns
from groundstation.diagnosis.effect import (
    ROTATION_PARAMETERS,
    Effect,
    ParameterInfo,
    SensorEffect,
    catalogue,
    lift_of,
)
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.flight_evidence import FlightEvidence
from groundstation.diagnosis.kinematic import TURNED
from groundstation.diagnosis.results import Finding
from groundstation.diagnosis.rivals import posterior
from groundstation.diagnosis.sentences import filled
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.identification.results import Estimate

Array = NDArray[np.float64]

TURN = Effect(
    identifier="imu_misalignment",
    equation="omega_imu = omega - e x omega, f_imu = f - e x f",
    source="definition",
    parameters=tuple(ParameterInfo(p.name, lambda vehicle: 0.1) for p in ROTATION_PARAMETERS),
    wrench=lambda signals, vehicle, settings: np.zeros((len(signals.t_s), 6, 3)),
    sentence="",
    confused_with=(),
    manoeuvre="",
)
"""A turn of the IMU as a member of a joint estimate; of a tenth of a radian before a flight."""


def told_by_rotors(
    findings: Sequence[Finding], evidence: Evidence, chosen: Sequence[tuple[Candidate, Columns]]
) -> Sequence[Finding]:
    """The findings with both bodies turned where no single one explains the flights, and with the one that does where
    it had been left open which and a plan frees the rotors' torque of feedback.

    Args:
        findings: of the sensors; one of them may be a turn.
        evidence: of flights with the IMU put straight by these. chosen: effects that were selected there; beside
            those left out a turn takes what is theirs.
    """
    named = next((f for f in findings if f.effect in TURNED and ROTATION_PARAMETERS[0].name in f.parameters), None)
    if named is None or evidence.flights[0].prepared.source != "imu":
        return findings
    left, covariance = _turn(evidence, chosen)
    covariance = covariance + THRESHOLDS.rotor_upright_rad**2 * np.eye(3)
    found = np.array([named.parameters[p.name].value for p in ROTATION_PARAMETERS])
    other = TURNED[1] if named.effect == TURNED[0] else TURNED[0]
    turns = {named.effect: found + left, other: left}
    without = {name: float(turn @ np.linalg.solve(covariance, turn)) for name, turn in turns.items()}
    if min(without.values()) >= THRESHOLDS.inseparable:
        std = np.sqrt(np.diag(covariance))
        both = [_finding(name, turns[name], std, like=named, lead=without[name]) for name in turns]
        return _in_place_of(named, both, findings)
    apart = without[named.effect] - without[other]
    told = abs(apart) >= THRESHOLDS.inseparable and all(flight.planned is not None for flight in evidence.flights)
    if not named.alternatives or not told:
        return findings
    name, turn = (named.effect, found) if apart > 0.0 else (other, -found)
    sharp = np.array([named.parameters[p.name].std for p in ROTATION_PARAMETERS])
    return _in_place_of(named, [_finding(name, turn, sharp, like=named, lead=abs(apart))], findings)


def _in_place_of(named: Finding, turned: Sequence[Finding], findings: Sequence[Finding]) -> list[Finding]:
    """Findings with turned bodies in the place of one, each with how its body is shifted."""
    out = list[Finding]()
    for finding in turned:
        like = [f for f in findings if f.effect == finding.effect]
        shifts = {n: e for f in like for n, e in f.parameters.items() if n not in finding.parameters}
        text = " ".join([finding.sentence, *(f.sentence for f in like if f is not named)])
        out.append(replace(finding, parameters={**finding.parameters, **shifts}, sentence=text))
    told = {finding.effect for finding in turned}
    return [*out, *(f for f in findings if f is not named and f.effect not in told)]


def turn_of_imu(findings: Sequence[Finding]) -> Mapping[str, Estimate]:
    """By which the IMU is put straight; nothing where none is named."""
    return {name: e for f in findings if f.effect == TURN.identifier for name, e in f.parameters.items()}


def _finding(name: str, turn: Array, std: Array, *, like: Finding, lead: float) -> Finding:
    """A turned body, of evidence that stands above its rivals' by a lead (chi squared)."""
    sentences = {n: e.readings[0].sentence for n, e in catalogue().items() if isinstance(e, SensorEffect)}
    values = zip(ROTATION_PARAMETERS, turn.tolist(), std.tolist(), strict=True)
    return replace(
        like,
        effect=name,
        parameters={p.name: Estimate.normal(v, s) for p, v, s in values},
        sentence=filled(sentences[name], size=float(np.linalg.norm(turn))),
        confidence=posterior([-lead]),
        alternatives=(),
    )


def _turn(evidence: Evidence, chosen: Sequence[tuple[Candidate, Columns]]) -> tuple[Array, Array]:
    """Turn of the IMU against the rotors beside base and chosen, (3,), and its covariance, (3, 3)."""
    pairs = [_columns(flight) for flight in evidence.flights]
    seen, wished = (np.concatenate([pair[side] for pair in pairs]) for side in (0, 1))
    turned = Candidate(TURN, {}), Columns.of(seen, wished, np.zeros((6, 3)))
    return evidence.solve([turned, *chosen]).part(0, 3)


def _columns(flight: FlightEvidence) -> tuple[Array, Array]:
    """Whitened columns of a turn, along the rates and forces there were and along those of a plan, (rows, 3) each."""
    model = flight.model
    moving = [(model.rate, model.force)]
    if flight.planned is not None:
        lift = model.average(lift_of(model.record.vehicle, np.asarray(flight.planned.thrust_n, dtype=float))[:, None])
        along = np.concatenate([np.zeros((len(lift), 2)), lift / flight.parameters.mass_kg], axis=1)
        moving.append((model.average(np.asarray(flight.planned.rate_rad_s, dtype=float)), along))
    made = list[Array]()
    for rate, force in moving:
        both = np.stack([rate, force], axis=1)
        columns = -np.cross(np.eye(3)[None, None], both[:, :, None])  # (blocks, 2, turn, axis)
        made.append(flight.whitening.apply(columns.transpose(0, 1, 3, 2).reshape(len(rate), 6, 3)))
    return made[0], made[-1]
