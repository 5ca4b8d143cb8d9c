"""``diagnose``: find what the declared vehicle lacks, name it or say that nothing known does, and show the error before and after."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.adoption import why_not
from groundstation.diagnosis.attribution import Named, Selection, candidates
from groundstation.diagnosis.augmented import is_among, known_candidates
from groundstation.diagnosis.comparison import (
    as_declared,
    base_covariance,
    base_parameters,
    held_out_errors,
    plain_gain,
    residual_series,
    splits_of,
    with_plain,
)
from groundstation.diagnosis.curve import exponent_error, recurved, with_exponent
from groundstation.diagnosis.effect import catalogue, library, shared_by_healthy
from groundstation.diagnosis.evidence import Candidate, Evidence, FlightEvidence, Solution
from groundstation.diagnosis.forecast import forecast
from groundstation.diagnosis.kinematic import kinematic_findings, turned
from groundstation.diagnosis.linearisation import linearisation
from groundstation.diagnosis.next_flight import rival_entries
from groundstation.diagnosis.proposal import with_proposals
from groundstation.diagnosis.results import Diagnosis, Finding, Unexplained
from groundstation.diagnosis.rivals import Entry
from groundstation.diagnosis.scale import scale_findings
from groundstation.diagnosis.screen import dependences, unexplained
from groundstation.diagnosis.sentences import told
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.diagnosis.timing import lag_findings
from groundstation.diagnosis.trim import applies as trim_applies
from groundstation.diagnosis.trim import compare_trims
from groundstation.errors import Refused
from groundstation.flightdata import FlightData
from groundstation.identification.declarations import check_declarations, said_first
from groundstation.identification.pipeline import fit_dynamics, options_for
from groundstation.identification.prediction_error import Fitted
from groundstation.identification.preparation import Prepared, prepare_all
from groundstation.identification.results import Estimate
from groundstation.model.parameters import FitOptions
from groundstation.options import DEFAULT_OPTIONS, AnalysisOptions
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Progress = Callable[[float, str], None]


def diagnose(
    flights: Sequence[FlightData],
    options: AnalysisOptions = DEFAULT_OPTIONS,
    *,
    progress: Progress = lambda fraction, text: None,
) -> Diagnosis:
    """Trace the residual of one or several flights of a vehicle to effects its declaration lacks.

    Args:
        flights: under suspicion; pooled.
        options: stretches to leave out, healthy flights to compare with, flights to judge by, effects that are known.
        progress: told the fraction done and what is being done.
    """
    checks = check_declarations(flights[0])
    found = _diagnose(flights, options, progress)
    return replace(
        found,
        declarations=tuple(check.to_dict() for check in checks),
        warnings=(*said_first(checks), *found.warnings),
    )


def _diagnose(flights: Sequence[FlightData], options: AnalysisOptions, progress: Progress) -> Diagnosis:
    """What :func:`diagnose` finds, the declarations taken as they are."""
    name = " + ".join(flight.name for flight in flights)
    vehicle = flights[0].vehicle
    references, augmented = options.references, known_candidates(options.known_effects)
    try:
        progress(0.05, "bringing the streams onto one clock")
        suspects = prepare_all(flights, options.exclude)
        healthy, unseen = prepare_all(references), prepare_all(options.held_out)
        kinematic = kinematic_findings(suspects[0])
        suspects, healthy, unseen = ([turned(item, kinematic) for item in each] for each in (suspects, healthy, unseen))
        if healthy and trim_applies(suspects, healthy):
            return _by_trim(name, suspects, healthy)
        bend = exponent_error(suspects[0])
        suspects, healthy, unseen = ([recurved(item, bend) for item in each] for each in (suspects, healthy, unseen))
        progress(0.25, "base fit")
        start, free = base_fit([*suspects, *healthy])
        suspects, healthy, unseen = ([for_evidence(item) for item in each] for each in (suspects, healthy, unseen))
        evidence, baseline, named, solution = _select(start, free, suspects, healthy, augmented, (), progress)
        if named:
            # An effect swells the noise it is judged against, and bends the base it is judged about: what was found is kept out of
            # the noise, the base moves to the joint estimate, and all is judged anew.
            known = tuple(n.candidate for n in named)
            about = evidence.flights[0].moved(start, solution)
            evidence, baseline, named, solution = _select(about, free, suspects, healthy, augmented, known, progress)
        chosen = [*baseline, *((n.candidate, n.columns) for n in named)]
        progress(0.9, "what is left")
        left = dependences(evidence, chosen)
    except Refused as refusal:
        return Diagnosis(
            flight=name, vehicle=vehicle.name, verdict="refused", reason=str(refusal), next_flight=refusal.remedy
        )
    lag = [] if references else lag_findings(evidence, solution)
    plain = as_declared(evidence, vehicle) if lag or bend else None
    offset = sum(len(c.effect.parameters) for c, _ in baseline)
    forces = with_exponent(_findings(named, solution, vehicle, offset), bend, plain_gain(evidence, chosen, plain))
    before, after = base_parameters(evidence, vehicle, baseline, chosen, plain)
    findings = sorted([*lag, *forces, *kinematic, *scale_findings(vehicle, after)], key=lambda f: -f.gain)
    splits = splits_of(evidence, unseen)
    halves = splits if unseen else splits_of(evidence, (), 2)
    remaining = with_proposals(
        evidence,
        chosen,
        unexplained(left),
        lambda more: held_out_errors(evidence, chosen, list(more), splits),
    )
    if plain is not None:
        splits, halves = (with_plain(each, evidence, vehicle) for each in (splits, halves))
    error = held_out_errors(evidence, baseline, chosen, splits)
    progress(0.95, "predicting what no estimate saw")
    ahead, notes = forecast(evidence, baseline, chosen, splits, halves)
    worse = why_not(ahead) if findings else ""
    verdict = "unexplained" if remaining or worse else "explained" if findings else "clean"
    progress(1.0, "done")
    return Diagnosis(
        flight=name,
        vehicle=vehicle.name,
        verdict=verdict,
        findings=tuple(findings),
        unexplained=remaining,
        error={"held_out": error | ahead},
        parameters_before=before,
        parameters_after=after,
        covariance_after=base_covariance(evidence, vehicle, chosen),
        next_flight=_next_flight(findings, remaining),
        reason=" ".join(filter(None, (worse, _reason(verdict, findings, remaining)))),
        warnings=tuple(_warnings(suspects, references)),
        notes=notes,
        adopted=not worse,
        candidates=(
            *(
                {
                    "effect": n.candidate.identifier,
                    "settings": dict(n.candidate.settings),
                    "evidence": float(n.evidence),
                    "held_out_gain": n.gain,
                }
                for n in named
            ),
            *rival_entries(
                evidence,
                chosen,
                [(n.candidate, n.alternatives) for n in named],
                _pool(vehicle, evidence.flights[0], references=bool(healthy)),
            ),
        ),
        residual=residual_series(evidence, baseline, chosen, plain),
    )


def _by_trim(name: str, suspects: Sequence[Prepared], healthy: Sequence[Prepared]) -> Diagnosis:
    """What mean thrusts say, where the rates that a dynamic comparison needs were not measured."""
    found = compare_trims(suspects, healthy)
    shares = {c: min((rms / found.before[c]) ** 2, 1.0) for c, rms in found.after.items() if found.before[c] > 0.0}
    remaining = (
        ()
        if found.explained
        else tuple(Unexplained(c, share) for c, share in shares.items() if share > THRESHOLDS.trim_unexplained_share)
    )
    verdict = "unexplained" if remaining else "explained" if found.findings else "clean"
    return Diagnosis(
        flight=name,
        vehicle=suspects[0].record.vehicle.name,
        verdict=verdict,
        findings=found.findings,
        unexplained=remaining,
        error={
            "held_out": {
                "before": found.before,
                "after": found.after,
                "simulation_before": {},
                "simulation_after": {},
            }
        },
        next_flight=_next_flight(found.findings, ()),
        reason=_reason(verdict, found.findings, remaining),
        warnings=(
            "Body rates were not measured: only the mean thrusts are compared with those of the healthy flights, by the declared "
            "thrust curve. Yaw alone tells a load from a weak rotor there, and a battery or another day changes it, too; a gyro "
            "and rotor speeds would show inertia, and tell them apart.",
        ),
        notes=("Prediction and closed-loop simulation are left out: body rates were not measured.",),
    )


def base_fit(prepared: Sequence[Prepared]) -> tuple[Fitted, FitOptions]:
    """The fit that the evidence is linear about. What divides a lag from a dead time lies above the evidence's rate: it keeps its own there."""
    free = options_for(prepared[0])
    fitted = fit_dynamics(prepared if free.lag else [for_evidence(item) for item in prepared])
    return linearisation(fitted), fitted.options


def for_evidence(prepared: Prepared) -> Prepared:
    """Effects are slow: thin the fit to ``evidence_rate_hz``."""
    rate = 1.0 / float(np.median(np.diff(prepared.record.t_s)))
    block = max(prepared.record.block, round(rate / THRESHOLDS.evidence_rate_hz))
    return replace(prepared, record=replace(prepared.record, block=block))


def _select(
    about: Fitted,
    options: FitOptions,
    suspects: Sequence[Prepared],
    healthy: Sequence[Prepared],
    augmented: tuple[Candidate, ...],
    known: Sequence[Candidate],
    progress: Progress,
) -> tuple[Evidence, list[Entry], list[Named], Solution]:
    """Evidence with a noise model that leaves the known effects out, and what it asks for."""
    progress(0.5, "noise of each channel")
    evidence = Evidence(
        [FlightEvidence(item, about, options, (*augmented, *known)) for item in suspects],
        [FlightEvidence(item, about, options) for item in healthy],
    )
    vehicle = suspects[0].record.vehicle
    pool = [c for c in _pool(vehicle, evidence.flights[0], references=bool(healthy)) if not is_among(c, augmented)]
    baseline = _baseline(evidence, vehicle, augmented, references=bool(healthy))
    selection = Selection(evidence, pool, baseline, lambda f: progress(0.55 + 0.25 * f, "effects one by one"))
    progress(0.8, "selecting")
    chosen = selection.choose()
    if chosen:
        # What is kept out of the noise lest effects hide in it takes noise along, most at the lowest frequencies. What was chosen
        # has to stand against the noise as it is with nothing else kept out, too.
        shared = tuple(c for c, _ in baseline)
        plain = Evidence(
            [FlightEvidence(i, about, options, (*shared, *(c for c, _ in chosen)), generic=False) for i in suspects],
            [FlightEvidence(item, about, options, shared, generic=False) for item in healthy],
        )
        again = _baseline(plain, vehicle, augmented, references=bool(healthy))
        left = Selection(plain, (), again, variants=selection.variants).standing([c for c, _ in chosen])
        chosen = [entry for entry in chosen if entry[0] in left]
    return evidence, baseline, *selection.named(chosen)


def _pool(vehicle: Vehicle, first: FlightEvidence, *, references: bool) -> list[Candidate]:
    pool = candidates(vehicle, first.excited)
    if references:
        payload = library()["payload_change"]
        pool.append(Candidate(payload, {"at_s": -1.0, "within_s": 1.0}))
    return pool


def _baseline(evidence: Evidence, vehicle: Vehicle, augmented: Sequence[Candidate], *, references: bool) -> list[Entry]:
    """What is there in any case: effects that are known, and where there are reference flights what those share."""
    shared = shared_by_healthy() if references else []
    members = [Candidate(effect, {}) for effect in shared if effect.applies(vehicle)]
    found = ((candidate, evidence.columns(candidate, everywhere=True)) for candidate in (*members, *augmented))
    return [(candidate, columns) for candidate, columns in found if columns is not None]


def _findings(named: Sequence[Named], solution: Solution, vehicle: Vehicle, offset: int) -> list[Finding]:
    out = []
    for item in named:
        effect, settings = item.candidate.effect, dict(item.candidate.settings)
        count = len(effect.parameters)
        values, covariance = solution.part(offset, count)
        offset += count
        std = np.sqrt(np.diag(covariance))
        rotor = int(settings.pop("rotor")) if effect.of_one_rotor else None
        parameters = {n: Estimate.normal(v, s) for n, v, s in zip(effect.names(), values, std, strict=True)}
        parameters |= {n: Estimate(v, 0.0, (v, v)) for n, v in settings.items()}
        values = {name: estimate.value for name, estimate in parameters.items()}
        out.append(
            Finding(
                effect=effect.identifier,
                parameters=parameters,
                evidence=told(effect.sentence, **values, rotor=str(rotor)),
                confidence=item.confidence,
                alternatives=item.alternatives,
                rotor=rotor,
                gain=item.gain,
            )
        )
    return out


def _next_flight(findings: Sequence[Finding], remaining: Sequence[Unexplained]) -> str:
    """The manoeuvre that separates what this flight could not."""
    effects = catalogue()
    parts = []
    for finding in findings:
        if finding.alternatives:
            rivals = ", ".join(finding.alternatives)
            parts.append(f"To tell {finding.effect} from {rivals}: {effects[finding.effect].manoeuvre}.")
    if remaining:
        where = ", ".join(sorted({v for item in remaining for v in item.depends_on}))
        parts.append(
            f"Something unknown varies with {where}: fly slowly over its whole range, twice, in opposite directions."
        )
    return " ".join(parts)


def _reason(verdict: str, findings: Sequence[Finding], remaining: Sequence[Unexplained]) -> str:
    if verdict == "clean":
        return "No effect beats chance; what is left is this flight's own disturbance and sensor noise."
    if verdict == "explained":
        return f"{len(findings)} effect{'s' if len(findings) > 1 else ''} found; the rest is disturbance and noise."
    if not remaining:
        return ""
    channels = ", ".join(item.channel for item in remaining)
    return f"A residual remains in {channels} that depends on the motion and that no known effect removes."


def _warnings(suspects: Sequence[Prepared], references: Sequence[FlightData]) -> list[str]:
    out = []
    if any(item.planned is None for item in suspects):
        out.append(
            "No plan or setpoints are recorded: without instruments a flexible effect of the inputs can soak up a disturbance."
        )
    if any(item.source != "imu" for item in suspects):
        out.append("Rates and accelerations are derived, not measured: small torques cannot be told.")
    return out
